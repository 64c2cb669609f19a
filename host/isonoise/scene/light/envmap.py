"""Environment maps: an image in latitude-longitude format around the scene, and the tables that sample it.

The map is Mitsuba 3's `envmap` (3.9.1). In its own space u = atan2(x, -z) / 2 pi and v = acos(y) / pi. Texel centers
are at (i + 0.5) / width along u, which wraps around. Along v they go from 0 to 1, so the first and the last row are the
poles. Radiance is interpolated bilinearly between texels.

It is sampled in proportion to luminance * sin(theta) at the texels, also interpolated bilinearly. Inversion selects a
row of cells, a cell in it, and the point in the cell, so that well-distributed random numbers give well-distributed
directions. This is nearly the density of radiance: a texel 10^7 times brighter than its neighbours makes no more noise
than a uniform map. Where radiance is not zero, the density is not zero either: at the poles, where the sine is 0, its
mean over the texel's support is used.
"""

import warnings
from dataclasses import dataclass

import numpy as np

from isonoise.errors import SceneError
from isonoise.luminance import REC709_LUMINANCE
from isonoise.scene.image.image import Image
from isonoise.scene.light.inverse_cdf import MAX_CELLS, inverse_cdfs

ENVIRONMENT = np.dtype(
    [
        ("to_world", "f4", 9),  # rows of an orthogonal matrix
        ("size", "u4", 2),  # texels: width, height
        ("scale", "f4"),  # radiance = texel * scale
        ("density", "f4"),  # pdf = density * interpolated (luminance * sine) / sin(theta); 0 if the map is black
    ]
)

ENVIRONMENT_ROW = np.dtype(
    [
        ("cdf", "u4"),  # of the rows of cells
        ("guide", "u4"),
        ("sine", "f4"),  # weight of this row of texels
    ]
)

_LUMINANCE = np.array(REC709_LUMINANCE)  # the kernels compute the density with these weights
_CHUNK_ROWS = 64  # rows processed at once
_MAX_STRETCH = 1e-3  # relative deviation of to_world from an orthogonal matrix


@dataclass(frozen=True)
class EnvironmentMap:
    """An environment map as the device reads it.

    Cell (row, column) lies between four texels: those of this and the next row, and of this and the next column, which
    wraps around.
    """

    record: np.ndarray  # (1,) ENVIRONMENT
    # (height, width, 4) float32: RGB, brightest luminance in [1, 2); bits of the CDF of the cells in their row
    texels: np.ndarray
    rows: np.ndarray  # (height,) ENVIRONMENT_ROW
    guide: np.ndarray  # (height - 1, width) uint32: of the cells in their row
    mean: np.ndarray  # (3,) float64: mean radiance over the sphere
    largest: float  # luminance of the brightest texel


def build_environment_map(image: Image, to_world: np.ndarray, scale: float, name: str) -> EnvironmentMap:
    """Build the map of an image. `to_world` is (4, 4); `name` names the emitter in errors.

    To scale its radiance, multiply the record's `scale`. Negative pixels become black, with a warning. Raises
    SceneError if the image is smaller than 2 x 3 pixels, has more than MAX_CELLS columns or rows of cells, or pixels
    that are not finite, or if to_world is not a rotation, reflection and uniform scale.
    """
    rotation, pixels = _rotation(to_world, name), image.linear()
    height, width, _ = pixels.shape
    if max(height - 1, width) > MAX_CELLS:
        raise SceneError(
            f"{name}: an environment map may have at most {MAX_CELLS} x {MAX_CELLS + 1} pixels, this one has "
            f"{width} x {height}; resize it"
        )
    if width < 2 or height < 3:
        raise SceneError(f"{name}: an environment map needs at least 2 x 3 pixels, this one has {width} x {height}")
    if not np.isfinite(pixels.min()) or not np.isfinite(pixels.max()):
        raise SceneError(f"{name}: the environment map has pixels that are not finite numbers")
    if pixels.min() < 0:
        warnings.warn(f"{name}: the environment map has negative pixels; they become black", stacklevel=2)
        pixels = np.maximum(pixels, 0)
    max_luminance = _max_luminance(pixels)
    exponent = 1 - int(np.frexp(max_luminance)[1])
    texels = np.zeros((height, width, 4), np.float32)
    np.ldexp(pixels, exponent, out=texels[..., :3])
    record = np.zeros(1, ENVIRONMENT)
    rows, cdf, guide, total = _sampling_tables(texels[..., :3])
    texels[:-1, :, 3] = cdf.view(np.float32)
    record["to_world"] = rotation.ravel()
    record["size"] = width, height
    record["scale"] = texel_scale = np.ldexp(scale, -exponent)
    record["density"] = width * (height - 1) / (2 * np.pi**2 * total) if total > 0 else 0.0
    mean = _mean_radiance(texels[..., :3]) * texel_scale
    return EnvironmentMap(record, texels, rows, guide, mean, max_luminance * scale)


