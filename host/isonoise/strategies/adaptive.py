"""isonoise's own adaptive strategies: a variance estimate, an allocation rule, uniform waves in between.

`Adaptive` takes the measure as a parameter.

A strategy's measure is what its rule acts on: `deficit` makes it equal in all pixels, `sqrt` minimises the mean of its
square. `deficit` is the default of all but `pooled`.
"""

from abc import abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from isonoise.statistics import BASIC_NEEDS, Needs, Statistics
from isonoise.strategies import measures
from isonoise.strategies.base import Strategy, Wave
from isonoise.strategies.parameters import check_integer, check_odd, ranged
from isonoise.strategies.pieces import (
    AllocationRule,
    Measure,
    allocate_by_rule,
    compute_measure,
    find_measure,
    find_rule,
)
from isonoise.strategies.schedule import alternating_waves


@dataclass(kw_only=True, eq=False)
class AdaptiveBase(Strategy):
    """A uniform warm-up, then adaptive and uniform waves in turn.

    A subclass says what V is, the variance of one sample; with n samples so far the squared error is V / n.

    Parameters
    ----------
    rule : str or callable
        `deficit` fills up to n ~ V: equal errors. `sqrt` fills up to n ~ sqrt(V): least mean squared error.
        `proportional` gives samples in proportion to (V / n)^exponent. Also `module:function`, an entry point of the
        group `isonoise.allocation_rules`, or a function: see `pieces.AllocationRule`.
    exponent : float
        Of the rule `proportional`, 0.01 to 16.
    warmup : int
        Samples per pixel of the first, uniform wave, 2 to 65536.
    ratio : float
        Adaptive samples for each uniform one after the warm-up, 0.01 to inf; inf: no uniform waves.
    growth : float
        An adaptive and a uniform wave together have this many times the samples so far, 0.01 to 4.
    clip : float
        V is cut at this quantile of the pixels with V > 0, 0.5 to 1; 1 is off.
    cap : float
        No pixel multiplies its count by more than this in one wave while others are below their cap; a whole number
        from 2, or inf.
    """

    rule: AllocationRule | str = "deficit"
    exponent: float = ranged(1.0, 0.01, 16)
    warmup: int = ranged(16, 2, 65536)
    ratio: float = ranged(1.0, 0.01)
    growth: float = ranged(0.5, 0.01, 4)
    clip: float = ranged(0.999, 0.5, 1)
    cap: float = ranged(4, 2)

    def __post_init__(self) -> None:
        super().__post_init__()
        self.rule = find_rule(self.rule)
        check_integer("cap", self.cap)

    def waves(self) -> Iterator[Wave]:
        return alternating_waves(self.warmup, self.ratio, self.growth)

    def allocate(self, statistics: Statistics, budget: int | None) -> np.ndarray:
        assert budget is not None  # every wave of the schedule has a size
        assert not isinstance(self.rule, str)  # it is the function since it was checked
        variance = self.variance(statistics, measures.image_floor(statistics.mean))
        limits = {"clip": self.clip, "cap": self.cap, "exponent": self.exponent}
        return allocate_by_rule(self.rule, statistics, variance, budget, limits)

    @abstractmethod
    def variance(self, statistics: Statistics, floor: float) -> np.ndarray:
        """Return V, the variance of one sample.

        Parameters
        ----------
        statistics : Statistics
            Of all samples.
        floor : float
            Smallest denominator of relative errors, in the scene's units.

        Returns
        -------
        (height, width) float64
            A new array; inf where n < 2.
        """


@dataclass(kw_only=True, eq=False)
class Adaptive(AdaptiveBase):
    """Any measure with any allocation rule.

    Parameters
    ----------
    measure : str or callable
        `relative-mean`, `relative-median`, `absolute`, `half-buffer`, an entry point of the group `isonoise.measures`,
        `module:function`, or a function: the error of every pixel's mean, from `Statistics` and, if the function has
        such a parameter, the `floor` of relative errors. It returns (height, width) numbers from 0 to inf; inf is
        unknown. What it needs beyond the basic statistics is in its attribute `needs`, a `Needs`.
    rule : str or callable
        `deficit` (equal errors), `sqrt` (least mean squared error), `proportional`, an entry point of the group
        `isonoise.allocation_rules`, `module:function`, or a function of count, variance of one sample, both (height,
        width), and the budget in samples. It returns (height, width) uint32 that sums to the budget.
    exponent, warmup, ratio, growth, clip, cap
        Schedule and limits, as for `pooled` and the other strategies: `isonoise.strategies.adaptive.AdaptiveBase`.

    Examples
    --------
    The relative error, but at most 1:

    >>> import numpy as np
    >>> def limited(statistics, floor):
    ...     return np.minimum(isonoise.measures.relative_mean(statistics, floor), 1)
    >>> strategy = isonoise.Adaptive(measure=limited, rule="sqrt")
    >>> isonoise.render("cornell", spp=32, size=(16, 12), strategy=strategy).statistics.samples
    6144
    """

    name = "adaptive"

    measure: Measure | str

    def __post_init__(self) -> None:
        super().__post_init__()
        self.measure = find_measure(self.measure)

    @property
    def needs(self) -> Needs:  # type: ignore[override]
        """The statistics that the measure reads."""
        return getattr(self.measure, "needs", BASIC_NEEDS)

    def variance(self, statistics: Statistics, floor: float) -> np.ndarray:
        assert not isinstance(self.measure, str)  # it is the function since it was checked
        return measures.variance_per_sample(statistics, compute_measure(self.measure, statistics, floor))


