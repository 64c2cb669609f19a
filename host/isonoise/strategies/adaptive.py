"""The strategies of isonoise: a measure, a rule that equalises it, and uniform waves between the adaptive ones."""

from abc import abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from isonoise.errors import UserError
from isonoise.statistics import Needs, Statistics
from isonoise.strategies import measures
from isonoise.strategies.allocation import deficit, proportional_to_error
from isonoise.strategies.base import Strategy, Wave
from isonoise.strategies.parameter_checks import check_integer, check_range
from isonoise.strategies.schedule import alternating_waves

RULES = ("deficit", "sqrt", "proportional")


@dataclass(kw_only=True, eq=False)
class Adaptive(Strategy):
    """A uniform warm-up, then adaptive and uniform waves in turn; adaptive waves follow a measure of the pixels.

    With V the variance of one sample in the measure's terms, n the samples so far and m^2 = V / n:

    - `rule`: `deficit` fills up to n ~ V, which makes the measure the same everywhere; `sqrt` fills up to n ~ sqrt(V),
      which makes the mean of m^2 the least; `proportional` gives samples in proportion to (V / n)^exponent.
    - `exponent`: of `proportional`, 0.01 to 16.
    - `warmup`: samples per pixel of the first, uniform wave, 2 to 65536.
    - `ratio`: adaptive samples for each uniform one after the warm-up, 0.01 to inf; inf is without alternation.
    - `growth`: an adaptive and a uniform wave together bring this many times the samples so far, 0.01 to 4.
    - `clip`: V is cut at this quantile of the pixels that have any, 0.5 to 1; 1 is off.
    - `cap`: no pixel multiplies its count by more than this in one wave; a whole number from 2, or inf.
    """

    rule: str = "deficit"
    exponent: float = 1.0
    warmup: int = 16
    ratio: float = 1.0
    growth: float = 0.5
    clip: float = 0.999
    cap: float = 4

    def __post_init__(self):
        if self.rule not in RULES:
            raise UserError(f"strategy parameter rule = {self.rule!r} is not one of {', '.join(RULES)}")
        check_range("exponent", self.exponent, 0.01, 16)
        check_range("warmup", self.warmup, 2, 65536)
        check_range("ratio", self.ratio, 0.01)
        check_range("growth", self.growth, 0.01, 4)
        check_range("clip", self.clip, 0.5, 1)
        check_range("cap", self.cap, 2)
        check_integer("cap", self.cap)

    def waves(self) -> Iterator[Wave]:
        return alternating_waves(self.warmup, self.ratio, self.growth)

    def allocate(self, statistics: Statistics, budget: int) -> np.ndarray:
        variance = self.variance(statistics, measures.image_floor(statistics.mean))
        # The samples so far stand for the wave's index: they differ from wave to wave and are the same after a resume.
        wave = statistics.samples
        limits = {"clip": self.clip, "cap": self.cap}
        if self.rule == "proportional":
            return proportional_to_error(statistics.count, variance, budget, wave, exponent=self.exponent, **limits)
        if self.rule == "sqrt":
            variance = np.sqrt(variance, out=variance)
        return deficit(statistics.count, variance, budget, wave, **limits)

    def variance(self, statistics: Statistics, floor: float) -> np.ndarray:
        """V, the variance of one sample in the measure's terms: n m^2, inf where n < 2. A new array."""
        return measures.variance_of_one(statistics, self.measure(statistics, floor))

    @abstractmethod
    def measure(self, statistics: Statistics, floor: float) -> np.ndarray:
        """What stands for a standard error: float64 (height, width), a new array."""


class RelativeMean(Adaptive):
    """Follows se / max(mean, floor), the relative standard error.

    - parameters: those of `Adaptive`.
    """

    name = "relative-mean"

    def measure(self, statistics: Statistics, floor: float) -> np.ndarray:
        return measures.relative_mean(statistics, floor)


