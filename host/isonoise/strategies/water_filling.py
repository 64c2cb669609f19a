"""The water level: the t at which shares that grow with t, each between two bounds, sum to a budget."""

import numpy as np

from isonoise.strips import pixel_strips

STRIP_PIXELS = 2**14
"""Pixels that are processed at a time, so that the temporary arrays stay in the cache."""
SUBSAMPLE_PIXELS = 2**14
"""Pixels from which the first guess of the water level is computed."""
MAX_ITERATIONS = 200
"""Limit of the search. Some 4 are usual; bisection of any bracket of floats needs fewer."""
BISECTION_INTERVAL = 4
"""Every so many iterations the bracket is halved, whatever the secant says."""
TOLERANCE = 1e-4
"""The search ends with one more step when the shares miss the budget by at most this part of it. The step leaves some
1e-8 of the budget, and nothing if the sum is linear there."""


class WaterFilling:
    """Shares min(max(slope t, lower), upper) - lower as functions of the water level t.

    Parameters
    ----------
    slope, lower, upper : (pixels,) float32 or float64
        Slopes of 0 or more; `upper` is at least `lower`, and `lower` at least 0. All of one type, in which the shares
        are computed.
    """

    def __init__(self, slope: np.ndarray, lower: np.ndarray, upper: np.ndarray):
        self._slope, self._lower, self._upper = slope, lower, upper
        self._lower_sum = float(lower.sum(dtype=np.float64))

    def find_level(self, budget: float) -> float | None:
        """The level at which the shares sum to the budget; None if the sum is at most the budget at any level."""
        if self._capacity() <= budget:
            return None
        slope, size = float(self._slope.sum(dtype=np.float64)), self._slope.size
        level = (budget + self._lower_sum) / slope  # exact if every pixel gets a share
        step = size // SUBSAMPLE_PIXELS
        if step >= 4:  # a better guess, from some of the pixels
            part = WaterFilling(*(array[::step].copy() for array in (self._slope, self._lower, self._upper)))
            part_budget = budget * part._slope.size / size
            if part._capacity() > part_budget:
                level, slope = part._search(part_budget, level, slope * part._slope.size / size)
                slope *= size / part._slope.size
        return self._search(budget, level, slope)[0]

    def _capacity(self) -> float:
        """The sum of the shares at an infinite level."""
        constant = np.flatnonzero(self._slope == 0)
        never = self._upper[constant] - self._lower[constant]
        return float(self._upper.sum(dtype=np.float64)) - self._lower_sum - float(never.sum(dtype=np.float64))

    def shares(self, level: float) -> np.ndarray:
        """The shares at a level, a new array."""
        result = np.empty_like(self._slope)
        for strip in pixel_strips(result.size, STRIP_PIXELS):
            self._fill(strip, level, result[strip])
            result[strip] -= self._lower[strip]
        return result

    def _fill(self, strip: slice, level: float, out: np.ndarray) -> None:
        """Write share + lower of the pixels of a strip."""
        np.multiply(self._slope[strip], level, out=out)
        np.maximum(out, self._lower[strip], out=out)
        np.minimum(out, self._upper[strip], out=out)

    def _share_sum(self, level: float) -> float:
        buffer, total = np.empty(STRIP_PIXELS, self._slope.dtype), -self._lower_sum
        for strip in pixel_strips(self._slope.size, STRIP_PIXELS):
            filled = buffer[: strip.stop - strip.start]
            self._fill(strip, level, filled)
            total += float(filled.sum())
        return total

    def _search(self, budget: float, level: float, slope: float) -> tuple[float, float]:
        """Secant method within a bracket, from a first guess of the level and of the sum's slope there; returns both.

        The sum is piecewise linear, so the method ends soon after it has found the right piece.
        """
        low, high = 0.0, np.inf
        last_level = last_sum = None
        for iteration in range(1, MAX_ITERATIONS + 1):
            share_sum = self._share_sum(level)
            missing = budget - share_sum
            if last_level is not None:
                slope = (share_sum - last_sum) / (level - last_level)
            if abs(missing) <= TOLERANCE * budget and slope > 0:
                return max(level + missing / slope, low), slope
            low, high = (level, high) if missing > 0 else (low, level)
            last_level, last_sum = level, share_sum
            level = level + missing / slope if slope > 0 else np.inf
            if iteration % BISECTION_INTERVAL == 0 or not low < level < high:
                level = _between(low, high)
                if not low < level < high:
                    break
        return level, slope


def _between(low: float, high: float) -> float:
    """A level in the middle of the bracket: of its logarithms if it is wide."""
    if high == np.inf:
        return 2 * low
    if low == 0:
        return high / 16
    return float(np.sqrt(low) * np.sqrt(high)) if high > 4 * low else 0.5 * (low + high)
