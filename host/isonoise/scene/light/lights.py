"""Lights of a scene: one record per emissive primitive or emitter, selected in proportion to their power.

Called by `scene.compile`, the light list and the light tree. The kinds of light are in `light_kinds`.
"""

import math

import numpy as np

from isonoise.errors import SceneError
from isonoise.scene import structs
from isonoise.scene.compiled_scene import CompiledScene
from isonoise.scene.light.light_bounds import LightBounds, bounding_radius
from isonoise.scene.light.light_kinds import AREA, KIND_OF_PLUGIN, KINDS, LightKind, kind_of_emitter, light_bits
from isonoise.scene.spectra import MITSUBA_LUMINANCE, colour_to_rgb

_MAX_EXPONENT = 1000  # within float64
_CDF_UNITS = 2**48  # as many as there are random numbers


def emitted(emitter: dict) -> np.ndarray:
    """Linear RGB (3,) float64 of what an emitter emits, in its own unit."""
    kind = KINDS["triangle"] if emitter["type"] == AREA else kind_of(emitter)
    return colour_to_rgb(emitter[kind.emission], "radiance")


def radiance_scale(values: list[np.ndarray]) -> float:
    """2^-floor(log2(max luminance)): brings the brightest emitter into [1, 2). 1 without light."""
    brightest = max((float(value @ MITSUBA_LUMINANCE) for value in values), default=0.0)
    if not brightest > 0:
        return 1.0
    return 2.0 ** min(max(1 - math.frexp(brightest)[1], -_MAX_EXPONENT), _MAX_EXPONENT)


def surface_lights(kind: str, primitives: np.ndarray, areas: np.ndarray) -> np.ndarray:
    """Lights (n,) of a kind on primitives (n,) with areas (n,), without radiance."""
    lights = np.zeros(len(areas), structs.LIGHT)
    lights["kind"] = light_bits(kind)
    lights["primitive"] = primitives
    lights["area"] = areas
    return lights


def emitter_light(emitter: dict, value: np.ndarray) -> np.ndarray:
    """The light (1,) of an emitter without surface."""
    kind = kind_of(emitter)
    light = np.zeros(1, structs.LIGHT)
    light["kind"] = light_bits(kind.name)
    light["primitive"] = light["texture"] = structs.NONE
    light["radiance"] = value
    for member, number in kind.record(emitter).items():
        light[member] = number
    return light


def kind_of(emitter: dict) -> LightKind:
    """The kind of an emitter without surface."""
    kind = kind_of_emitter(emitter)
    if kind is None:
        known = ", ".join(sorted(KIND_OF_PLUGIN))
        raise SceneError(f"emitter '{emitter['type']}' has no row in light_kinds.py (it has: {known})")
    return kind


def light_power_pmf(lights: np.ndarray, bounds: np.ndarray) -> np.ndarray:
    """Probabilities (l,) float64 in proportion to power, summing to 1.

    Power is pi A L for a surface, 4 pi I for a point, that of the cone for a spot; directional and environment lights
    count what enters the sphere around the scene: pi r^2 E and 4 pi^2 r^2 L, as in pbrt's and Mitsuba's power light
    samplers. All zero is uniform.
    """
    radius = bounding_radius(bounds)
    factor = np.zeros(len(lights))
    for kind, of_kind in _by_kind(lights):
        factor[of_kind] = kind.power_factor(lights[of_kind], radius)
    power = factor * (lights["radiance"].astype(np.float64) @ MITSUBA_LUMINANCE)
    largest = power.max()
    if not largest > 0:
        return np.full(len(lights), 1.0 / len(lights))
    power /= largest  # so that the sum of a million powers of 1e38 stays finite
    return power / power.sum()


def light_power_cdf(pmf: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Inverse of a discrete distribution (l,) for the kernels, and the probabilities with which that selects.

    Returns
    -------
    cdf : (l, 2) float32, a and b below 2^24 over 2^24: a + 2^-24 b is the sum of the probabilities before each light
    pmf : (l,) float64; above 0 where the argument is
    """
    raised = np.where(pmf > 0, np.maximum(pmf, 2.0 / _CDF_UNITS), 0.0)  # at least one unit after rounding
    bounds = np.rint(np.cumsum(raised) * (_CDF_UNITS / raised.sum())).astype(np.uint64)
    bounds[np.flatnonzero(pmf)[-1] :] = _CDF_UNITS
    cdf = np.append(np.uint64(0), bounds[:-1])
    high_and_low = np.stack([cdf >> np.uint64(24), cdf & np.uint64(2**24 - 1)], axis=1)
    return (high_and_low * 2.0**-24).astype(np.float32), (bounds - cdf) / _CDF_UNITS


def compute_light_bounds(scene: CompiledScene, lights: np.ndarray) -> LightBounds:
    """Bounds of lights (n,): where they and their normals are, and how much they emit."""
    count = len(lights)
    made = LightBounds(*(np.zeros((3, count)) for _ in range(3)), *(np.zeros(count) for _ in range(4)))
    for kind, of_kind in _by_kind(lights):
        power = lights["power_pmf"][of_kind].astype(np.float64)
        made[of_kind] = kind.bounds(scene, lights[of_kind], power)
    return made


def _by_kind(lights: np.ndarray) -> list[tuple[LightKind, np.ndarray]]:
    """Kinds that are there, with the mask (n,) of their lights."""
    masks = [(kind, lights["kind"] == light_bits(name)) for name, kind in KINDS.items()]
    return [(kind, mask) for kind, mask in masks if mask.any()]
