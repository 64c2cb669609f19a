"""Base of the strategies that stop sampling converged pixels: `purgathofer`, `dammertz`, `cycles`."""

from abc import abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from isonoise.statistics import Statistics
from isonoise.strategies.base import Strategy, Wave
from isonoise.strategies.schedule import warmup_then_adaptive

MAX_HALVINGS = 64
"""Most halvings of the threshold between two tests. If all pixels have converged even then, none has any error."""
MIN_WAVE_DIVISOR = 64
"""A wave has at least 1 / 64 of the samples so far, unless a pixel would more than double its count."""
MAX_WAVE_SAMPLES_PER_PIXEL = 2**20
"""One work-item sums up a pixel's samples: more would keep it busy for too long."""


@dataclass(kw_only=True, eq=False)
class StoppingStrategy(Strategy):
    """Tests all pixels after a uniform warm-up and then after every wave; the active ones get the next samples.

    A pixel is active until it has converged. Two things differ from the published methods, which stop at some point:
    when all pixels have converged before the render ends, the threshold is halved and all pixels are tested anew from
    their statistics. And if few pixels are active, they get several steps between two tests, because small waves leave
    a device idle.
    """

    _threshold_scale: float = field(default=1.0, init=False, repr=False)
    _active: np.ndarray | None = field(default=None, init=False, repr=False)

    def waves(self) -> Iterator[Wave]:
        self._threshold_scale, self._active = 1.0, None  # one object may be used for several renders in turn
        return warmup_then_adaptive(self.first_test_spp, None)

    def allocate(self, statistics: Statistics, budget: None) -> np.ndarray:
        active = self._update_active(statistics)
        steps_for_full_wave = statistics.samples // (MIN_WAVE_DIVISOR * self.step * int(np.count_nonzero(active)))
        max_steps = max(min(steps_for_full_wave, MAX_WAVE_SAMPLES_PER_PIXEL // self.step), 1)
        steps = np.clip(statistics.count // self.step, 1, max_steps)
        return np.where(active, self.step * steps, 0).astype(np.uint32)

    def _update_active(self, statistics: Statistics) -> np.ndarray:
        """Test all pixels; halve the threshold until one is active."""
        error = self.pixel_error(statistics)
        only_rejected = (statistics.count == 0) & (statistics.rejected > 0)  # more samples would not help
        error[only_rejected] = 0
        threshold_scale, previous = self._threshold_scale, self._active
        for _ in range(MAX_HALVINGS):
            active = self.active_pixels(error, statistics, threshold_scale, previous) & ~only_rejected
            if active.any():
                self._threshold_scale, self._active = threshold_scale, active
                return active
            threshold_scale, previous = threshold_scale / 2, None
        self._active = None
        return np.ones(statistics.shape, dtype=bool)

    @property
    @abstractmethod
    def first_test_spp(self) -> int:
        """Samples per pixel before the first test."""

    @property
    @abstractmethod
    def step(self) -> int:
        """Samples of an active pixel between two tests."""

    @abstractmethod
    def pixel_error(self, statistics: Statistics) -> np.ndarray:
        """The error that is compared with the threshold: a new (height, width) float64 array; inf if unknown."""

    @abstractmethod
    def active_pixels(
        self, error: np.ndarray, statistics: Statistics, threshold_scale: float, previous: np.ndarray | None
    ) -> np.ndarray:
        """The pixels that have not converged to `threshold_scale` times the threshold, (height, width) bool.

        `previous` are the active pixels of the last test; None: test all pixels anew.
        """
