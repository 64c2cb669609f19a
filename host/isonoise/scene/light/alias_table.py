"""Walker's alias method: tables by which one of many entries is picked in one step, whatever their probabilities."""

import numpy as np

from isonoise.scene import structs


def alias_tables(weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Thresholds (r, n) float64 and aliases (r, n), of a table for each row of weights, without a loop over entries.

    An entry is picked evenly; where what is left of the random number, in [0, 1), is below its threshold, it stays,
    else its alias takes its place. Rows without any weight are even.

    Entries below the average are filled from those above it, both in index order (Vose 1991; as prefix sums:
    Huebschle-Schneider and Sanders 2019, "Parallel Weighted Random Sampling", section 4.2). With the deficits laid end
    to end and the surpluses too, an entry's alias is the surplus on which its deficit begins; a surplus that the
    deficit ending beyond it overdraws is filled from the next one. All rows stand on one line, each from `room` times
    its number on.
    """
    rows, count = weights.shape
    total = weights.sum(axis=1, keepdims=True)
    share = np.where(total > 0, weights * (count / np.where(total > 0, total, 1.0)), 1.0)
    above = (share >= np.minimum(1.0, share.max(axis=1, keepdims=True))).ravel()
    share, room = share.ravel(), 2.0 * count
    low, high = np.flatnonzero(~above), np.flatnonzero(above)
    row_of_low, row_of_high = low // count, high // count
    deficit = _sums_by_row(1.0 - share[low], row_of_low, room)
    surplus = _sums_by_row(share[high] - 1.0, row_of_high, room)
    last = np.flatnonzero(np.append(np.diff(row_of_high) > 0, True))  # of each row's surpluses
    ends = surplus.copy()
    ends[last] = room * (np.arange(rows) + 1.0)  # what is missing there is rounding
    begins = np.maximum(np.append(0.0, deficit)[: len(low)], room * row_of_low)
    threshold, alias = share.copy(), np.arange(rows * count)
    alias[low] = high[np.searchsorted(ends, begins, side="right")]
    overdraws = np.searchsorted(deficit, surplus, side="left")  # the deficit that ends there or is the first beyond
    kept = np.ones(len(high))
    drawn = overdraws < len(low)
    drawn[drawn] = row_of_low[overdraws[drawn]] == row_of_high[drawn]
    drawn[last] = False
    kept[drawn] = 1.0 + surplus[drawn] - deficit[overdraws[drawn]]
    threshold[high] = kept
    alias[high[:-1]] = high[1:]
    alias[high[last]] = high[last]
    return np.clip(threshold, 0.0, 1.0).reshape(rows, count), alias.reshape(rows, count) % count


def _sums_by_row(parts: np.ndarray, row: np.ndarray, room: float) -> np.ndarray:
    """Sums of a row's parts up to each, all rows on one line; `row` is that of each part, ascending."""
    sums = np.cumsum(parts)
    first = np.searchsorted(row, row)
    return sums - np.where(first > 0, sums[first - 1], 0.0) + room * row if len(parts) else sums


def alias_table(probabilities: np.ndarray) -> np.ndarray:
    """The table (n,) of structs.ALIAS of one row of weights."""
    threshold, alias = alias_tables(probabilities[None])
    table = np.zeros(len(probabilities), structs.ALIAS)
    table["threshold"], table["alias"] = threshold[0], alias[0]
    return table


def selection_probabilities(table: np.ndarray) -> np.ndarray:
    """Probabilities (n,) float64 with which an alias table, its thresholds rounded as they are, picks each entry."""
    kept = table["threshold"].astype(np.float64)
    return (kept + np.bincount(table["alias"], 1.0 - kept, len(table))) / len(table)
