"""Allocation rules: distribute a budget of samples over the pixels as whole numbers that sum to it exactly."""

from bisect import bisect_right

import numpy as np

from isonoise.strategies.uniform_allocation import MAX_COUNT, check_budget, first_in_hashed_order, uniform_allocation
from isonoise.strategies.water_filling import STRIP_PIXELS, WaterFilling
from isonoise.strips import pixel_strips

MAX_FLOAT32_COUNT = 2**18
"""Largest count for shares in float32, which is twice as fast: they are good to 1/64 of a sample."""
SUBSAMPLE_PIXELS = 2**14
"""Pixels that bracket the k-th largest value."""


def distribute_in_proportion(weights: np.ndarray, budget: int, wave_index: int) -> np.ndarray:
    """Distribute samples in proportion to weights, rounded by largest remainders.

    Parameters
    ----------
    weights : (height, width)
        Finite, not negative, in any unit. All 0 counts as all equal.
    budget : int
        Samples to distribute.
    wave_index : int
        Any number that changes with the wave. It determines the hashed order in which ties are broken.

    Returns
    -------
    (height, width) uint32
        Samples per pixel; they sum to `budget` exactly.

    Raises
    ------
    ValueError
        If the budget is negative or gives a pixel more samples than uint32 holds.
    """
    max_weight = weights.max()
    if max_weight == 0:
        return uniform_allocation(weights.shape, budget, wave_index)
    share = weights.reshape(-1) / np.float64(max_weight)
    share *= int(budget) / share.sum()
    check_budget(budget, MAX_COUNT if share.max() >= MAX_COUNT else weights.size * MAX_COUNT)
    return _round_to_budget(share, int(budget), wave_index).reshape(weights.shape)


def deficit(
    count: np.ndarray,
    variance: np.ndarray,
    budget: int,
    wave_index: int,
    *,
    clip: float = 1.0,
    cap: float = 4.0,
) -> np.ndarray:
    """Water-filling: make the error V_i / n_i equal over the pixels, as far as the budget allows.

    With V the variance of one sample, n the samples so far and g the cap, find the water level t with

        sum over i of min(max(0, t V_i - n_i), (g - 1) n_i) = budget

    exactly: the left side is piecewise linear in t and changes slope at n_i / V_i and g n_i / V_i. If all pixels
    with V > 0 reach their cap, the rest is spread evenly over the pixels below theirs; if all pixels do, evenly over
    the image. If no pixel has a variance, all count as equal. Shares are rounded by largest remainders.

    Parameters
    ----------
    count : (height, width) uint32
        n. A pixel without samples has no known variance and a cap of 0.
    variance : (height, width) float32 or float64
        V, in any unit. NaN and negative values count as 0; +inf (unknown, as with fewer than two samples) counts as
        the largest finite value.
    budget : int
        Samples to distribute.
    wave_index : int
        Any number that changes with the wave. It determines the hashed order in which ties are broken.
    clip : float
        V is cut at this quantile of the pixels with V > 0; 1 is off.
    cap : float
        g, a whole number of at least 2, or inf for none. No pixel's count grows by more than a factor g while others
        are below their cap.

    Returns
    -------
    (height, width) uint32
        Samples per pixel; they sum to `budget` exactly. Scaling V by a power of two changes nothing, by another factor
        nothing beyond rounding.

    Raises
    ------
    ValueError
        If `budget`, `clip` or `cap` is out of range.
    """
    slope = _clip_variance(variance.reshape(-1), clip)
    return _allocate_capped(count, slope, count.reshape(-1), budget, wave_index, cap)


def deficit_of_sqrt(
    count: np.ndarray,
    variance: np.ndarray,
    budget: int,
    wave_index: int,
    *,
    clip: float = 1.0,
    cap: float = 4.0,
) -> np.ndarray:
    """`deficit` of sqrt(V), which minimises the mean of V_i / n_i. Overwrites `variance`.

    Parameters
    ----------
    count, variance, budget, wave_index, clip, cap
        As for `deficit`.

    Returns
    -------
    (height, width) uint32
        As of `deficit`, also the errors.
    """
    return deficit(count, np.sqrt(variance, out=variance), budget, wave_index, clip=clip, cap=cap)


