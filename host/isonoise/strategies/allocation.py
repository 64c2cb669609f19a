"""Allocation rules: a budget of samples becomes whole numbers of samples per pixel that sum to it exactly."""

from bisect import bisect_right

import numpy as np

from isonoise.strategies.uniform_allocation import MAX_COUNT, check_budget, first_in_hashed_order, uniform_allocation

SAMPLE = 2**14
"""Pixels on which the water level is sought first."""
MAX_STEPS = 200
"""Of the search for the level; a handful is usual, and bisection from any bracket of floats ends well before."""
ROUNDING = 1e-13
"""Relative error of a sum of millions of float64 numbers; a level is not known better."""


def proportional(weights: np.ndarray, budget: int, wave_index: int) -> np.ndarray:
    """Samples in proportion to the weights; whole numbers by largest remainders, ties by a hashed order that changes
    with the wave.

    - `weights`: (height, width), finite and not negative; their unit does not matter. All 0 count as all equal.

    Returns uint32 (height, width) that sums to `budget` exactly. Raises ValueError if the budget is negative or gives a
    pixel more than uint32 counts hold.
    """
    top = weights.max()
    if top == 0:
        return uniform_allocation(weights.shape, budget, wave_index)
    share = weights.reshape(-1) / np.float64(top)
    share *= int(budget) / share.sum()
    check_budget(budget, MAX_COUNT if share.max() >= MAX_COUNT else weights.size * MAX_COUNT)
    return _rounded(share, int(budget), wave_index).astype(np.uint32).reshape(weights.shape)


def deficit(
    count: np.ndarray,
    variance: np.ndarray,
    budget: int,
    wave_index: int,
    *,
    clip: float = 1.0,
    cap: float = 4.0,
) -> np.ndarray:
    """Water-filling: the allocation that makes V_i / n_i equal over the pixels, as far as the budget goes.

    With V the variance of one sample in the measure's terms, n the samples so far and g the cap, it finds lambda with

        sum over i of min(max(0, V_i / lambda - n_i), (g - 1) n_i) = budget

    exactly: the left side is piecewise linear in 1 / lambda and changes slope at n_i / V_i and g n_i / V_i. When every
    pixel with V > 0 is at its cap, the rest is spread evenly over the pixels below theirs, and when all are, evenly
    over the image. Where no pixel has any, all count as equal. Shares are rounded by largest remainders; ties go by a
    hashed order that changes with the wave.

    - `count`: uint32 (height, width). A pixel without samples has no variance to speak of: g times nothing is nothing.
    - `variance`: float64 (height, width); its unit does not matter. NaN and negative values are no evidence and count
      as 0; +inf (unknown, as from fewer than two samples) counts as the largest finite value.
    - `budget`: samples to give out.
    - `wave_index`: any number that changes with the wave.
    - `clip`: V is cut at this quantile of the pixels with V > 0; 1 is off.
    - `cap`: g, a whole number of at least 2, or inf for none: no pixel more than g-folds its count while others have
      room below theirs.

    Returns uint32 (height, width) that sums to `budget` exactly. Scaling V by a power of two changes nothing, by
    another factor nothing beyond rounding. Raises ValueError if budget, `clip` or `cap` is out of range.
    """
    return _allocate(count, _clipped(variance.reshape(-1), clip), count.reshape(-1), budget, wave_index, cap)


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
    """Samples in proportion to (V / n)^p, p the exponent: the common rule of adaptive sampling.

    Repeated, it converges to n ~ V^(p / (p + 1)): it never makes the error V / n the same everywhere.
    Arguments, cap, rounding and errors as for `deficit`.
    """
    weight = _clipped(variance.reshape(-1), clip)
    np.divide(weight, count.reshape(-1), out=weight, where=count.reshape(-1) > 0)
    top = weight.max()
    if top > 0:
        weight /= top
    return _allocate(count, weight**exponent, np.zeros(count.size), budget, wave_index, cap)


def _allocate(count, slope, offset, budget: int, wave_index: int, cap: float) -> np.ndarray:
    """Shares min(max(0, slope t - offset), (g - 1) n) as whole numbers; what does not fit is spread evenly."""
    if not (cap == np.inf or (cap >= 2 and cap == int(cap))):
        raise ValueError(f"cap is a whole number of at least 2, or inf, not {cap}")
    shape, count = count.shape, count.reshape(-1)
    budget = int(budget)
    check_budget(budget, count.size * MAX_COUNT - int(count.sum(dtype=np.int64)))

    def room(limit: float) -> np.ndarray:
        """Samples that every pixel can get if none may multiply its count by more than `limit`; whole numbers."""
        left = MAX_COUNT - count.astype(np.float64)
        return left if limit == np.inf else np.minimum(left, (limit - 1.0) * count, out=left)

    share = _fill(slope, offset, room(cap), budget)
    if share is not None:
        allocation = _rounded(share, budget, wave_index)
    else:
        allocation = np.where(slope > 0, room(cap), 0).astype(np.int64) if cap < np.inf else np.zeros(count.size, int)
    del share, slope
    for limit in (cap, np.inf):  # evenly below the cap, then evenly everywhere
        missing = budget - int(allocation.sum())
        if missing:
            allocation += _spread(np.maximum(room(limit).astype(np.int64) - allocation, 0), missing, wave_index)
    return allocation.astype(np.uint32).reshape(shape)


