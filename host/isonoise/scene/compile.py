"""Compiles a scene description, as `load` returns it, to a CompiledScene: flat world-space arrays for the device."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from isonoise.errors import SceneError
from isonoise.limits import MAX_DEPTH
from isonoise.scene import structs, vocabulary
from isonoise.scene.accel.bounds import instance_extents
from isonoise.scene.camera import compile_camera, warn_if_clipped
from isonoise.scene.compile_cache import CompileCache
from isonoise.scene.compiled_scene import CompiledScene
from isonoise.scene.geometry import (
    Boxes,
    Layout,
    group_offsets,
    merge_analytics,
    merge_meshes,
    merge_uvs,
    shape_boxes,
)
from isonoise.scene.image.image import Image, read_image
from isonoise.scene.instances import Space, Spaces, instance_records, split_instances
from isonoise.scene.light.compile_lights import (
    ANALYTIC_LIGHTS,
    AreaLight,
    compile_lights,
    projected_texture,
    radiance_texture,
    raise_too_dim,
)
from isonoise.scene.light.envmap import EnvironmentMap, build_environment_map
from isonoise.scene.material.bsdfs import Bsdfs, mark_pass_through, reads_uvs
from isonoise.scene.material.media import Media
from isonoise.scene.material.textures import MeshAttributes, Textures, mesh_attributes_used
from isonoise.scene.mesh.surfaces import Surfaces, make_surfaces
from isonoise.scene.placement import UNPLACED, Placement, find_placement, place_scene, warn_where_rounded

if TYPE_CHECKING:
    from isonoise.scene.volume.heterogeneous import HeterogeneousMedia

_DEFAULT_BSDF = {"type": "diffuse", "reflectance": 0.5}  # Mitsuba 3's, for a shape without a bsdf
_EMITTER_BSDF = {"type": "diffuse", "reflectance": 0.0}  # Mitsuba 3's, for an emissive shape without a bsdf
_DEFAULT_INTEGRATOR = {"type": "path", "max_depth": -1, "rr_depth": 5, "hide_emitters": False}
_DIRECT_MAX_DEPTH = 2  # of the integrator `direct`: light that arrives over one bounce
_MAX_PLACEMENTS = 4  # each finds the scene to 2^-24 of its distance from the last one
_SAMPLE_COUNT = 4  # Mitsuba 3's, for a sensor without a sampler


def compile_scene(
    description: dict,
    size: tuple[int, int] | None = None,
    max_depth: int | None = None,
    sampler: str | None = None,
    keep_uvs: bool = False,
    cache: CompileCache | None = None,
) -> CompiledScene:
    """Compile a scene for the device.

    Parameters
    ----------
    description
        A scene description made by `load`.
    size
        Width and height in pixels, in place of the film's size.
    max_depth
        Maximum path length, in place of the integrator's.
    sampler
        One of `SAMPLERS`, in place of the sensor's.
    keep_uvs
        Keep texture coordinates that no material reads.
    cache
        Results of earlier compilations of the scene, which are used again; gets those of this one.

    Raises
    ------
    SceneError
        If a mesh or an image cannot be read, or numbers exceed the range of the device.
    """
    cache = cache or CompileCache()
    cache.begin()
    description, geometry, placement = _place_geometry(description, cache)
    sensor = next(iter(_objects_of_kind(description, "sensor").values()))
    camera, filter_name = compile_camera(sensor, size)
    world = geometry.boxes[0]
    warn_where_rounded(world.name, world.corners, camera, placement)
    warn_if_clipped(camera, world.union())
    integrator = _integrator_settings(description, max_depth)
    emitters = _objects_of_kind(description, "emitter")
    volumetric = integrator["volumetric"]
    materials = _compile_materials(geometry, emitters, sensor.get("medium"), Textures(cache), volumetric, keep_uvs)
    environment = _environment_map(emitters, cache)
    projecting = list(zip(emitters.values(), materials.projected_textures, strict=True))
    lights = compile_lights(materials.area_lights, projecting, environment, materials.textures, world.union())
    _set_analytic_lights(materials.arrays["shapes"], geometry.arrays["analytics"], lights.records)
    if environment is not None:
        environment = _scaled(environment, lights.radiance_scale)
    arrays = {"camera": camera, **geometry.arrays, **materials.arrays}
    arrays |= {"lights": lights.records, "light_cdf": lights.cdf}
    settings = {
        "filter": filter_name,
        **integrator,
        "sensor_medium": materials.sensor_medium,
        "environment_light": lights.environment_light,
        "radiance_scale": lights.radiance_scale,
    }
    return CompiledScene(
        **arrays,
        **settings,
        projections=lights.projections,
        environment=environment,
        heterogeneous=materials.heterogeneous,
        sampler=sampler or _sampler(sensor),
        sample_count=sensor.get("sampler", {}).get("sample_count", _SAMPLE_COUNT),
        exposure=sensor.get("film", {}).get("exposure"),
        hash=_hash(arrays, settings, lights.projections, environment, materials.heterogeneous),
    )


def _set_analytic_lights(shapes: np.ndarray, analytics: np.ndarray, lights: np.ndarray) -> None:
    """Store in the records of analytic shapes which light they are."""
    is_analytic = lights["kind"] & ANALYTIC_LIGHTS != 0
    shapes["light"][analytics["shape"][lights["primitive"][is_analytic]]] = np.flatnonzero(is_analytic)


def _sampler(sensor: dict) -> str:
    """The sampler of a sensor; Mitsuba's stratified ones become `sobol`."""
    return "independent" if sensor.get("sampler", {}).get("type") == "independent" else "sobol"


