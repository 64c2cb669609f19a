"""Quantiles of Student's t distribution."""

import math
from functools import lru_cache

import numpy as np

TABLE_ACCURACY = 1e-6
"""The table of exact quantiles ends where the expansion's relative error falls below this."""


def quantile(p: float, dof: np.ndarray) -> np.ndarray:
    """The quantile at probability p of Student's t distribution.

    Few degrees of freedom are read from a table of exact values. For more, the Cornish-Fisher expansion about the
    normal quantile is used (Abramowitz and Stegun 1964, 26.7.5).

    Parameters
    ----------
    p : float
        In (0.5, 1).
    dof : array of int
        Degrees of freedom, 1 or more, of any shape.

    Returns
    -------
    float64 array
        Of the shape of `dof`; relative error 1e-5, as far as the spacing of floats near 1 allows (1 - p > 1e-11).

    Raises
    ------
    ValueError
        If p or `dof` is out of range.
    """
    if not 0.5 < p < 1:
        raise ValueError(f"p must be in (0.5, 1), not {p}")
    dof = np.asarray(dof)
    if dof.size and dof.min() < 1:
        raise ValueError("degrees of freedom must be 1 or more")
    table = np.array(_exact_table(p))
    t = np.polynomial.polynomial.polyval(1 / dof.astype(np.float64), _expansion(p))
    in_table = dof <= table.size
    t[in_table] = table[dof[in_table].astype(np.intp) - 1]
    return t


@lru_cache(maxsize=64)
def _expansion(p: float) -> tuple[float, ...]:
    """Coefficients of the powers of 1 / dof."""
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
def _exact_table(p: float) -> tuple[float, ...]:
    """Exact quantiles for 1, 2, 3, ... degrees of freedom, up to where the expansion is accurate enough."""
    terms = _expansion(p)
    table = []
    while True:
        dof = len(table) + 1
        exact = _exact_quantile(p, dof)
        expanded = sum(term / dof**power for power, term in enumerate(terms))
        if dof > 3 and abs(expanded - exact) < TABLE_ACCURACY * exact:  # for few dof the error may change its sign
            return tuple(table)
        table.append(exact)


def _exact_quantile(p: float, dof: int) -> float:
    """Newton's method on P(|T| <= t) = 2 p - 1 for the angle atan(t / sqrt(dof)).

    The probability is concave in the angle, so from 0 the iteration rises to the root without passing it.
    """
    slope = 2 * math.exp(math.lgamma((dof + 1) / 2) - math.lgamma(dof / 2)) / math.sqrt(math.pi)
    angle = 0.0
    for _ in range(200):
        step = (2 * p - 1 - _probability(angle, dof)) / (slope * math.cos(angle) ** (dof - 1))
        angle += step
        if step <= 1e-15 * angle:
            break
    return math.sqrt(dof) * math.tan(angle)


def _probability(angle: float, dof: int) -> float:
    """P(|T| <= t) with t = sqrt(dof) tan(angle): Abramowitz and Stegun 1964, 26.7.3 and 26.7.4."""
    cosine = math.cos(angle)
    odd = dof % 2
    term = cosine if odd else 1.0
    total = 0.0
    for factor in range(1 + odd, dof, 2):  # the ratio of neighbouring terms is cos^2 factor / (factor + 1)
        total += term
        term *= cosine * cosine * factor / (factor + 1)
    return 2 / math.pi * (angle + math.sin(angle) * total) if odd else math.sin(angle) * total