def proportional_to_error(
    count: np.ndarray,
    variance: np.ndarray,
    budget: int,
    wave_index: int,
    *,
    exponent: float = 1.0,
    clip: float = 1.0,
    cap: float = 4.0,
) -> np.ndarray:
    """Distribute samples in proportion to (V / n)^exponent: the common rule of adaptive sampling.

    Repeated, it converges to n ~ V^(p / (p + 1)), p the exponent: the error V / n never becomes equal.

    Parameters
    ----------
    count, variance, budget, wave_index, clip, cap
        As for `deficit`.
    exponent : float
        Above 0.

    Returns
    -------
    (height, width) uint32
        As of `deficit`, also the errors.
    """
    weight = _clip_variance(variance.reshape(-1), clip)
    np.divide(weight, count.reshape(-1), out=weight, where=count.reshape(-1) > 0)
    max_weight = weight.max()
    if max_weight > 0:
        weight /= max_weight
    return _allocate_capped(count, weight**exponent, np.zeros(count.size), budget, wave_index, cap)


def _allocate_capped(count, slope, offset, budget: int, wave_index: int, cap: float) -> np.ndarray:
    """Shares min(max(0, slope t - offset), (cap - 1) count) as whole numbers; the rest is spread evenly."""
    if not (cap == np.inf or (cap >= 2 and cap == int(cap))):
        raise ValueError(f"cap must be a whole number of at least 2, or inf, not {cap}")
    shape, count = count.shape, count.reshape(-1)
    budget = int(budget)
    check_budget(budget, count.size * MAX_COUNT - int(count.sum(dtype=np.int64)))

    if slope.dtype == np.float32 and int(count.max()) * cap > MAX_FLOAT32_COUNT:
        slope = slope.astype(np.float64)
    lower = offset.astype(slope.dtype)
    upper = _capacity(count, cap, slope.dtype)
    upper += lower
    filling = WaterFilling(slope, lower, upper)
    level = filling.find_level(budget)
    if level is not None:
        share = filling.shares(level)
        del filling, lower, upper, slope
        allocation = _round_to_budget(share, budget, wave_index)
    elif cap < np.inf:
        allocation = np.where(slope > 0, _capacity(count, cap), 0).astype(np.int64)
    else:
        allocation = np.zeros(count.size, int)
    for limit in (cap, np.inf):  # evenly below the cap, then evenly everywhere
        missing = budget - int(allocation.sum())
        if missing:
            free = np.maximum(_capacity(count, limit).astype(np.int64) - allocation, 0)
            allocation += _spread_evenly(free, missing, wave_index)
    return allocation.astype(np.uint32, copy=False).reshape(shape)


def _capacity(count: np.ndarray, cap: float, dtype: type = np.float64) -> np.ndarray:
    """Samples that every pixel can take if its count is multiplied by `cap` at most; whole numbers."""
    if cap < np.inf and int(count.max()) * cap <= MAX_COUNT:
        return np.multiply(count, cap - 1.0, dtype=dtype, casting="same_kind")
    remaining = MAX_COUNT - count.astype(np.float64)
    if cap < np.inf:
        np.minimum(remaining, (cap - 1.0) * count, out=remaining)
    return remaining.astype(dtype, copy=False)


def _clip_variance(variance: np.ndarray, clip: float) -> np.ndarray:
    """A copy of V, finite, not negative, cut, and scaled by a power of two so that its maximum is in [1/2, 1)."""
    if not 0 < clip <= 1:
        raise ValueError(f"clip must be a quantile in (0, 1], not {clip}")
    result = np.empty(variance.size, variance.dtype)
    max_variance, has_unknown = 0.0, False
    for strip in pixel_strips(variance.size, STRIP_PIXELS):
        known = np.fmax(variance[strip], 0.0, out=result[strip])  # NaN counts as 0
        max_known = float(known.max())
        if max_known == np.inf:  # unknown: marked as -1 until the maximum is known
            has_unknown = True
            known[np.isposinf(known)] = -1.0
            max_known = float(known.max())
        max_variance = max(max_variance, max_known)
    if max_variance == 0:
        if has_unknown:
            return (result < 0) * result.dtype.type(0.5)
        result[:] = 0.5
        return result
    if clip < 1:
        # An element of the data, not an interpolated value: scaling V must not move the cut by a rounding.
        positive = result[result > 0]
        rank = min(int(clip * positive.size), positive.size - 1)
        positive.partition(rank)
        max_variance = positive[rank]
    exponent = -int(np.frexp(max_variance)[1])
    for strip in pixel_strips(variance.size, STRIP_PIXELS):
        values = result[strip]
        if has_unknown:
            values[values < 0] = max_variance
        if clip < 1:
            np.minimum(values, max_variance, out=values)
        np.ldexp(values, exponent, out=values)
    return result


