"""What the parameters of one plugin have to fulfil together; by plugin, called once its defaults are filled in."""

from collections.abc import Iterator

import numpy as np

from isonoise.scene.camera import MAX_PIXELS, fits_film, focal_length, is_rigid
from isonoise.scene.material.presets import conductors
from isonoise.scene.parse.elements import Place, nearest
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


def check_constraints(kind: str, result: dict, place: Place):
    """Raise SceneError where the normalised object contradicts itself."""
    name = result["type"]
    for first, second in _EXCLUSIVE.get(name, ()):
        if first in result and second in result:
            place.fail(f"give '{first}' or '{second}', not both")
    if kind in ("shape", "emitter") and "to_world" in result:
        _check_invertible(result["to_world"], place)
    if name in _CHECKS:
        _CHECKS[name](result, place)


def _check_invertible(to_world: np.ndarray, place: Place):
    with np.errstate(all="ignore"):
        determinant = np.linalg.det(to_world[:3, :3])
    if not np.isfinite(determinant) or determinant == 0 or np.any(to_world[3] != (0, 0, 0, 1)):
        place.fail("to_world cannot be inverted, or its last row is not 0 0 0 1")


def _sensor(sensor: dict, place: Place):
    if sensor["near_clip"] >= sensor["far_clip"]:
        place.fail("near_clip has to be smaller than far_clip")


def _orthographic(sensor: dict, place: Place):
    _sensor(sensor, place)
    if "to_world" in sensor:
        _check_invertible(sensor["to_world"], place)


def _perspective(sensor: dict, place: Place):
    _sensor(sensor, place)
    if "focal_length" in sensor and focal_length(sensor["focal_length"]) is None:
        place.fail(f"a focal length is a number of millimetres such as '50mm', got '{sensor['focal_length'][:40]}'")
    if "to_world" in sensor and not is_rigid(sensor["to_world"]):
        place.fail("to_world scales or shears; a camera may only be moved, turned and mirrored")


def _thin_lens(sensor: dict, place: Place):
    _perspective(sensor, place)
    if sensor["aperture_radius"] > _WIDEST * sensor.get("focus_distance", sensor["far_clip"]):
        place.fail(f"aperture_radius is more than {_WIDEST:g} times focus_distance: 32-bit floats overflow")


def _hdrfilm(film: dict, place: Place):
    if not fits_film(film):
        place.fail("the crop window leaves the film; crop_offset plus crop size is at most width and height")
    width, height = film.get("crop_width", film["width"]), film.get("crop_height", film["height"])
    if width * height > MAX_PIXELS:
        place.fail(f"the picture has {width} x {height} pixels; it may have {MAX_PIXELS:,}")


def _conductor(bsdf: dict, place: Place):
    material = bsdf.get("material")
    if material is not None and material not in conductors():
        place.fail(f"unknown conductor '{material}'; did you mean '{nearest(material, conductors())}'?")


def _dielectric(bsdf: dict, place: Place):
    if not _SMALLEST <= bsdf["int_ior"] / bsdf["ext_ior"] <= 1.0 / _SMALLEST:
        place.fail("int_ior / ext_ior leaves the range of 32-bit floats")


def _rough_boundary(bsdf: dict, place: Place):
    _dielectric(bsdf, place)
    if np.float32(bsdf["int_ior"] / bsdf["ext_ior"]) == 1:
        place.fail("int_ior and ext_ior have to differ: a rough boundary between equal indices refracts nothing")


def _pair_of_alphas(bsdf: dict, place: Place):
    if ("alpha_u" in bsdf) != ("alpha_v" in bsdf):
        place.fail("give both 'alpha_u' and 'alpha_v', or 'alpha' for both")


def _rough_conductor(bsdf: dict, place: Place):
    _conductor(bsdf, place)
    _pair_of_alphas(bsdf, place)


def _rough_dielectric(bsdf: dict, place: Place):
    _rough_boundary(bsdf, place)
    _pair_of_alphas(bsdf, place)


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


def _twosided(bsdf: dict, place: Place):
    for nested in _inside(bsdf):
        if nested["type"] in _TRANSMITTING or nested.get("spec_trans", 0.0) != 0.0:
            place.fail(f"twosided cannot hold a bsdf '{nested['type']}' that lets light through, in Mitsuba 3 neither")


def _relief(bsdf: dict, place: Place):
    for nested in _inside(bsdf):
        if nested["type"] in ("bumpmap", "normalmap"):
            place.fail(f"a {bsdf['type']} cannot hold a {nested['type']}, not even inside of another bsdf")


def _cylinder(shape: dict, place: Place):
    if shape["p0"] == shape["p1"]:
        place.fail("p0 and p1 have to differ")


def _directional(emitter: dict, place: Place):
    if not any(emitter.get("direction", (0.0, 0.0, 1.0))):
        place.fail("the direction is zero")


def _spot(emitter: dict, place: Place):
    if emitter.get("beam_width", 0.0) > emitter["cutoff_angle"]:
        place.fail("beam_width has to be at most cutoff_angle")


def _mesh(shape: dict, place: Place):
    count, faces = len(shape["vertices"]), shape["faces"]
    if len(shape.get("normals", shape["vertices"])) != count:
        place.fail("there have to be as many normals as vertices")
    if not len(faces) or faces.min() < 0 or faces.max() >= count:
        place.fail(f"there are no faces, or one names a vertex that does not exist (there are {count})")


def _shapegroup(group: dict, place: Place):
    if any(isinstance(shape, dict) and "emitter" in shape for shape in group.values()):
        place.fail("a shape of a shapegroup cannot shine, in Mitsuba 3 neither; place it outside of the group")


def _homogeneous(medium: dict, place: Place):
    if not colour_to_rgb(medium["sigma_t"], "unbounded").max() * medium["scale"] <= _DENSEST:
        place.fail(f"sigma_t times scale is more than {_DENSEST:g}: 32-bit floats overflow")


def _scene(scene: dict, place: Place):
    constant = [v for v in scene.values() if isinstance(v, dict) and v["type"] in ("constant", "envmap")]
    if len(constant) > 1:
        place.fail("a scene has only one constant emitter or environment map")
    sensors = {plugin.name for plugin in SENSORS}
    if not any(isinstance(v, dict) and v["type"] in sensors for v in scene.values()):
        place.fail('the scene has no sensor; add a <sensor type="perspective">')


_TRANSMITTING = ("dielectric", "thindielectric", "roughdielectric", "null", "mask")
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