def _objects_of_kind(description: dict, kind: str) -> dict[str, dict]:
    names = vocabulary.plugins_of(kind)
    return {k: v for k, v in description.items() if isinstance(v, dict) and v["type"] in names}


def _integrator_settings(description: dict, max_depth: int | None) -> dict:
    """The fields of CompiledScene that the integrator sets."""
    integrator = next(iter(_objects_of_kind(description, "integrator").values()), _DEFAULT_INTEGRATOR)
    volumetric = integrator["type"] in ("volpath", "volpathmis")
    if max_depth is None:
        max_depth = _DIRECT_MAX_DEPTH if integrator["type"] == "direct" else integrator["max_depth"]
    if not -1 <= max_depth <= MAX_DEPTH:
        raise SceneError(f"max_depth = {max_depth} is out of range: it goes from -1 (no limit) to {MAX_DEPTH}")
    rr_depth = integrator.get("rr_depth", _DEFAULT_INTEGRATOR["rr_depth"])
    return {
        "max_depth": max_depth,
        "rr_depth": rr_depth + volumetric,  # Mitsuba 3's volumetric integrators start roulette one bounce later
        "hide_emitters": integrator["hide_emitters"],
        "volumetric": volumetric,
    }


@dataclass(frozen=True)
class _Geometry:
    """All surfaces: those of the world first, then those of each shape group."""

    shapes: list[dict]  # of the description
    surfaces: list[Surfaces]
    layout: Layout
    group_ids: list[int]  # id() of the description of each shape group
    boxes: list[Boxes]  # of the world, with instances after the other shapes; then of the groups
    arrays: dict[str, np.ndarray]  # fields of CompiledScene

    def mesh_attributes(self) -> list[MeshAttributes]:
        """The attributes of all meshes, in the order of their shapes."""
        values = {int(part.index[0]): part.attributes for part in self.surfaces if part.attributes}
        counts = zip(self.layout.vertex_count.tolist(), self.layout.triangle_count.tolist(), strict=True)
        return [MeshAttributes(*count, values.get(i, {})) for i, count in enumerate(counts) if count[1]]


def _place_geometry(description: dict, cache: CompileCache) -> tuple[dict, _Geometry, Placement]:
    """The description, near the origin and of a size near 1 if it was far from that, its geometry and its placement."""
    if cache.geometry is not None:
        return _placed_again(description, *cache.geometry)
    placed, geometry = description, _compile_geometry(_objects_of_kind(description, "shape"))
    group_ids, placements = geometry.group_ids, [UNPLACED] * len(geometry.boxes)
    for _ in range(_MAX_PLACEMENTS):
        found = [find_placement(space.corners) for space in geometry.boxes]
        if all(placement.is_identity for placement in found):
            break
        placements = [earlier.then(later) for earlier, later in zip(placements, found, strict=True)]
        placed = place_scene(description, placements[0], dict(zip(group_ids, placements[1:], strict=True)))
        geometry = _compile_geometry(_objects_of_kind(placed, "shape"))
    for space in geometry.boxes:
        space.check()
    cache.geometry = geometry, placements
    return placed, geometry, placements[0]


