"""What the parameters of one plugin have to fulfil together; by plugin, called once its defaults are filled in."""

from collections.abc import Iterator

import numpy as np

from isonoise.scene.camera import MAX_PIXELS, crop_fits_film, is_rigid, parse_focal_length
from isonoise.scene.light.light_kinds import KIND_OF_PLUGIN as LIGHT_OF_PLUGIN
from isonoise.scene.material.bsdf_kinds import KIND_OF_PLUGIN
from isonoise.scene.material.presets import conductors
from isonoise.scene.parse.elements import SourceLocation, closest_name
from isonoise.scene.spectra import colour_to_rgb
from isonoise.scene.vocabulary.sensors import SENSORS

_EXCLUSIVE = {
    "perspective": (("fov", "focal_length"),),
    "thinlens": (("fov", "focal_length"),),
    "conductor": (("material", "eta"), ("material", "k")),
    "roughconductor": (("material", "eta"), ("material", "k"), ("alpha", "alpha_u"), ("alpha", "alpha_v")),
    "roughdielectric": (("alpha", "alpha_u"), ("alpha", "alpha_v")),
    "principled": (("eta", "specular"),),
    "point": (("position", "to_world"),),
    "directional": (("direction", "to_world"),),
}


def check_constraints(kind: str, result: dict, location: SourceLocation):
    """Raise SceneError where the normalised object contradicts itself."""
    name = result["type"]
    for first, second in _EXCLUSIVE.get(name, ()):
        if first in result and second in result:
            location.raise_error(f"give '{first}' or '{second}', not both")
    if kind in ("shape", "emitter") and "to_world" in result:
        _check_invertible(result["to_world"], location)
    if name in _CHECKS:
        _CHECKS[name](result, location)


def _check_invertible(to_world: np.ndarray, location: SourceLocation):
    with np.errstate(all="ignore"):
        determinant = np.linalg.det(to_world[:3, :3])
    if not np.isfinite(determinant) or determinant == 0 or np.any(to_world[3] != (0, 0, 0, 1)):
        location.raise_error("to_world cannot be inverted, or its last row is not 0 0 0 1")


def _sensor(sensor: dict, location: SourceLocation):
    if sensor["near_clip"] >= sensor["far_clip"]:
        location.raise_error("near_clip has to be smaller than far_clip")


def _orthographic(sensor: dict, location: SourceLocation):
    _sensor(sensor, location)
    if "to_world" in sensor:
        _check_invertible(sensor["to_world"], location)


def _perspective(sensor: dict, location: SourceLocation):
    _sensor(sensor, location)
    if "focal_length" in sensor and parse_focal_length(sensor["focal_length"]) is None:
        location.raise_error(
            f"a focal length is a number of millimetres such as '50mm', got '{sensor['focal_length'][:40]}'"
        )
    if "to_world" in sensor and not is_rigid(sensor["to_world"]):
        location.raise_error("to_world scales or shears; a camera may only be moved, turned and mirrored")


def _thin_lens(sensor: dict, location: SourceLocation):
    _perspective(sensor, location)
    if sensor["aperture_radius"] > _WIDEST * sensor.get("focus_distance", sensor["far_clip"]):
        location.raise_error(f"aperture_radius is more than {_WIDEST:g} times focus_distance: 32-bit floats overflow")


def _hdrfilm(film: dict, location: SourceLocation):
    if not crop_fits_film(film):
        location.raise_error("the crop window leaves the film; crop_offset plus crop size is at most width and height")
    width, height = film.get("crop_width", film["width"]), film.get("crop_height", film["height"])
    if width * height > MAX_PIXELS:
        location.raise_error(f"the picture has {width} x {height} pixels; it may have {MAX_PIXELS:,}")


def _conductor(bsdf: dict, location: SourceLocation):
    material = bsdf.get("material")
    if material is not None and material not in conductors():
        location.raise_error(f"unknown conductor '{material}'; did you mean '{closest_name(material, conductors())}'?")


def _dielectric(bsdf: dict, location: SourceLocation):
    if not _SMALLEST <= bsdf["int_ior"] / bsdf["ext_ior"] <= 1.0 / _SMALLEST:
        location.raise_error("int_ior / ext_ior leaves the range of 32-bit floats")


def _rough_boundary(bsdf: dict, location: SourceLocation):
    _dielectric(bsdf, location)
    if np.float32(bsdf["int_ior"] / bsdf["ext_ior"]) == 1:
        location.raise_error(
            "int_ior and ext_ior have to differ: a rough boundary between equal indices refracts nothing"
        )


