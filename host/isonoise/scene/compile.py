"""Scene description -> CompiledScene: flat world-space arrays for the device."""

import hashlib

import numpy as np

from isonoise.errors import SceneError
from isonoise.scene import lights as lighting
from isonoise.scene import structs, vocabulary
from isonoise.scene.camera import compile_camera
from isonoise.scene.compiled import CompiledScene
from isonoise.scene.materials import MIRROR, conductors
from isonoise.scene.spectra import colour_to_rgb
from isonoise.scene.surfaces import Surface, make_surface

_DIFFUSE = {"type": "diffuse", "reflectance": 0.5}  # Mitsuba 3's material of a shape that names none,
_BLACK = {"type": "diffuse", "reflectance": 0.0}  # and where it shines
_PATH = {"type": "path", "max_depth": -1, "rr_depth": 5, "hide_emitters": False}
_DIRECT_DEPTH = 2  # light that arrives over one bounce
_FARTHEST = 1e18  # the square of a distance, 1.2e37 at most, fits in 32-bit floats
_SAMPLE_COUNT = 4  # Mitsuba 3's, where there is no sampler


def compile_scene(
    description: dict, size: tuple[int, int] | None = None, max_depth: int | None = None
) -> CompiledScene:
    """Flatten a description made by `load`.

    `size` (width, height) replaces the film's size, `max_depth` the integrator's. Raises SceneError where a mesh
    cannot be read or numbers leave the range of the device.
    """
    sensor = next(iter(_of_kind(description, "sensor").values()))
    camera, filter_name = compile_camera(sensor, size)
    integrator = next(iter(_of_kind(description, "integrator").values()), _PATH)
    depth = _DIRECT_DEPTH if integrator["type"] == "direct" else integrator["max_depth"]
    shapes = _of_kind(description, "shape")
    surfaces = [make_surface(shape, f"shape '{name}'") for name, shape in shapes.items()]
    bounds = _bounds(list(shapes), surfaces)
    geometry = _Geometry(list(shapes.values()), surfaces)
    lights, alias, environment, scale = _lights(geometry, list(_of_kind(description, "emitter").values()), bounds)
    arrays = {
        "camera": camera,
        "vertices": geometry.vertices,
        "faces": geometry.faces,
        "vertex_normals": geometry.normals,
        "triangle_shape": geometry.triangle_shape,
        "analytics": geometry.analytics,
        "shapes": geometry.shapes,
        "bsdfs": geometry.bsdfs,
        "lights": lights,
        "light_alias": alias,
        "bounds": bounds.astype(np.float32),
    }
    facts = {
        "filter": filter_name,
        "max_depth": depth if max_depth is None else max_depth,
        "rr_depth": integrator.get("rr_depth", _PATH["rr_depth"]),
        "hide_emitters": integrator["hide_emitters"],
        "environment_light": environment,
        "radiance_scale": scale,
    }
    sample_count = sensor.get("sampler", {}).get("sample_count", _SAMPLE_COUNT)
    return CompiledScene(**arrays, **facts, sample_count=sample_count, hash=_hash(arrays, facts))


def _of_kind(description: dict, kind: str) -> dict[str, dict]:
    names = vocabulary.plugins_of(kind)
    return {k: v for k, v in description.items() if isinstance(v, dict) and v["type"] in names}


def _hash(arrays: dict[str, np.ndarray], facts: dict) -> str:
    """Digest of everything that the picture follows from; file names and ids are not in it."""
    digest = hashlib.blake2b(repr(sorted(facts.items())).encode(), digest_size=16)
    for name, array in arrays.items():
        digest.update(f"{name}{array.shape}".encode())
        digest.update(np.ascontiguousarray(array).data.cast("B") if array.size else b"")
    return digest.hexdigest()


def _bounds(names: list[str], surfaces: list[Surface]) -> np.ndarray:
    """(2, 3) float64 corners of the box around all surfaces, zeros if there are none."""
    if not surfaces:
        return np.zeros((2, 3))
    boxes = np.stack([surface.bounds for surface in surfaces])
    farthest = int(np.argmax(np.abs(boxes).max(axis=(1, 2))))
    if not np.abs(boxes[farthest]).max() <= _FARTHEST:
        raise SceneError(
            f"shape '{names[farthest]}' reaches beyond {_FARTHEST:g}: its distances overflow 32-bit floats"
        )
    return np.stack([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])


