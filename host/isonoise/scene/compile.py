"""Scene description -> CompiledScene: flat world-space arrays for the device."""

import hashlib

import numpy as np

from isonoise.errors import SceneError
from isonoise.scene import structs, vocabulary
from isonoise.scene.accel.bounds import instance_extents
from isonoise.scene.camera import compile_camera
from isonoise.scene.compiled_scene import CompiledScene
from isonoise.scene.image.image import read_image
from isonoise.scene.instances import instance_records, split_instances
from isonoise.scene.light import lights as lighting
from isonoise.scene.light.alias_table import alias_table, selection_probabilities
from isonoise.scene.light.envmap import EnvironmentMap, build_environment_map
from isonoise.scene.material.bsdfs import Bsdfs, mark_pass_through, reads_uvs
from isonoise.scene.material.media import Media
from isonoise.scene.material.textures import MeshAttributes, Textures, is_plain, mesh_attributes_used
from isonoise.scene.mesh.surfaces import Surface, make_surface

_DIFFUSE = {"type": "diffuse", "reflectance": 0.5}  # Mitsuba 3's material of a shape that names none,
_BLACK = {"type": "diffuse", "reflectance": 0.0}  # and where it shines
_PATH = {"type": "path", "max_depth": -1, "rr_depth": 5, "hide_emitters": False}
_DIRECT_DEPTH = 2  # light that arrives over one bounce
_LARGEST = float(np.finfo(np.float32).max)
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
    volumetric = integrator["type"] in ("volpath", "volpathmis")
    world, groups, placed = split_instances(_of_kind(description, "shape"))
    spaces = [{where: make_surface(shape, where) for where, shape in shapes.items()} for shapes in (world, *groups)]
    for part, surfaces in zip((world, *groups), spaces, strict=True):
        _check_attributes(part, surfaces)
    instances = instance_records(placed)
    bounds = _bounds(spaces, instances, list(placed))
    shapes = [shape for space in (world, *groups) for shape in space.values()]
    surfaces = [surface for space in spaces for surface in space.values()]
    geometry = _Geometry(shapes, surfaces, volumetric, sensor.get("medium"))
    emitters = _of_kind(description, "emitter")
    sky = next((_sky(emitter, name) for name, emitter in emitters.items() if emitter["type"] == "envmap"), None)
    lights, alias, environment, scale = _lights(geometry, list(emitters.values()), sky, bounds)
    arrays = {
        "camera": camera,
        "vertices": geometry.vertices,
        "faces": geometry.faces,
        "vertex_normals": geometry.normals,
        "triangle_shape": geometry.triangle_shape,
        "analytics": geometry.analytics,
        "shapes": geometry.shapes,
        "instances": instances,
        "group_offsets": _group_begins(spaces),
        "bsdfs": geometry.bsdfs,
        "rough_transmittances": geometry.boundaries,
        "media": geometry.media,
        "reversed_winding": geometry.reversed_winding,
        "uvs": geometry.uvs,
        "textures": geometry.textures.records,
        "texel_bytes": geometry.textures.bytes,
        "texel_floats": geometry.textures.floats,
        "attributes": geometry.textures.attributes,
        "lights": lights,
        "light_alias": alias,
        "bounds": bounds.astype(np.float32),
    }
    facts = {
        "filter": filter_name,
        "max_depth": depth if max_depth is None else max_depth,
        "rr_depth": integrator.get("rr_depth", _PATH["rr_depth"]) + volumetric,  # Mitsuba 3 begins one later there
        "hide_emitters": integrator["hide_emitters"],
        "volumetric": volumetric,
        "sensor_medium": geometry.sensor_medium,
        "environment_light": environment,
        "radiance_scale": scale,
    }
    sample_count = sensor.get("sampler", {}).get("sample_count", _SAMPLE_COUNT)
    hashed = arrays if sky is None else arrays | {"sky": sky.texels, "sky_record": sky.record}
    return CompiledScene(**arrays, **facts, environment=sky, sample_count=sample_count, hash=_hash(hashed, facts))


def _sky(emitter: dict, name: str) -> EnvironmentMap:
    where = f"emitter '{name}'"
    return build_environment_map(
        read_image(emitter["filename"]), emitter.get("to_world", np.eye(4)), emitter["scale"], where
    )


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


