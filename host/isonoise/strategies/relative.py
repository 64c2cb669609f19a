"""The strategies that make the relative error uniform: a measure, water-filling, and uniform waves in between."""

from abc import abstractmethod
from collections.abc import Iterator

import numpy as np

from isonoise.statistics import Needs, Statistics
from isonoise.strategies.allocation import deficit
from isonoise.strategies.base import Strategy, Wave
from isonoise.strategies.measures import image_floor, relative_mean, relative_median, variance_of_one
from isonoise.strategies.parameters import check_range, check_whole
from isonoise.strategies.schedule import alternating_waves


class _Deficit(Strategy):
    """A uniform warm-up, then adaptive and uniform waves in turn; adaptive waves are allocated by `deficit`."""

    def __init__(self, warmup: int, ratio: float, growth: float, clip: float, cap: float):
        check_range("warmup", warmup, 2, 65536)
        check_range("ratio", ratio, 0.01, 100)
        check_range("growth", growth, 0.01, 4)
        check_range("clip", clip, 0.5, 1)
        check_range("cap", cap, 2)
        check_whole("cap", cap)
        self.warmup, self.ratio, self.growth, self.clip, self.cap = warmup, ratio, growth, clip, cap

    def waves(self) -> Iterator[Wave]:
        return alternating_waves(self.warmup, self.ratio, self.growth)

    def allocate(self, statistics: Statistics, budget: int) -> np.ndarray:
        measure = self.measure(statistics, image_floor(statistics.mean))
        variance = variance_of_one(statistics, measure)
        del measure
        # The samples so far stand for the wave's index: they differ from wave to wave and are the same after a resume.
        return deficit(statistics.count, variance, budget, statistics.samples, clip=self.clip, cap=self.cap)

    @abstractmethod
    def measure(self, statistics: Statistics, floor: float) -> np.ndarray:
        """The relative standard error to equalise, float64 (height, width)."""


class RelativeMean(_Deficit):
    """Makes se / max(mean, floor) uniform: the standard estimate.

    - `warmup`: samples per pixel of the first, uniform wave, 2 to 65536.
    - `ratio`: adaptive samples for each uniform one after the warm-up, 0.01 to 100.
    - `growth`: an adaptive and a uniform wave together bring this many times the samples so far, 0.01 to 4.
    - `clip`: the variance is cut at this quantile of the pixels that have any, 0.5 to 1; 1 is off.
    - `cap`: no pixel multiplies its count by more than this in one wave; a whole number from 2, or inf.
    """

    name = "relative-mean"

    def __init__(
        self, *, warmup: int = 16, ratio: float = 1.0, growth: float = 0.5, clip: float = 0.999, cap: float = 4
    ):
        super().__init__(warmup, ratio, growth, clip, cap)

    def measure(self, statistics: Statistics, floor: float) -> np.ndarray:
        return relative_mean(statistics, floor)


class RelativeMedian(_Deficit):
    """Makes se / max(M_x, mean / kappa, floor) uniform, M_x the mean of the chunk medians: the poster's measure.

    - `kappa`: how much smaller than the mean M_x may count, 1 to inf; inf is the poster's own form.
    - `warmup`: samples per pixel of the first, uniform wave, 2 to 65536.
    - `ratio`: adaptive samples for each uniform one after the warm-up, 0.01 to 100.
    - `growth`: an adaptive and a uniform wave together bring this many times the samples so far, 0.01 to 4.
    - `clip`: the variance is cut at this quantile of the pixels that have any, 0.5 to 1; 1 is off.
    - `cap`: no pixel multiplies its count by more than this in one wave; a whole number from 2, or inf.
    """

    name = "relative-median"
    needs = Needs(median=True)

    def __init__(
        self,
        *,
        kappa: float = 8.0,
        warmup: int = 16,
        ratio: float = 1.0,
        growth: float = 0.5,
        clip: float = 0.999,
        cap: float = 4,
    ):
        super().__init__(warmup, ratio, growth, clip, cap)
        check_range("kappa", kappa, 1)
        self.kappa = kappa

    def measure(self, statistics: Statistics, floor: float) -> np.ndarray:
        return relative_median(statistics, floor, self.kappa)
