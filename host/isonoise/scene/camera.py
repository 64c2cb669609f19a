"""The sensor, its film and its filter as one camera record."""

import math
import re

import numpy as np

from isonoise.errors import SceneError
from isonoise.scene import structs

_GAUSSIAN_RADIUS = 4.0  # in standard deviations, where Mitsuba 3 cuts its gaussian
_DEFAULT_FOCAL_LENGTH = "50mm"


def compile_camera(sensor: dict, size: tuple[int, int] | None) -> tuple[np.ndarray, str]:
    """(camera record (1,), name of the filter). `size` replaces the film's size and drops its crop window."""
    film = sensor.get("film", {})
    width, height = size or (film.get("width", 768), film.get("height", 576))
    if width < 1 or height < 1:
        raise SceneError(f"a film of {width}x{height} has no pixels")
    offset = (0, 0) if size else (film.get("crop_offset_x", 0), film.get("crop_offset_y", 0))
    crop = (width, height) if size else (film.get("crop_width", width), film.get("crop_height", height))
    if offset[0] + crop[0] > width or offset[1] + crop[1] > height:
        raise SceneError(f"film: the crop window {crop[0]}x{crop[1]} at {offset} leaves the film of {width}x{height}")
    rfilter = film.get("rfilter", {"type": "gaussian", "stddev": 0.5})
    camera = np.zeros(1, structs.CAMERA)
    camera["to_world"] = _rigid(sensor.get("to_world", np.eye(4)))[:3].ravel()
    tan_x = math.tan(0.5 * _fov_x(sensor, width / height))
    camera["tan_half_fov"] = (tan_x, tan_x * height / width)
    camera["principal_point"] = (sensor["principal_point_offset_x"], sensor["principal_point_offset_y"])
    camera["near_clip"], camera["far_clip"] = sensor["near_clip"], sensor["far_clip"]
    camera["film_size"], camera["crop_offset"], camera["crop_size"] = (width, height), offset, crop
    camera["filter_stddev"] = rfilter.get("stddev", 0.0)
    radius = {"box": 0.5, "tent": rfilter.get("radius"), "gaussian": _GAUSSIAN_RADIUS * rfilter.get("stddev", 0.0)}
    camera["filter_radius"] = radius[rfilter["type"]]
    return camera, rfilter["type"]


def _fov_x(sensor: dict, aspect: float) -> float:
    """Horizontal field of view of the full film in radians, from `fov` and its axis or from the focal length.

    A focal length is that of a 35 mm camera: its 36 x 24 mm frame's diagonal is the film's.
    """
    axis = sensor["fov_axis"]
    if "fov" in sensor:
        half = math.tan(0.5 * math.radians(sensor["fov"]))
    else:
        text = sensor.get("focal_length", _DEFAULT_FOCAL_LENGTH)
        match = re.fullmatch(r"\s*([0-9]*\.?[0-9]+)\s*(mm)?\s*", text)
        if not match or float(match[1]) <= 0:
            raise SceneError(f"sensor: a focal length is a number of millimetres such as '50mm', got '{text}'")
        half, axis = 0.5 * math.hypot(36.0, 24.0) / float(match[1]), "diagonal"
    if axis in ("smaller", "larger"):
        axis = "x" if (aspect <= 1.0) == (axis == "smaller") else "y"
    if axis == "y":
        half *= aspect
    elif axis == "diagonal":
        half /= math.sqrt(1.0 + 1.0 / aspect**2)
    return 2.0 * math.atan(half)


def _rigid(to_world: np.ndarray) -> np.ndarray:
    """The camera's transform, which has to keep lengths (as in Mitsuba 3, to 1e-3; it may mirror)."""
    if np.abs(to_world[:3, :3].T @ to_world[:3, :3] - np.eye(3)).max() > 1e-3:
        raise SceneError("sensor: to_world scales or shears; a camera may only be moved, turned and mirrored")
    return to_world
