"""Figures of a comparison freed of the reference's error, on simulated errors whose true figures are known.

Simulations have fixed seeds; their tolerances are 4 standard errors of the simulated figure unless stated otherwise
(false alarm: 1 in 16,000 if the seeds were drawn anew).
"""

import math

import numpy as np
import pytest
from simulated_comparison import make_comparison

from isonoise.comparison import metrics
from isonoise.comparison.reference_error import (
    error_quantiles,
    neighbour_mean,
    reference_rel_mse,
    rms_quantiles,
    without_reference_error,
)
from isonoise.comparison.summary import summarise

QUANTILES = (0.5, 0.95, 0.99)


def sigma_of(shape, spread):
    """Standard errors that rise from left to right by a factor `spread`."""
    return np.broadcast_to(np.geomspace(1, spread, shape[1]), shape)


@pytest.mark.parametrize("spread", [1, 100])
@pytest.mark.parametrize(
    ("share", "equal_noise"), [(0.1, False), (0.25, False), (0.5, False), (0.1, True), (0.25, True)]
)
def test_quantiles_of_single_images_are_those_with_an_exact_reference(spread, share, equal_noise):
    """Normal errors of the image, equal or with a spread of 100; the reference's are in proportion or all equal.

    Quantiles of 200x300 pixels, mean of 16 images with references of their own: standard errors of the differences are
    below 0.2 %. Equal noise is as large as the errors in some pixels with a spread of 100, so linear extrapolation is
    off by more there.
    """
    rng, shape = np.random.default_rng([spread, int(100 * share), equal_noise]), (200, 300)
    sigma = sigma_of(shape, spread)
    se = np.full(shape, share * np.median(sigma)) if equal_noise else share * sigma
    ratios, raw = [], []
    for _ in range(16):
        e = sigma * rng.normal(size=shape)
        observed = e - se * rng.normal(size=shape)
        exact = np.quantile(np.abs(e), QUANTILES)
        ratios.append(error_quantiles(observed, QUANTILES, se) / exact)
        raw.append(np.quantile(np.abs(observed), QUANTILES) / exact)
    tolerance = 0.01 if share <= 0.25 else 0.03
    assert np.mean(ratios, axis=0) == pytest.approx(np.ones(3), abs=tolerance)
    assert np.mean(raw, axis=0)[0] > 1 + 0.3 * share**2


def test_heavy_tails_are_left_where_the_reference_does_not_reach():
    """Student errors with 3 degrees of freedom: the noise of the reference hardly changes p99."""
    rng, shape = np.random.default_rng(2), (300, 400)
    e = rng.standard_t(3, size=shape)
    observed = e + 0.25 * math.sqrt(3) * rng.normal(size=shape)
    corrected = error_quantiles(observed, QUANTILES, np.full(shape, 0.25 * math.sqrt(3)))
    assert corrected == pytest.approx(np.quantile(np.abs(e), QUANTILES), rel=0.02)


@pytest.mark.parametrize("seeds", [2, 8])
def test_quantiles_of_the_rms_over_seeds(seeds):
    """The reference's error is the same for all seeds. Its noise is a quarter of the error of a single image."""
    rng, shape = np.random.default_rng(seeds), (200, 300)
    sigma = sigma_of(shape, 10)
    e = sigma * rng.normal(size=(seeds, *shape))
    observed = e - 0.25 * sigma * rng.normal(size=shape)
    exact = np.quantile(metrics.rms_over_seeds(e), QUANTILES)
    corrected, leave_one_out = rms_quantiles(observed, QUANTILES, 0.25 * sigma)
    assert corrected == pytest.approx(exact, rel=0.015)
    assert np.quantile(metrics.rms_over_seeds(observed), QUANTILES)[0] > 1.015 * exact[0]
    assert leave_one_out.shape == (seeds, 3)
    if seeds > 2:
        assert leave_one_out.mean(axis=0) == pytest.approx(corrected, rel=0.1)


def test_an_exact_reference_changes_nothing():
    errors = np.random.default_rng(3).normal(size=(3, 20, 30))
    expected = np.quantile(metrics.rms_over_seeds(errors), QUANTILES)
    for se in (None, np.zeros((20, 30))):
        assert rms_quantiles(errors, QUANTILES, se)[0] == pytest.approx(expected, rel=1e-2)
        assert error_quantiles(errors[0], QUANTILES, se) == pytest.approx(np.quantile(np.abs(errors[0]), QUANTILES))


