"""Checks that span several parameters of a plugin. Called by `validate.py` once defaults are filled in."""

import math
from collections.abc import Iterator

import numpy as np

from isonoise.limits import MAX_PIXELS
from isonoise.scene.camera import crop_fits_film, is_rigid, parse_focal_length
from isonoise.scene.light.light_kinds import KIND_OF_PLUGIN as LIGHT_OF_PLUGIN
from isonoise.scene.material.bsdf_kinds import KIND_OF_PLUGIN
from isonoise.scene.material.presets import conductors
from isonoise.scene.material.textures import mesh_attributes_used
from isonoise.scene.parse.elements import Location, did_you_mean
from isonoise.scene.spectra import colour_to_rgb
from isonoise.scene.vocabulary.sensors import SENSORS
from isonoise.scene.vocabulary.textures import CONSTANT_TEXTURES

_MAX_APERTURE_RATIO = 1e18  # the square of a tangent, 1e36, fits in 32-bit floats
_MAX_SIGMA_T = 1e30  # per unit of length: products with distances stay within 32-bit floats
_MIN_SURE_DETERMINANT = 1e-12  # relative: rounding is below 1e-14
_MIN_FLOAT32 = float(np.finfo(np.float32).tiny)
_MUTUALLY_EXCLUSIVE = {
    "perspective": (("fov", "focal_length"),),
    "projector": (("fov", "focal_length"),),
    "thinlens": (("fov", "focal_length"),),
    "conductor": (("material", "eta"), ("material", "k")),
    "roughconductor": (("material", "eta"), ("material", "k"), ("alpha", "alpha_u"), ("alpha", "alpha_v")),
    "roughdielectric": (("alpha", "alpha_u"), ("alpha", "alpha_v")),
    "principled": (("eta", "specular"),),
    "point": (("position", "to_world"),),
    "directional": (("direction", "to_world"),),
    "bitmap": (("filename", "bitmap"), ("filename", "data"), ("bitmap", "data")),
    "envmap": (("filename", "bitmap"),),
}


def check_constraints(kind: str, result: dict, location: Location):
    """Raise SceneError if the parameters of a normalised object contradict each other."""
    name = result["type"]
    for first, second in _MUTUALLY_EXCLUSIVE.get(name, ()):
        if first in result and second in result:
            location.raise_error(f"give '{first}' or '{second}', not both")
    if kind in ("shape", "emitter", "volume") and "to_world" in result:
        _check_invertible(result["to_world"], location)
    if name in _CHECKS:
        _CHECKS[name](result, location)


def _check_invertible(to_world: np.ndarray, location: Location):
    (a, b, c, _), (d, e, f, _), (g, h, i, _), last_row = to_world.tolist()
    determinant = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)
    largest = max(map(abs, (a, b, c, d, e, f, g, h, i)))
    if not abs(determinant) > _MIN_SURE_DETERMINANT * largest * largest * largest:  # perhaps nothing but rounding
        with np.errstate(all="ignore"):
            determinant = np.linalg.det(to_world[:3, :3])
    if not math.isfinite(determinant) or determinant == 0 or last_row != [0, 0, 0, 1]:
        location.raise_error("to_world cannot be inverted, or its last row is not 0 0 0 1")


def _check_sensor(sensor: dict, location: Location):
    if sensor["near_clip"] >= sensor["far_clip"]:
        location.raise_error("near_clip has to be smaller than far_clip")


def _check_orthographic(sensor: dict, location: Location):
    _check_sensor(sensor, location)
    if "to_world" in sensor:
        _check_invertible(sensor["to_world"], location)


def _check_perspective(sensor: dict, location: Location):
    _check_sensor(sensor, location)
    _check_focal_length(sensor, location)
    if "to_world" in sensor and not is_rigid(sensor["to_world"]):
        location.raise_error("to_world scales or shears; a camera can only be translated, rotated and mirrored")


def _check_focal_length(optics: dict, location: Location):
    if "focal_length" in optics and parse_focal_length(optics["focal_length"]) is None:
        location.raise_error(f"focal_length has to be millimetres, such as '50mm', got '{optics['focal_length'][:40]}'")


