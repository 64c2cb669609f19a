"""The strategy `luxcore`: the adaptive sampling of LuxCoreRender."""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from isonoise.statistics import Statistics
from isonoise.strategies.allocation import distribute_in_proportion
from isonoise.strategies.base import Strategy, Wave
from isonoise.strategies.parameters import ranged
from isonoise.strategies.schedule import warmup_then_adaptive
from isonoise.strategies.uniform_allocation import uniform_allocation

CLIP_SIGMAS = 6
"""Errors are cut at this many standard deviations from their mean."""
EQUAL_TOLERANCE = 1e-12
"""Errors that differ by less than this share of their mean count as equal: the difference is rounding."""


@dataclass(kw_only=True, eq=False)
class LuxCore(Strategy):
    """Distributes samples in proportion to how much the image has changed since the last test.

    From: github.com/LuxCoreRender/LuxCore, `src/slg/film/noiseestimation/filmnoiseestimation.cpp` (error),
    `src/slg/samplers/random.cpp` (how the sampler uses it), `src/slg/film/filmparse.cpp` (defaults). With I the image
    and J the one `step` samples per pixel earlier, the error is

        (|I_R - J_R| + |I_G - J_G| + |I_B - J_B|) / sqrt(I_R + I_G + I_B),

    0 where the image is black; averaged over a window of 2 `scale` pixels per side; cut at 6 standard deviations from
    its mean over the image; and normalised to 0 for the best and 1 for the worst pixel. A pixel is sampled in
    proportion to the larger of that and 1 - `strength`. Scaling the light changes nothing.

    Differences: LuxCore tests the tone-mapped image, this the linear one. LuxCore accepts or skips a pixel at random,
    this rounds by largest remainders. If all errors are equal, LuxCore divides by 0; here the wave is uniform.

    Parameters
    ----------
    warmup : int
        Samples per pixel before the first image is stored, 1 to 65536.
    step : int
        Mean samples per pixel between two tests, 1 to 65536.
    scale : int
        Half of the window's side in pixels, 1 to 64.
    strength : float
        0 (uniform) to 0.95; with 0.95 every pixel gets at least 5 % of the worst one's samples.
    """

    name = "luxcore"

    warmup: int = ranged(32, 1, 65536)
    step: int = ranged(32, 1, 65536)
    scale: int = ranged(4, 1, 64)
    strength: float = ranged(0.95, 0, 0.95)

    _last_image: np.ndarray | None = field(default=None, init=False, repr=False)
    _last_samples: int = field(default=0, init=False, repr=False)
    _weights: np.ndarray | None = field(default=None, init=False, repr=False)

    def waves(self) -> Iterator[Wave]:
        self._last_image, self._weights = None, None  # one object may be used for several renders in turn
        return warmup_then_adaptive(self.warmup, self.step)

    def allocate(self, statistics: Statistics, budget: int) -> np.ndarray:
        samples = statistics.samples + int(statistics.rejected.sum(dtype=np.int64))
        if self._last_image is None or samples - self._last_samples >= self.step * statistics.count.size:
            if self._last_image is not None:
                noise = importance(change(statistics.rgb, self._last_image), self.scale)
                self._weights = np.maximum(noise, 1 - self.strength)
            self._last_image, self._last_samples = statistics.rgb.copy(), samples
        if self._weights is None:
            return uniform_allocation(statistics.shape, budget, samples)
        return distribute_in_proportion(self._weights, budget, samples)


def change(image: np.ndarray, last_image: np.ndarray) -> np.ndarray:
    """The error of `LuxCore` per pixel, from two images (height, width, 3); (height, width) float64."""
    difference = np.abs(image - last_image.astype(np.float64)).sum(axis=-1)
    light = np.maximum(image.sum(axis=-1, dtype=np.float64), 0)
    return np.divide(difference, np.sqrt(light), out=np.zeros(light.shape), where=light > 0)


def importance(error: np.ndarray, scale: int) -> np.ndarray:
    """Errors averaged over the window, cut at 6 sigma and normalised to [0, 1]; 1 if all are equal."""
    error = _window_mean(_window_mean(error, scale, axis=0), scale, axis=1)
    mean = error.mean()
    error -= mean
    limit = CLIP_SIGMAS * np.sqrt((error * error).mean())
    np.clip(error, -limit, limit, out=error)
    low, high = error.min(), error.max()
    if high - low <= EQUAL_TOLERANCE * mean:
        return np.ones(error.shape)
    return (error - low) / (high - low)


def _window_mean(values: np.ndarray, scale: int, axis: int) -> np.ndarray:
    """Mean from `scale` pixels before each to scale - 1 after it: LuxCore's window is not symmetric."""
    size = values.shape[axis]
    sums = np.insert(np.cumsum(values, axis=axis), 0, 0, axis=axis)
    index = np.arange(size)
    low, high = np.maximum(index - scale, 0), np.minimum(index + scale, size)
    shape = [-1 if a == axis else 1 for a in range(2)]
    return (sums.take(high, axis=axis) - sums.take(low, axis=axis)) / (high - low).reshape(shape)
