"""Maps pbrt's media to Mitsuba's. Called by `scene_builder.py`."""

import numpy as np

from isonoise.scene import transforms
from isonoise.scene.formats.mesh_shape import rgb
from isonoise.scene.formats.pbrt.colours import Colours
from isonoise.scene.formats.pbrt.parameters import SPECTRUM_TYPES, Parameters
from isonoise.scene.formats.report import ImportReport

_MEDIA = ("homogeneous", "uniformgrid", "rgbgrid", "cloud", "nanovdb", "heterogeneous")
PRESETS = {
    "Apple": ((2.29, 2.39, 1.97), (0.0030, 0.0034, 0.046)),
    "Chicken1": ((0.15, 0.21, 0.38), (0.015, 0.077, 0.19)),
    "Chicken2": ((0.19, 0.25, 0.32), (0.018, 0.088, 0.20)),
    "Cream": ((7.38, 5.47, 3.15), (0.0002, 0.0028, 0.0163)),
    "Ketchup": ((0.18, 0.07, 0.03), (0.061, 0.97, 1.45)),
    "Marble": ((2.19, 2.62, 3.00), (0.0021, 0.0041, 0.0071)),
    "Potato": ((0.68, 0.70, 0.55), (0.0024, 0.0090, 0.12)),
    "Skimmilk": ((0.70, 1.22, 1.90), (0.0014, 0.0025, 0.0142)),
    "Skin1": ((0.74, 0.88, 1.01), (0.032, 0.17, 0.48)),
    "Skin2": ((1.09, 1.59, 1.79), (0.013, 0.070, 0.145)),
    "Spectralon": ((11.6, 20.4, 14.9), (0.0, 0.0, 0.0)),
    "Wholemilk": ((2.55, 3.21, 3.77), (0.0011, 0.0024, 0.014)),
}
"""Reduced scattering and absorption coefficients, 1 / mm, by pbrt's names. H. W. Jensen et al., "A Practical Model for
Subsurface Light Transport", SIGGRAPH 2001."""
_MAX_ANISOTROPY = 0.9999
_MAX_GRID_CELLS = 1 << 28


def make_medium(parameters: Parameters, to_world: np.ndarray, colours: Colours, report: ImportReport) -> dict | None:
    """The medium of a directive `MakeNamedMedium`; None if it is left out."""
    kind = parameters.text("type", "homogeneous")
    if kind not in _MEDIA:
        parameters.position_of("type").raise_unknown("unknown medium", kind, _MEDIA)
    report.use("media")
    report.count("media")
    place = parameters.position.place
    if kind in ("rgbgrid", "cloud", "nanovdb"):
        report.limit("media", f"the medium '{kind}' is left out", place)
        parameters.ignore(*(value.name for value in parameters.unused()))
        return None
    for name in ("Le", "temperature"):
        emission = parameters.find(name)
        if emission is not None and (emission.is_texts or emission.values.any()):
            report.limit("media", "the emission of a medium is ignored", place)
    parameters.ignore(
        "Le", "Lescale", "Legrid", "temperature", "temperaturescale", "temperatureoffset", "temperaturecutoff"
    )
    phase = _phase(parameters)
    scale = parameters.number("scale", 1.0)
    if scale < 0:
        parameters.position_of("scale").raise_error("'scale' of a medium cannot be negative")
    if kind != "homogeneous":
        return _grid(parameters, to_world, colours) | {"scale": scale, "phase": phase}
    sigma_a, sigma_s = _coefficients(parameters, colours, report)
    largest = float((sigma_a + sigma_s).max()) or 1.0  # Mitsuba refuses an rgb sigma_t above 1
    medium = _collisions(sigma_a / largest, sigma_s / largest)
    return medium | {"type": "homogeneous", "scale": scale * largest, "phase": phase}


def _phase(parameters: Parameters) -> dict:
    g = parameters.number("g", 0.0)
    if abs(g) > 1:
        parameters.position_of("g").raise_error(f"g has to be -1 to 1, got {g:g}")
    return {"type": "hg", "g": min(max(g, -_MAX_ANISOTROPY), _MAX_ANISOTROPY)} if g else {"type": "isotropic"}


def _coefficients(parameters: Parameters, colours: Colours, report: ImportReport) -> tuple[np.ndarray, np.ndarray]:
    """Absorption and scattering coefficients of a homogeneous medium, (3,) each."""
    name = parameters.text("preset", "")
    if name and name not in PRESETS:
        report.limit("media", "an unknown preset of a medium is replaced by whole milk", name)
    scattering, absorption = PRESETS.get(name, PRESETS["Wholemilk"])
    if name in PRESETS:
        parameters.ignore("sigma_a", "sigma_s")
        return np.array(absorption), np.array(scattering)
    values = [parameters.find(other, "float", *SPECTRUM_TYPES) for other in ("sigma_a", "sigma_s")]
    return tuple(
        np.array(default) if value is None else colours.unbounded(value)
        for value, default in zip(values, (absorption, scattering), strict=True)
    )


def _collisions(sigma_a: np.ndarray, sigma_s: np.ndarray) -> dict:
    sigma_t = sigma_a + sigma_s
    albedo = np.divide(sigma_s, sigma_t, out=np.zeros(3), where=sigma_t > 0)
    return {"sigma_t": rgb(sigma_t), "albedo": rgb(np.clip(albedo, 0, 1))}


def _grid(parameters: Parameters, to_world: np.ndarray, colours: Colours) -> dict:
    """`uniformgrid`, in pbrt-v3 `heterogeneous`: a density on a grid in a box, times sigma_a and sigma_s."""
    density = parameters.array("density", ("float",))
    if density is None:
        parameters.position.raise_error('the medium needs "float density"')
    shape = tuple(parameters.integer(name, 1) for name in ("nz", "ny", "nx"))
    if min(shape) < 1 or np.prod(shape, dtype=float) > _MAX_GRID_CELLS or len(density) != np.prod(shape):
        parameters.position_of("density").raise_error(
            f"'density' has {len(density)} values for a grid of {shape[2]} x {shape[1]} x {shape[0]}"
        )
    if density.min() < 0:
        parameters.position_of("density").raise_error("a density cannot be negative")
    low = parameters.vector("p0", (0.0, 0.0, 0.0))
    high = parameters.vector("p1", (1.0, 1.0, 1.0))
    if not (high > low).all():
        parameters.position_of("p1").raise_error("p1 has to exceed p0 along all axes")
    values = [parameters.find(name, "float", *SPECTRUM_TYPES) for name in ("sigma_a", "sigma_s")]
    sigma_a, sigma_s = (np.ones(3) if value is None else colours.unbounded(value) for value in values)
    collisions = _collisions(sigma_a, sigma_s)
    sigma_t = np.array(collisions["sigma_t"]["value"])
    grid = density.reshape(shape).astype(np.float32)
    data = grid * np.float32(sigma_t[0]) if np.ptp(sigma_t) == 0 else grid[..., None] * sigma_t.astype(np.float32)
    box = to_world @ transforms.translate(low) @ transforms.scale(high - low)
    volume = {"type": "gridvolume", "data": data, "to_world": box}
    return {"type": "heterogeneous", "sigma_t": volume, "albedo": collisions["albedo"]}
