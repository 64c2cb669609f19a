"""Metrics over the seeds against closed forms and simulations.

Simulations have fixed seeds; their tolerances are 4 standard errors of the simulated figure (false alarm: 1 in 16,000
if the seeds were drawn anew).
"""

import math

import numpy as np
import pytest

from isonoise.comparison import metrics
from isonoise.comparison.metrics import Curve
from isonoise.comparison.reference_error import rms_quantiles


def covered(intervals, truth) -> float:
    return float(np.mean([interval.low <= truth <= interval.high for interval in intervals]))


@pytest.mark.parametrize(
    ("p", "dof", "x"), [(0.99, 8, 20.0902), (0.5, 8, 7.3441), (0.99, 1, 6.6349), (0.99, 100, 135.8067)]
)
def test_chi_square_quantiles_agree_with_tables(p, dof, x):
    assert metrics.chi_square_quantile(p, dof) == pytest.approx(x, abs=1e-4)  # Abramowitz and Stegun, table 26.8


def test_chi_square_of_two_is_exponential():
    for p in (0.01, 0.5, 0.999):
        assert metrics.chi_square_quantile(p, 2) == pytest.approx(-2 * math.log1p(-p), rel=1e-12)


@pytest.mark.parametrize(("seeds", "expected"), [(8, 1.654), (16, 1.444)])
def test_ideal_uniformity(seeds, expected):
    assert metrics.ideal_uniformity(seeds) == pytest.approx(expected, abs=5e-4)
    errors = np.random.default_rng(1).normal(size=(seeds, 300, 400))
    p50, p99 = np.quantile(metrics.rms_over_seeds(errors), (0.5, 0.99))
    # Standard error of log p99: sqrt(0.99 0.01 / pixels) / (density times quantile) < 0.002; of log p50 less.
    assert p99 / p50 == pytest.approx(expected, rel=0.01)


def test_rms_over_seeds_is_the_definition():
    errors = np.random.default_rng(2).normal(size=(5, 20, 30)).astype(np.float16)
    exact = np.sqrt(np.mean(errors.astype(np.float64) ** 2, axis=0))
    assert metrics.rms_over_seeds(errors) == pytest.approx(exact)
    without = metrics.leave_one_out_rms_quantiles(errors, (0.5, 0.99))
    assert without.shape == (5, 2)
    for seed in range(5):  # quantiles of the squares differ between two pixels
        others = np.sqrt(np.mean(np.delete(errors, seed, axis=0).astype(np.float64) ** 2, axis=0))
        assert without[seed] == pytest.approx(np.quantile(others, (0.5, 0.99)), rel=1e-3)


def test_errors_near_the_largest_float16_do_not_overflow():
    errors = np.full((2, 3, 3), 60000, np.float16)
    assert metrics.rms_over_seeds(errors) == pytest.approx(np.full((3, 3), 60000), rel=1e-3)
    assert metrics.leave_one_out_rms_quantiles(errors, (0.99,)) == pytest.approx(np.full((2, 1), 60000), rel=1e-3)


def test_one_seed_has_no_interval():
    assert metrics.leave_one_out_rms_quantiles(np.ones((1, 4, 4)), (0.5, 0.99)).shape == (0, 2)
    for interval in (metrics.mean_over_seeds([2.0]).interval(), metrics.jackknife(2.0, []).interval()):
        assert interval.value == 2
        assert np.isnan([interval.low, interval.high]).all()


def test_mean_over_seeds_is_the_t_interval():
    estimate = metrics.mean_over_seeds([1.0, 2.0, 3.0])
    assert (estimate.value, estimate.se, estimate.dof) == (2.0, pytest.approx(1 / math.sqrt(3)), 2)
    assert estimate.half_width() == pytest.approx(4.302653 / math.sqrt(3), rel=1e-5)
    assert estimate.z(2.0) == 0


@pytest.mark.parametrize("common", [0.0, 0.3, 3.0])
def test_intervals_of_means_cover_with_the_references_error(common):
    """The reference's error shifts all seeds equally: it must widen the interval although the seeds do not show it."""
    rng, trials, seeds = np.random.default_rng(3), 6000, 8
    intervals = [
        metrics.mean_over_seeds(rng.normal(size=seeds) + common * rng.normal(), common).interval()
        for _ in range(trials)
    ]
    # Welch's approximation is off by up to 0.01 if both variances are similar
    assert covered(intervals, 0) == pytest.approx(0.95, abs=4 * math.sqrt(0.95 * 0.05 / trials) + 0.01 * (common > 0))