@dataclass(kw_only=True, eq=False)
class RelativeMedian(Adaptive):
    """Follows se / max(M_x, mean / kappa, floor), M_x the mean of the medians of chunks of samples.

    The proposal of Pajot, Barthe, Paulin, "Robust adaptive sampling for Monte-Carlo-based rendering", SIGGRAPH Asia
    2011 Posters, 49:1. It writes V(x_1..x_n) / M_x and does not say what V is; here it is the standard error.

    - `kappa`: how much smaller than the mean M_x may count, 1 to inf; inf with `batch` 1 is the poster's own form.
    - `chunk`: entries of a chunk, odd, 3 to 31.
    - `batch`: consecutive samples whose mean is an entry, 1 to 1024.
    - `literal`: reads V as the variance: se^2 / max(M_x, mean / kappa, floor) is followed.
    - and those of `Adaptive`.
    """

    name = "relative-median"

    kappa: float = 8.0
    chunk: int = 5
    batch: int = 4
    literal: bool = False

    def __post_init__(self):
        super().__post_init__()
        check_range("kappa", self.kappa, 1)
        check_range("chunk", self.chunk, 3, 31)
        check_range("batch", self.batch, 1, 1024)
        if self.chunk % 2 == 0:
            raise UserError(f"strategy parameter chunk = {self.chunk} must be odd, so that a chunk has a median")

    @property
    def needs(self) -> Needs:
        return Needs(median=True, chunk=self.chunk, batch=self.batch)

    def variance(self, statistics: Statistics, floor: float) -> np.ndarray:
        measure = self.measure(statistics, floor)
        if self.literal:  # already a variance: it falls like 1 / n
            return np.multiply(measure, statistics.count, out=measure, where=np.isfinite(measure))
        return measures.variance_of_one(statistics, measure)

    def measure(self, statistics: Statistics, floor: float) -> np.ndarray:
        measure = measures.relative_median(statistics, floor, self.kappa)
        return measure * measures.standard_error(statistics) if self.literal else measure


class Absolute(Adaptive):
    """Follows se, the standard error itself: plain variance-driven sampling. Bright pixels get the samples.

    - parameters: those of `Adaptive`.
    """

    name = "absolute"

    def measure(self, statistics: Statistics, floor: float) -> np.ndarray:
        return measures.standard_error(statistics)


@dataclass(kw_only=True, eq=False)
class Tsallis(Adaptive):
    """Follows sqrt(1 - S_q / S_max), S_q the Tsallis entropy of the samples' shares of their sum.

    Xu, Sbert, Xing, Zhan, "Adaptive sampling based on Tsallis entropy", 2007. With q = 2 it is `relative-mean` without
    a floor, exactly; other q do not fall like 1 / sqrt(n) and so do not make an error the same everywhere.

    - `q`: the entropic index, 0.1 to 8; 1 is Shannon's entropy.
    - and those of `Adaptive`.
    """

    name = "tsallis"

    q: float = 2.0

    def __post_init__(self):
        super().__post_init__()
        check_range("q", self.q, 0.1, 8)

    @property
    def needs(self) -> Needs:
        return Needs(power=None if self.q == 2 else self.q)

    def measure(self, statistics: Statistics, floor: float) -> np.ndarray:
        return measures.tsallis(statistics, self.q)


@dataclass(kw_only=True, eq=False)
class Pooled(Adaptive):
    """Follows the relative standard error with variance and mean pooled over a window of pixels, the own one included.

    A pixel that has caught a bright outlier raises its neighbours with it, so samples go where outliers are to be
    expected and not only where one has been seen: those merely dilute it, and leave the image too dark.

    - `window`: pixels a side, odd, 1 to 31; 1 is `relative-mean`.
    - and those of `Adaptive`.
    """

    name = "pooled"

    window: int = 3
    rule: str = "sqrt"
    ratio: float = 0.35
    growth: float = 0.2
    clip: float = 1.0

    def __post_init__(self):
        super().__post_init__()
        check_range("window", self.window, 1, 31)
        if self.window % 2 == 0:
            raise UserError(f"strategy parameter window = {self.window} must be odd, so that it has a middle")

    def variance(self, statistics: Statistics, floor: float) -> np.ndarray:
        return measures.pooled_variance(statistics, floor, self.window)

    def measure(self, statistics: Statistics, floor: float) -> np.ndarray:
        return np.sqrt(self.variance(statistics, floor) / np.maximum(statistics.count, 1))
