"""The layers of the live page as bytes: float16 in units of their own, and what the page has to know to show them.

The thread that renders makes a `Picture`; a thread of the server encodes it, while the device goes on.
"""

import json
import math
import threading
import time
from collections.abc import Callable

import numpy as np

from isonoise.film.png import automatic_exposure

LAYERS = ("image", "error", "samples")
MAX_REDUCTION = 16
"""Most pixels, in either direction, whose mean is a pixel of a reduced layer."""
SAMPLED_PIXELS = 2**16
"""About so many pixels decide exposures and the ends of scales."""
MAX_RATIO = 1000.0
"""Most that the ends of a map's scale differ: pixels that are nearly exact share a colour."""
_MAX_HALF = np.float32(65504)
_SHARES = (0.01, 0.99)
"""Quantiles of the pixels at the ends of the scales of maps."""


class Picture:
    """A layer at a moment of the render, as bytes once somebody asks for them.

    Parameters
    ----------
    version : int
        Samples of the render. A later picture has more.
    encode : callable
        Returns the bytes, as `encode_image` does.
    """

    def __init__(self, version: int, encode: Callable[[], bytes]):
        self.version = version
        self._encode: Callable[[], bytes] | None = encode  # until it has been called
        self._data = b""
        self._lock = threading.Lock()
        self.cpu_s = 0.0

    def data(self) -> bytes:
        """The bytes. The first call takes `cpu_s` seconds of CPU time."""
        with self._lock:
            if self._encode is not None:
                start = time.thread_time()
                self._data, self._encode = self._encode(), None
                self.cpu_s = time.thread_time() - start
            return self._data


def encode_image(rgb: np.ndarray, version: int, reduction: int = 1, exposure: float | None = None) -> bytes:
    """The image as bytes.

    Four bytes hold the length of the JSON object that follows, which is padded with spaces to a multiple of 4; then
    come float16 values, all of a channel one after the other. All numbers are little-endian. The object has `width`,
    `height`, `channels`, `reduction` (pixels of the image that a pixel stands for, in either direction), `unit` (what a
    value of 1 stands for), `version`; `exposure` of the image, and `range` (ends of the scale) of a map.

    Parameters
    ----------
    rgb : (height, width, 3) float32
        Linear RGB.
    version : int
        Of the picture.
    reduction : int
        1 to `MAX_REDUCTION`.
    exposure : float or None
        Factor on radiance before the page tone-maps it; None: the one that a PNG file has, from a part of the pixels.
    """
    reduction = min(reduction, *rgb.shape[:2])
    planes = _reduce(rgb.transpose(2, 0, 1), reduction)
    step = _step(planes[0].size)
    few = planes[:, ::step, ::step].transpose(1, 2, 0).clip(0)
    exposure = automatic_exposure(np.where(np.isfinite(few), few, 0)) if exposure is None else exposure
    unit = 2.0 ** -round(math.log2(exposure)) if 0 < exposure < math.inf else 1.0  # visible values are around 1
    return _bytes(planes, reduction, unit, version, exposure=exposure)


def encode_map(values: np.ndarray, version: int, reduction: int = 1) -> bytes:
    """A map as bytes; as `encode_image`. `values`: (height, width), 0 or more, infinite where unknown."""
    reduction = min(reduction, *values.shape)
    plane = _reduce(values[np.newaxis].astype(np.float32, copy=False), reduction)
    step = _step(plane.size)
    few = plane[0, ::step, ::step]
    few = few[np.isfinite(few) & (few > 0)]
    low, high = np.quantile(few, _SHARES).tolist() if few.size else (1.0, 1.0)
    low = max(low, high / MAX_RATIO)
    unit = 2.0 ** round(math.log2(math.sqrt(low * high)))
    return _bytes(plane, reduction, unit, version, range=[low, high])


def _step(pixels: int) -> int:
    return max(math.isqrt(pixels // SAMPLED_PIXELS), 1)


def _reduce(planes: np.ndarray, reduction: int) -> np.ndarray:
    """Means of blocks of pixels; rows and columns that fill no block are left out."""
    _, height, width = planes.shape
    if reduction == 1:
        return planes
    bottom, right = height // reduction * reduction, width // reduction * reduction
    rows = planes[:, :bottom:reduction, :right].copy()
    for row in range(1, reduction):
        rows += planes[:, row:bottom:reduction, :right]
    result: np.ndarray = rows[:, :, ::reduction].copy()
    for column in range(1, reduction):
        result += rows[:, :, column::reduction]
    result /= reduction * reduction
    return result


def _bytes(planes: np.ndarray, reduction: int, unit: float, version: int, **facts: object) -> bytes:
    channels, height, width = planes.shape
    facts |= {"width": width, "height": height, "channels": channels, "reduction": reduction, "unit": unit}
    text = json.dumps(facts | {"version": version}).encode()
    text += b" " * (-len(text) % 4)
    values = planes * np.float32(1 / unit) if unit != 1 else planes
    with np.errstate(over="ignore", invalid="ignore"):
        half = np.clip(values, -_MAX_HALF, _MAX_HALF).astype("<f2") if channels == 3 else values.astype("<f2")
    return b"".join((len(text).to_bytes(4, "little"), text, half.tobytes()))
