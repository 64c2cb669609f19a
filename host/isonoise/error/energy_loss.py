"""The energy that an image lost because samples decide where the next ones go. Called by the render loop.

A pixel that gets more samples once it has seen a bright one dilutes it, and its mean is too small on average (Kirk and
Arvo, "Unbiased sampling techniques for image synthesis", 1991). The samples of uniform waves alone do not have this
bias, and their mean over the image is the control.
"""

import numpy as np

from isonoise.statistics import Statistics


class EnergyLoss:
    """Estimates the loss of a render from the statistics after each of its waves."""

    def __init__(self):
        self._uniform = self._all = (0.0, 0.0)  # count and sum of x of every pixel: of uniform waves, and of all
        self._has_adaptive_waves = False

    def add_wave(self, kind: str, statistics: Statistics) -> None:
        """Add a wave, 'uniform' or 'adaptive'; `statistics` are those after it."""
        count = statistics.count.astype(np.float64)
        after = (count, count * statistics.mean)
        if kind == "uniform":
            self._uniform = tuple(u + a - b for u, a, b in zip(self._uniform, after, self._all, strict=True))
        else:
            self._has_adaptive_waves = True
        self._all = after

    def estimate(self, statistics: Statistics) -> tuple[float, float]:
        """Relative loss of the image's mean luminance, and its standard error.

        `statistics` are those after the last wave. The loss is 1 - mean / control, above 0 if the image is too dark.
        The image holds the samples of the control, so a pixel's difference has the variance d s^2 (1 / u - 1 / n): of
        its n samples u are from uniform waves, and d is the design effect. Both are 0 without adaptive waves, and nan
        if a pixel has no sample of a uniform wave or the image is black.
        """
        if not self._has_adaptive_waves:
            return 0.0, 0.0
        count, total = self._uniform
        if not np.all(count > 0):
            return np.nan, np.nan
        control = float((total / count).sum())
        if not control > 0:
            return np.nan, np.nan
        rest = np.maximum(1 / count - 1 / np.maximum(statistics.count, 1), 0)
        error = np.sqrt(float((statistics.variance_per_sample() * rest).sum()))
        return 1 - float(statistics.mean.sum()) / control, error / control