def test_errors_below_the_references_are_not_negative():
    figures = without_reference_error(lambda e: np.quantile(np.abs(e), QUANTILES), np.zeros((9, 9)), np.ones((9, 9)))
    assert figures.tolist() == [0, 0, 0]


def test_the_references_share_of_the_relmse():
    """An unbiased reference adds its variance: the mean over 20,000 pixels has a standard error of 1.2 %."""
    rng, shape = np.random.default_rng(4), (100, 200, 3)
    truth = rng.uniform(0.3, 2, shape)
    se = 0.05 * truth
    observed = np.mean((truth - (truth + se * rng.normal(size=shape))) ** 2 / (truth**2 + 0.01))
    assert reference_rel_mse(truth, se) == pytest.approx(observed, rel=0.05)


def test_the_mean_of_the_neighbours_is_without_the_pixel():
    image = np.random.default_rng(5).random((7, 9))
    means = neighbour_mean(image)
    for y, x in ((0, 0), (3, 4), (6, 8), (1, 7)):
        window = image[max(y - 2, 0) : y + 3, max(x - 2, 0) : x + 3]
        assert means[y, x] == pytest.approx((window.sum() - image[y, x]) / (window.size - 1))
    assert neighbour_mean(np.array([[3.0]])) == 3
    assert neighbour_mean(np.array([[3.0, 1.0]])).tolist() == [[1, 3]]


@pytest.mark.parametrize("share", [0.25, 1.0])
def test_z_of_unbiased_images_is_standard_normal(share):
    """400 comparisons of 4 unbiased images with a reference whose noise is a share of theirs; dark and bright pixels.

    z follows Student's t with 3 degrees of freedom or more: it is compared through its 5 % level and its mean. The
    relative error itself, without the weight, accuses unbiased images.
    """
    rng, trials, shape = np.random.default_rng(6), 400, (32, 40)
    truth = rng.uniform(0.2, 1, shape) * np.geomspace(0.02, 1, 40)
    sigma = 0.4 * truth
    estimates, unweighted = [], []
    for _ in range(trials):
        reference = np.maximum(truth + share * sigma * rng.normal(size=shape), 0.05 * truth)
        images = truth + sigma * rng.normal(size=(4, *shape))
        errors, relative_se = (images - reference) / reference, share * sigma / reference
        estimates.append(metrics.bias(errors, reference / neighbour_mean(reference), relative_se))
        unweighted.append(metrics.bias(errors, relative_se=relative_se).z())
    z = np.array([estimate.z() for estimate in estimates])
    significant = np.mean([abs(estimate.z()) > estimate.critical() for estimate in estimates])
    assert significant == pytest.approx(0.05, abs=4 * math.sqrt(0.05 * 0.95 / trials) + 0.01)  # Welch's approximation
    assert np.median(z) == pytest.approx(0, abs=4 * 1.26 / math.sqrt(trials))
    assert np.median(unweighted) > 4 * 1.26 / math.sqrt(trials)


@pytest.mark.parametrize("reference_se", [0.005, 0.0125])
def test_a_noisy_reference_accuses_no_strategy(tmp_path, reference_se):
    """The whole table: errors from 2.5 to 25 %, the median 8 %. 48x64 pixels, 8 seeds."""
    strategies = {"uniform": np.ones_like, "relative-median": lambda v: v}
    folder = make_comparison(tmp_path / "noisy", ["a"], strategies, range(8), (48, 64), reference_se=reference_se)
    exact = make_comparison(tmp_path / "exact", ["a"], strategies, range(8), (48, 64), reference_se=None)
    rows, exact_rows = summarise(folder)["scenes"][0]["rows"], summarise(exact)["scenes"][0]["rows"]
    for row, other in zip(rows, exact_rows, strict=True):
        assert abs(row["bias"]["z"]) < 5.4  # 1 in 1000 at 7 degrees of freedom
        for quantile in ("p50", "p95", "p99"):
            assert row["stated_over_true"][quantile]["value"] == pytest.approx(0.98, abs=0.01)
            assert row["rms"][quantile] == pytest.approx(other["rms"][quantile], rel=0.03)
        assert row["rel_mse"]["value"] == pytest.approx(other["rel_mse"]["value"], rel=0.03)
        assert row["rel_mse"]["low"] < other["rel_mse"]["value"] < row["rel_mse"]["high"]
