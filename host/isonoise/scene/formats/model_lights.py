"""Estimates how much light a model's own lights give to it. Called by `staging.py`."""

from collections.abc import Mapping

import numpy as np

from isonoise.luminance import REC709_LUMINANCE
from isonoise.scene.formats.framing import Extent
from isonoise.scene.formats.studio import WHITE, sphere_brightness
from isonoise.scene.image.image import Image
from isonoise.scene.spectra import colour_to_rgb
from isonoise.scene.transforms import transform_points

_MIN_LAMP = 4.0  # luminance of a lamp, in that of a white surface
_MAX_POINTS = 1000  # of the model, at which point lights are metered


def brightness_by_own_lights(scene: Mapping, extent: Extent, to_camera: np.ndarray) -> float:
    """Mean luminance of a white diffuse sphere in the model's place under the model's own lights, without shadows.

    A point or spot light is metered at points of the model and their median is taken, as if the sphere were lit from
    all sides; of an emissive surface its power, spread over a sphere of the model's size.
    """
    level = 0.0
    for part in filter(_is_object, scene.values()):
        if part.get("type") == "directional":
            direction = np.asarray(part.get("direction", _axis(part)), float)
            cosine = -(direction @ to_camera) / np.linalg.norm(direction)
            level += _luminance(part.get("irradiance", 1.0)) * float(sphere_brightness(cosine))
        elif part.get("type") in ("point", "spot"):
            level += _luminance(part.get("intensity", 1.0)) / (4 * np.pi * _squared_distance(part, extent))
        elif isinstance(part.get("emitter"), Mapping):
            radiance = _luminance(part["emitter"].get("radiance", 1.0), part)
            level += radiance * _area(part) / (4 * np.pi * extent.size**2)
    return level


def has_lamp(scene: Mapping) -> bool:
    """Whether a surface is so bright that it is meant to light others."""
    shapes = [part for part in filter(_is_object, scene.values()) if "emitter" in part]
    return any(_luminance(shape["emitter"].get("radiance", 1.0), shape) > _MIN_LAMP * WHITE for shape in shapes)


def _is_object(part) -> bool:
    return isinstance(part, Mapping)


def _axis(part: Mapping) -> np.ndarray:
    return np.asarray(part.get("to_world", np.eye(4)), float)[:3, 2]


def _squared_distance(light: Mapping, extent: Extent) -> float:
    """The median over the model's points, at least a hundredth of its size."""
    position = light.get("position")
    if position is None:
        position = np.asarray(light.get("to_world", np.eye(4)), float)[:3, 3]
    points = extent.points[:: -(-len(extent.points) // _MAX_POINTS)]
    squares = ((points - np.asarray(position, float)) ** 2).sum(axis=1)
    return max(float(np.median(squares)), (0.01 * extent.size) ** 2)


def _luminance(value, shape: Mapping | None = None) -> float:
    """The luminance of a colour; of a texture its mean over the image or over the mesh."""
    if not isinstance(value, Mapping) or value["type"] in ("rgb", "spectrum"):
        return _of_pixels(colour_to_rgb(value, "radiance"))
    if isinstance(value.get("bitmap"), Image):
        return _of_pixels(value["bitmap"].linear(bool(value.get("raw", False))))
    if value["type"] == "mesh_attribute" and shape is not None:
        attribute = shape.get("attributes", {}).get(value.get("name"))
        return 0.0 if attribute is None else float(value.get("scale", 1.0)) * _of_pixels(attribute)
    return 1.0


def _of_pixels(values: np.ndarray) -> float:
    """The luminance of the mean of colours (..., 1 or 3)."""
    values = np.asarray(values, float)
    mean = values.reshape(-1, values.shape[-1]).mean(axis=0)
    return float(mean.mean() if len(mean) == 1 else mean @ np.array(REC709_LUMINANCE))


def _area(shape: Mapping) -> float:
    """The area of a mesh; of other shapes, that of a sphere around the unit one."""
    to_world = np.asarray(shape.get("to_world", np.eye(4)), float)
    if shape["type"] != "mesh":
        return 4 * np.pi * abs(float(np.linalg.det(to_world[:3, :3]))) ** (2 / 3) * float(shape.get("radius", 1.0)) ** 2
    vertices = transform_points(to_world, np.asarray(shape["vertices"], float))
    a, b, c = (vertices[np.asarray(shape["faces"])[:, corner]] for corner in range(3))
    return 0.5 * float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())