def _check_thin_lens(sensor: dict, location: Location):
    _check_perspective(sensor, location)
    if sensor["aperture_radius"] > _MAX_APERTURE_RATIO * sensor.get("focus_distance", sensor["far_clip"]):
        location.raise_error(
            f"aperture_radius exceeds {_MAX_APERTURE_RATIO:g} * focus_distance: 32-bit floats overflow"
        )


def _check_hdrfilm(film: dict, location: Location):
    if not crop_fits_film(film):
        location.raise_error("the crop window extends beyond the film: reduce crop_offset or crop size")
    width, height = film.get("crop_width", film["width"]), film.get("crop_height", film["height"])
    if width * height > MAX_PIXELS:
        location.raise_error(f"the image has {width} x {height} pixels; the limit is {MAX_PIXELS:,}")


def _check_conductor(bsdf: dict, location: Location):
    material = bsdf.get("material")
    if material is not None and material not in conductors():
        known = ", ".join(sorted(conductors()))
        location.raise_error(f"unknown conductor '{material}'{did_you_mean(material, conductors())} (known: {known})")


def _check_dielectric(bsdf: dict, location: Location):
    if not _MIN_FLOAT32 <= bsdf["int_ior"] / bsdf["ext_ior"] <= 1.0 / _MIN_FLOAT32:
        location.raise_error("int_ior / ext_ior exceeds the range of 32-bit floats")


def _check_rough_boundary(bsdf: dict, location: Location):
    _check_dielectric(bsdf, location)
    if np.float32(bsdf["int_ior"] / bsdf["ext_ior"]) == 1:
        location.raise_error("int_ior and ext_ior have to differ: a rough boundary of equal indices does not refract")


def _check_alpha_u_and_v(bsdf: dict, location: Location):
    if ("alpha_u" in bsdf) != ("alpha_v" in bsdf):
        location.raise_error("give both 'alpha_u' and 'alpha_v', or 'alpha' alone")


def _check_rough_conductor(bsdf: dict, location: Location):
    _check_conductor(bsdf, location)
    _check_alpha_u_and_v(bsdf, location)


def _check_rough_dielectric(bsdf: dict, location: Location):
    _check_rough_boundary(bsdf, location)
    _check_alpha_u_and_v(bsdf, location)


def _nested_bsdfs(bsdf: dict) -> Iterator[dict]:
    """All bsdfs nested in a bsdf, each once."""
    visited: set[int] = set()
    queue = [bsdf]
    while queue:
        outer = queue.pop()
        for nested in (outer[name] for name in ("bsdf", "bsdf_1") if name in outer and id(outer[name]) not in visited):
            yield nested
            visited.add(id(nested))
            queue.append(nested)


def _check_twosided(bsdf: dict, location: Location):
    for nested in _nested_bsdfs(bsdf):
        transmits = KIND_OF_PLUGIN[nested["type"]].transmits
        if transmits and transmits(nested):
            location.raise_error(f"twosided cannot contain the transmissive bsdf '{nested['type']}' (nor in Mitsuba 3)")


def _check_bump_or_normal_map(bsdf: dict, location: Location):
    for nested in _nested_bsdfs(bsdf):
        if nested["type"] in ("bumpmap", "normalmap"):
            location.raise_error(f"a {bsdf['type']} cannot contain a {nested['type']}, not even inside another bsdf")


def _check_bump_map(bsdf: dict, location: Location):
    _check_bump_or_normal_map(bsdf, location)
    if bsdf["texture"]["type"] in CONSTANT_TEXTURES:
        location.raise_error("a bumpmap needs a texture whose heights vary (so does Mitsuba 3): a bitmap")


def _check_bitmap(texture: dict, location: Location):
    if not texture.keys() & {"filename", "bitmap", "data"}:
        location.raise_error("texture 'bitmap' needs a 'filename'")


def _check_envmap(emitter: dict, location: Location):
    if "filename" not in emitter and "bitmap" not in emitter:
        location.raise_error("emitter 'envmap' needs a 'filename'")


def _check_cylinder(shape: dict, location: Location):
    if shape["p0"] == shape["p1"]:
        location.raise_error("p0 and p1 have to differ")


def _check_directional(emitter: dict, location: Location):
    if not any(emitter.get("direction", (0.0, 0.0, 1.0))):
        location.raise_error("the direction is zero")


