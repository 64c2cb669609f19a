"""What finished runs say about a strategy: errors over the seeds, bias, paired ratios, time to equal error.

Pure functions on arrays. `errors` are signed relative errors e = (x - r) / max(r, floor) of the luminance, one image a
seed, shape (S, height, width). Intervals are 95 % and Student's t.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from isonoise.student_t import quantile as student_quantile

NORMAL = 10**6
"""Degrees of freedom from which on Student's t is normal, to 1e-6."""

TINY = np.finfo(np.float64).tiny


@dataclass(frozen=True)
class Interval:
    """A value and its 95 % interval; bounds are nan where there is none (fewer than two seeds)."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Estimate:
    """A mean, its standard error and the degrees of freedom of that error."""

    value: float
    se: float
    dof: int

    def interval(self) -> Interval:
        half = self.half_width()
        return Interval(self.value, self.value - half, self.value + half)

    def ratio(self) -> Interval:
        """Value and interval of exp(value): an estimate of a logarithm as a ratio."""
        interval = self.interval()
        return Interval(*(float(np.exp(x)) for x in (interval.value, interval.low, interval.high)))

    def half_width(self) -> float:
        """Half of the 95 % interval: t(0.975, dof) se."""
        return self.critical() * self.se

    def critical(self) -> float:
        """What |z| has to pass to be significant at 5 %: t(0.975, dof); nan without degrees of freedom."""
        return float(student_quantile(0.975, np.array([self.dof]))[0]) if self.dof > 0 else math.nan

    def z(self, null: float = 0.0) -> float:
        """(value - null) / se: follows Student's t where `null` is true."""
        off = self.value - null
        return off / self.se if self.se != 0 else (0.0 if off == 0 else math.copysign(math.inf, off))


def mean_over_seeds(values: Sequence[float], common_se: float = 0.0) -> Estimate:
    """Mean over the seeds; `common_se` is the standard error of what all seeds share, the reference.

    se^2 = s^2 / S + common_se^2. Degrees of freedom: Welch and Satterthwaite's (Welch 1947), with the second part
    known exactly: (S - 1) (se^2 / (s^2 / S))^2, rounded down; S - 1 where the reference is exact.
    """
    values = np.asarray(values, np.float64)
    if len(values) < 2 or not np.isfinite(values).all():
        return Estimate(float(values.mean()) if len(values) else math.nan, math.nan, 0)
    own = values.var(ddof=1) / len(values)
    total = own + common_se**2
    dof = (len(values) - 1) * (total / own) ** 2 if own > 0 else math.inf
    return Estimate(float(values.mean()), math.sqrt(total), int(min(dof, NORMAL)))


def paired_ratio(values: Sequence[float], baseline: Sequence[float]) -> Interval:
    """Ratio to the baseline, paired over the seeds: exp of the mean of log(value_s / baseline_s), t interval, S - 1."""
    values, baseline = np.asarray(values, np.float64), np.asarray(baseline, np.float64)
    with np.errstate(all="ignore"):
        return mean_over_seeds(np.log(values / baseline)).ratio()


def jackknife(value: float, without: Sequence[float]) -> Estimate:
    """A statistic of all seeds with its standard error from the S values that leave one seed out.

    se^2 = (S - 1)/S sum (without_i - mean)^2 (Tukey 1958; Efron and Stein 1981), S - 1 degrees of freedom. For a ratio
    give logarithms, made from both strategies without the same seed: that pairs them.

    It errs on the safe side (Efron and Stein): for the RMS p99 over 8 seeds the standard error came out 1.0 to 1.6
    times the true one in simulations (normal and Student errors, pixels alike or of very different noise).
    """
    without = np.asarray(without, np.float64)
    count = len(without)
    if count < 2 or not np.isfinite(without).all() or not math.isfinite(value):
        return Estimate(float(value), math.nan, 0)
    return Estimate(float(value), math.sqrt((count - 1) * without.var()), count - 1)


def rms_over_seeds(errors: np.ndarray) -> np.ndarray:
    """Root of the mean over the seeds of e^2 in every pixel, float64 (height, width)."""
    return np.sqrt(_sum_of_squares(errors) / len(errors))


