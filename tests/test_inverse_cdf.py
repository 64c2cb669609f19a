"""Inverse CDFs with guide tables."""

import numpy as np

from isonoise.scene.light.inverse_cdf import inverse_cdfs


def test_inverse_cdf_selects_in_proportion():
    """Probabilities differ from the weights by at most 2^-32, and every guide entry holds the cells that it selects."""
    random = np.random.default_rng(12)
    weights = np.zeros((5, 37))
    weights[0], weights[1] = random.random(37), 10.0 ** random.uniform(-30, 10, 37)
    weights[2, [4, 20]], weights[4, 36] = (1.0, 3.0), 1e-300  # row 3 is black, so uniform
    cdf, guide = inverse_cdfs(weights)
    weights[3] = 1.0
    numbers = np.concatenate([random.integers(0, 1 << 32, 1000), [0, (1 << 32) - 1]])
    for row in range(5):
        ends = np.append(cdf[row, 1:].astype(float), 2.0**32)
        expected = weights[row] / weights[row].sum()
        np.testing.assert_allclose((ends - cdf[row]) / 2.0**32, expected, rtol=0, atol=2.0**-32)
        first, last = guide[row] & 0xFFFF, guide[row] >> 16
        entry = numbers * 37 >> 32
        cell = np.searchsorted(cdf[row, : last[-1] + 1], numbers, side="right") - 1
        assert (expected[cell] > 0).all()
        assert (first[entry] <= cell).all()
        assert (cell <= last[entry]).all()
