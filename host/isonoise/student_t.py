"""Quantiles of Student's t distribution."""

import math
from functools import lru_cache

import numpy as np

AGREE = 1e-6
"""Relative difference from the exact quantile below which the expansion takes over; the table ends there."""


def quantile(p: float, freedom: np.ndarray) -> np.ndarray:
    """The quantile at probability p of Student's t distribution with `freedom` degrees of freedom.

    - `p`: in (0.5, 1).
    - `freedom`: whole numbers from 1, of any shape.

    Returns float64 of the shape of `freedom`, good to 1e-5 relative as far as the spacing of p near 1 allows
    (1 - p from about 1e-11).

    Few degrees of freedom are read from a table of exact values; for more, the Cornish-Fisher expansion about the
    normal quantile (Abramowitz and Stegun 1964, 26.7.5) serves. Raises ValueError if p or `freedom` is out of range.
    """
    if not 0.5 < p < 1:
        raise ValueError(f"p is in (0.5, 1), not {p}")
    freedom = np.asarray(freedom)
    if freedom.size and freedom.min() < 1:
        raise ValueError("there have to be 1 or more degrees of freedom")
    table = np.array(_table(p))
    t = np.polynomial.polynomial.polyval(1 / freedom.astype(np.float64), _expansion(p))
    few = freedom <= table.size
    t[few] = table[freedom[few].astype(np.intp) - 1]
    return t


@lru_cache(maxsize=64)
def _expansion(p: float) -> tuple[float, ...]:
    """Coefficients of the powers of 1 / freedom."""
    from statistics import NormalDist  # takes some 10 ms, and not every command needs it

    z = NormalDist().inv_cdf(p)
    return (
        z,
        (z**3 + z) / 4,
        (5 * z**5 + 16 * z**3 + 3 * z) / 96,
        (3 * z**7 + 19 * z**5 + 17 * z**3 - 15 * z) / 384,
        (79 * z**9 + 776 * z**7 + 1482 * z**5 - 1920 * z**3 - 945 * z) / 92160,
    )


@lru_cache(maxsize=64)
def _table(p: float) -> tuple[float, ...]:
    """Exact quantiles for 1, 2, 3, ... degrees of freedom, up to where the expansion is as good."""
    terms = _expansion(p)
    table = []
    while True:
        freedom = len(table) + 1
        exact = _exact(p, freedom)
        expanded = sum(term / freedom**power for power, term in enumerate(terms))
        if freedom > 3 and abs(expanded - exact) < AGREE * exact:  # the error may change its sign at few degrees
            return tuple(table)
        table.append(exact)


def _exact(p: float, freedom: int) -> float:
    """Newton's method on P(|T| <= t) = 2 p - 1 for the angle atan(t / sqrt(freedom)).

    The probability is concave in the angle, so from 0 the iteration rises to the root without passing it.
    """
    slope = 2 * math.exp(math.lgamma((freedom + 1) / 2) - math.lgamma(freedom / 2)) / math.sqrt(math.pi)
    angle = 0.0
    for _ in range(200):
        step = (2 * p - 1 - _probability(angle, freedom)) / (slope * math.cos(angle) ** (freedom - 1))
        angle += step
        if step <= 1e-15 * angle:
            break
    return math.sqrt(freedom) * math.tan(angle)


def _probability(angle: float, freedom: int) -> float:
    """P(|T| <= t) with t = sqrt(freedom) tan(angle): Abramowitz and Stegun 1964, 26.7.3 and 26.7.4."""
    cosine = math.cos(angle)
    odd = freedom % 2
    term = cosine if odd else 1.0
    total = 0.0
    for factor in range(1 + odd, freedom, 2):  # the ratio of neighbours is cos^2 factor / (factor + 1)
        total += term
        term *= cosine * cosine * factor / (factor + 1)
    return 2 / math.pi * (angle + math.sin(angle) * total) if odd else math.sin(angle) * total
