"""Allocation rules: distribute a budget of samples over the pixels as whole numbers that sum to it exactly."""

from bisect import bisect_right
from collections.abc import Iterator

import numpy as np

from isonoise.strategies.uniform_allocation import MAX_COUNT, check_budget, first_in_hashed_order, uniform_allocation

STRIP_PIXELS = 2**14
"""Pixels that are processed at a time, so that the temporary arrays stay in the cache."""
SUBSAMPLE_PIXELS = 2**14
"""Pixels from which the first guess of the water level is computed."""
MAX_ITERATIONS = 200
"""Limit of the search for the water level. Some 5 are usual; bisection of any bracket of floats needs fewer."""
SUM_ROUNDING = 1e-13
"""Relative rounding error of a sum of millions of float64 numbers: the water level cannot be known better."""


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
    return _round_to_budget(share, int(budget), wave_index).astype(np.uint32).reshape(weights.shape)


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
    variance : (height, width) float64
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
    Parameters, result and errors are those of `deficit`.
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

    shares = _Shares(slope, offset, count, cap)
    t = shares.find_level(budget)
    if t is not None:
        allocation = _round_to_budget(shares.at(t), budget, wave_index)
    elif cap < np.inf:
        allocation = np.where(slope > 0, _capacity(count, cap), 0).astype(np.int64)
    else:
        allocation = np.zeros(count.size, int)
    del shares, slope
    for limit in (cap, np.inf):  # evenly below the cap, then evenly everywhere
        missing = budget - int(allocation.sum())
        if missing:
            free = np.maximum(_capacity(count, limit).astype(np.int64) - allocation, 0)
            allocation += _spread_evenly(free, missing, wave_index)
    return allocation.astype(np.uint32).reshape(shape)


def _strips(size: int) -> Iterator[slice]:
    """Parts of a flat image that are processed at a time."""
    return (slice(begin, min(begin + STRIP_PIXELS, size)) for begin in range(0, size, STRIP_PIXELS))


def _capacity(count: np.ndarray, cap: float) -> np.ndarray:
    """Samples that every pixel can take if its count is multiplied by `cap` at most; whole numbers, float64."""
    remaining = MAX_COUNT - count.astype(np.float64)
    return remaining if cap == np.inf else np.minimum(remaining, (cap - 1.0) * count, out=remaining)


def _clip_variance(variance: np.ndarray, clip: float) -> np.ndarray:
    """A copy of V, finite, not negative, cut, and scaled by a power of two so that its maximum is in [1/2, 1)."""
    if not 0 < clip <= 1:
        raise ValueError(f"clip must be a quantile in (0, 1], not {clip}")
    result = np.empty(variance.size)
    max_variance, has_unknown = 0.0, False
    for strip in _strips(variance.size):
        known = np.fmax(variance[strip], 0.0, out=result[strip])  # NaN counts as 0
        max_known = float(known.max())
        if max_known == np.inf:  # unknown: marked as -1 until the maximum is known
            has_unknown = True
            known[np.isposinf(known)] = -1.0
            max_known = float(known.max())
        max_variance = max(max_variance, max_known)
    if max_variance == 0:
        if has_unknown:
            return np.where(result < 0, 0.5, 0.0)
        result[:] = 0.5
        return result
    if clip < 1:
        # An element of the data, not an interpolated value: scaling V must not move the cut by a rounding.
        positive = result[result > 0]
        rank = min(int(clip * positive.size), positive.size - 1)
        positive.partition(rank)
        max_variance = positive[rank]
    exponent = -int(np.frexp(max_variance)[1])
    for strip in _strips(variance.size):
        values = result[strip]
        if has_unknown:
            values[values < 0] = max_variance
        if clip < 1:
            np.minimum(values, max_variance, out=values)
        np.ldexp(values, exponent, out=values)
    return result


class _Shares:
    """Real shares min(max(0, slope t - offset), capacity) as functions of the water level t."""

    def __init__(self, slope: np.ndarray, offset: np.ndarray, count: np.ndarray, cap: float):
        self._slope, self._offset, self._count, self._cap = slope, offset, count, cap
        self._only_cap_limits = count.max() * cap <= MAX_COUNT
        self._buffers = np.empty((2, STRIP_PIXELS))

    def at(self, t: float) -> np.ndarray:
        """The shares."""
        result = np.empty(self._slope.size)
        for strip in _strips(result.size):
            self._compute(strip, t, result[strip])
        return result

    def find_level(self, budget: int) -> float | None:
        """The water level at which the shares sum to the budget; None if all capacity is less."""
        size = self._slope.size
        capacity = 0.0
        for strip in _strips(size):
            values = self._capacity(strip)
            capacity += float(np.multiply(values, self._slope[strip] > 0, out=values).sum())
        if capacity <= budget:
            return None
        first_guess = None
        if size > 4 * SUBSAMPLE_PIXELS:
            every = np.s_[:: size // SUBSAMPLE_PIXELS]
            part = _Shares(self._slope[every], self._offset[every], self._count[every], self._cap)
            if part._slope.any():
                first_guess = part._search(budget * part._slope.size / size, None)
        return self._search(budget, first_guess)

    def _capacity(self, strip: slice) -> np.ndarray:
        """`_capacity` of the pixels, in a buffer."""
        capacity = self._buffers[1, : strip.stop - strip.start]
        if self._only_cap_limits:
            return np.multiply(self._count[strip], self._cap - 1.0, out=capacity)
        capacity[:] = _capacity(self._count[strip], self._cap)
        return capacity

    def _compute(self, strip: slice, t: float, out: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Write the shares of a strip to `out`; returns their slopes and where they are neither 0 nor the capacity."""
        slope, capacity = self._slope[strip], self._capacity(strip)
        np.multiply(slope, t, out=out)
        out -= self._offset[strip]
        interior = out > 0
        interior &= out < capacity
        np.maximum(out, 0, out=out)
        np.minimum(out, capacity, out=out)
        return slope, interior

    def _sums(self, t: float) -> tuple[float, float]:
        """The sum of the shares, and its derivative."""
        total, derivative = 0.0, 0.0
        for strip in _strips(self._slope.size):
            share = self._buffers[0, : strip.stop - strip.start]
            slope, interior = self._compute(strip, t, share)
            total += float(share.sum())
            derivative += float(np.multiply(slope, interior, out=share).sum())
        return total, derivative

    def _search(self, budget: float, first_guess: float | None) -> float:
        """Newton's method with bisection as a safeguard.

        The sum is piecewise linear in t, so the method ends when it has found the right piece.
        """
        low, high = 0.0, np.inf
        # exact if every pixel gets a share
        t = first_guess or (budget + float(self._offset.sum(dtype=np.float64))) / float(self._slope.sum())
        for _ in range(MAX_ITERATIONS):
            total, derivative = self._sums(t)
            missing = budget - total
            if abs(missing) <= SUM_ROUNDING * budget:
                break
            low, high = (t, high) if missing > 0 else (low, t)
            next_t = t + missing / derivative if derivative > 0 else np.inf
            if not low < next_t < high:
                next_t = 2 * t if high == np.inf else 0.5 * (low + high)
                if not low < next_t < high:
                    break
            t = next_t
        return t


def _round_to_budget(share: np.ndarray, budget: int, wave_index: int) -> np.ndarray:
    """Whole numbers (int64) of sum `budget` from shares of that sum, by largest remainders. Overwrites `share`."""
    allocation = np.empty(share.size, np.int64)
    for strip in _strips(share.size):
        remainder = share[strip]
        allocation[strip] = remainder  # shares are not negative: this is the floor
        remainder -= allocation[strip]
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