def _bounds(spaces: list[dict[str, Surface]], instances: np.ndarray, names: list[str]) -> np.ndarray:
    """(2, 3) float64 corners of the box around all that stands in the world, zeros if that is nothing.

    `spaces` are the surfaces of the world and of every group, `names` those of the instances.
    """
    boxes = [_box({where: surface.bounds for where, surface in space.items()}) for space in spaces]
    if len(instances):
        extents = np.stack(instance_extents(instances, np.stack(boxes)[instances["root"]]), axis=1)
        in_world = _box(dict(zip(names, extents, strict=True)))
        boxes[0] = _box({"world": boxes[0], "instances": in_world}) if spaces[0] else in_world
    return boxes[0]


def _box(boxes: dict[str, np.ndarray]) -> np.ndarray:
    """The box (2, 3) around boxes, which go by the names of what they hold; zeros around nothing."""
    if not boxes:
        return np.zeros((2, 3))
    corners = np.stack(list(boxes.values()))
    farthest = int(np.argmax(np.abs(corners).max(axis=(1, 2))))
    if not np.abs(corners[farthest]).max() <= _FARTHEST:
        raise SceneError(f"{list(boxes)[farthest]} reaches beyond {_FARTHEST:g}: its distances overflow 32-bit floats")
    return np.stack([corners[:, 0].min(axis=0), corners[:, 1].max(axis=0)])


def _check_attributes(shapes: dict[str, dict], surfaces: dict[str, Surface]) -> None:
    """Raise SceneError where a material or a light reads an attribute that its shape does not have."""
    read: dict[int, set[str]] = {}
    for where, shape in shapes.items():
        for part in (shape[name] for name in ("bsdf", "emitter") if name in shape):
            if id(part) not in read:
                read[id(part)] = mesh_attributes_used(part)
            for name in sorted(read[id(part)] - surfaces[where].attributes.keys()):
                having = ", ".join(surfaces[where].attributes) or "none"
                raise SceneError(
                    f"{where} has no attribute '{name}', which its {part['type']} reads (it has: {having})"
                )


def _group_begins(spaces: list[dict[str, Surface]]) -> np.ndarray:
    """(groups + 1, 2) uint32: triangles and analytic primitives before each group (the world comes first), and all."""
    counts = [
        [sum(len(s.faces) for s in space.values()), sum(s.analytic is not None for s in space.values())]
        for space in spaces
    ]
    return np.cumsum(counts, axis=0, dtype=np.uint32)


class _Geometry:
    """All surfaces in common arrays; media and what is seen through only if the integrator is volumetric."""

    def __init__(self, shapes: list[dict], surfaces: list[Surface], volumetric: bool, sensor_medium: dict | None):
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
        self._textures = textures = Textures()
        bsdfs, analytics, first_face = Bsdfs(textures.index), [], 0
        media = Media(bsdfs)
        self.sensor_medium = media.index(sensor_medium if volumetric else None)
        for index, (shape, surface) in enumerate(zip(shapes, surfaces, strict=True)):
            flags = structs.SHAPE_VERTEX_NORMALS if len(surface.normals) else 0
            flags |= structs.SHAPE_FLIP_NORMALS if surface.flip else 0
            primitive = first_face if surface.analytic is None else len(analytics)
            bsdf = shape.get("bsdf", _BLACK if "emitter" in shape else _DIFFUSE)
            sides = media.sides(shape) if volumetric else structs.NONE
            self.shapes[index] = (bsdfs.index(bsdf), structs.NONE, primitive, flags, sides)
            if "emitter" in shape:
                self.emissive.append((index, shape["emitter"], surface))
                self.radiance_texture(shape["emitter"])  # enters it
            if surface.analytic is None:
                first_face += len(surface.faces)
            else:
                surface.analytic["shape"] = index
                analytics.append(surface.analytic)
        self.analytics = np.concatenate(analytics) if analytics else np.zeros(0, structs.ANALYTIC)
        self.bsdfs, self.boundaries, self.media = bsdfs.records, bsdfs.tables, media.records
        if volumetric:
            self.shapes["flags"][mark_pass_through(self.bsdfs)[self.shapes["bsdf"]]] |= structs.SHAPE_PASS_THROUGH
        self.textures = textures.arrays(
            [MeshAttributes(len(mesh.vertices), len(mesh.faces), mesh.attributes) for mesh in meshes]
        )
        self.uvs, self.reversed_winding = np.zeros((0, 2), np.float32), np.zeros(0, bool)
        textured = any(self.radiance_texture(emitter) != structs.NONE for _, emitter, _ in self.emissive)
        read = textured or reads_uvs(self.bsdfs)
        if read and not all(len(mesh.uvs) for mesh in meshes):
            self.reversed_winding = np.concatenate([mesh.reversed_winding for mesh in meshes])
        if read and any(len(mesh.uvs) for mesh in meshes):
            self.uvs = np.concatenate(
                [mesh.uvs if len(mesh.uvs) else np.zeros((len(mesh.vertices), 2), np.float32) for mesh in meshes]
            )
            having = [surface.analytic is None and len(surface.uvs) > 0 for surface in surfaces]
            self.shapes["flags"][having] |= structs.SHAPE_UVS

    def radiance_texture(self, emitter: dict) -> int:
        """The index of the texture that an area emitter's radiance is, NONE if it is plain."""
        return structs.NONE if is_plain(emitter["radiance"]) else self._textures.index(emitter["radiance"], "radiance")

    def emitted(self, emitter: dict) -> np.ndarray:
        """Linear RGB (3,) of an area emitter's radiance, of a texture its mean."""
        texture = self.radiance_texture(emitter)
        return lighting.emitted(emitter) if texture == structs.NONE else self._textures.mean(texture)


