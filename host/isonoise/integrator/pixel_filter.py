"""Reconstruction filters as distributions of the sample's offset from its pixel's centre."""

import math

import numpy as np

CELLS = 4096
"""Cells of equal probability in the table; the offset is uniform within one."""


def inverse_cdf(kind: str, radius: float, stddev: float) -> np.ndarray:
    """Offsets in pixels, (CELLS + 1,) float32, at equal steps of the filter's cumulative distribution.

    `tent`: 1 - |x| / radius. `gaussian`: exp(-x^2 / 2 stddev^2) less its value at the radius, as Mitsuba 3 defines it.
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