def _round_to_budget(share: np.ndarray, budget: int, wave_index: int) -> np.ndarray:
    """Whole numbers (uint32) of sum `budget` from shares of that sum, by largest remainders. Overwrites `share`."""
    allocation = np.empty(share.size, np.uint32)
    for strip in pixel_strips(share.size, STRIP_PIXELS):
        whole = np.floor(share[strip])
        allocation[strip] = whole
        share[strip] -= whole
    missing = budget - int(allocation.sum())
    # One pass in general; more only if rounding moved the sum of the shares by 1 or more.
    while missing > 0:
        k = min(missing, share.size)
        threshold, ties = _threshold(share, k)
        allocation += share > threshold
        equal = np.flatnonzero(share == threshold)
        allocation[equal[first_in_hashed_order(equal.astype(np.uint32), ties, wave_index)]] += 1
        missing -= k
    while missing < 0:
        candidates = np.flatnonzero(allocation)
        chosen = candidates[_k_largest(-share[candidates], min(-missing, candidates.size), candidates, wave_index)]
        allocation[chosen] -= 1
        missing += chosen.size
    return allocation


def _spread_evenly(capacity: np.ndarray, total: int, wave_index: int) -> np.ndarray:
    """min(c, capacity_i) with one level c, plus one for some pixels in hashed order, so that the sum is `total`.

    All of the capacity if it is less than `total`.
    """
    if total >= int(capacity.sum()):
        return capacity
    ascending = np.sort(capacity)
    cumulative = np.cumsum(ascending)

    def sum_at_level(i: int) -> int:
        """Sum of min(ascending[i], capacity): pixels up to i are full, all others hold as much as pixel i."""
        return int(cumulative[i] + ascending[i] * (capacity.size - 1 - i))

    full = bisect_right(range(capacity.size), total, key=sum_at_level)
    held = int(cumulative[full - 1]) if full else 0
    level, missing = divmod(total - held, capacity.size - full)
    above = np.flatnonzero(capacity > level)
    spread = np.minimum(capacity, level)
    spread[above[first_in_hashed_order(above.astype(np.uint32), missing, wave_index)]] += 1
    return spread


def _k_largest(values: np.ndarray, k: int, pixels: np.ndarray, wave_index: int) -> np.ndarray:
    """Indices of the k largest values; ties go to the pixels that come first in the hashed order."""
    if k == 0:
        return np.zeros(0, dtype=np.intp)
    threshold, ties = _threshold(values, k)
    equal = np.flatnonzero(values == threshold)
    tied = first_in_hashed_order(pixels[equal].astype(np.uint32), ties, wave_index)
    return np.concatenate([np.flatnonzero(values > threshold), equal[tied]])


def _threshold(values: np.ndarray, k: int) -> tuple[float, int]:
    """The k-th largest value, k from 1 on, and how many values equal to it are among the k largest.

    A subsample brackets the value, and only the values in between are partitioned.
    """
    low, high = -np.inf, np.inf
    if values.size > 4 * SUBSAMPLE_PIXELS:
        subsample = np.sort(values[:: values.size // SUBSAMPLE_PIXELS])
        rank = subsample.size * (1 - k / values.size)
        margin = 2 * np.sqrt(subsample.size)  # four standard deviations of the rank, or more
        low, high = (subsample[int(min(max(r, 0), subsample.size - 1))] for r in (rank - margin, rank + margin))
    above = int(np.count_nonzero(values > high))
    between = values[(values >= low) & (values <= high)]
    if not above < k <= above + between.size:  # the bracket misses
        above, between = 0, values
    rank = between.size - (k - above)
    threshold = np.partition(between, rank)[rank]
    return threshold, k - above - int(np.count_nonzero(between > threshold))
