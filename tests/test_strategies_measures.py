"""Measures and the floor: closed forms, edge cases, invariance to the scale of the light."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from synthetic_statistics import make_statistics, noisy_statistics, statistics_of_samples

from isonoise.strategies import make_strategy, measures
from isonoise.strategies.measures import (
    confidence,
    half_buffer,
    image_floor,
    neighbour_variance,
    relative_mean,
    relative_median,
    standard_error,
    tsallis,
    variance_per_sample,
    with_neighbours,
)


def test_floor_is_one_percent_of_the_geometric_mean():
    assert image_floor(np.array([[1.0, 100.0]])) == pytest.approx(0.1)
    assert image_floor(np.array([[1.0, 100.0, 0.0, -3.0]])) == pytest.approx(0.1)
    # mean 1e8 / 2: the dark pixel counts as 1e-4 of it
    assert image_floor(np.array([[1e8, 1.0]])) == pytest.approx(0.01 * np.sqrt(1e8 * 5000.00005))
    assert image_floor(np.zeros((3, 3))) == 0.0


@pytest.mark.parametrize("power", [-100, -20, -1, 1, 20, 100])
def test_floor_scales_exactly_with_powers_of_two(power):
    image = np.random.default_rng(1).lognormal(0, 4, size=(50, 50))
    assert image_floor(np.ldexp(image, power)) == np.ldexp(image_floor(image), power)


def test_measures_are_their_formulas():
    s = make_statistics(16, [[2.0, 2.0, 2.0, 0.01]], [[4.0, 4.0, 4.0, 4.0]], median=[[1.5, 0.1, 5.0, 0.0]])
    assert standard_error(s) == pytest.approx(np.full((1, 4), 0.5))
    assert relative_mean(s, 0.1)[0] == pytest.approx([0.25, 0.25, 0.25, 5.0])
    assert relative_median(s, 0.1)[0] == pytest.approx([0.5 / 1.5, 0.5 / 0.25, 0.1, 5.0])
    assert relative_median(s, 0.1, kappa=np.inf)[0] == pytest.approx([0.5 / 1.5, 5.0, 0.1, 5.0])
    assert variance_per_sample(s, relative_mean(s, 0.1))[0] == pytest.approx([1.0, 1.0, 1.0, 400.0])


def test_the_design_effect_multiplies_the_variance_of_the_mean():
    """Statistics with the design effect d have the errors of samples with the variance d s^2, in every measure."""
    shape = (9, 13)
    rng = np.random.default_rng(4)
    count, mean, variance = rng.integers(0, 9, size=shape), rng.lognormal(size=shape), rng.lognormal(size=shape)
    d = rng.uniform(0.05, 2, size=shape)
    s = make_statistics(count, mean, variance, median=mean, design_effect=d)
    scaled = make_statistics(count, mean, d * variance, median=mean)
    assert (s.variance_of_mean() == scaled.variance_of_mean()).all()
    assert (s.variance_of_mean()[count >= 2] == (d * variance / np.maximum(count, 1))[count >= 2]).all()
    assert np.isposinf(s.variance_of_mean()[count < 2]).all()
    assert (s.variance == variance).all()
    for measure in (
        standard_error,
        lambda s: relative_mean(s, 0.1),
        lambda s: relative_median(s, 0.1),
        lambda s: neighbour_variance(with_neighbours(s, 3), 0.1),
        lambda s: confidence(s, 0.05),
    ):
        assert (measure(s) == measure(scaled)).all()


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (7, 5), (3, 2)])
@pytest.mark.parametrize("window", [3, 5, 31])
@pytest.mark.parametrize("all_known", [True, False])
def test_neighbour_variance_is_a_plain_loop_over_the_window(shape, window, all_known, monkeypatch):
    monkeypatch.setattr(measures, "MEASURE_STRIP_PIXELS", 10)  # a few rows at a time
    rng = np.random.default_rng(3)
    count = rng.integers(2 if all_known else 0, 50 if all_known else 4, size=shape)
    s = make_statistics(count, rng.lognormal(size=shape), np.where(count >= 2, rng.lognormal(size=shape), 0))
    s = replace(s, design_effect=rng.uniform(0.1, 1, size=shape))
    own, reach = s.design_effect * s.variance, window // 2
    for (y, x), value in np.ndenumerate(neighbour_variance(with_neighbours(s, window), 0.5)):
        around = np.zeros(shape, dtype=bool)
        around[max(y - reach, 0) : y + reach + 1, max(x - reach, 0) : x + reach + 1] = True
        if shape != (1, 1):
            around[y, x] = False
        around &= count >= 2
        if count[y, x] < 2 or not around.any():
            assert value == np.inf
        else:
            expected = own[around].mean() / max(s.mean[around].mean(), 0.5) ** 2
            assert value == pytest.approx(expected, rel=1e-12)


def test_neighbour_variance_does_not_depend_on_the_pixel_itself():
    s = noisy_statistics((9, 8))
    changed = replace(s, mean=s.mean.copy(), variance=s.variance.copy(), count=s.count.copy())
    changed.mean[4, 3], changed.variance[4, 3], changed.count[4, 3] = 1e30, 1e60, 10**6
    before, after = (neighbour_variance(with_neighbours(each, 5), 0.1) for each in (s, changed))
    assert after[4, 3] == before[4, 3]
    differs = np.zeros(s.shape, dtype=bool)
    differs[2:7, 1:6] = True
    differs[4, 3] = False
    assert ((after != before) == differs).all()


def test_outliers_count_with_their_own_variance_as_far_as_their_share_of_the_energy_allows():
    """Three pixels of 20x20 have seen an outlier; the image has 100 samples per pixel and a sum of 400."""
    variance = np.full((20, 20), 0.01)
    for pixel, error in (((3, 3), 2.0), ((10, 10), 1.0), ((15, 15), 0.5)):
        variance[pixel] = 100 * error**2
    s = with_neighbours(make_statistics(100, np.ones((20, 20)), variance), 5)

    def with_own(share):
        difference = neighbour_variance(s, 0.1, share) != neighbour_variance(s, 0.1)
        return {(int(y), int(x)) for y, x in np.argwhere(difference)}

    # The limit is share / sqrt(100) * 400 = 40 share, against errors of 2, then 1, then 0.5.
    assert with_own(0.049) == set()
    assert with_own(0.051) == {(3, 3)}
    assert with_own(0.076) == {(3, 3), (10, 10)}
    assert with_own(0.09) == {(3, 3), (10, 10), (15, 15)}
    assert neighbour_variance(s, 0.1, 0.051)[3, 3] == pytest.approx(400)


@pytest.mark.parametrize("q", [0.5, 1.0, 1.5, 2.0, 3.0])
def test_tsallis_is_the_entropy_of_the_shares(q):
    x = np.random.default_rng(4).lognormal(0, 1.5, size=(20, 3, 4))
    power = np.mean(x * np.log(x) if q == 1 else x**q, axis=0)
    s = replace(make_statistics(20, x.mean(axis=0), x.var(axis=0, ddof=1)), power=power)
    p = x / x.sum(axis=0)
    if q == 1:
        expected = np.sqrt(1 - -(p * np.log(p)).sum(axis=0) / np.log(20))
    else:
        expected = np.sqrt(1 - (1 - (p**q).sum(axis=0)) / (1 - 20.0 ** (1 - q)))
    assert tsallis(s, q) == pytest.approx(expected, rel=1e-9)
    if q == 2:  # relative-mean exactly, where the mean is above the floor
        assert tsallis(s, 2) == pytest.approx(relative_mean(s, 0.0), rel=1e-15)
    dark = make_statistics([[0, 1, 9]], [[0.0, 1.0, 0.0]], np.zeros((1, 3)))
    assert tsallis(replace(dark, power=np.zeros((1, 3))), q).tolist() == [[0, 0, 0]]


def test_unknown_is_inf_and_noiseless_is_zero():
    s = make_statistics([[0, 1, 2, 16, 16]], [[0.0, 3.0, 3.0, 0.0, 3.0]], median=0.0)
    for measure in (relative_mean(s, 0.01), relative_median(s, 0.01)):
        assert measure.tolist() == [[np.inf, np.inf, 0.0, 0.0, 0.0]]
        assert variance_per_sample(s, measure).tolist() == [[np.inf, np.inf, 0.0, 0.0, 0.0]]


def test_a_black_image_has_no_floor_and_no_nan():
    s = make_statistics(16, np.zeros((2, 2)), median=0.0)
    assert (relative_mean(s, image_floor(s.mean)) == 0).all()
    assert (relative_median(s, image_floor(s.mean)) == 0).all()
    noisy = make_statistics(16, [[0.0, -1.0]], [[1.0, 1.0]])  # from negative samples: noise without a scale
    assert np.isposinf(relative_mean(noisy, image_floor(noisy.mean))).all()


def test_kappa_bounds_pixels_of_zero_median():
    """One sample in 8 is 24, the rest 0, among pixels of relative variance 7. Without kappa it gets all samples."""
    x = np.random.default_rng(2).lognormal(0, np.sqrt(np.log(8)), size=(800, 10, 10))
    x[:, 5, 5] = np.where(np.arange(800) % 8 == 0, 24.0, 0.0)
    s = statistics_of_samples(x, chunk=5)
    assert s.median[5, 5] == 0
    floor = image_floor(s.mean)
    by_mean = relative_mean(s, floor)
    bare, bounded = relative_median(s, floor, kappa=np.inf), relative_median(s, floor)
    assert bare[5, 5] / by_mean[5, 5] == pytest.approx(s.mean[5, 5] / floor)
    assert bare[5, 5] / by_mean[5, 5] > 50
    assert bounded[5, 5] / by_mean[5, 5] == pytest.approx(8)
    budget = 20_000
    assert make_strategy("relative-median:kappa=inf,clip=1,cap=inf").allocate(s, budget)[5, 5] == budget
    assert make_strategy("relative-mean:clip=1,cap=inf").allocate(s, budget)[5, 5] < 0.1 * budget


@pytest.mark.parametrize(
    "spec",
    [
        "relative-mean",
        "relative-median",
        "relative-median:kappa=inf",
        "relative-median:literal=true",
        "absolute",
        "pooled",
        "tsallis",
        "pooled:rule=proportional",
    ],
)
def test_scaling_the_light_changes_no_allocation(spec):
    rng = np.random.default_rng(3)
    x = rng.gamma(0.3, size=(20, 30, 40)) * np.exp(rng.normal(0, 2, size=(30, 40)))
    strategy = make_strategy(spec)
    plain = strategy.allocate(statistics_of_samples(x, chunk=5), 5000)
    assert plain.sum() == 5000
    for power in (-20, -3, 20):
        assert (strategy.allocate(statistics_of_samples(np.ldexp(x, power), chunk=5), 5000) == plain).all()
    change = strategy.allocate(statistics_of_samples(x * 0.3, chunk=5), 5000).astype(int) - plain
    assert np.abs(change).max() <= 1
    assert np.count_nonzero(change) <= 4  # pixels whose remainders tie but for the last bit


def test_the_map_sends_samples_where_the_relative_error_is():
    """Half of the image has twice the relative error of the other: water-filling wants counts of 1 to 4."""
    rng = np.random.default_rng(4)
    sigma = np.where(np.arange(64) < 32, 0.1, 0.2)
    brightness = np.exp(rng.normal(0, 1, size=(64, 64)))  # does not affect a relative error
    x = brightness * (1 + sigma * rng.normal(size=(400, 64, 64)))
    counts = 400 + make_strategy("relative-mean:clip=1,cap=inf").allocate(
        statistics_of_samples(x, chunk=5), 1600 * 64 * 64
    )
    # 2000 on average: 800 and 3200. The variance's noise, sqrt(2 / 399) a pixel, averages out over 2048 pixels.
    assert counts[:, :32].mean() == pytest.approx(800, rel=0.02)
    assert counts[:, 32:].mean() == pytest.approx(3200, rel=0.02)


def test_a_black_image_is_sampled_uniformly():
    s = make_statistics(16, np.zeros((6, 5)), median=0.0)
    for spec in ("relative-mean", "relative-median"):
        allocation = make_strategy(spec).allocate(s, 30 * 4)
        assert (allocation == 4).all()


def test_half_buffer_is_its_formula():
    s = noisy_statistics((5, 7))
    for y, x in itertools.product(range(5), range(7)):
        whole, half = ([float(v) for v in image[y, x]] for image in (s.rgb, s.half))
        expected = sum(abs(a - b) for a, b in zip(whole, half, strict=True)) / math.sqrt(sum(whole))
        assert half_buffer(s)[y, x] == pytest.approx(expected, rel=1e-12)


def test_half_buffer_of_unknown_and_black_pixels():
    s = make_statistics([[0, 1, 2, 2]], [[0.0, 3.0, 3.0, 0.0]], half=[[0.0, 0.0, 3.0, 0.0]])
    assert half_buffer(s).tolist() == [[math.inf, math.inf, 0.0, 0.0]]


def test_confidence_is_half_of_the_interval():
    s = make_statistics([[2, 2, 10, 0, 1]], np.ones((1, 5)), [[2.0, 0.0, 10.0, 0.0, 0.0]])
    assert confidence(s, 0.05)[0] == pytest.approx([12.7062047, 0.0, 2.26215716, math.inf, math.inf])
    assert confidence(s, 0.5)[0, 0] == pytest.approx(1.0)  # tan(pi / 4)


def test_confidence_intervals_have_the_stated_coverage():
    """Of 4 normal samples in 100,000 pixels; 4.4 standard deviations of a binomial share (false alarms: 1e-5)."""
    rng = np.random.default_rng(2)
    s = statistics_of_samples(np.repeat(5 + rng.normal(size=(4, 250, 400, 1)), 3, axis=-1))
    for significance in (0.01, 0.05, 0.3):
        missed = np.mean(np.abs(s.mean - 5) > confidence(s, significance))
        assert missed == pytest.approx(significance, abs=4.4 * math.sqrt(significance / 1e5))