def _placed_again(
    description: dict, geometry: _Geometry, placements: list[Placement]
) -> tuple[dict, _Geometry, Placement]:
    """What `_place_geometry` returns for a description with the same shapes, of which only materials may differ."""
    if not all(placement.is_identity for placement in placements):
        group_ids = split_instances(_objects_of_kind(description, "shape")).group_ids
        description = place_scene(description, placements[0], dict(zip(group_ids, placements[1:], strict=True)))
    spaces = split_instances(_objects_of_kind(description, "shape"))
    shapes: list[dict] = []
    for space in (spaces.world, *spaces.groups):
        _check_mesh_attributes(space, geometry.surfaces, len(shapes))
        shapes += space.shapes
    return description, replace(geometry, shapes=shapes, group_ids=spaces.group_ids), placements[0]


def _compile_geometry(description: Mapping[str, dict]) -> _Geometry:
    spaces = split_instances(description)
    shapes, surfaces, sizes = [], [], []
    for space in (spaces.world, *spaces.groups):
        made = make_surfaces(space.shapes, len(shapes), space.name)
        _check_mesh_attributes(space, made, len(shapes))
        shapes += space.shapes
        surfaces += made
        sizes.append(len(space.shapes))
    layout = Layout(surfaces, len(shapes))
    instances = instance_records(spaces)
    boxes = _boxes(spaces, shape_boxes(surfaces, len(shapes)), sizes, instances)
    with np.errstate(over="ignore"):  # `Boxes.check` reports it
        bounds = boxes[0].union().astype(np.float32)
    arrays = {
        **merge_meshes(surfaces, layout),
        "analytics": merge_analytics(surfaces, layout),
        "instances": instances,
        "group_offsets": group_offsets(layout, sizes),
        "bounds": bounds,
    }
    return _Geometry(shapes, surfaces, layout, spaces.group_ids, boxes, arrays)


def _boxes(spaces: Spaces, boxes: np.ndarray, sizes: list[int], instances: np.ndarray) -> list[Boxes]:
    """The boxes of the spaces; `boxes` (n, 2, 3) are those of the shapes, `sizes` the numbers of shapes of a space."""
    parts = np.split(boxes, np.cumsum(sizes)[:-1])
    world, *groups = [
        Boxes(space.name, part) for space, part in zip((spaces.world, *spaces.groups), parts, strict=True)
    ]
    if not len(instances):
        return [world]

    def name(number: int) -> str:
        return spaces.world.name(number) if number < sizes[0] else spaces.instances.name(number - sizes[0])

    unions = np.stack([group.union() for group in groups])
    extents = np.stack(instance_extents(instances, unions[instances["root"] - 1]), axis=1)
    return [Boxes(name, np.concatenate([world.corners, extents])), *groups]


def _check_mesh_attributes(space: Space, surfaces: list[Surfaces], first_index: int) -> None:
    """Raise SceneError where a bsdf or an emitter uses a mesh attribute that its shape does not have as numbers."""
    used: dict[int, set[str]] = {}
    attributes_of = {int(part.index[0]) - first_index: part.attributes for part in surfaces if part.attributes}
    for number, shape in enumerate(space.shapes):
        for part in (shape[key] for key in ("bsdf", "emitter") if key in shape):
            if id(part) not in used:
                used[id(part)] = mesh_attributes_used(part)
            for attribute in sorted(used[id(part)]):
                values = attributes_of.get(number, {})
                if attribute not in values:
                    raise SceneError(
                        f"{space.name(number)} has no attribute '{attribute}', which its {part['type']} uses "
                        f"(it has: {', '.join(values) or 'none'})"
                    )
                if not np.isfinite(values[attribute]).all():
                    raise SceneError(
                        f"{space.name(number)}: its attribute '{attribute}', which its {part['type']} uses, has a "
                        "value that is no finite 32-bit number"
                    )


@dataclass(frozen=True)
class _Materials:
    arrays: dict[str, np.ndarray]  # fields of CompiledScene
    textures: Textures
    sensor_medium: int
    heterogeneous: "HeterogeneousMedia | None"
    area_lights: list[AreaLight]  # in the order of their shapes
    projected_textures: list[int]  # of the emitters without surface: `projected_texture`