def _stack(arrays: list[np.ndarray], dtype) -> np.ndarray:
    return np.concatenate(arrays).astype(dtype, copy=False) if arrays else np.zeros((0, 3), dtype)


def _lights(
    geometry: _Geometry, emitters: list[dict], sky: EnvironmentMap | None, bounds: np.ndarray
) -> tuple[np.ndarray, np.ndarray, int, float]:
    """(lights, alias table, index of the light beyond the scene or -1, radiance_scale); enters first_light into the
    shapes, and the scale into the sky."""
    values = [geometry.emitted(emitter) for _, emitter, _ in geometry.emissive]
    values += [sky.mean if emitter["type"] == "envmap" else lighting.emitted(emitter) for emitter in emitters]
    scale = lighting.radiance_scale([*values, *([np.full(3, sky.largest)] if sky else [])])
    parts, count = [], 0
    for (index, emitter, surface), value in zip(geometry.emissive, values[: len(geometry.emissive)], strict=True):
        kind = None if surface.analytic is None else int(surface.analytic["kind"][0])
        first = int(geometry.shapes["first_primitive"][index])
        texture = geometry.radiance_texture(emitter)
        parts.append(lighting.surface_lights(kind, first, surface.areas, value * scale, texture))
        geometry.shapes["first_light"][index] = count
        count += len(parts[-1])
    parts += [
        lighting.emitter_light(emitter, value * scale)
        for emitter, value in zip(emitters, values[len(geometry.emissive) :], strict=True)
    ]
    if sky is not None:
        with np.errstate(over="ignore"):  # the check below tells
            sky.record["scale"] *= scale
    if not parts:
        return np.zeros(0, structs.LIGHT), np.zeros(0, structs.ALIAS), -1, scale
    lights = np.concatenate(parts)
    if not np.isfinite(lights["radiance"]).all():
        raise SceneError("an emitter's colour leaves the range of 32-bit floats")
    textured = lights["texture"] != structs.NONE
    if (textured.any() and scale > _LARGEST) or (sky is not None and not np.isfinite(sky.record["scale"]).all()):
        raise SceneError("the lights are so dim that images in them leave the range of 32-bit floats")
    beyond = np.flatnonzero(np.isin(lights["kind"], (structs.LIGHT_CONSTANT, structs.LIGHT_ENVIRONMENT_MAP)))
    alias = alias_table(lighting.light_selection_pmf(lights, bounds))
    lights["selection_pmf"] = selection_probabilities(alias)
    if textured.any():
        lights["radiance"][textured] = scale  # times the texture
    return lights, alias, int(beyond[0]) if len(beyond) else -1, scale
