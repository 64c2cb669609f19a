"""Allocation rules: a budget of samples becomes whole numbers of samples per pixel that sum to it exactly."""

from bisect import bisect_right

import numpy as np

MAX_COUNT = 2**32 - 1
"""Samples that a pixel can count (uint32), all waves together."""


def uniform_allocation(shape: tuple[int, int], budget: int, wave_index: int) -> np.ndarray:
    """The same count in every pixel; the remainder goes, one sample each, by a hashed order that changes with the wave.

    Returns uint32 of `shape` (height, width) that sums to `budget` exactly.
    Raises ValueError if the budget is negative or more than uint32 counts hold.
    """
    pixels = shape[0] * shape[1]
    _check_budget(budget, pixels * MAX_COUNT)
    each, rest = divmod(int(budget), pixels)
    allocation = np.full(pixels, each, dtype=np.uint32)
    allocation[_first_in_hashed_order(np.arange(pixels, dtype=np.uint32), rest, wave_index)] += np.uint32(1)
    return allocation.reshape(shape)


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
    over the image. Shares are rounded by largest remainders; ties go by a hashed order that changes with the wave.

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
    if not 0 < clip <= 1:
        raise ValueError(f"clip is a quantile in (0, 1], not {clip}")
    if not (cap == np.inf or (cap >= 2 and cap == int(cap))):
        raise ValueError(f"cap is a whole number of at least 2, or inf, not {cap}")
    shape, count = count.shape, count.reshape(-1)
    _check_budget(budget, count.size * MAX_COUNT - int(count.sum(dtype=np.int64)))
    variance = _clipped(variance.reshape(-1), clip)

    allocation = np.zeros(count.size, dtype=np.int64)
    share = _capped_fill(count, variance, int(budget), cap)
    if share is not None:
        _round_to(share, int(budget), wave_index, out=allocation)
    elif cap < np.inf:
        np.multiply(count, int(cap) - 1, out=allocation, where=variance > 0, dtype=np.int64)
    del share, variance
    np.minimum(allocation, MAX_COUNT - count.astype(np.int64), out=allocation)

    for limit in (cap, np.inf):  # evenly below the cap, then evenly everywhere
        missing = int(budget) - int(allocation.sum())
        if missing:
            room = MAX_COUNT - count.astype(np.int64)
            if limit < np.inf:
                np.minimum(room, (int(limit) - 1) * count.astype(np.int64), out=room)
            room -= allocation
            allocation += _spread(np.maximum(room, 0, out=room), missing, wave_index)
    return allocation.astype(np.uint32).reshape(shape)


def _check_budget(budget: int, most: int) -> None:
    if not 0 <= budget <= most:
        raise ValueError(f"a wave of {budget} samples is outside of 0 to {most}, what the pixels can count")


def _clipped(variance: np.ndarray, clip: float) -> np.ndarray:
    """A copy of V, finite and not negative, scaled by a power of two so that its largest value is in [1/2, 1)."""
    variance = np.array(variance, dtype=np.float64)
    unknown = np.isposinf(variance)
    variance[~(variance > 0) | unknown] = 0.0
    positive = variance[variance > 0]
    if positive.size == 0:
        variance[unknown] = 0.5
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


def _capped_fill(count: np.ndarray, variance: np.ndarray, budget: int, cap: float) -> np.ndarray | None:
    """Real-valued shares min(max(0, V t - n), (g - 1) n) that sum to the budget; None if all together hold no more."""
    level = _water_level(count, variance, budget, cap)
    if level is None:
        return None
    share = variance * level
    share -= count
    np.maximum(share, 0, out=share)
    if cap < np.inf:
        np.minimum(share, (cap - 1) * count.astype(np.float64), out=share)
    return share


def _water_level(count: np.ndarray, variance: np.ndarray, budget: int, cap: float) -> float | None:
    """t = 1 / lambda at which the shares of `_capped_fill` sum to the budget."""
    entry = np.full(count.size, np.inf)  # the level at which a pixel starts to fill
    np.divide(count, variance, out=entry, where=variance > 0)
    order = np.argsort(entry)[: int(np.count_nonzero(np.isfinite(entry)))]
    entry = entry[order]
    n = count[order]
    v = variance[order]
    if v.size == 0 or (cap < np.inf and (cap - 1) * int(n.sum(dtype=np.int64)) <= budget):
        return None

    def held(full: int) -> int:
        """Samples in the first `full` pixels, all of them at their cap."""
        return int(cap - 1) * int(n[:full].sum(dtype=np.int64)) if full else 0

    def filled(level: float) -> float:
        """Samples in all pixels at this level. Sums of slices, not differences of running sums: these cancel."""
        full = int(np.searchsorted(entry, level / cap, side="right")) if cap < np.inf else 0
        begun = int(np.searchsorted(entry, level, side="right"))
        return held(full) + level * float(v[full:begun].sum()) - int(n[full:begun].sum(dtype=np.int64))

    # Pixels begun and pixels full at the level sought: breakpoints up to it, found by bisection as `filled` rises.
    begun = bisect_right(range(entry.size), budget, key=lambda i: filled(entry[i]))
    full = bisect_right(range(begun), budget, key=lambda i: filled(cap * entry[i])) if cap < np.inf else 0
    if full == begun:  # between the last pixel full and the next to begin, where nothing fills
        return cap * entry[full - 1]
    return (budget - held(full) + int(n[full:begun].sum(dtype=np.int64))) / float(v[full:begun].sum())


def _round_to(share: np.ndarray, budget: int, wave_index: int, out: np.ndarray) -> None:
    """Whole numbers of sum `budget` from shares of that sum, by largest remainders. Spoils `share`."""
    np.floor(share, out=out, casting="unsafe")
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
    spread[open_pixels[_first_in_hashed_order(open_pixels.astype(np.uint32), missing, wave_index)]] += 1
    return spread


def _largest(values: np.ndarray, k: int, pixels: np.ndarray, wave_index: int) -> np.ndarray:
    """Indices of the k largest values; among equal ones, those of the pixels that come first in the hashed order."""
    if k == 0:
        return np.zeros(0, dtype=np.intp)
    threshold = np.partition(values, values.size - k)[values.size - k]
    above = np.flatnonzero(values > threshold)
    equal = np.flatnonzero(values == threshold)
    tied = _first_in_hashed_order(pixels[equal].astype(np.uint32), k - above.size, wave_index)
    return np.concatenate([above, equal[tied]])


def _first_in_hashed_order(pixels: np.ndarray, k: int, wave_index: int) -> np.ndarray:
    """Indices into `pixels` (uint32, distinct) of the k that come first in the wave's order."""
    if k == 0 or k == pixels.size:
        return np.arange(k)
    salt = _mix(np.array([wave_index & MAX_COUNT], dtype=np.uint32)) ^ np.uint32((wave_index >> 32) & MAX_COUNT)
    return np.argpartition(_mix(_mix(pixels) ^ salt), k)[:k]


def _mix(x: np.ndarray) -> np.ndarray:
    """A bijection of the 32-bit integers that looks random: C. Wellons' lowbias32 (github.com/skeeto/hash-prospector).

    One to one, so that no two pixels of a wave share a place in the order.
    """
    x = x ^ (x >> np.uint32(16))
    x *= np.uint32(0x7FEB352D)
    x ^= x >> np.uint32(15)
    x *= np.uint32(0x846CA68B)
    x ^= x >> np.uint32(16)
    return x