def _max_luminance(pixels: np.ndarray) -> float:
    weights = _LUMINANCE if pixels.shape[2] == 3 else np.ones(1)
    return max(float((pixels[row : row + _CHUNK_ROWS] @ weights).max()) for row in range(0, len(pixels), _CHUNK_ROWS))


def _rotation(to_world: np.ndarray, name: str) -> np.ndarray:
    """The orthogonal matrix (3, 3) in to_world."""
    linear = np.asarray(to_world, float)[:3, :3]
    size = abs(np.linalg.det(linear)) ** (1 / 3)
    if size > 0 and np.isfinite(size):
        u, stretch, vt = np.linalg.svd(linear / size)
        if np.abs(stretch - 1).max() <= _MAX_STRETCH:
            return u @ vt
    raise SceneError(f"{name}: to_world of an environment map may only rotate, mirror and scale uniformly")


def _row_sines(height: int) -> np.ndarray:
    """Mean of sin(theta) over the support of each row of texels, weighted by linear interpolation, float64."""
    step = np.pi / (height - 1)
    sines = np.sin(step * np.arange(height)) * (2 * (1 - np.cos(step)) / step**2)
    sines[[0, -1]] = 2 * (step - np.sin(step)) / step**2
    return sines


def _sampling_tables(texels: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """(rows, CDFs and guides of the cells in their rows, sum of the cells' weights)."""
    height, width, _ = texels.shape
    sines = _row_sines(height)
    row_weights = np.empty(height - 1)
    cdf, guide = np.empty((height - 1, width), np.uint32), np.empty((height - 1, width), np.uint32)
    for first in range(0, height - 1, _CHUNK_ROWS):
        last = min(first + _CHUNK_ROWS, height - 1)
        texel_weights = (texels[first : last + 1].astype(np.float64) @ _LUMINANCE) * sines[first : last + 1, None]
        pairs = texel_weights + np.roll(texel_weights, -1, axis=1)
        cells = 0.25 * (pairs[:-1] + pairs[1:])
        row_weights[first:last] = cells.sum(axis=1)
        cdf[first:last], guide[first:last] = inverse_cdfs(cells)
    rows = np.zeros(height, ENVIRONMENT_ROW)
    rows["sine"] = sines
    (rows["cdf"][:-1],), (rows["guide"][:-1],) = inverse_cdfs(row_weights[None])
    return rows, cdf, guide, float(row_weights.sum())


def _mean_radiance(texels: np.ndarray) -> np.ndarray:
    """Mean (3,) float64 over the sphere."""
    height, width, _ = texels.shape
    row_sums = np.empty((height, 3))
    for first in range(0, height, _CHUNK_ROWS):
        row_sums[first : first + _CHUNK_ROWS] = texels[first : first + _CHUNK_ROWS].astype(np.float64).sum(axis=1)
    row_weights = _row_sines(height)
    row_weights[[0, -1]] *= 0.5  # the poles have texels on one side only
    return row_weights @ row_sums * (np.pi / (2 * width * (height - 1)))
