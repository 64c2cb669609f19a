"""True errors against their formulas on small images, and the coverage of intervals in a simulation."""

import numpy as np
import pytest
from synthetic_statistics import grey, make_statistics, statistics_of_samples

from isonoise.error.true_error import true_error
from isonoise.luminance import luminance


def test_luminance_is_rec_709():
    assert luminance(np.eye(3, dtype=np.float32)).tolist() == pytest.approx([0.2126, 0.7152, 0.0722])
    assert luminance(np.ones((2, 3, 3), np.float32)) == pytest.approx(np.ones((2, 3)))


def test_an_equal_image_has_no_error():
    reference = np.random.default_rng(1).lognormal(size=(6, 5, 3)).astype(np.float32)
    e = true_error(reference, reference)
    assert (e.p50, e.p95, e.p99, e.max, e.rel_mse, e.rel_mse_floor, e.energy_ratio) == (0, 0, 0, 0, 0, 0, 1)
    assert np.isnan(e.coverage)
    assert np.isnan(e.energy_ratio_se)


def test_formulas():
    r = np.array([[1.0, 4.0], [0.25, 1.0]])
    x = np.array([[1.1, 3.0], [0.25, 0.0]])
    e = true_error(grey(x), grey(r))
    assert e.floor == pytest.approx(0.01)  # the geometric mean is 1
    relative = np.abs(x - r) / r
    assert (e.p50, e.max) == pytest.approx((np.median(relative), 1.0), rel=1e-6)
    assert e.p95 == pytest.approx(np.quantile(relative, 0.95), rel=1e-6)
    assert e.rel_mse == pytest.approx(np.mean((x - r) ** 2 / (r**2 + 0.01)), rel=1e-6)
    assert e.rel_mse_floor == pytest.approx(np.mean((x - r) ** 2 / (r**2 + 1e-4)), rel=1e-6)
    assert e.energy_ratio == pytest.approx(x.sum() / r.sum(), rel=1e-6)


def test_rel_mse_is_over_rgb_and_quantiles_are_over_luminance():
    reference = np.ones((1, 2, 3), np.float32)
    image = reference.copy()
    image[0, 0] = [1.5, 1.0, 1.0]
    e = true_error(image, reference)
    assert e.rel_mse == pytest.approx(0.25 / 1.01 / 6)
    assert e.max == pytest.approx(0.5 * 0.2126)


def test_the_worst_thousandth_is_left_out():
    reference = np.ones((50, 100, 3), np.float32)
    image = reference.copy()
    image[0, :4] = [[1001.0]]  # 4 of 5000 pixels
    image[1:] += 0.1
    e = true_error(image, reference)
    assert e.rel_mse > 700
    assert e.rel_mse_trimmed == pytest.approx((4900 - 1) / 4995 * 0.01 / 1.01, rel=1e-5)  # and one more
    small = true_error(image[:9], reference[:9])  # 900 pixels: a thousandth rounds to 0
    assert small.rel_mse_trimmed == pytest.approx(small.rel_mse)


def test_errors_of_black_pixels_are_relative_to_the_floor():
    e = true_error(grey([[1.0, 0.02]]), grey([[1.0, 0.0]]))
    assert e.max == pytest.approx(0.02 / 0.01, rel=1e-6)
    black = true_error(grey([[0.0, 1.0]]), grey([[0.0, 0.0]]))
    assert (black.floor, black.p50, black.p99, black.max, black.rel_mse_floor) == (0, 0, np.inf, np.inf, np.inf)
    assert np.isnan(black.energy_ratio)


def test_coverage_and_energy_ratio_of_a_simulation():
    """Normal samples, image and reference both noisy: 95 % covered, and the energy ratio's error in units of its own
    standard error normal over 200 images."""
    rng = np.random.default_rng(2)
    shape, n, reference_n, sigma = (20, 20), 6, 50, 0.5
    covered, deviations = [], []
    for _ in range(200):
        s = statistics_of_samples(1 + sigma * rng.normal(size=(n, *shape)))
        reference = grey(1 + sigma / np.sqrt(reference_n) * rng.normal(size=shape))
        e = true_error(s.rgb, reference, grey(np.full(shape, sigma / np.sqrt(reference_n))), s)
        covered.append(e.coverage)
        deviations.append((e.energy_ratio - 1) / e.energy_ratio_se)
    # 80,000 pixels; adding variances of a t and a normal interval is conservative by up to 1 %.
    assert 0.95 - 4.5 * np.sqrt(0.0475 / 80_000) < np.mean(covered) < 0.962
    assert abs(np.mean(deviations)) < 4.5 / np.sqrt(200)  # false alarms: 7e-6
    assert abs(np.var(deviations) - 1) < 4.5 * np.sqrt(2 / 200)


def test_coverage_allows_rounding_and_ignores_pixels_without_an_interval():
    reference = grey([[1 / 3, 1.0, 1.0]])
    s = make_statistics([[16, 16, 1]], [[1 / 3, 1.1, 5.0]])
    e = true_error(s.rgb, reference, None, s)
    assert e.coverage == 0.5  # the first differs by rounding, the second is wrong, the third has no interval
    assert e.energy_ratio_se == np.inf


def test_invalid_references_are_refused():
    ones = np.ones((4, 4, 3), np.float32)
    with pytest.raises(ValueError, match="shape"):
        true_error(ones, ones[:3])
    with pytest.raises(ValueError, match="reference_se"):
        true_error(ones, ones, ones[:, :3])
    with pytest.raises(ValueError, match="finite"):
        true_error(ones, ones * np.nan)
