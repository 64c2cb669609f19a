"""The energy that an image lost because samples decide where the next ones go. Called by the render loop.

A pixel that gets more samples once it has seen a bright one dilutes it, and its mean is too small on average (Kirk and
Arvo, "Unbiased sampling techniques for image synthesis", 1991). The samples of uniform waves alone do not have this
bias, and their mean over the image is the control.
"""

from collections.abc import Iterator

import numpy as np

from isonoise.statistics import Statistics

STRIP_PIXELS = 2**14
"""Pixels that are processed at a time, so that the temporary arrays stay in the cache."""


class EnergyLoss:
    """Estimates the loss of a render from the statistics after each of its waves."""

    def __init__(self):
        self._last: Statistics | None = None
        # Count and sum of x of every pixel's samples of uniform waves; until the first adaptive wave those of `_last`.
        self._uniform: np.ndarray | None = None

    def add_wave(self, kind: str, statistics: Statistics) -> None:
        """Add a wave, 'uniform' or 'adaptive'; `statistics` are those after it."""
        if kind == "adaptive" and self._uniform is None:
            self._uniform = np.zeros((2, *statistics.shape))
            if self._last is not None:
                self._add(self._last, np.add)
        elif kind == "uniform" and self._uniform is not None:
            self._add(statistics, np.add)
            self._add(self._last, np.subtract)
        self._last = statistics

    def _add(self, statistics: Statistics, operation: np.ufunc) -> None:
        """Add the statistics' counts and sums to those of the uniform waves, or subtract them."""
        for strip in _strips(statistics):
            count, mean = statistics.count[strip], statistics.mean[strip]
            uniform_count, uniform_sum = self._uniform[:, strip]
            operation(uniform_count, count, out=uniform_count)
            operation(uniform_sum, count * mean, out=uniform_sum)

    def estimate(self, statistics: Statistics) -> tuple[float, float]:
        """Relative loss of the image's mean luminance, and its standard error.

        `statistics` are those after the last wave. The loss is 1 - mean / control, above 0 if the image is too dark.
        The image holds the samples of the control, so a pixel's difference has the variance d s^2 (1 / u - 1 / n): of
        its n samples u are from uniform waves, and d is the design effect. Both are 0 without adaptive waves, and nan
        if a pixel has no sample of a uniform wave or the image is black.
        """
        if self._uniform is None:
            return 0.0, 0.0
        control, square = 0.0, 0.0
        for strip in _strips(statistics):
            uniform_count, uniform_sum = self._uniform[:, strip]
            if not uniform_count.min() > 0:
                return np.nan, np.nan
            count = np.maximum(statistics.count[strip], uniform_count)
            inverse = 1 / (uniform_count * count)  # one division for 1 / u and 1 / n: they take the most time
            rest = count - uniform_count
            rest *= inverse
            rest *= statistics.variance_per_sample(strip)
            square += float(rest.sum())
            count *= inverse
            count *= uniform_sum
            control += float(count.sum())
        if not control > 0:
            return np.nan, np.nan
        return 1 - float(statistics.mean.sum()) / control, float(np.sqrt(square)) / control


def _strips(statistics: Statistics) -> Iterator[slice]:
    """Rows of the image that are processed at a time."""
    height, width = statistics.shape
    rows = max(1, STRIP_PIXELS // width)
    return (slice(top, min(top + rows, height)) for top in range(0, height, rows))