def _check_spot(emitter: dict, location: Location):
    if emitter.get("texture", {}).get("type") == "rgb":
        location.raise_error("the texture of a spot has to vary (so it has in Mitsuba 3): scale the intensity instead")
    if emitter.get("beam_width", 0.0) > emitter["cutoff_angle"]:
        location.raise_error("beam_width has to be at most cutoff_angle")
    _check_projected_texture(emitter, location)


def _check_projector(emitter: dict, location: Location):
    _check_focal_length(emitter, location)
    _check_projected_texture(emitter, location)


def _check_projected_texture(emitter: dict, location: Location):
    if mesh_attributes_used(emitter):
        location.raise_error(f"a {emitter['type']} cannot project a mesh_attribute: it belongs to a mesh")


def _check_mesh(shape: dict, location: Location):
    count, faces = len(shape["vertices"]), shape["faces"]
    if len(shape.get("normals", shape["vertices"])) != count:
        location.raise_error("the number of normals has to equal the number of vertices")
    if len(shape.get("texcoords", shape["vertices"])) != count:
        location.raise_error("the number of texture coordinates has to equal the number of vertices")
    for name, values in shape.get("attributes", {}).items():
        expected = count if name.startswith("vertex_") else len(faces)
        if len(values) != expected:
            location.raise_error(f"the attribute '{name}' has {len(values)} values and needs {expected}")
    if not len(faces) or faces.min() < 0 or faces.max() >= count:
        location.raise_error(f"it has no faces, or a face uses a vertex that does not exist (there are {count})")


def _check_shapegroup(group: dict, location: Location):
    if any(isinstance(shape, dict) and "emitter" in shape for shape in group.values()):
        location.raise_error(
            "a shape of a shapegroup cannot have an emitter (nor can it in Mitsuba 3); move it out of the group"
        )


def _check_homogeneous(medium: dict, location: Location):
    if not colour_to_rgb(medium["sigma_t"], "unbounded").max() * medium["scale"] <= _MAX_SIGMA_T:
        location.raise_error(f"sigma_t times scale exceeds {_MAX_SIGMA_T:g}: 32-bit floats overflow")


def _check_gridvolume(volume: dict, location: Location):
    if sum(name in volume for name in ("filename", "grid", "data")) != 1:
        location.raise_error("give one of 'filename', 'grid' and 'data'")
    in_memory = volume.get("grid", volume.get("data"))
    if volume["use_grid_bbox"] and isinstance(in_memory, np.ndarray):
        location.raise_error("use_grid_bbox needs a file or a VolumeGrid; an array has no box")


def _check_scene(scene: dict, location: Location):
    environments = {plugin for plugin, kind in LIGHT_OF_PLUGIN.items() if kind.is_environment}
    if sum(isinstance(value, dict) and value["type"] in environments for value in scene.values()) > 1:
        location.raise_error("a scene can have only one constant emitter or environment map")
    sensors = {plugin.name for plugin in SENSORS}
    if not any(isinstance(v, dict) and v["type"] in sensors for v in scene.values()):
        location.raise_error('the scene has no sensor; add a <sensor type="perspective">')


_CHECKS = {
    "perspective": _check_perspective,
    "thinlens": _check_thin_lens,
    "orthographic": _check_orthographic,
    "hdrfilm": _check_hdrfilm,
    "conductor": _check_conductor,
    "roughconductor": _check_rough_conductor,
    "dielectric": _check_dielectric,
    "thindielectric": _check_dielectric,
    "plastic": _check_dielectric,
    "roughplastic": _check_rough_boundary,
    "roughdielectric": _check_rough_dielectric,
    "twosided": _check_twosided,
    "bumpmap": _check_bump_map,
    "normalmap": _check_bump_or_normal_map,
    "bitmap": _check_bitmap,
    "envmap": _check_envmap,
    "cylinder": _check_cylinder,
    "directional": _check_directional,
    "spot": _check_spot,
    "projector": _check_projector,
    "mesh": _check_mesh,
    "shapegroup": _check_shapegroup,
    "homogeneous": _check_homogeneous,
    "gridvolume": _check_gridvolume,
    "scene": _check_scene,
}
