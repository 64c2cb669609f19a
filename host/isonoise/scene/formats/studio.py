"""The studio that lights a model: an environment in memory, and a light meter for environments. Called by `staging.py`.

The studio has a large soft light to the left of the camera, a weaker one to the right, a light overhead and one behind
the model, which lights its edge. Below the horizon it is as bright as the ground, so that the edge of the ground cannot
be seen. Mirrors and glass show the lights as rectangles with soft edges.
"""

from typing import NamedTuple

import numpy as np

from isonoise.luminance import REC709_LUMINANCE

WHITE = 0.8
"""Mean luminance of a white diffuse sphere in the model's place: what the light is metered to."""
GROUND_REFLECTANCE = 0.18
_HEIGHT = 128  # texels; the width is twice that
_MAX_METERED_HEIGHT = 512  # larger images are averaged first
_EDGE_DEGREES = 5.0  # over which a light falls to 0
_ZENITH = 0.6  # radiance at the zenith without its light, in that at the horizon


class _SoftBox(NamedTuple):
    """A light: angles in degrees; azimuth from the camera to its right, elevation from the horizon."""

    azimuth: float
    elevation: float
    half_width: float
    half_height: float
    radiance: float


_LIGHTS = (
    _SoftBox(-55, 45, 20, 18, 20.0),  # key
    _SoftBox(75, 28, 22, 22, 1.6),  # fill
    _SoftBox(150, 52, 18, 20, 9.0),  # edge
    _SoftBox(0, 90, 180, 20, 1.5),  # overhead
)


def studio_image() -> np.ndarray:
    """The studio (height, width, 3) float32 as a latitude-longitude image: y up, the camera in the direction +z."""
    azimuth, elevation = _angles(_HEIGHT)
    lights = np.zeros((_HEIGHT, 2 * _HEIGHT))
    for light in _LIGHTS:
        across = np.abs((azimuth - light.azimuth + 180) % 360 - 180)
        lights += (
            light.radiance
            * _inside(across, light.half_width)
            * _inside(np.abs(elevation - light.elevation), light.half_height)
        )
    background = np.where(elevation < 0, 1.0, 1.0 + (_ZENITH - 1.0) * np.sin(np.radians(elevation)) ** 2)
    background = np.broadcast_to(background, lights.shape)
    lights = np.where(elevation < 0, 0.0, lights)
    # the horizon is as bright as the ground, g = reflectance / pi * (g * a + b), with irradiances a and b
    a, b = (_irradiance_from_above(part) for part in (background, lights))
    ground = GROUND_REFLECTANCE * b / (np.pi - GROUND_REFLECTANCE * a)
    return np.repeat((ground * background + lights)[..., None], 3, axis=2).astype(np.float32)


def _angles(height: int) -> tuple[np.ndarray, np.ndarray]:
    """Azimuth (1, width) and elevation (height, 1) of the texels, degrees; rows from pole to pole."""
    column = (np.arange(2 * height) + 0.5) / (2 * height)
    return 180 - 360 * column[None, :], 90 - 180 * np.arange(height)[:, None] / (height - 1)


def _inside(distance: np.ndarray, half_size: float) -> np.ndarray:
    """1 within the half size, 0 beyond the edge, and a smooth step between."""
    t = np.clip((half_size - distance) / _EDGE_DEGREES + 0.5, 0, 1)
    return t * t * (3 - 2 * t)


def _solid_angles(height: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    """(height, 1) of a texel of each row, whose sum is that of the sphere; and the texels' polar angles."""
    theta = np.pi * np.arange(height)[:, None] / max(height - 1, 1)
    weights = np.sin(theta) if height > 2 else np.ones((height, 1))  # the only rows may be those of the poles
    return weights * (4 * np.pi / (weights.sum() * width)), theta


def _irradiance_from_above(radiance: np.ndarray) -> float:
    """On a horizontal surface, of an image (height, width)."""
    solid_angle, theta = _solid_angles(*radiance.shape)
    return float((radiance * solid_angle * np.maximum(np.cos(theta), 0)).sum())


def sphere_brightness(cosine: np.ndarray) -> np.ndarray:
    """Mean radiance of the disk of a white diffuse sphere, per unit of irradiance from one direction.

    `cosine` is that of the angle between the directions to the light and to the camera. The phase function of
    Lambert's sphere: Seeliger 1887; van de Hulst 1980, "Multiple Light Scattering", section 18.1.4. Its integral over
    all directions is 1, so that a uniform environment makes the sphere as bright as itself.
    """
    angle = np.arccos(np.clip(cosine, -1, 1))
    return 2 / (3 * np.pi**2) * (np.sin(angle) + (np.pi - angle) * np.cos(angle))


def meter(pixels: np.ndarray, to_camera: np.ndarray, ground_reflectance: float | None) -> float:
    """Mean luminance of a white diffuse sphere under a latitude-longitude image.

    Parameters
    ----------
    pixels : (height, width, 1 or 3), linear
    to_camera : unit vector to the camera, in the image's space
    ground_reflectance : of a horizontal ground, which takes the place of the image's lower half; None: there is none
    """
    weights = REC709_LUMINANCE if pixels.shape[2] == 3 else (1.0,)
    radiance = _reduced(np.maximum(pixels, 0) @ np.array(weights))
    solid_angle, theta = _solid_angles(*radiance.shape)
    if ground_reflectance is not None:
        irradiance = _irradiance_from_above(radiance)
        radiance = np.where(np.cos(theta) < 0, ground_reflectance * irradiance / np.pi, radiance)
    phi = 2 * np.pi * (np.arange(radiance.shape[1]) + 0.5)[None, :] / radiance.shape[1]
    directions = (np.sin(theta) * np.sin(phi), np.cos(theta), -np.sin(theta) * np.cos(phi))
    cosine = sum(component * axis for component, axis in zip(directions, to_camera, strict=True))
    return float((radiance * solid_angle * sphere_brightness(cosine)).sum())


def _reduced(radiance: np.ndarray) -> np.ndarray:
    """The image (height, width), averaged over square blocks if it is large."""
    factor = min(-(-radiance.shape[0] // _MAX_METERED_HEIGHT), radiance.shape[1])
    if factor == 1:
        return radiance
    height, width = (size // factor for size in radiance.shape)
    blocks = radiance[: height * factor, : width * factor].reshape(height, factor, width, factor)
    return blocks.mean(axis=(1, 3))
