"""Places a scene near the origin, at a size near 1, where the steps of 32-bit floats are small and squares stay finite.

Called by `compile.py`, which compiles the placed description. The image stays the same: `place_scene` changes every
parameter of the vocabulary that is a position or depends on the unit of length. Most scenes need no placement and keep
every bit.
"""

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from isonoise.scene.spectra import colour_to_rgb
from isonoise.scene.transforms import scale, translate
from isonoise.scene.vocabulary import plugins_of
from isonoise.scene.volume import is_volume

FLOAT_STEP, DOUBLE_STEP = 2.0**-24, 2.0**-53
"""Relative rounding error of 32-bit and 64-bit floats."""
_MAX_DISTANCE = 2.0**8
"""Distance of shapes from the origin, in their sizes, up to which a scene stays where it is: their corners are rounded
to 2^-16 of their size, and the Cornell box keeps its brightness to 0.1 %."""
_MIN_GAIN = 8.0  # factor by which a placement has to bring shapes closer
_SIZE_RANGE = (2.0**-30, 2.0**30)
"""Sizes of shapes at which a scene keeps its scale. The Cornell box is right from 10^-12 to 10^12."""
_MAX_SIGMA_T = 1e30  # as in `parse.constraints`
_MAX_CLIP = 1e30  # its square does not enter, but sums with other distances stay finite
_MAX_SHAPE_ROUNDING = 2.0**-7  # of its size: beyond it there is a warning
_MAX_SCENE_ROUNDING = 2.0**-11  # of the shapes' size, by 64-bit floats; cornell at 10^13 is still right to 0.02 %
_MAX_CAMERA_ROUNDING = 2.0**-10  # of the scene's size: half a pixel of an image 500 pixels wide


@dataclass(frozen=True)
class Placement:
    """The map x -> scale * (x - origin) of a space: the world, or that of a shape group."""

    origin: np.ndarray  # (3,) float64
    scale: float  # a power of two

    def to_placed(self) -> np.ndarray:
        """The map as a 4x4 matrix."""
        return scale(self.scale) @ translate(-self.origin)

    def from_placed(self) -> np.ndarray:
        """Its inverse."""
        return translate(self.origin) @ scale(1 / self.scale)

    def then(self, other: "Placement") -> "Placement":
        """This map and then another one."""
        return Placement(self.origin + other.origin / self.scale, self.scale * other.scale)

    @property
    def is_identity(self) -> bool:
        return self.scale == 1 and not self.origin.any()


UNPLACED = Placement(np.zeros(3), 1.0)


def _median(values: np.ndarray) -> np.ndarray:
    """The median along the first axis; numpy's own imports 12 ms of masked arrays."""
    ordered, middle = np.sort(values, axis=0), len(values) // 2
    return ordered[middle] if len(values) % 2 else (ordered[middle - 1] + ordered[middle]) / 2


def find_placement(boxes: np.ndarray) -> Placement:
    """The placement of a space with shapes in boxes (n, 2, 3), rounded to 32 bits.

    The new origin is the median of the shapes' centers, and their median size becomes about 1: a single object far away
    changes neither. Boxes that rounding has made points are only known to be far: repeat it with the placed boxes.
    """
    size = _sizes(boxes)
    boxes, size = boxes[size > 0], size[size > 0]
    if not len(boxes) or not np.isfinite(boxes).all():
        return UNPLACED
    typical_size = float(_median(size))
    is_usual = _SIZE_RANGE[0] <= typical_size <= _SIZE_RANGE[1]
    factor = 1.0 if is_usual else 2.0 ** -round(np.log2(typical_size))
    distance = _median(_distances(boxes, size))
    if distance > _MAX_DISTANCE:
        origin = _median(boxes.mean(axis=1)).astype(np.float32).astype(float)
        if _median(_distances(boxes - origin, size)) * _MIN_GAIN < distance:
            return Placement(origin, factor)
    return Placement(UNPLACED.origin, factor)


def _sizes(boxes: np.ndarray) -> np.ndarray:
    """The longest side of each box, at least the rounding error of its corners."""
    return np.maximum(np.ptp(boxes, axis=1).max(axis=1), FLOAT_STEP * np.abs(boxes).max(axis=(1, 2)))


def _distances(boxes: np.ndarray, size: np.ndarray) -> np.ndarray:
    """The largest coordinate of each box, in sizes of its shape."""
    return np.abs(boxes).max(axis=(1, 2)) / size


def place_scene(
    description: dict, world: Placement, groups: Mapping[int, Placement], ids: dict[int, str] | None = None
) -> dict:
    """The description in placed spaces.

    `groups` has the placement of each shape group by the id() of its dict. `ids` are names of objects by the id() of
    their dicts; those of the new dicts are added.
    """
    placer = _Placer(world, groups)
    placed = placer.placed(description, world)
    if ids is not None:
        ids.update({id(new): ids[old] for old, new in placer.done.items() if old in ids})
    return placed


class _Placer:
    """Places each object once, so that an object with several references stays one dict."""

    def __init__(self, world: Placement, groups: Mapping[int, Placement]):
        self.world, self.groups = world, groups
        self.done: dict[int, dict] = {}  # by id()

    def placed(self, part: dict, space: Placement) -> dict:
        """An object of the description, which is in `space`, and all that it contains."""
        is_shape = part.get("type") in _SHAPES
        if id(part) in self.done and not is_shape:  # a shape may be in the world and in a group
            return self.done[id(part)]
        inner = self.groups.get(id(part), space)
        result = {k: self.placed(v, inner) if isinstance(v, dict) else v for k, v in part.items()}
        if is_shape:
            result["to_world"] = space.to_placed() @ _to_world(part)
        elif part.get("type") == "instance":
            group = self.groups[id(part["shape"])]
            result["to_world"] = self.world.to_placed() @ _to_world(part) @ group.from_placed()
        elif part.get("type") in _CHANGES:
            result.update(_CHANGES[part["type"]](part, self.world))
        self.done[id(part)] = result
        return result


