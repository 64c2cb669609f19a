"""Environment maps: an image in latitude and longitude around the scene, and the table by which it is sampled.

The map is Mitsuba 3's `envmap` (3.9.1): in its own space u = atan2(x, -z) / 2 pi and v = acos(y) / pi; texel centres
lie at one half along u, which closes upon itself, but along v from 0 to 1, so that the first and the last row are the
poles. Radiance is interpolated bilinearly between texels.

It is sampled in proportion to luminance * sin(theta) at the texels, interpolated bilinearly as well: a row of cells
and a cell of it by alias tables, which take one step however steep the map is, and a place within by inversion. So
nearly the density that radiance has: a texel 10^7 times brighter than its neighbours makes no more noise than a plain
sky. Where radiance is not zero the density is not either. Of the poles, where the sine is zero, its mean over the reach
of the texel counts.
"""

import warnings
from dataclasses import dataclass

import numpy as np

from isonoise.errors import SceneError
from isonoise.luminance import REC709_LUMINANCE
from isonoise.scene.image.image import Image
from isonoise.scene.light.alias_table import alias_tables

ENVIRONMENT = np.dtype(
    [
        ("to_world", "f4", 9),  # rows of an orthogonal matrix
        ("size", "u4", 2),  # texels: width, height
        ("scale", "f4"),  # radiance = texel * scale
        ("density", "f4"),  # pdf = density * interpolated (luminance * sine) / sin(theta); 0 if all is dark
    ]
)

ENVIRONMENT_ROW = np.dtype(
    [
        ("threshold", "f4"),  # of the alias table over rows of cells: scene/alias.py
        ("alias", "u4"),
        ("sine", "f4"),  # weight of this row of texels
    ]
)

_ROWS = 64  # that are summed at once
_ORTHOGONAL = 1e-3  # how far the axes of to_world may be off


@dataclass(frozen=True)
class EnvironmentMap:
    """An environment map as the device has it. Cell (row, column) lies between four texels, the next row's and, around
    the seam, the next column's."""

    record: np.ndarray  # (1,) ENVIRONMENT
    texels: np.ndarray  # (height, width, 4) float32: RGB, brightest luminance in [1, 2); threshold of the cell in
    # the alias table of its row
    rows: np.ndarray  # (height,) ENVIRONMENT_ROW
    aliases: np.ndarray  # (height - 1, width) uint32: of the cells in their row
    mean: np.ndarray  # (3,) float64: mean radiance over the sphere
    largest: float  # luminance of the brightest texel


def build_environment_map(image: Image, to_world: np.ndarray, scale: float, where: str) -> EnvironmentMap:
    """The map of an image. `to_world` is (4, 4); `where` names the emitter in errors.

    Whoever scales radiance for the device multiplies the record's `scale`. Raises SceneError where the image is smaller
    than 2 x 3 pixels or has values that are no finite numbers, and where to_world does more than turn, mirror and scale
    evenly. Negative values are black, with a warning.
    """
    rotation, pixels = _rotation(to_world, where), image.linear()
    height, width, _ = pixels.shape
    if width < 2 or height < 3:
        raise SceneError(f"{where}: an environment map needs at least 2 x 3 pixels, this one has {width} x {height}")
    if not np.isfinite(pixels.min()) or not np.isfinite(pixels.max()):
        raise SceneError(f"{where}: the environment map has pixels that are no finite numbers")
    if pixels.min() < 0:
        warnings.warn(f"{where}: the environment map has negative pixels; they are taken for black", stacklevel=2)
        pixels = np.maximum(pixels, 0)
    brightest = _brightest(pixels)
    exponent = 1 - int(np.frexp(brightest)[1])
    texels = np.zeros((height, width, 4), np.float32)
    np.ldexp(pixels, exponent, out=texels[..., :3])
    record = np.zeros(1, ENVIRONMENT)
    rows, aliases, total, mean = _tables(texels)
    record["to_world"] = rotation.ravel()
    record["size"] = width, height
    record["scale"] = unit = np.ldexp(scale, -exponent)
    record["density"] = width * (height - 1) / (2 * np.pi**2 * total) if total > 0 else 0.0
    return EnvironmentMap(record, texels, rows, aliases, mean * unit, brightest * scale)


def _brightest(pixels: np.ndarray) -> float:
    """The largest luminance."""
    weights = REC709_LUMINANCE if pixels.shape[2] == 3 else np.ones(1)
    return max(float((pixels[row : row + _ROWS] @ weights).max()) for row in range(0, len(pixels), _ROWS))


def _rotation(to_world: np.ndarray, where: str) -> np.ndarray:
    """The orthogonal matrix (3, 3) in to_world."""
    linear = np.asarray(to_world, float)[:3, :3]
    size = abs(np.linalg.det(linear)) ** (1 / 3)
    if size > 0 and np.isfinite(size):
        u, stretch, vt = np.linalg.svd(linear / size)
        if np.abs(stretch - 1).max() <= _ORTHOGONAL:
            return u @ vt
    raise SceneError(f"{where}: to_world of an environment map may turn, mirror and scale evenly, nothing else")


def _sines(height: int) -> np.ndarray:
    """Mean of sin(theta) over the reach of each row of texels, weighted as in linear interpolation, float64."""
    step = np.pi / (height - 1)
    sines = np.sin(step * np.arange(height)) * (2 * (1 - np.cos(step)) / step**2)
    sines[[0, -1]] = 2 * (step - np.sin(step)) / step**2
    return sines


def _tables(texels: np.ndarray) -> tuple[np.ndarray, np.ndarray, float, np.ndarray]:
    """Rows, aliases, the sum of the cells' weights, and the mean radiance over the sphere; enters thresholds into the
    texels."""
    height, width, _ = texels.shape
    sines = _sines(height)
    weights, sums = np.empty(height - 1), np.empty((height, 3))
    aliases = np.empty((height - 1, width), np.uint32)
    for first in range(0, height - 1, _ROWS):
        last = min(first + _ROWS, height - 1)
        part = texels[first : last + 1, :, :3].astype(np.float64)
        sums[first : last + 1] = part.sum(axis=1)
        node = (part @ REC709_LUMINANCE) * sines[first : last + 1, None]
        pair = node + np.roll(node, -1, axis=1)
        cells = 0.25 * (pair[:-1] + pair[1:])
        weights[first:last] = cells.sum(axis=1)
        texels[first:last, :, 3], aliases[first:last] = alias_tables(cells)
    rows = np.zeros(height, ENVIRONMENT_ROW)
    rows["sine"] = sines
    threshold, alias = alias_tables(weights[None])
    rows["threshold"][:-1], rows["alias"][:-1] = threshold[0], alias[0]
    share = sines.copy()  # of the sphere, for a row of texels; the poles reach to one side alone
    share[[0, -1]] *= 0.5
    mean = share @ sums * (np.pi / (2 * width * (height - 1)))
    return rows, aliases, float(weights.sum()), mean
