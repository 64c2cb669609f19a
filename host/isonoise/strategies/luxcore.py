"""The strategy `luxcore`: the adaptive sampling of LuxCoreRender."""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from isonoise.statistics import Statistics
from isonoise.strategies.allocation import proportional
from isonoise.strategies.base import Strategy, Wave
from isonoise.strategies.parameter_checks import check_range
from isonoise.strategies.uniform_allocation import uniform_allocation

SIGMAS = 6
"""Standard deviations from the mean at which errors are cut."""
ROUNDING = 1e-12
"""Differences below this share of the mean are rounding, and none."""


@dataclass(kw_only=True, eq=False)
class LuxCore(Strategy):
    """Samples in proportion to how much the image has changed since the test before.

    From: github.com/LuxCoreRender/LuxCore, `src/slg/film/noiseestimation/filmnoiseestimation.cpp` (error),
    `src/slg/samplers/random.cpp` (what becomes of it), `src/slg/film/filmparse.cpp` (defaults). With I the image and J
    the one `step` samples per pixel earlier, the error is

        (|I_R - J_R| + |I_G - J_G| + |I_B - J_B|) / sqrt(I_R + I_G + I_B),

    0 where the image is black; averaged over a window of 2 `scale` pixels a side; cut at 6 standard deviations from its
    mean over the image; and brought to 0 for the least and 1 for the worst pixel. A pixel is sampled in proportion to
    the larger of that and 1 - `strength`. Scaling the light changes nothing.

    Differences: LuxCore tests the image as it is shown, after tone mapping, here it is the linear one; it takes or
    leaves a pixel at random, here are largest remainders. Where all errors are equal it divides by 0; here the wave is
    uniform.

    - `warmup`: samples per pixel before the first image is kept, 1 to 65536.
    - `step`: mean samples per pixel between two tests, 1 to 65536.
    - `scale`: half the side of the window, in pixels, 1 to 64.
    - `strength`: 0 (uniform) to 0.95; with 0.95 every pixel has at least 5 % of the worst one's samples.
    """

    name = "luxcore"

    warmup: int = 32
    step: int = 32
    scale: int = 4
    strength: float = 0.95

    _image: np.ndarray | None = field(default=None, init=False, repr=False)  # at the last test
    _samples: int = field(default=0, init=False, repr=False)  # at the last test
    _weights: np.ndarray | None = field(default=None, init=False, repr=False)

    def __post_init__(self):
        check_range("warmup", self.warmup, 1, 65536)
        check_range("step", self.step, 1, 65536)
        check_range("scale", self.scale, 1, 64)
        check_range("strength", self.strength, 0, 0.95)

    def waves(self) -> Iterator[Wave]:
        self._image, self._weights = None, None  # an object may serve several renders, one after the other
        yield Wave("uniform", self.warmup)
        while True:
            yield Wave("adaptive", self.step)

    def allocate(self, statistics: Statistics, budget: int) -> np.ndarray:
        samples = statistics.samples + int(statistics.rejected.sum(dtype=np.int64))
        if self._image is None or samples - self._samples >= self.step * statistics.count.size:
            if self._image is not None:
                noise = importance(change(statistics.rgb, self._image), self.scale)
                self._weights = np.maximum(noise, 1 - self.strength)
            self._image, self._samples = statistics.rgb.copy(), samples
        if self._weights is None:
            return uniform_allocation(statistics.shape, budget, samples)
        return proportional(self._weights, budget, samples)


def change(image: np.ndarray, before: np.ndarray) -> np.ndarray:
    """The error of `LuxCore` by the pixel, from two images (height, width, 3); float64 (height, width)."""
    difference = np.abs(image - before.astype(np.float64)).sum(axis=-1)
    light = np.maximum(image.sum(axis=-1, dtype=np.float64), 0)
    return np.divide(difference, np.sqrt(light), out=np.zeros(light.shape), where=light > 0)


def importance(error: np.ndarray, scale: int) -> np.ndarray:
    """From errors to numbers from 0 to 1: averaged over the window, cut at 6 sigma, normalised; 1 if all are equal."""
    error = _window_mean(_window_mean(error, scale, axis=0), scale, axis=1)
    mean = error.mean()
    error -= mean
    cut = SIGMAS * np.sqrt((error * error).mean())
    np.clip(error, -cut, cut, out=error)
    low, high = error.min(), error.max()
    if high - low <= ROUNDING * mean:
        return np.ones(error.shape)
    return (error - low) / (high - low)


def _window_mean(values: np.ndarray, scale: int, axis: int) -> np.ndarray:
    """Mean of the `scale` values before each, its own and the scale - 1 after it, as far as there are such: LuxCore's
    window, which is not symmetric."""
    size = values.shape[axis]
    sums = np.insert(np.cumsum(values, axis=axis), 0, 0, axis=axis)
    at = np.arange(size)
    low, high = np.maximum(at - scale, 0), np.minimum(at + scale, size)
    shape = [-1 if a == axis else 1 for a in range(2)]
    return (sums.take(high, axis=axis) - sums.take(low, axis=axis)) / (high - low).reshape(shape)