class _Geometry:
    """All surfaces in common arrays."""

    def __init__(self, shapes: list[dict], surfaces: list[Surface]):
        meshes = [s for s in surfaces if s.analytic is None]
        first_vertex = np.cumsum([0, *(len(m.vertices) for m in meshes)])
        self.vertices = _stack([m.vertices for m in meshes], np.float32)
        offsets = first_vertex[:-1].astype(np.uint32)
        self.faces = _stack([m.faces + offset for m, offset in zip(meshes, offsets, strict=True)], np.uint32)
        self.normals = np.zeros((0, 3), np.float32)
        if any(len(m.normals) for m in meshes):
            self.normals = _stack(
                [m.normals if len(m.normals) else np.zeros_like(m.vertices) for m in meshes], np.float32
            )
        self.shapes = np.zeros(len(shapes), structs.SHAPE)
        self.triangle_shape = np.repeat(
            np.array([i for i, s in enumerate(surfaces) if s.analytic is None], np.uint32),
            [len(m.faces) for m in meshes],
        )
        self.emissive: list[tuple[int, dict, Surface]] = []
        self.bsdfs, analytics, first_face = _Bsdfs(), [], 0
        for index, (shape, surface) in enumerate(zip(shapes, surfaces, strict=True)):
            flags = structs.SHAPE_VERTEX_NORMALS if len(surface.normals) else 0
            flags |= structs.SHAPE_FLIP_NORMALS if surface.flip else 0
            primitive = first_face if surface.analytic is None else len(analytics)
            bsdf = shape.get("bsdf", _BLACK if "emitter" in shape else _DIFFUSE)
            self.shapes[index] = (self.bsdfs.index(bsdf), structs.NONE, primitive, flags)
            if "emitter" in shape:
                self.emissive.append((index, shape["emitter"], surface))
            if surface.analytic is None:
                first_face += len(surface.faces)
            else:
                surface.analytic["shape"] = index
                analytics.append(surface.analytic)
        self.analytics = np.concatenate(analytics) if analytics else np.zeros(0, structs.ANALYTIC)
        self.bsdfs = np.concatenate(self.bsdfs.records) if self.bsdfs.records else np.zeros(0, structs.BSDF)


def _stack(arrays: list[np.ndarray], dtype) -> np.ndarray:
    return np.concatenate(arrays).astype(dtype, copy=False) if arrays else np.zeros((0, 3), dtype)


class _Bsdfs:
    """Material records, equal ones once."""

    def __init__(self):
        self.records: list[np.ndarray] = []
        self.known: dict[bytes, int] = {}

    def index(self, bsdf: dict) -> int:
        record = _bsdf(bsdf)
        if record.tobytes() not in self.known:
            self.known[record.tobytes()] = len(self.records)
            self.records.append(record)
        return self.known[record.tobytes()]


def _bsdf(bsdf: dict) -> np.ndarray:
    record = np.zeros(1, structs.BSDF)
    if bsdf["type"] == "twosided":
        record["flags"] = structs.BSDF_TWOSIDED
        bsdf = bsdf["bsdf"]
    if bsdf["type"] == "diffuse":
        record["kind"] = structs.BSDF_DIFFUSE
        record["reflectance"] = colour_to_rgb(bsdf["reflectance"], "reflectance")
        return record
    record["reflectance"] = colour_to_rgb(bsdf["specular_reflectance"], "reflectance")
    if bsdf["type"] == "dielectric":
        record["kind"] = structs.BSDF_DIELECTRIC
        record["transmittance"] = colour_to_rgb(bsdf["specular_transmittance"], "reflectance")
        record["eta"] = bsdf["int_ior"] / bsdf["ext_ior"]
        return record
    record["kind"] = structs.BSDF_CONDUCTOR
    eta, k = conductors()[bsdf.get("material", MIRROR)]
    record["eta"] = colour_to_rgb(bsdf["eta"], "unbounded") if "eta" in bsdf else eta
    record["k"] = colour_to_rgb(bsdf["k"], "unbounded") if "k" in bsdf else k
    return record


def _lights(geometry: _Geometry, emitters: list[dict], bounds: np.ndarray) -> tuple[np.ndarray, np.ndarray, int, float]:
    """(lights, alias table, index of the constant light or -1, radiance_scale); enters first_light into the shapes."""
    values = [lighting.emitted(emitter) for _, emitter, _ in geometry.emissive]
    values += [lighting.emitted(emitter) for emitter in emitters]
    scale = lighting.radiance_scale(values)
    parts, count = [], 0
    for (index, _, surface), value in zip(geometry.emissive, values[: len(geometry.emissive)], strict=True):
        kind = None if surface.analytic is None else int(surface.analytic["kind"][0])
        first = int(geometry.shapes["first_primitive"][index])
        parts.append(lighting.surface_lights(kind, first, surface.areas, value * scale))
        geometry.shapes["first_light"][index] = count
        count += len(parts[-1])
    parts += [
        lighting.emitter_light(emitter, value * scale)
        for emitter, value in zip(emitters, values[len(geometry.emissive) :], strict=True)
    ]
    if not parts:
        return np.zeros(0, structs.LIGHT), np.zeros(0, structs.ALIAS), -1, scale
    lights = np.concatenate(parts)
    if not np.isfinite(lights["radiance"]).all():
        raise SceneError("an emitter's colour leaves the range of 32-bit floats")
    constant = np.flatnonzero(lights["kind"] == structs.LIGHT_CONSTANT)
    alias = lighting.alias_table(lighting.pick_probabilities(lights, bounds))
    lights["pick_probability"] = lighting.picked(alias)
    return lights, alias, int(constant[0]) if len(constant) else -1, scale