def rms_quantiles(errors: np.ndarray, quantiles: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
    """Quantiles over the pixels of `rms_over_seeds`: of all seeds, shape (Q,), and without each seed, (S, Q).

    A single seed gives an empty second array, (0, Q).
    """
    total = _sum_of_squares(errors)
    of_all_seeds = np.sqrt(np.quantile(total, quantiles) / len(errors))
    if len(errors) < 2:
        return of_all_seeds, np.empty((0, len(quantiles)))
    # Rounding of a difference is nothing beside the noise of a quantile: the sort is what takes the time.
    left = ((total - np.square(e, dtype=np.float64)).astype(np.float32) for e in errors)
    without = np.array([np.quantile(rest, quantiles) for rest in left], np.float64)
    return of_all_seeds, np.sqrt(np.maximum(without, 0) / (len(errors) - 1))


def freed_of_reference(rms: np.ndarray, relative_se: np.ndarray) -> np.ndarray:
    """sqrt(max(rms^2 - se_ref^2, 0)): the RMS that an exact reference would show, in the mean over the pixels.

    `relative_se` is the reference's standard error over max(r, floor), of the same shape as `rms`.
    """
    return np.sqrt(np.maximum(np.square(rms) - np.square(relative_se), 0))


def bias(errors: np.ndarray, relative_se: np.ndarray | None = None) -> Estimate:
    """Mean relative error over the pixels, estimated from one mean a seed.

    The reference's part of its standard error is sqrt(sum (se_ref / max(r, floor))^2) / pixels: pixels independent.
    """
    means = [float(np.mean(e, dtype=np.float64)) for e in errors]
    shared = (
        0.0 if relative_se is None else math.sqrt(np.square(relative_se, dtype=np.float64).sum()) / relative_se.size
    )
    return mean_over_seeds(means, shared)


@lru_cache(maxsize=64)
def perfect_uniformity(seeds: int) -> float:
    """p99/p50 over the pixels of the RMS over S seeds when every pixel has the same normal error.

    That RMS is distributed like sqrt(chi^2_S / S), so it is sqrt(q(0.99) / q(0.5)) of chi^2 with S degrees of freedom.
    """
    return math.sqrt(chi_square_quantile(0.99, seeds) / chi_square_quantile(0.5, seeds))


def chi_square_quantile(p: float, dof: float) -> float:
    """The x with P(dof/2, x/2) = p, by bisection; P is the regularised lower incomplete gamma function."""
    low, high = 0.0, dof + 10.0
    while _lower_gamma(dof / 2, high / 2) < p:
        low, high = high, 2 * high
    for _ in range(100):
        middle = (low + high) / 2
        low, high = (middle, high) if _lower_gamma(dof / 2, middle / 2) < p else (low, middle)
    return (low + high) / 2


def allocation_bound(variance: np.ndarray) -> float:
    """What any allocation can make of uniform sampling's mean relMSE: mean(sqrt V)^2 / mean(V), reached by n ~ sqrt V.

    `variance`: relative variance of one sample, (height, width). By Cauchy and Schwarz, sum V/n >= (sum sqrt V)^2 / N
    for counts that sum to N. nan where all is noiseless.
    """
    mean = float(np.mean(variance, dtype=np.float64))
    return float(np.mean(np.sqrt(variance, dtype=np.float64))) ** 2 / mean if mean > 0 else math.nan


@dataclass(frozen=True)
class Curve:
    """Error against time: of all seeds, shape (K,), and without each seed, (S, K) (empty for a single seed)."""

    time: np.ndarray
    error: np.ndarray
    time_without: np.ndarray
    error_without: np.ndarray


@dataclass(frozen=True)
class TimeRatio:
    """Time to the baseline's final error over the baseline's time to it: between `low` and `high`.

    The two are the same where both curves pass through that error; `high` is inf where the strategy did not reach it,
    `low` 0 where it was never above. `common`: the same ratio at the larger of the two errors that the curves end with,
    which is another one only where the baseline's is not reached, with its 95 % interval: the jackknife's over the
    seeds, both curves without the same seed. It goes on smoothly where the one case becomes the other.
    """

    low: float
    high: float
    common: Interval


def curve_of_means(times: Sequence[np.ndarray], errors: Sequence[np.ndarray], points: int = 49) -> Curve:
    """Mean over the seeds of error curves with points at times of their own.

    Each is interpolated, logarithm against logarithm, on `points` common times, evenly spaced in the logarithm, from
    the latest first to the earliest last time; then the errors are averaged.
    """
    first, last = max(t[0] for t in times), min(t[-1] for t in times)
    grid = np.geomspace(first, last, points) if first < last else np.array([last])
    values = np.array([_interpolate(grid, t, e) for t, e in zip(times, errors, strict=True)])
    count = len(values)
    without = (values.sum(axis=0) - values) / (count - 1) if count > 1 else np.empty((0, len(grid)))
    return Curve(grid, values.mean(axis=0), np.broadcast_to(grid, without.shape), without)


def time_to_reach(time: np.ndarray, error: np.ndarray, level: float) -> tuple[float, float]:
    """Earliest and latest time from which on the error is at most `level`.

    Both are the same where the curve passes through it: interpolated, logarithm against logarithm, on the curve's
    monotone envelope, the largest error from then on. (An image that has found no firefly yet has small errors, for a
    while: the smallest error so far would take it for the better one.) (0, first time) if the curve is never above
    `level`, (last time, inf) if it ends above. The error that it ends with is reached at its end, by definition.
    """
    envelope = np.log(np.maximum(np.maximum.accumulate(error[::-1])[::-1], TINY))
    target = math.log(max(level, TINY))
    if envelope[-1] > target:
        return float(time[-1]), math.inf
    if envelope[-1] == target:
        return float(time[-1]), float(time[-1])
    after = int(np.argmax(envelope <= target))
    if after == 0:
        return 0.0, float(time[0])
    share = (envelope[after - 1] - target) / (envelope[after - 1] - envelope[after])
    at = math.exp((1 - share) * math.log(time[after - 1]) + share * math.log(time[after]))
    return at, at


def time_ratio(curve: Curve, baseline: Curve) -> TimeRatio:
    """Time to equal error relative to the baseline."""
    low, high = _time_ratio_at(float(baseline.error[-1]), curve.time, curve.error, baseline.time, baseline.error)
    both = zip(curve.time_without, curve.error_without, baseline.time_without, baseline.error_without, strict=True)
    with np.errstate(all="ignore"):
        common = np.log(_common_ratio(curve.time, curve.error, baseline.time, baseline.error))
        without = np.log([_common_ratio(*curves) for curves in both])
    return TimeRatio(low, high, jackknife(float(common), without).ratio())


def _time_ratio_at(level: float, time, error, base_time, base_error) -> tuple[float, float]:
    low, high = time_to_reach(time, error, level)
    base_low, base_high = time_to_reach(base_time, base_error, level)
    return low / base_high, high / base_low if base_low > 0 else math.inf


def _common_ratio(time, error, base_time, base_error) -> float:
    """Ratio at the larger of the two errors that the curves end with; nan where one of them is never above it."""
    level = max(float(error[-1]), float(base_error[-1]))
    low, high = _time_ratio_at(level, time, error, base_time, base_error)
    return low if low == high else math.nan


def _sum_of_squares(errors: np.ndarray) -> np.ndarray:
    total = np.zeros(errors.shape[1:])
    for image in errors:
        total += np.square(image, dtype=np.float64)
    return total


def _lower_gamma(a: float, x: float) -> float:
    """P(a, x) = x^a e^-x / Gamma(a + 1) sum x^k / ((a + 1)...(a + k)): terms are positive, nothing cancels."""
    if x <= 0:
        return 0.0
    term = total = 1.0
    k = 0
    while term > 1e-17 * total:
        k += 1
        term *= x / (a + k)
        total += term
    return min(1.0, total * math.exp(a * math.log(x) - x - math.lgamma(a + 1)))


def _interpolate(grid: np.ndarray, time: np.ndarray, error: np.ndarray) -> np.ndarray:
    return np.exp(np.interp(np.log(grid), np.log(time), np.log(np.maximum(error, TINY))))