def test_paired_ratio_removes_the_noise_that_a_seed_has_in_common():
    rng = np.random.default_rng(4)
    shared = rng.lognormal(sigma=2, size=8)
    ratio = metrics.paired_ratio(0.4 * shared, shared)
    assert (ratio.value, ratio.low, ratio.high) == pytest.approx((0.4, 0.4, 0.4))
    noisy = [
        metrics.paired_ratio(0.4 * shared * rng.lognormal(sigma=0.3, size=8), shared * rng.lognormal(sigma=0.3, size=8))
        for _ in range(4000)
    ]
    assert covered(noisy, 0.4) == pytest.approx(0.95, abs=4 * math.sqrt(0.95 * 0.05 / 4000))


def test_a_ratio_to_zero_is_nan():
    assert math.isnan(metrics.paired_ratio([1.0, 2.0], [0.0, 1.0]).low)


def test_jackknife_of_a_mean_is_its_standard_error():
    values = np.random.default_rng(5).normal(size=9)
    estimate = metrics.jackknife(values.mean(), [np.delete(values, i).mean() for i in range(9)])
    assert estimate.se == pytest.approx(values.std(ddof=1) / 3)
    assert estimate.dof == 8


def test_jackknife_intervals_of_the_rms_ratio_are_conservative():
    """Ratio of the RMS p99 of two strategies whose errors are normal, one 0.6 times the other, half of it shared."""
    rng, trials, estimates = np.random.default_rng(6), 400, []
    for _ in range(trials):
        shared, one, two = rng.normal(size=(3, 8, 40, 50))
        a, a_without = rms_quantiles(0.6 * (shared + one), (0.99,), None)
        b, b_without = rms_quantiles(shared + two, (0.99,), None)
        estimates.append(metrics.jackknife(float(np.log(a / b)[0]), np.log(a_without / b_without)[:, 0]))
    assert covered([estimate.ratio() for estimate in estimates], 0.6) >= 0.94
    truth = np.std([estimate.value for estimate in estimates])
    assert 1 < np.mean([estimate.se for estimate in estimates]) / truth < 1.8


def test_bias_includes_the_references_error():
    rng = np.random.default_rng(7)
    reference_error = 0.1 * rng.normal(size=(40, 50))
    errors = 0.5 * rng.normal(size=(8, 40, 50)) - reference_error
    relative_se = np.full((40, 50), 0.1)
    assert abs(metrics.bias(errors, relative_se=relative_se).z()) < 3
    shifted = metrics.bias(errors + 0.05, relative_se=relative_se)
    assert shifted.value == pytest.approx(0.05, abs=0.02)
    assert shifted.z() > shifted.critical()
    exact = metrics.bias(errors)
    assert math.hypot(exact.se, 0.1 / math.sqrt(2000)) == pytest.approx(
        metrics.bias(errors, relative_se=relative_se).se
    )


def test_the_lower_bound_of_relmse_is_reached_by_the_root():
    variance = np.random.default_rng(9).lognormal(sigma=1.5, size=(30, 40))
    bound = metrics.rel_mse_lower_bound(variance)
    count = np.sqrt(variance) / np.sqrt(variance).mean()
    assert np.mean(variance / count) / variance.mean() == pytest.approx(bound)
    assert metrics.rel_mse_lower_bound(np.full((4, 4), 3.0)) == pytest.approx(1)
    assert metrics.rel_mse_lower_bound(np.array([[0.0, 1.0]])) == pytest.approx(0.5)
    assert math.isnan(metrics.rel_mse_lower_bound(np.zeros((2, 2))))


def power_law(scale: float, power: float = 0.5, first: float = 0.25, seeds: int = 4, jitter: float = 0.0) -> Curve:
    """error = scale t^-power at six times, up to 8 s."""
    rng = np.random.default_rng(10)
    time = 8.0 * 2.0 ** -np.arange(5, -1, -1) * first * 4
    without = scale * np.exp(jitter * rng.normal(size=(seeds, 1))) * time**-power
    return Curve(time, scale * time**-power, np.broadcast_to(time, without.shape), without)


