"""Walker's alias method: tables that select one of many entries in one step, for any probabilities."""

import numpy as np


def alias_tables(weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Thresholds (r, n) float64 and aliases (r, n) of one table per row of weights, without a loop over entries.

    To sample, select an entry uniformly. If the rest of the random number, in [0, 1), is below its threshold, take the
    entry, else its alias. A row whose weights are all 0 is uniform.

    Entries below the average are filled up from entries above it, both in index order (Vose 1991; with prefix sums:
    Huebschle-Schneider and Sanders 2019, "Parallel Weighted Random Sampling", section 4.2). Put the deficits end to end
    on a line, and the surpluses on another. The alias of an entry is the surplus at the position where its deficit
    begins. A surplus that the last deficit on it overdraws is filled up from the next surplus. All rows share one line:
    each begins at `row_length` times its number.
    """
    rows, count = weights.shape
    total = weights.sum(axis=1, keepdims=True)
    scaled = np.where(total > 0, weights * (count / np.where(total > 0, total, 1.0)), 1.0)  # mean 1
    is_above = (scaled >= np.minimum(1.0, scaled.max(axis=1, keepdims=True))).ravel()
    scaled, row_length = scaled.ravel(), 2.0 * count
    low, high = np.flatnonzero(~is_above), np.flatnonzero(is_above)
    row_of_low, row_of_high = low // count, high // count
    deficit_end = _prefix_sums_by_row(1.0 - scaled[low], row_of_low, row_length)
    surplus_end = _prefix_sums_by_row(scaled[high] - 1.0, row_of_high, row_length)
    last_of_row = np.flatnonzero(np.append(np.diff(row_of_high) > 0, True))
    padded_end = surplus_end.copy()
    padded_end[last_of_row] = row_length * (np.arange(rows) + 1.0)  # deficits exceed surpluses only by rounding
    deficit_begin = np.maximum(np.append(0.0, deficit_end)[: len(low)], row_length * row_of_low)
    threshold, alias = scaled.copy(), np.arange(rows * count)
    alias[low] = high[np.searchsorted(padded_end, deficit_begin, side="right")]
    overdrawing = np.searchsorted(deficit_end, surplus_end, side="left")  # the deficit that ends at or after it
    high_threshold = np.ones(len(high))
    is_overdrawn = overdrawing < len(low)
    is_overdrawn[is_overdrawn] = row_of_low[overdrawing[is_overdrawn]] == row_of_high[is_overdrawn]
    is_overdrawn[last_of_row] = False
    high_threshold[is_overdrawn] = 1.0 + surplus_end[is_overdrawn] - deficit_end[overdrawing[is_overdrawn]]
    threshold[high] = high_threshold
    alias[high[:-1]] = high[1:]
    alias[high[last_of_row]] = high[last_of_row]
    return np.clip(threshold, 0.0, 1.0).reshape(rows, count), alias.reshape(rows, count) % count


def _prefix_sums_by_row(values: np.ndarray, row: np.ndarray, row_length: float) -> np.ndarray:
    """Inclusive prefix sums within each row, plus `row_length` times the row. `row` (ascending) is each value's row."""
    sums = np.cumsum(values)
    first = np.searchsorted(row, row)
    return sums - np.where(first > 0, sums[first - 1], 0.0) + row_length * row if len(values) else sums
