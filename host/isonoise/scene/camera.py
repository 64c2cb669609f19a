"""Compiles the sensor, its film and its pixel filter to one camera record. Called by `compile.py`."""

import math
import re
import warnings

import numpy as np

from isonoise.errors import SceneError
from isonoise.limits import MAX_PIXELS
from isonoise.scene import structs

_GAUSSIAN_RADIUS = 4.0  # truncation radius in standard deviations, Mitsuba 3's
_DEFAULT_FOCAL_LENGTH = "50mm"
_DEFAULT_FILTER = {"type": "gaussian", "stddev": 0.5}
_CAMERA_KINDS = {
    "perspective": structs.CAMERA_PINHOLE,
    "thinlens": structs.CAMERA_THIN_LENS,
    "orthographic": structs.CAMERA_ORTHOGRAPHIC,
}
_DEFAULT_FILM = {"width": 768, "height": 576}


def compile_camera(sensor: dict, size: tuple[int, int] | None) -> tuple[np.ndarray, str]:
    """(structs.CAMERA record (1,), name of the filter). `size` replaces the film's size and removes its crop window.

    Raises SceneError if it is out of range.
    """
    film = sensor.get("film", _DEFAULT_FILM)
    if size:
        check_size(size)
        film = {"width": size[0], "height": size[1], "rfilter": film.get("rfilter", _DEFAULT_FILTER)}
    width, height, offset, crop = _crop_window(film)
    rfilter = film.get("rfilter", _DEFAULT_FILTER)
    camera = np.zeros(1, structs.CAMERA)
    camera["to_world"] = sensor.get("to_world", np.eye(4))[:3].ravel()
    camera["kind"] = _CAMERA_KINDS[sensor["type"]]
    half_width = 1.0 if sensor["type"] == "orthographic" else tan_half_fov_x(sensor, width / height)
    camera["tan_half_fov"] = (half_width, half_width * height / width)
    if sensor["type"] == "perspective":
        camera["principal_point"] = (sensor["principal_point_offset_x"], sensor["principal_point_offset_y"])
    if sensor["type"] == "thinlens":
        camera["aperture_radius"] = sensor["aperture_radius"]
        camera["focus_distance"] = sensor.get("focus_distance", sensor["far_clip"])  # Mitsuba 3's default
    camera["near_clip"], camera["far_clip"] = sensor["near_clip"], sensor["far_clip"]
    camera["film_size"], camera["crop_offset"], camera["crop_size"] = (width, height), offset, crop
    stddev = rfilter.get("stddev", 0.0)
    camera["filter_stddev"] = stddev
    radius = {"box": 0.5, "tent": rfilter.get("radius"), "gaussian": _GAUSSIAN_RADIUS * stddev}
    camera["filter_radius"] = radius[rfilter["type"]]
    return camera, rfilter["type"]


def check_size(size: tuple[int, int]) -> None:
    """Raise SceneError if an image cannot have this size."""
    if min(size) < 1 or size[0] * size[1] > MAX_PIXELS:
        raise SceneError(f"size = {size} is out of range: an image has 1 to {MAX_PIXELS:,} pixels")


def warn_if_clipped(camera: np.ndarray, bounds: np.ndarray) -> None:
    """Warn if near_clip or far_clip of a camera (1,) hides the whole scene, which is in the box (2, 3) `bounds`."""
    to_world = camera["to_world"].reshape(3, 4).astype(float)
    corners = np.stack(np.meshgrid(*bounds.T, indexing="ij"), axis=-1).reshape(-1, 3)
    depth = (corners - to_world[:, 3]) @ to_world[:, 2] / (to_world[:, 2] @ to_world[:, 2])
    near, far = float(camera["near_clip"][0]), float(camera["far_clip"][0])
    if 0 < depth.max() < near:
        warnings.warn("the image shows no shape: all are nearer than near_clip", stacklevel=3)
    if depth.min() > far:
        warnings.warn("the image shows no shape: all are beyond far_clip", stacklevel=3)


def _crop_window(film: dict) -> tuple[int, int, tuple[int, int], tuple[int, int]]:
    """(film width, film height, crop offset, crop size) in pixels."""
    width, height = film["width"], film["height"]
    offset = (film.get("crop_offset_x", 0), film.get("crop_offset_y", 0))
    return width, height, offset, (film.get("crop_width", width), film.get("crop_height", height))


def crop_fits_film(film: dict) -> bool:
    """Whether the crop window lies within the film."""
    width, height, offset, crop = _crop_window(film)
    return offset[0] + crop[0] <= width and offset[1] + crop[1] <= height


def parse_focal_length(text: str) -> float | None:
    """Millimetres in a text such as '50mm', or None if it is invalid."""
    match = re.fullmatch(r"\s*([0-9]*\.?[0-9]+)\s*(mm)?\s*", text)
    return float(match[1]) if match and float(match[1]) > 0 else None


def is_rigid(to_world: np.ndarray) -> bool:
    """Whether a camera's transform preserves lengths, to 1e-3 as in Mitsuba 3. It may mirror."""
    linear = to_world[:3, :3]
    return bool(np.abs(linear.T @ linear - np.eye(3)).max() <= 1e-3)


def tan_half_fov_x(sensor: dict, aspect: float) -> float:
    """Tangent of half the horizontal field of view of the full film, from `fov` and its axis or the focal length.

    A focal length is that of a 35 mm camera: the diagonal of its 36 x 24 mm frame becomes the diagonal of the film.
    """
    axis = sensor["fov_axis"]
    if "fov" in sensor:
        half = math.tan(0.5 * math.radians(sensor["fov"]))
    else:
        half = 0.5 * math.hypot(36.0, 24.0) / parse_focal_length(sensor.get("focal_length", _DEFAULT_FOCAL_LENGTH))
        axis = "diagonal"
    if axis in ("smaller", "larger"):
        axis = "x" if (aspect <= 1.0) == (axis == "smaller") else "y"
    if axis == "y":
        return half * aspect
    return half / math.hypot(1.0, 1.0 / aspect) if axis == "diagonal" else half
