"""View: what the caller gives in place of a scene's own camera and environment. Applied by `load` and by `staging`.

The command line's options --sensor, --fov, --look-at, --up, --env and --crop are its fields.
"""

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, fields
from numbers import Real

import numpy as np

from isonoise.errors import UserError
from isonoise.scene.transforms import look_at, scale, translate
from isonoise.scene.vocabulary import plugins_of

_ENVIRONMENTS = ("constant", "envmap")


@dataclass(frozen=True)
class View:
    """Camera and environment in place of the scene's own; None keeps what the scene has.

    Parameters
    ----------
    camera : str, int or None
        Name of a camera of the file, or its number from 0 in the order of the file. None: the first one.
    fov : float or None
        Horizontal angle of view, degrees.
    look_at : tuple or None
        A point (x, y, z) to which the camera turns; or two, its position and the point to which it turns.
    up : (x, y, z) or None
        Direction that is up in the image, and in which a model stands. None: models stand along y, those of STL files
        along z, and `look_at` keeps up the coordinate axis that is nearest to the camera's own up.
    env : str or None
        An image in latitude-longitude format that takes the place of the environment. Its upper edge is `up`, else y.
    crop : (left, top, width, height) or None
        Window of the whole image in pixels. Its pixels have the same samples as in the whole image.

    Raises
    ------
    UserError
        If a value is out of range.
    """

    camera: str | int | None = None
    fov: float | None = None
    look_at: tuple | None = None
    up: tuple[float, float, float] | None = None
    env: str | None = None
    crop: tuple[int, int, int, int] | None = None

    def __post_init__(self):
        if self.camera is not None:
            object.__setattr__(self, "camera", str(self.camera))
        if self.fov is not None and not (isinstance(self.fov, Real) and 0 < self.fov < 180):
            raise UserError(
                f"fov = {self.fov} is out of range: an angle of view is more than 0 and less than 180 degrees"
            )
        if self.look_at is not None:
            points = _points(self.look_at)
            if points is None or len(points) > 2:
                raise UserError(f"look_at = {self.look_at} is not one point x, y, z or two")
            object.__setattr__(self, "look_at", tuple(map(tuple, points.tolist())))
        if self.up is not None:
            points = _points(self.up)
            if points is None or len(points) != 1 or not points.any():
                raise UserError(f"up = {self.up} is not a direction x, y, z")
            object.__setattr__(self, "up", tuple((points[0] / np.abs(points).max()).tolist()))
        if self.crop is not None:
            object.__setattr__(self, "crop", _window(self.crop))
        if self.env is not None:
            object.__setattr__(self, "env", os.fspath(self.env))

    @property
    def position(self) -> np.ndarray | None:
        """Where the camera has to be."""
        return None if self.look_at is None or len(self.look_at) < 2 else np.array(self.look_at[0])

    @property
    def target(self) -> np.ndarray | None:
        """The point to which the camera turns."""
        return None if self.look_at is None else np.array(self.look_at[-1])


NO_VIEW = View()
DEFAULT_FILM = {"type": "hdrfilm", "width": 768, "height": 576}
"""Mitsuba 3's, for a sensor without a film."""


def view_of(options) -> View:
    """The view that the options of a command name."""
    return View(**{field.name: getattr(options, field.name) for field in fields(View)})


def _points(value) -> np.ndarray | None:
    """(n, 3) float64 within the range of 32-bit floats, or None if it is something else."""
    try:
        points = np.atleast_2d(np.asarray(value, np.float64))
    except (TypeError, ValueError):
        return None
    is_valid = points.ndim == 2 and points.shape[1] == 3 and (np.abs(points) <= np.finfo(np.float32).max).all()
    return points if is_valid else None


def _window(value) -> tuple[int, int, int, int]:
    numbers = np.asarray(value)
    is_window = numbers.shape == (4,) and numbers.dtype.kind in "iu" and (numbers >= (0, 0, 1, 1)).all()
    if not is_window:
        raise UserError(f"crop = {value} is not a window: give (left, top, width, height) in whole pixels")
    return tuple(numbers.tolist())


def apply_view(description: dict, view: View, size: tuple[int, int] | None) -> dict:
    """A normalised scene with the view's camera and environment, and an image of this size.

    Raises UserError if they do not fit the scene.
    """
    if view == NO_VIEW and size is None:
        return description
    name, sensor = find_camera(sensors_of(description), view.camera)
    others = sensors_of(description).keys() - {name}
    result = {key: part for key, part in description.items() if key not in others}
    result[name] = move_camera(sensor, view)
    if size is not None:
        result[name]["film"] = resized(sensor.get("film", {"type": "hdrfilm"}), size)
    if view.crop is not None:
        result[name]["film"] = cropped(result[name].get("film", DEFAULT_FILM), view.crop)
    if view.env is not None:
        result = {key: part for key, part in result.items() if not is_environment(part)}
        name = next(name for name in ("environment", "environment_map", "--env") if name not in result)
        result[name] = environment_map(view)
    return result


def environment_map(view: View) -> dict:
    """The emitter with the image `view.env`."""
    to_world = np.eye(4)
    to_world[:3, :3] = rotation_from_y(view.up or (0.0, 1.0, 0.0))
    return {"type": "envmap", "filename": os.path.abspath(view.env), "scale": 1.0, "to_world": to_world}