def _clipped(variance: np.ndarray, clip: float) -> np.ndarray:
    """A copy of V, finite and not negative, scaled by a power of two so that its largest value is in [1/2, 1)."""
    if not 0 < clip <= 1:
        raise ValueError(f"clip is a quantile in (0, 1], not {clip}")
    variance = np.array(variance, dtype=np.float64)
    unknown = np.isposinf(variance)
    variance[~(variance > 0) | unknown] = 0.0
    positive = variance[variance > 0]
    if positive.size == 0:  # nothing is known to be worse than the rest
        variance[unknown if unknown.any() else np.s_[:]] = 0.5
        return variance
    top = positive.max()
    if clip < 1:
        # An element of the data, not an interpolated value: scaling V must not move the cut by a rounding.
        at = min(int(clip * positive.size), positive.size - 1)
        positive.partition(at)
        top = positive[at]
        np.minimum(variance, top, out=variance)
    variance[unknown] = top
    return np.ldexp(variance, -np.frexp(top)[1], out=variance)


def _fill(slope: np.ndarray, offset: np.ndarray, room: np.ndarray, budget: int) -> np.ndarray | None:
    """Real shares min(max(0, slope t - offset), room) that sum to the budget; None if together they hold less."""
    if float(room.sum(where=slope > 0)) <= budget:
        return None
    start = None
    if slope.size > 4 * SAMPLE:  # a sample of the pixels says nearly where the level is
        some = np.s_[:: slope.size // SAMPLE]
        part = slope[some], offset[some], room[some]
        start = _level(*part, budget * part[0].size / slope.size, None)[0] if part[0].any() else None
    return _level(slope, offset, room, budget, start)[1]


def _level(slope, offset, room, budget: float, start: float | None) -> tuple[float, np.ndarray]:
    """The t at which the shares sum to the budget, and the shares: Newton's method, kept within the bracket so far.

    The sum is piecewise linear in t, so the method ends when it has found the piece.
    """
    low, high = 0.0, np.inf
    t = start or (budget + float(offset.sum())) / float(slope.sum())  # what all pixels would need if all took part
    for _ in range(MAX_STEPS):
        share = slope * t
        share -= offset
        filling = share > 0
        filling &= share < room
        np.clip(share, 0, room, out=share)
        missing = budget - float(share.sum())
        if abs(missing) <= ROUNDING * budget:
            break
        low, high = (t, high) if missing > 0 else (low, t)
        growth = float(slope.sum(where=filling))
        step = t + missing / growth if growth > 0 else np.inf
        if not low < step < high:
            step = 2 * t if high == np.inf else 0.5 * (low + high)
            if not low < step < high:
                break
        t = step
    return t, share


def _rounded(share: np.ndarray, budget: int, wave_index: int) -> np.ndarray:
    """Whole numbers (int64) of sum `budget` from shares of that sum, by largest remainders. Spoils `share`."""
    out = share.astype(np.int64)  # shares are not negative: this is the floor
    share -= out
    missing = budget - int(out.sum())
    # Once in general. More often only where rounding of the shares left their sum an integer or more off.
    while missing > 0:
        candidates = np.flatnonzero(share > 0) if missing <= np.count_nonzero(share > 0) else np.arange(share.size)
        given = candidates[_largest(share[candidates], min(missing, candidates.size), candidates, wave_index)]
        out[given] += 1
        missing -= given.size
    while missing < 0:
        candidates = np.flatnonzero(out)
        taken = candidates[_largest(-share[candidates], min(-missing, candidates.size), candidates, wave_index)]
        out[taken] -= 1
        missing += taken.size
    return out


def _spread(room: np.ndarray, total: int, wave_index: int) -> np.ndarray:
    """min(c, room_i) with one level c, and one more in hashed order where it does not come out even; sums to `total`
    or fills all the room."""
    if total >= int(room.sum()):
        return room
    ascending = np.sort(room)
    below = np.cumsum(ascending)
    # At level ascending[i] the pixels up to i are full and all others hold as much: increasing in i.
    at = bisect_right(range(room.size), total, key=lambda i: int(below[i] + ascending[i] * (room.size - 1 - i)))
    held = int(below[at - 1]) if at else 0
    level, missing = divmod(total - held, room.size - at)
    open_pixels = np.flatnonzero(room > level)
    spread = np.minimum(room, level)
    spread[open_pixels[first_in_hashed_order(open_pixels.astype(np.uint32), missing, wave_index)]] += 1
    return spread


def _largest(values: np.ndarray, k: int, pixels: np.ndarray, wave_index: int) -> np.ndarray:
    """Indices of the k largest values; among equal ones, those of the pixels that come first in the hashed order."""
    if k == 0:
        return np.zeros(0, dtype=np.intp)
    threshold = np.partition(values, values.size - k)[values.size - k]
    above = np.flatnonzero(values > threshold)
    equal = np.flatnonzero(values == threshold)
    tied = first_in_hashed_order(pixels[equal].astype(np.uint32), k - above.size, wave_index)
    return np.concatenate([above, equal[tied]])