class RelativeMean(AdaptiveBase):
    """Measure: se / max(mean, floor), the relative standard error.

    Parameters: those of `AdaptiveBase`.
    """

    name = "relative-mean"

    def variance(self, statistics: Statistics, floor: float) -> np.ndarray:
        return measures.variance_per_sample(statistics, measures.relative_mean(statistics, floor))


@dataclass(kw_only=True, eq=False)
class RelativeMedian(AdaptiveBase):
    """Measure: se / max(M_x, mean / kappa, floor), M_x the mean of the medians of chunks of samples.

    The proposal of Pajot, Barthe, Paulin, "Robust adaptive sampling for Monte-Carlo-based rendering", SIGGRAPH Asia
    2011 Posters, 49:1. The poster writes V(x_1..x_n) / M_x without saying what V is; here it is the standard error.

    Parameters
    ----------
    kappa : float
        M_x counts as at least mean / kappa, 1 to inf; inf with `batch` 1 is the poster's own form.
    chunk : int
        Entries per chunk, odd, 3 to 31.
    batch : int
        Samples per entry, which is their mean, 1 to 1024.
    literal : bool
        Take the poster's V as the variance: se^2 / max(M_x, mean / kappa, floor) in place of the squared measure.

    Further parameters: those of `AdaptiveBase`.
    """

    name = "relative-median"

    kappa: float = ranged(8.0, 1)
    chunk: int = ranged(5, 3, 31)
    batch: int = ranged(4, 1, 1024)
    literal: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        check_odd("chunk", self.chunk)

    @property
    def needs(self) -> Needs:  # type: ignore[override]
        return Needs(median=True, chunk=self.chunk, batch=self.batch)

    def variance(self, statistics: Statistics, floor: float) -> np.ndarray:
        measure = measures.relative_median(statistics, floor, self.kappa)
        if not self.literal:
            return measures.variance_per_sample(statistics, measure)
        square: np.ndarray = measure * measures.standard_error(statistics)  # falls like 1 / n, as a squared error does
        np.multiply(square, statistics.count, out=square, where=np.isfinite(square))
        return square


class Absolute(AdaptiveBase):
    """Measure: se, the standard error itself: plain variance-driven sampling. Bright pixels get the samples.

    Parameters: those of `AdaptiveBase`.
    """

    name = "absolute"

    def variance(self, statistics: Statistics, floor: float) -> np.ndarray:
        return measures.variance_per_sample(statistics, measures.standard_error(statistics))


@dataclass(kw_only=True, eq=False)
class Tsallis(AdaptiveBase):
    """Measure: sqrt(1 - S_q / S_max), S_q the Tsallis entropy of the samples' shares of their sum.

    Xu, Sbert, Xing, Zhan, "Adaptive sampling based on Tsallis entropy", 2007. With q = 2 it is exactly `relative-mean`
    without a floor. Other q do not fall like 1 / sqrt(n) and so cannot make an error the same everywhere.

    Parameters
    ----------
    q : float
        The entropic index, 0.1 to 8; 1 is Shannon's entropy.

    Further parameters: those of `AdaptiveBase`.
    """

    name = "tsallis"

    q: float = ranged(2.0, 0.1, 8)

    @property
    def needs(self) -> Needs:  # type: ignore[override]
        return Needs(power=None if self.q == 2 else self.q)

    def variance(self, statistics: Statistics, floor: float) -> np.ndarray:
        return measures.variance_per_sample(statistics, measures.tsallis(statistics, self.q))


@dataclass(kw_only=True, eq=False)
class Pooled(AdaptiveBase):
    """Measure: the relative standard error, with variance and mean of the pixel's neighbours.

    The default rule, `sqrt`, minimises the mean of the squared measure over the pixels for a given number of samples.

    A pixel that chooses its count by its own samples gets more of them when it has seen a bright outlier. They dilute
    the outlier and leave the image too dark (Kirk and Arvo, "Unbiased sampling techniques for image synthesis", 1991).
    Neighbours expect the same outliers and do not know whether the pixel has seen one.

    Parameters
    ----------
    window : int
        Pixels per side of the neighbourhood, odd, 3 to 31; the pixel itself is left out.
    outlier_share : float
        Pixels with far more variance than their neighbours count with their own, the worst first, as long as their
        standard errors sum to at most outlier_share / sqrt(samples per pixel) of the image's sum, 0 to 1. It dilutes
        the brightest outliers at the cost of a small loss of energy, which falls as the render goes on.
    unbiased : bool
        Read only the uniform waves' samples, and no pixel's own variance (outlier_share counts as 0). Then a pixel's
        count does not depend on its own samples, but for its share in sums over the image.

    Further parameters: those of `AdaptiveBase`.
    """

    name = "pooled"

    window: int = ranged(5, 3, 31)
    outlier_share: float = ranged(0.012, 0, 1)
    unbiased: bool = False
    rule: AllocationRule | str = "sqrt"
    ratio: float = ranged(0.35, 0.01)
    growth: float = ranged(0.2, 0.01, 4)
    clip: float = ranged(1.0, 0.5, 1)

    def __post_init__(self) -> None:
        super().__post_init__()
        check_odd("window", self.window)

    @property
    def needs(self) -> Needs:  # type: ignore[override]
        return Needs(uniform=True) if self.unbiased else Needs(neighbours=self.window)

    def variance(self, statistics: Statistics, floor: float) -> np.ndarray:
        if self.unbiased:
            assert statistics.uniform is not None  # it is needed
            uniform = measures.with_neighbours(statistics.uniform, self.window)
            return measures.neighbour_variance(uniform, measures.image_floor(uniform.mean))
        if statistics.neighbour_variance is None:  # they are not from a renderer
            statistics = measures.with_neighbours(statistics, self.window)
        return measures.neighbour_variance(statistics, floor, self.outlier_share)