def _compile_materials(
    geometry: _Geometry,
    emitters: dict[str, dict],
    sensor_medium: dict | None,
    textures: Textures,
    volumetric: bool,
    keep_uvs: bool,
) -> _Materials:
    """Compile bsdfs, media and textures. Media are left out unless the integrator is volumetric."""
    bsdfs = Bsdfs(textures.index)
    media = Media(bsdfs)
    sensor_medium_index = media.index(sensor_medium if volumetric else None)
    layout = geometry.layout
    shapes = np.zeros(len(geometry.shapes), structs.SHAPE)
    shapes["light"] = structs.NONE
    shapes["first_primitive"] = layout.first_primitive
    shapes["flags"] = structs.SHAPE_VERTEX_NORMALS * layout.has_normals + structs.SHAPE_FLIP_NORMALS * layout.is_flipped
    radiance_textures = {}  # by index of the shape
    for i, shape in enumerate(geometry.shapes):
        shapes["media"][i] = media.sides(shape) if volumetric else structs.NONE
        shapes["bsdf"][i] = bsdfs.index(shape.get("bsdf", _EMITTER_BSDF if "emitter" in shape else _DEFAULT_BSDF))
        if "emitter" in shape:
            radiance_textures[i] = radiance_texture(shape["emitter"], textures)
    projected_textures = [projected_texture(emitter, textures) for emitter in emitters.values()]
    bsdf_records = bsdfs.records
    if volumetric:
        shapes["flags"][mark_pass_through(bsdf_records)[shapes["bsdf"]]] |= structs.SHAPE_PASS_THROUGH
    texture_arrays = textures.arrays(geometry.mesh_attributes() if textures.reads_attributes else ())
    uvs, reversed_winding = np.zeros((0, 2), np.float32), np.zeros(0, bool)
    has_textured_lights = any(texture != structs.NONE for texture in radiance_textures.values())
    if keep_uvs or reads_uvs(bsdf_records) or has_textured_lights:
        uvs, reversed_winding = merge_uvs(geometry.surfaces, layout)
        if len(uvs):
            shapes["flags"][layout.has_uvs] |= structs.SHAPE_UVS
    arrays = {
        "shapes": shapes,
        "bsdfs": bsdf_records,
        "rough_transmittances": bsdfs.tables,
        "media": media.records,
        "reversed_winding": reversed_winding,
        "uvs": uvs,
        "textures": texture_arrays.records,
        "texel_bytes": texture_arrays.bytes,
        "texel_floats": texture_arrays.floats,
        "attributes": texture_arrays.attributes,
    }
    area_lights = _area_lights(geometry, radiance_textures)
    return _Materials(arrays, textures, sensor_medium_index, media.heterogeneous, area_lights, projected_textures)


def _area_lights(geometry: _Geometry, radiance_textures: dict[int, int]) -> list[AreaLight]:
    """The emissive shapes. `radiance_textures` has the texture of each, NONE without, by its index."""
    lights = {}
    for part in geometry.surfaces:
        for number, index in enumerate(part.index.tolist()):
            if index in radiance_textures:
                first, emitter = int(geometry.layout.first_primitive[index]), geometry.shapes[index]["emitter"]
                lights[index] = AreaLight(emitter, part.select(number), first, radiance_textures[index])
    return [lights[index] for index in sorted(lights)]


def _environment_map(emitters: dict[str, dict], cache: CompileCache) -> EnvironmentMap | None:
    """The environment map among the emitters; a scene has at most one."""
    name = next((name for name, emitter in emitters.items() if emitter["type"] == "envmap"), None)
    if name is None:
        return None
    emitter = emitters[name]
    to_world, scale = emitter.get("to_world", np.eye(4)), emitter["scale"]
    source = emitter.get("bitmap", emitter.get("filename"))
    key = ("environment", source, to_world.tobytes(), scale)
    return cache.get(key, lambda: build_environment_map(_image(source), to_world, scale, f"emitter '{name}'"))


def _image(source: str | Image) -> Image:
    return source if isinstance(source, Image) else read_image(source)


def _scaled(environment: EnvironmentMap, radiance_scale: float) -> EnvironmentMap:
    """The environment map with radiance multiplied by `radiance_scale`."""
    record = environment.record.copy()
    with np.errstate(over="ignore"):  # checked below
        record["scale"] *= radiance_scale
    if not np.isfinite(record["scale"]).all():
        raise_too_dim()
    return replace(environment, record=record)


def _hash(
    arrays: dict[str, np.ndarray],
    settings: dict,
    projections: np.ndarray,
    environment: EnvironmentMap | None,
    heterogeneous: "HeterogeneousMedia | None",
) -> str:
    """Hex digest of all arrays and settings. File names and ids do not change it."""
    if len(projections):
        arrays = arrays | {"projections": projections}
    if heterogeneous is not None:
        arrays = arrays | heterogeneous.arrays()
    if environment is not None:
        arrays = arrays | {"environment": environment.record, "environment_texels": environment.texels}
    digest = hashlib.blake2b(repr(sorted(settings.items())).encode(), digest_size=16)
    for name, array in arrays.items():
        digest.update(f"{name}{array.shape}".encode())
        digest.update(np.ascontiguousarray(array).data.cast("B") if array.size else b"")
    return digest.hexdigest()
