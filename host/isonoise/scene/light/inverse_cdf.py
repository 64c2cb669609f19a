"""Inverse CDFs with guide tables: tables that select a cell by one random number and keep its order.

The kernels search them in kernels/light/envmap.h. Chen and Asau, "On Generating Random Variates from an Empirical
Distribution", AIIE Transactions 6, 1974.
"""

import numpy as np

MAX_CELLS = 1 << 16
"""Most cells of a table: the guide packs two indices in 32 bits."""

_ONE = 1 << 32  # probability 1


def inverse_cdfs(weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """CDF (r, n) and guide (r, n), uint32, of one table per row of weights. A row whose weights are all 0 is uniform.

    The CDF is the probability below each cell, in units of 2^-32. Entry k of the guide holds the cells that k / n and
    the last number below (k + 1) / n select: first | last << 16. Probabilities are rounded by at most 2^-32.
    """
    rows, count = weights.shape
    weights = np.where(weights.sum(axis=1, keepdims=True) > 0, weights, 1.0)
    above = np.cumsum(weights, axis=1)
    above = np.rint(above / above[:, -1:] * _ONE).astype(np.int64)
    below = np.concatenate([np.zeros((rows, 1), np.int64), above[:, :-1]], axis=1)
    bounds = -(-_ONE * np.arange(count + 1, dtype=np.int64) // count)  # smallest number of each entry
    numbers = np.stack([bounds[:-1], bounds[1:] - 1])
    # one search for all rows: their CDFs one behind the other
    offset = _ONE * np.arange(rows)[:, None]
    found = np.searchsorted((above + offset).ravel(), numbers[:, None] + offset, side="right")
    first, last = found - count * np.arange(rows)[:, None]
    # cells of no probability at the end have the CDF 1, which 32 bits cannot hold; no guide entry leads to them
    return np.minimum(below, _ONE - 1).astype(np.uint32), (first | last << 16).astype(np.uint32)