def _pair_of_alphas(bsdf: dict, location: SourceLocation):
    if ("alpha_u" in bsdf) != ("alpha_v" in bsdf):
        location.raise_error("give both 'alpha_u' and 'alpha_v', or 'alpha' for both")


def _rough_conductor(bsdf: dict, location: SourceLocation):
    _conductor(bsdf, location)
    _pair_of_alphas(bsdf, location)


def _rough_dielectric(bsdf: dict, location: SourceLocation):
    _rough_boundary(bsdf, location)
    _pair_of_alphas(bsdf, location)


def _inside(bsdf: dict) -> Iterator[dict]:
    """The materials inside of one, each of them once."""
    passed: set[int] = set()
    queue = [bsdf]
    while queue:
        outer = queue.pop()
        for nested in (outer[name] for name in ("bsdf", "bsdf_1") if name in outer and id(outer[name]) not in passed):
            yield nested
            passed.add(id(nested))
            queue.append(nested)


def _twosided(bsdf: dict, location: SourceLocation):
    for nested in _inside(bsdf):
        transmits = KIND_OF_PLUGIN[nested["type"]].transmits
        if transmits and transmits(nested):
            location.raise_error(
                f"twosided cannot hold a bsdf '{nested['type']}' that lets light through, in Mitsuba 3 neither"
            )


def _relief(bsdf: dict, location: SourceLocation):
    for nested in _inside(bsdf):
        if nested["type"] in ("bumpmap", "normalmap"):
            location.raise_error(f"a {bsdf['type']} cannot hold a {nested['type']}, not even inside of another bsdf")


def _cylinder(shape: dict, location: SourceLocation):
    if shape["p0"] == shape["p1"]:
        location.raise_error("p0 and p1 have to differ")


def _directional(emitter: dict, location: SourceLocation):
    if not any(emitter.get("direction", (0.0, 0.0, 1.0))):
        location.raise_error("the direction is zero")


def _spot(emitter: dict, location: SourceLocation):
    if emitter.get("beam_width", 0.0) > emitter["cutoff_angle"]:
        location.raise_error("beam_width has to be at most cutoff_angle")


def _mesh(shape: dict, location: SourceLocation):
    count, faces = len(shape["vertices"]), shape["faces"]
    if len(shape.get("normals", shape["vertices"])) != count:
        location.raise_error("there have to be as many normals as vertices")
    if not len(faces) or faces.min() < 0 or faces.max() >= count:
        location.raise_error(f"there are no faces, or one names a vertex that does not exist (there are {count})")


def _shapegroup(group: dict, location: SourceLocation):
    if any(isinstance(shape, dict) and "emitter" in shape for shape in group.values()):
        location.raise_error(
            "a shape of a shapegroup cannot shine, in Mitsuba 3 neither; place it outside of the group"
        )


def _homogeneous(medium: dict, location: SourceLocation):
    if not colour_to_rgb(medium["sigma_t"], "unbounded").max() * medium["scale"] <= _DENSEST:
        location.raise_error(f"sigma_t times scale is more than {_DENSEST:g}: 32-bit floats overflow")


def _scene(scene: dict, location: SourceLocation):
    environments = {plugin for plugin, kind in LIGHT_OF_PLUGIN.items() if kind.is_environment}
    if sum(isinstance(value, dict) and value["type"] in environments for value in scene.values()) > 1:
        location.raise_error("a scene has only one constant emitter or environment map")
    sensors = {plugin.name for plugin in SENSORS}
    if not any(isinstance(v, dict) and v["type"] in sensors for v in scene.values()):
        location.raise_error('the scene has no sensor; add a <sensor type="perspective">')


_WIDEST = 1e18  # the square of a tangent, 1e36, fits in 32-bit floats
_DENSEST = 1e30  # collisions a unit of length: products with distances stay within 32-bit floats
_SMALLEST = float(np.finfo(np.float32).tiny)
_CHECKS = {
    "perspective": _perspective,
    "thinlens": _thin_lens,
    "orthographic": _orthographic,
    "hdrfilm": _hdrfilm,
    "conductor": _conductor,
    "roughconductor": _rough_conductor,
    "dielectric": _dielectric,
    "thindielectric": _dielectric,
    "plastic": _dielectric,
    "roughplastic": _rough_boundary,
    "roughdielectric": _rough_dielectric,
    "twosided": _twosided,
    "bumpmap": _relief,
    "normalmap": _relief,
    "cylinder": _cylinder,
    "directional": _directional,
    "spot": _spot,
    "mesh": _mesh,
    "shapegroup": _shapegroup,
    "homogeneous": _homogeneous,
    "scene": _scene,
}
