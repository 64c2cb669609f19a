"""What the strategies that retire pixels share: a threshold, pixels that are done, and a new round when all are."""

from abc import abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from isonoise.statistics import Statistics
from isonoise.strategies.base import Strategy, Wave

HALVINGS = 64
"""Of the threshold at a time; where all pixels are done even then, none has any error."""
WAVE_SHARE = 64
"""A wave brings this part of the samples so far, or more, if no pixel more than doubles its count by it ..."""
MOST = 2**20
"""... and none gets more samples than this: one work-item sums a pixel's."""


@dataclass(kw_only=True, eq=False)
class Retiring(Strategy):
    """Tests the pixels after a uniform warm-up and then after every wave; the active ones get the next samples.

    Ours in all of them, where the sources stop: when all pixels are done before the render is, the threshold is halved
    and all begin anew from their statistics. And where few pixels are active they get several steps between two tests,
    or waves too small for the device would take the time.
    """

    _scale: float = field(default=1.0, init=False, repr=False)  # of the threshold
    _active: np.ndarray | None = field(default=None, init=False, repr=False)

    def waves(self) -> Iterator[Wave]:
        self._scale, self._active = 1.0, None  # an object may serve several renders, one after the other
        yield Wave("uniform", self.first)
        while True:
            yield Wave("adaptive", None)

    def allocate(self, statistics: Statistics, budget: None) -> np.ndarray:
        active = self._next_active(statistics)
        least = statistics.samples // (WAVE_SHARE * self.step * int(np.count_nonzero(active)))
        steps = np.clip(statistics.count // self.step, 1, max(min(least, MOST // self.step), 1))
        return np.where(active, self.step * steps, 0).astype(np.uint32)

    @property
    @abstractmethod
    def first(self) -> int:
        """Samples per pixel before the first test."""

    @property
    @abstractmethod
    def step(self) -> int:
        """Samples of an active pixel between two tests."""

    @abstractmethod
    def error(self, statistics: Statistics) -> np.ndarray:
        """What is tested, float64 (height, width); inf where it is unknown."""

    @abstractmethod
    def active(self, error: np.ndarray, statistics: Statistics, scale: float, before: np.ndarray | None) -> np.ndarray:
        """The pixels that are not done, bool (height, width), with `scale` times the threshold.

        `before` are those that were not done at the last test; None begins anew, with all pixels.
        """

    def _next_active(self, statistics: Statistics) -> np.ndarray:
        error = self.error(statistics)
        lost = (statistics.count == 0) & (statistics.rejected > 0)  # pixels that no sample is going to find out
        error[lost] = 0
        scale, before = self._scale, self._active
        for _ in range(HALVINGS):
            active = self.active(error, statistics, scale, before) & ~lost
            if active.any():
                self._scale, self._active = scale, active
                return active
            scale, before = scale / 2, None
        self._active = None
        return np.ones(statistics.shape, dtype=bool)
