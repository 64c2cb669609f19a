"""Strategies that sample in proportion to an error (tungsten, luxcore): errors, rounding, the stored image."""

import math

import numpy as np
import pytest
from synthetic_statistics import make_statistics, noisy_statistics, statistics_of_samples

from isonoise.strategies import Wave
from isonoise.strategies.luxcore import LuxCore, change, importance
from isonoise.strategies.tungsten import Tungsten, block_error, clamped, dilated, distributed

SHAPES = [(1, 1), (7, 5), (5, 7), (16, 33)]


@pytest.mark.parametrize("shape", SHAPES)
def test_tungsten_block_error_is_that_of_all_its_samples(shape):
    rng = np.random.default_rng(4)
    x = np.repeat(rng.gamma(0.5, 0.3, size=(6, *shape, 1)), 3, axis=-1)
    error = block_error(statistics_of_samples(x))
    assert error.shape == (-(-shape[0] // 4), -(-shape[1] // 4))
    for by, bx in np.ndindex(error.shape):
        samples = x[:, 4 * by : 4 * by + 4, 4 * bx : 4 * bx + 4, 0].ravel()
        expected = samples.var(ddof=1) / (samples.size * max(samples.mean() ** 2, 1e-3))
        assert error[by, bx] == pytest.approx(expected, rel=1e-9)


def test_tungsten_clamps_at_the_95th_percentile_of_errors_above_zero():
    error = np.concatenate([np.arange(1.0, 101), np.zeros(50), [np.inf]]).reshape(1, -1)
    assert clamped(error).max() == 96  # the element 100 * 95 / 100, from 0
    assert clamped(error)[0, -1] == 96
    assert (clamped(error)[0, 100:150] == 0).all()
    assert clamped(np.array([[0.0, np.inf]])).tolist() == [[0.0, 1.0]]


@pytest.mark.parametrize("shape", SHAPES)
def test_tungsten_dilates_in_two_sweeps(shape):
    error = np.random.default_rng(5).random(shape)
    offsets = [(0, 0), (0, 1), (0, -1), (1, 0), (-1, 0), (1, -1), (-1, 1)]
    for y, x in np.ndindex(shape):
        near = [(y + a, x + b) for a, b in offsets if 0 <= y + a < shape[0] and 0 <= x + b < shape[1]]
        assert dilated(error)[y, x] == max(error[at] for at in near)


@pytest.mark.parametrize("start", [0.0, 0.3, 0.999])
def test_tungsten_carries_fractions(start):
    rng = np.random.default_rng(6)
    share = rng.lognormal(0, 2, size=(13, 17))
    for budget in (1, 100, 10**6):
        counts = distributed(share * (budget / share.sum()), budget, start).astype(np.int64)
        assert counts.sum() == budget
        exact = np.cumsum(share) * (budget / share.sum())
        assert (np.abs(np.cumsum(counts) - exact) < 1 + 1e-6).all()


@pytest.mark.parametrize("budget", [0, 1, 34, 35, 36, 560, 10**6])
def test_tungsten_gives_one_sample_to_every_pixel_and_the_rest_by_error(budget):
    s = noisy_statistics((7, 5))
    allocation = Tungsten().allocate(s, budget)
    assert allocation.sum() == budget
    if budget >= 35:
        assert allocation.min() >= 1
        weights = dilated(clamped(block_error(s)))[np.arange(7)[:, None] // 4, np.arange(5) // 4]
        share = 1 + (budget - 35) * weights / weights.sum()
        assert np.abs(allocation - share).max() < 2


def test_tungsten_carries_differently_in_every_wave():
    """Half a sample each on average: over many waves all pixels get as many."""
    times = np.zeros((8, 8))
    for wave in range(400):
        times += Tungsten().allocate(make_statistics(16 + wave, np.ones((8, 8)), 1.0), 64 + 32) - 1
    assert times.sum() == 400 * 32
    assert np.ptp(times) <= 12


def test_luxcore_error_is_its_formula():
    a, b = noisy_statistics((9, 11), seed=7).rgb, noisy_statistics((9, 11), seed=8).rgb
    a[2, 3] = 0
    b[2, 3] = 1
    error = np.zeros((9, 11))
    for y, x in np.ndindex(9, 11):
        light = sum(map(float, a[y, x]))
        difference = sum(abs(float(p) - float(q)) for p, q in zip(a[y, x], b[y, x], strict=True))
        error[y, x] = difference / math.sqrt(light) if light else 0
    assert change(a, b) == pytest.approx(error, rel=1e-12)

    mean = np.zeros((9, 11))
    for y, x in np.ndindex(9, 11):
        mean[y, x] = error[max(y - 4, 0) : min(y + 4, 9), max(x - 4, 0) : min(x + 4, 11)].mean()
    score = np.clip((mean - mean.mean()) / mean.std(), -6, 6)
    expected = (score - score.min()) / (score.max() - score.min())
    assert importance(error, 4) == pytest.approx(expected, abs=1e-9)


def test_luxcore_cuts_at_six_sigma():
    """One pixel in 10,000: it is 100 standard deviations from the mean, the others a hundredth of one."""
    error = np.full((100, 100), 1.0)
    error[::2] = 2.0
    error[50, 50] = 1e6
    noise = importance(error, 1)
    assert noise.max() == 1
    window = error[49:51, 49:51].mean()
    assert noise[10, 10] < 0.01
    assert (noise == 1).sum() == 4
    mean, deviation = 4 * window / 1e4, 2 * window / 1e2  # of four windows that hold the pixel
    assert (window - mean) / deviation > 6


def test_luxcore_compares_with_the_image_of_the_last_test():
    strategy = LuxCore(scale=1)
    waves = strategy.waves()
    assert (next(waves), next(waves)) == (Wave("uniform", 32), Wave("adaptive", 32))
    image = np.ones((10, 10))
    budget = 32 * 100
    assert (strategy.allocate(make_statistics(32, image), budget) == 32).all()  # nothing to compare with yet
    changed = image.copy()
    changed[3, 3] = 2.0
    first = strategy.allocate(make_statistics(64, changed), budget)
    assert first[3, 3] == first[4, 4] == first.max() > 10 * first.min()
    # until there are 32 samples per pixel more, the weights stay
    again = strategy.allocate(make_statistics(95, image), budget).astype(int)
    assert np.abs(again - first).max() <= 1
    changed[7, 7] = 2.0
    second = strategy.allocate(make_statistics(96, changed), budget)  # compared with the image of 64, not of 95
    assert second[7, 7] > 10 * second[3, 3]
    # a new render begins without an image
    next(strategy.waves())
    assert (strategy.allocate(make_statistics(64, image), budget) == 32).all()


@pytest.mark.parametrize("strength", [0.0, 0.5, 0.95])
def test_luxcore_strength(strength):
    strategy = LuxCore(strength=strength)
    strategy.allocate(noisy_statistics((30, 40), seed=12), 32 * 1200)
    allocation = strategy.allocate(noisy_statistics((30, 40), n=64, seed=13), 10**6)
    assert allocation.sum() == 10**6
    assert allocation.min() >= (1 - strength) * allocation.max() - 1
    assert allocation.min() <= (1 - strength) * allocation.max() + 1