def _to_world(part: dict) -> np.ndarray:
    return part.get("to_world", np.eye(4))


def _place_camera(camera: dict, world: Placement) -> dict:
    """Lengths of a camera. Its matrix has to stay rigid; that of an orthographic one has the film's size."""
    film_scale = (1.0, 1.0, 1.0 / world.scale) if camera["type"] == "orthographic" else 1.0 / world.scale
    lengths = ("near_clip", "far_clip", "aperture_radius", "focus_distance")
    return {
        "to_world": world.to_placed() @ _to_world(camera) @ scale(film_scale),
        **{name: min(camera[name] * world.scale, _MAX_CLIP) for name in lengths if name in camera},
    }


def _place_light(light: dict, world: Placement) -> dict:
    """Position and intensity of a point or a spot: radiant intensity is irradiance times a squared distance."""
    intensity = colour_to_rgb(light["intensity"], "radiance") * world.scale**2
    changes = {"intensity": {"type": "rgb", "value": intensity.tolist()}}
    if "position" in light:
        return changes | {"position": tuple(world.scale * (np.array(light["position"]) - world.origin))}
    return changes | {"to_world": world.to_placed() @ _to_world(light)}


def _place_projector(light: dict, world: Placement) -> dict:
    """Position and scale of a projector. The depth that its irradiance depends on is in its own space."""
    return {"scale": light["scale"] * world.scale, "to_world": world.to_placed() @ _to_world(light)}


def _place_medium(medium: dict, world: Placement) -> dict:
    """Density of a medium, per unit of length."""
    largest = float(colour_to_rgb(medium["sigma_t"], "unbounded").max()) or 1.0
    return {"scale": min(medium["scale"] / world.scale, _MAX_SIGMA_T / largest)}


def _place_heterogeneous(medium: dict, world: Placement) -> dict:
    """Density of a heterogeneous medium. A constant one fills the unit cube, which becomes a volume with a place."""
    changes = {"scale": medium["scale"] / world.scale}
    if not is_volume(medium["sigma_t"]):
        changes["sigma_t"] = {"type": "constvolume", "value": medium["sigma_t"], "to_world": world.to_placed()}
    return changes


_SHAPES = frozenset(name for name in plugins_of("shape") if name not in ("shapegroup", "instance"))
_CHANGES = {
    **dict.fromkeys(("perspective", "thinlens", "orthographic"), _place_camera),
    **dict.fromkeys(("point", "spot"), _place_light),
    "projector": _place_projector,
    "homogeneous": _place_medium,
    "heterogeneous": _place_heterogeneous,
    **dict.fromkeys(
        ("gridvolume", "constvolume"), lambda volume, world: {"to_world": world.to_placed() @ _to_world(volume)}
    ),
    "bumpmap": lambda bsdf, world: {"scale": bsdf["scale"] * world.scale},  # heights are lengths
}


def warn_where_rounded(name: Callable[[int], str], boxes: np.ndarray, camera: np.ndarray, world: Placement) -> None:
    """Warn of what floats cannot resolve in a placed scene.

    Parameters
    ----------
    name : gives the name of a shape
    boxes : (n, 2, 3) of the shapes
    camera : (1,) structs.CAMERA
    world : the placement of the scene
    """
    size = np.ptp(boxes, axis=1).max(axis=1)
    extended = np.flatnonzero(size > 0)
    if not len(extended):
        return
    _warn_of_shapes(name, boxes, size, extended)
    rounding = DOUBLE_STEP * np.abs(world.origin).max() * world.scale / _median(size[extended])
    if rounding > _MAX_SCENE_ROUNDING:
        _warn(f"the scene is far from the origin: 64-bit floats round its shapes to {rounding:.2%} of their size")
    position = camera["to_world"].reshape(3, 4)[:, 3].astype(float)
    lower, upper = boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)
    distance = np.maximum(np.maximum(lower - position, position - upper), 0).max() / (upper - lower).max()
    if FLOAT_STEP * distance > _MAX_CAMERA_ROUNDING:
        _warn(
            f"the camera is {distance:.1g} times the scene's size away from it: 32-bit floats round its rays to "
            f"{FLOAT_STEP * distance:.1%} of that size; move the camera closer"
        )


def _warn_of_shapes(name: Callable[[int], str], boxes: np.ndarray, size: np.ndarray, extended: np.ndarray) -> None:
    """Warn of shapes, among those `extended`, that are coarse where they are."""
    rounding = FLOAT_STEP * _distances(boxes[extended], size[extended])
    count = np.count_nonzero(rounding > _MAX_SHAPE_ROUNDING)
    if count:
        more = f" (and {count - 1} other shapes)" if count > 1 else ""
        _warn(
            f"{name(int(extended[np.argmax(rounding)]))}{more}: far from the other shapes for its size; 32-bit floats "
            f"round its corners to {rounding.max():.1%} of its size; make it larger or move it closer"
        )


def _warn(text: str) -> None:
    warnings.warn(text, stacklevel=4)
