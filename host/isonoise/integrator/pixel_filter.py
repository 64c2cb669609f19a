"""Reconstruction filters as distributions of the offset of a sample from the centre of its pixel."""

import math

import numpy as np

CELLS = 4096
"""Cells of equal probability in the table; within a cell the offset is uniform."""


def inverse_cdf(kind: str, radius: float, stddev: float) -> np.ndarray:
    """Inverse cumulative distribution of a filter: offsets in pixels at equal steps, (CELLS + 1,) float32.

    `tent` is 1 - |x| / radius; `gaussian` is exp(-x^2 / 2 stddev^2) minus its value at the radius, as in Mitsuba 3.
    """
    x = np.linspace(-radius, radius, 16 * CELLS + 1)
    if kind == "tent":
        cumulative = 0.5 + np.sign(x) * (np.abs(x) / radius - 0.5 * (x / radius) ** 2)
    else:
        tail = math.exp(-0.5 * (radius / stddev) ** 2)
        erf = np.array([math.erf(value) for value in x / (stddev * math.sqrt(2))])
        cumulative = stddev * math.sqrt(math.pi / 2) * erf - tail * x
    cumulative = (cumulative - cumulative[0]) / (cumulative[-1] - cumulative[0])
    return np.interp(np.linspace(0, 1, CELLS + 1), cumulative, x).astype(np.float32)