def sensors_of(scene: Mapping) -> dict[str, dict]:
    """The cameras of a scene dict, normalised or not, by name."""
    return {name: part for name, part in scene.items() if _is_of_type(part, plugins_of("sensor"))}


def is_environment(part) -> bool:
    """Whether a part of a scene dict is an emitter around the scene."""
    return _is_of_type(part, _ENVIRONMENTS)


def _is_of_type(part, types) -> bool:
    return isinstance(part, Mapping) and part.get("type") in types


def find_camera(sensors: Mapping[str, dict], choice: str | None) -> tuple[str, dict]:
    """Name and dict of the camera that was chosen; without a choice, the first one.

    Case and punctuation of its name do not matter: readers of other formats change them, and may begin with "camera_".
    """
    names = list(sensors)
    if choice is None and names:
        return names[0], sensors[names[0]]
    if choice in sensors:
        return choice, sensors[choice]
    similar = [name for name in names if _letters(name) in (_letters(choice), "camera" + _letters(choice))]
    if len(similar) == 1 and _letters(choice) and not choice.isdecimal():
        return similar[0], sensors[similar[0]]
    name_by_number = {str(number): name for number, name in enumerate(names)}
    if choice in name_by_number:
        return name_by_number[choice], sensors[name_by_number[choice]]
    listed = ", ".join(f"{number} '{name}'" for number, name in enumerate(names))
    raise UserError(
        f"there is no camera '{choice}'; " + (f"the scene has: {listed}" if names else "the scene has none")
    )


def _letters(name: str) -> str:
    """The letters and digits of a name, in small letters."""
    return "".join(letter for letter in name.lower() if letter.isascii() and letter.isalnum())


def move_camera(sensor: Mapping, view: View) -> dict:
    """The camera with the view's angle, position, direction and up. Raises UserError if they do not fit."""
    moved = dict(sensor)
    if view.fov is not None:
        if sensor["type"] == "orthographic":
            raise UserError("the camera is orthographic: it has no angle of view, so leave out --fov")
        moved.pop("focal_length", None)
        moved |= {"fov": float(view.fov), "fov_axis": "x"}
    if view.look_at is not None or view.up is not None:
        moved["to_world"] = _moved(np.asarray(sensor.get("to_world", np.eye(4)), float), view)
    return moved


def resized(film: Mapping, size: tuple[int, int]) -> dict:
    """The film with another size, and without a crop window."""
    kept = {key: value for key, value in film.items() if not key.startswith("crop_")}
    return kept | {"width": size[0], "height": size[1]}


def cropped(film: Mapping, window: tuple[int, int, int, int]) -> dict:
    """The film with this crop window: left, top, width, height. Raises UserError if it is not inside the film."""
    left, top, width, height = window
    if left + width > film["width"] or top + height > film["height"]:
        raise UserError(
            f"the window of --crop, {left},{top},{width}x{height}, extends beyond the image of "
            f"{film['width']}x{film['height']} pixels"
        )
    return dict(film) | {"crop_offset_x": left, "crop_offset_y": top, "crop_width": width, "crop_height": height}


def _moved(to_world: np.ndarray, view: View) -> np.ndarray:
    """The camera-to-world matrix `to_world` with the view's position, direction and up; it keeps its scale."""
    sizes = np.linalg.norm(to_world[:3, :3], axis=0)
    _, own_up, forward = (to_world[:3, :3] / sizes).T
    position = to_world[:3, 3] if view.position is None else view.position
    to_target = forward if view.target is None else view.target - position
    distance = np.linalg.norm(to_target)
    if not distance > 0:
        raise UserError("the camera is at the point that it has to look at; give two different points to --look-at")
    direction = to_target / distance
    if view.up is not None and are_parallel(view.up, direction):
        raise UserError("the camera looks along --up; give another direction that is up in the image")
    ups = [view.up] if view.up is not None else [_nearest_axis(own_up), own_up, forward]
    up = next(up for up in ups if not are_parallel(up, direction))
    return translate(position) @ look_at(np.zeros(3), direction, up) @ scale(sizes.tolist())


def are_parallel(a, b) -> bool:
    """Whether two vectors have the same or opposite directions, to 10^-6."""
    a, b = np.asarray(a, float), np.asarray(b, float)
    return bool(np.linalg.norm(np.cross(a, b)) <= 1e-6 * np.linalg.norm(a) * np.linalg.norm(b))


def _nearest_axis(direction: np.ndarray) -> np.ndarray:
    """The coordinate axis, or its opposite, that is nearest to a direction."""
    index = int(np.argmax(np.abs(direction)))
    return np.eye(3)[index] * math.copysign(1.0, direction[index])


def rotation_from_y(up) -> np.ndarray:
    """(3, 3): the smallest rotation that takes +y to the direction `up`; to -y, about x."""
    x, y, z = np.asarray(up, float) / np.linalg.norm(up)
    if y < -1 + 1e-12:
        return np.diag([1.0, -1.0, -1.0])
    k = 1.0 / (1.0 + y)  # Möller and Hughes 1999, "Efficiently Building a Matrix to Rotate One Vector to Another"
    return np.array([[1 - k * x * x, x, -k * x * z], [-x, y, -z], [-k * x * z, z, 1 - k * z * z]])
