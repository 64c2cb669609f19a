"""The sampler `sobol` beyond `isonoise selftest`: pairs of a group, variances, seeds, images.

Statistical tests use one fixed set of numbers. Their bounds are at z standard deviations; false alarms are 6e-7 for
each of the about 50 comparisons at z = 5.
"""

import numpy as np
import pytest
from small_scene import lamp_over_floor
from test_random import Z

import isonoise
from isonoise.device.opencl import Device
from isonoise.selftest.sampler import SobolNumbers


@pytest.fixture(scope="module")
def numbers() -> SobolNumbers:
    return SobolNumbers(Device())


@pytest.mark.parametrize("group", [0, 1, 2])
def test_both_pairs_of_a_group_are_spread_together(numbers, group):
    """Any two of their four dimensions: at most 2^3 times as many points of a net in a rectangle as on average."""
    first, second = (numbers(np.arange(3)[:, None], np.arange(2**10), 2 * group + odd) for odd in (1, 0))
    for one in (0, 1):
        for other in (0, 1):
            for a in range(4, 7):
                cell = (first[..., one] * 2**a).astype(int) * 2 ** (10 - a)
                cell += (second[..., other] * 2 ** (10 - a)).astype(int)
                assert max(np.bincount(row).max() for row in cell) <= 8


def test_differences_of_halves_are_uncorrelated(numbers):
    """The difference between the halves of a net says nothing of that of another net, which the estimate of the design
    effect assumes."""
    u = numbers(np.arange(4096)[:, None], np.arange(16), np.array([2, 3])[:, None, None])
    function = np.floor(u[..., 0] * 3) * u[..., 1]
    nets = ((0, 8), (8, 8), (0, 4), (4, 4), (8, 4), (12, 4))
    halves = [function[..., first : first + n].mean(axis=-1) for first, n in nets]
    differences = [halves[0] - halves[1], halves[2] - halves[3], halves[4] - halves[5]]
    for block in range(2):
        for one, other in ((0, 1), (0, 2), (1, 2)):
            product = differences[one][block] * differences[other][block]
            assert abs(product.mean()) < Z * product.std() / np.sqrt(len(product))


def test_the_variance_falls_faster_than_one_over_n(numbers):
    """Of the mean of x y over the pixels: that of a net of n points is below 2 / n^2 of the variance of one point."""
    for block in (2, 3):
        u = numbers(np.arange(1000)[:, None], np.arange(256), block)
        for x, y in ((0, 1), (2, 3)):
            product = u[..., x] * u[..., y]
            for n in (4, 16, 64, 256):
                assert product[:, :n].mean(axis=1).var() < 2 * (7 / 144) / n**2


def test_a_seed_does_not_only_permute_the_pixels(numbers):
    pixels = np.arange(4096)
    base = set(map(tuple, numbers(pixels, 0, 1, (12, 0)).tolist()))
    for seed in ((13, 0), (12, 1), (13, 2**31), (0, 12)):
        assert not base & set(map(tuple, numbers(pixels, 0, 1, seed).tolist()))


def test_both_samplers_have_the_same_mean():
    """Every pixel's mean over 30 seeds: 5.8 standard errors, false alarms 1e-4 at most over the 35 pixels (Student)."""
    means = {sampler: [] for sampler in ("sobol", "independent")}
    for sampler, found in means.items():
        for seed in range(30):
            renderer = isonoise.Renderer(lamp_over_floor(), strategy="uniform:wave_spp=64", seed=seed, sampler=sampler)
            renderer.step()
            found.append(renderer.statistics().mean)
    sobol, independent = (np.array(found) for found in means.values())
    error = np.sqrt((sobol.var(axis=0, ddof=1) + independent.var(axis=0, ddof=1)) / 30)
    assert (np.abs(sobol.mean(axis=0) - independent.mean(axis=0)) <= 5.8 * error + 1e-7).all()
    assert sobol.var(axis=0).sum() < 0.7 * independent.var(axis=0).sum()