def test_time_to_reach_on_a_power_law():
    curve = power_law(3.0)
    for level in (1.2, 2.0, 5.0):
        low, high = metrics.time_to_reach(curve.time, curve.error, level)
        assert low == high == pytest.approx((3 / level) ** 2)
    assert metrics.time_to_reach(curve.time, curve.error, 0.1) == (8.0, math.inf)
    assert metrics.time_to_reach(curve.time, curve.error, 100) == (0.0, 0.25)
    assert metrics.time_to_reach(curve.time, curve.error, curve.error[-1]) == pytest.approx((8.0, 8.0))


def test_an_error_counts_as_reached_if_it_stays_below():
    """The dip at 2 s is an image without its fireflies."""
    time, error = np.array([1.0, 2.0, 4.0, 8.0]), np.array([4.0, 0.4, 3.0, 0.5])
    assert metrics.time_to_reach(time, error, 1.0)[0] == pytest.approx(4 * 2 ** (math.log(3) / math.log(6)))
    rising = np.array([1.0, 2.0, 2.0, 3.0])
    assert metrics.time_to_reach(time, rising, 3.0) == (8.0, 8.0)
    assert metrics.time_to_reach(time, rising, 4.0) == (0.0, 1.0)


@pytest.mark.parametrize("scale", [0.9, 0.5, 0.25])
def test_time_ratio_of_power_laws(scale):
    ratio = metrics.time_ratio(power_law(scale), power_law(1.0))
    assert ratio.low == ratio.high == pytest.approx(scale**2)
    assert ratio.at_common_error.value == pytest.approx(scale**2)
    assert (ratio.at_common_error.low, ratio.at_common_error.high) == pytest.approx((scale**2, scale**2))


def test_time_ratio_of_the_baseline_is_one():
    ratio = metrics.time_ratio(power_law(1.0, jitter=0.1), power_law(1.0, jitter=0.1))
    assert (ratio.low, ratio.high, ratio.at_common_error.low, ratio.at_common_error.high) == pytest.approx((1, 1, 1, 1))


def test_an_error_that_is_not_reached_gives_a_bound_and_the_ratio_at_the_final_error():
    ratio = metrics.time_ratio(power_law(1.5), power_law(1.0))
    assert (ratio.low, ratio.high) == (pytest.approx(1), math.inf)
    assert ratio.at_common_error.value == pytest.approx(1.5**2)


def test_an_error_that_is_reached_before_the_first_point_gives_a_bound():
    ratio = metrics.time_ratio(power_law(0.1), power_law(1.0))
    assert (ratio.low, ratio.high) == (0, pytest.approx(1 / 32))
    assert math.isnan(ratio.at_common_error.value)


def test_time_ratio_near_one_has_an_interval_on_both_sides():
    """Only some of the sets of seeds reach the baseline's error; there is an interval all the same."""
    for scale in (0.99, 1.01):
        ratio = metrics.time_ratio(power_law(scale, jitter=0.05), power_law(1.0))
        assert ratio.at_common_error.low < scale**2 < ratio.at_common_error.high
        assert ratio.at_common_error.high / ratio.at_common_error.low < 2


def test_curve_of_means_of_waves_at_different_times():
    rng = np.random.default_rng(11)
    times = [np.sort(rng.uniform(0.1, 10, 30)) for _ in range(4)]
    scales = [1.0, 2.0, 3.0, 6.0]
    curve = metrics.curve_of_means(times, [scale / t for scale, t in zip(scales, times, strict=True)])
    assert curve.error == pytest.approx(3 / curve.time)
    assert curve.leave_one_out_error[3] == pytest.approx(2 / curve.time)
    assert curve.time[0] == pytest.approx(max(t[0] for t in times))
    assert curve.time[-1] == pytest.approx(min(t[-1] for t in times))


def test_curve_of_a_single_wave():
    curve = metrics.curve_of_means([np.array([2.0]), np.array([2.5])], [np.array([0.5]), np.array([0.3])])
    assert curve.time.tolist() == [2.0]
    assert curve.error.tolist() == [0.4]
