"""The energy that an image lost because samples decide where the next ones go. Called by the render loop.

A pixel that gets more samples once it has seen a bright one dilutes it, and its mean is too small on average (Kirk and
Arvo, "Unbiased sampling techniques for image synthesis", 1991). The samples of uniform waves alone do not have this
bias, and their mean over the image is the control.
"""

from collections.abc import Callable

import numpy as np

from isonoise.statistics import Statistics
from isonoise.strips import row_strips

STRIP_PIXELS = 2**14
"""Pixels that are processed at a time, so that the temporary arrays stay in the cache."""


class EnergyLoss:
    """Estimates the loss of a render from the statistics before and after each of its waves.

    Attributes
    ----------
    uniform : (2, height, width) float64 or None
        Count and sum of x of every pixel's samples of uniform waves; during a uniform wave without all samples before
        it. None until the first adaptive wave, because until then all samples are of uniform waves.
    control : float
        Sum over the pixels of the means of these samples; nan if a pixel has none.
    """

    def __init__(self):
        self.uniform: np.ndarray | None = None
        self.control = np.nan

    def begin_wave(self, kind: str, statistics: Callable[[], Statistics]) -> None:
        """Begin a wave, 'uniform' or 'adaptive'; `statistics`, called if needed, returns those before it."""
        if kind == "adaptive" and self.uniform is None:
            self.uniform = np.zeros((2, *statistics().shape))
            self._add(statistics(), 1)
            self._update_control()
        elif kind == "uniform" and self.uniform is not None:
            self._add(statistics(), -1)

    def end_wave(self, kind: str, after: Statistics) -> None:
        """End the wave; `after` are the statistics after it."""
        if kind == "uniform" and self.uniform is not None:
            self._add(after, 1)
            self._update_control()

    def _add(self, statistics: Statistics, sign: int) -> None:
        for strip in row_strips(statistics.shape, STRIP_PIXELS):
            count, total = self.uniform[:, strip]
            signed = sign * statistics.count[strip].astype(np.float64)
            count += signed
            total += signed * statistics.mean[strip]

    def _update_control(self) -> None:
        self.control = 0.0
        for strip in row_strips(self.uniform.shape[1:], STRIP_PIXELS):
            count, total = self.uniform[:, strip]
            if not count.min() > 0:
                self.control = np.nan
                return
            self.control += float((total / count).sum())

    def estimate(self, statistics: Statistics) -> tuple[float, float]:
        """Relative loss of the image's mean luminance, and its standard error.

        `statistics` are those after the last wave. The loss is 1 - mean / control, above 0 if the image is too dark.
        The image holds the samples of the control, so a pixel's difference has the variance d s^2 (1 / u - 1 / n): of
        its n samples u are from uniform waves, and d is the design effect. Both are 0 without adaptive waves, and nan
        if a pixel has no sample of a uniform wave or the image is black.
        """
        if self.uniform is None:
            return 0.0, 0.0
        if not self.control > 0:
            return np.nan, np.nan
        square = 0.0
        for strip in row_strips(statistics.shape, STRIP_PIXELS):
            variance = statistics.variance_per_sample(strip)
            square += float((variance / self.uniform[0, strip]).sum())
            square -= float((variance / statistics.count[strip]).sum())
        loss = 1 - float(statistics.mean.sum()) / self.control
        return loss, float(np.sqrt(max(square, 0))) / self.control
