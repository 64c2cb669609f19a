"""Resamples pbrt-v4's environment maps to latitude and longitude. Called by `lights.py`.

They are squares in the equal-area octahedral mapping of Clarberg, "Fast Equal-Area Mapping of the (Hemi)Sphere using
SIMD" (2008), which all of pbrt-v4's spherical images have.
"""

import math

import numpy as np

from isonoise.scene.image.image import Image

_MAX_ROWS = 1024
_MIN_SUBSAMPLES, _MAX_SUBSAMPLES = 2, 8  # along each side of a texel
_CHUNK_ROWS = 32


def resample_equal_area(image: Image) -> Image:
    """The image of `envmap` with the same radiance in the same directions of the light's own space."""
    square = image.linear()
    size = len(square)
    rows = min(max(2 * size, 4), _MAX_ROWS)
    columns = 2 * rows
    subsamples = min(_MIN_SUBSAMPLES * math.ceil(max(size, _MAX_ROWS) / rows), _MAX_SUBSAMPLES)
    pixels = np.empty((rows, columns, square.shape[2]), np.float32)
    offsets = (np.arange(subsamples) + 0.5) / subsamples
    azimuth = 2 * np.pi * ((np.arange(columns)[:, None] + offsets) / columns).ravel()
    for first in range(0, rows, _CHUNK_ROWS):
        count = min(_CHUNK_ROWS, rows - first)
        # rows of texels are at theta = 0 to pi (Mitsuba 3, `envmap`)
        theta = np.pi * (np.arange(first, first + count)[:, None] - 0.5 + offsets).ravel() / (rows - 1)
        theta = np.clip(theta, 1e-9, np.pi - 1e-9)
        values = square[square_texels(_directions(theta, azimuth), size)]
        weights = np.sin(theta).reshape(count, subsamples)
        weights = (weights / weights.sum(axis=1, keepdims=True) / subsamples).astype(np.float32)
        values = values.reshape(count, subsamples, columns, subsamples, -1).sum(axis=3)
        pixels[first : first + count] = np.einsum("rs,rscn->rcn", weights, values)
    return Image(pixels)


def _directions(theta: np.ndarray, azimuth: np.ndarray) -> np.ndarray:
    """Directions (t, a, 3) in the space of `envmap`: theta from +y, azimuth = atan2(x, -z)."""
    sine = np.sin(theta)[:, None]
    y = np.broadcast_to(np.cos(theta)[:, None], (len(theta), len(azimuth)))
    return np.stack([sine * np.sin(azimuth), y, -sine * np.cos(azimuth)], axis=2)


def square_texels(directions: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    """(row, column) of the texel of a square image in each direction (..., 3)."""
    indices = np.clip((equal_area_square(directions) * size).astype(np.int64), 0, size - 1)
    return indices[..., 1], indices[..., 0]


def equal_area_square(directions: np.ndarray) -> np.ndarray:
    """The point (..., 2) of [0, 1]^2 of unit directions (..., 3)."""
    x, y, z = np.moveaxis(np.abs(directions), -1, 0)
    radius = np.sqrt(np.maximum(1.0 - z, 0.0))
    phi = np.arctan2(y, x) * (2 / np.pi)
    v = phi * radius
    u = radius - v
    is_below = directions[..., 2] < 0
    u, v = np.where(is_below, 1.0 - v, u), np.where(is_below, 1.0 - u, v)
    signed = np.stack([np.copysign(u, directions[..., 0]), np.copysign(v, directions[..., 1])], axis=-1)
    return 0.5 * (signed + 1.0)


def equal_area_directions(size: int) -> np.ndarray:
    """Unit directions (size, size, 3) at the centers of the texels, by row and column."""
    centers = 2 * (np.arange(size) + 0.5) / size - 1
    u, v = np.meshgrid(centers, centers)
    signed_distance = 1 - (np.abs(u) + np.abs(v))
    radius = 1 - np.abs(signed_distance)
    phi = np.pi / 4 * np.where(radius == 0, 1.0, (np.abs(v) - np.abs(u)) / np.where(radius == 0, 1, radius) + 1)
    length = radius * np.sqrt(2 - radius**2)
    z = np.copysign(1 - radius**2, signed_distance)
    return np.stack([np.copysign(np.cos(phi) * length, u), np.copysign(np.sin(phi) * length, v), z], axis=2)
