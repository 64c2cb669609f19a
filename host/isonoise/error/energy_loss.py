"""The energy that an image lost because samples decide where the next ones go. Called by the render loop.

A pixel that gets more samples once it has seen a bright one dilutes it, and its mean is too small on average (Kirk and
Arvo, "Unbiased sampling techniques for image synthesis", 1991). The samples of uniform waves alone do not have this
bias, and their mean over the image is the control.
"""

import numpy as np

from isonoise.statistics import Statistics
from isonoise.strips import row_strips

STRIP_PIXELS = 2**14
"""Pixels that are processed at a time, so that the temporary arrays stay in the cache."""


class EnergyLoss:
    """Estimates the loss of a render from the statistics after each of its waves."""

    def __init__(self):
        self._last: Statistics | None = None
        # Count and sum of x of every pixel's samples of uniform waves; until the first adaptive wave those of `_last`.
        self._uniform: np.ndarray | None = None
        self._control = np.nan  # sum over the pixels of the means of these samples

    def add_wave(self, kind: str, statistics: Statistics) -> None:
        """Add a wave, 'uniform' or 'adaptive'; `statistics` are those after it."""
        if kind == "adaptive" and self._uniform is None:
            self._uniform = np.zeros((2, *statistics.shape))
            if self._last is not None:
                self._add(self._last, None)
        elif kind == "uniform" and self._uniform is not None:
            self._add(statistics, self._last)
        self._last = statistics

    def _add(self, after: Statistics, before: Statistics | None) -> None:
        """Add the samples between two statistics to those of the uniform waves."""
        control, has_all = 0.0, True
        for strip in row_strips(after.shape, STRIP_PIXELS):
            count, total = self._uniform[:, strip]
            count += after.count[strip]
            total += after.count[strip] * after.mean[strip]
            if before is not None:
                count -= before.count[strip]
                total -= before.count[strip] * before.mean[strip]
            has_all = has_all and bool(count.min() > 0)
            control += float(np.divide(total, count, where=count > 0, out=np.zeros(count.shape)).sum())
        self._control = control if has_all else np.nan

    def estimate(self, statistics: Statistics) -> tuple[float, float]:
        """Relative loss of the image's mean luminance, and its standard error.

        `statistics` are those after the last wave. The loss is 1 - mean / control, above 0 if the image is too dark.
        The image holds the samples of the control, so a pixel's difference has the variance d s^2 (1 / u - 1 / n): of
        its n samples u are from uniform waves, and d is the design effect. Both are 0 without adaptive waves, and nan
        if a pixel has no sample of a uniform wave or the image is black.
        """
        if self._uniform is None:
            return 0.0, 0.0
        if not self._control > 0:
            return np.nan, np.nan
        square = 0.0
        for strip in row_strips(statistics.shape, STRIP_PIXELS):
            variance = statistics.variance_per_sample(strip)
            square += float((variance / self._uniform[0, strip]).sum())
            square -= float((variance / statistics.count[strip]).sum())
        loss = 1 - float(statistics.mean.sum()) / self._control
        return loss, float(np.sqrt(max(square, 0))) / self._control
