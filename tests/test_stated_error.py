"""The stated error: closed forms, invariants, and simulations with a known true error.

Simulations have fixed seeds. Their tolerances are those promised for the estimator (5 % where samples are normal), not
sampling noise: a quantile of 256x256 pixels has a standard error of 0.5 % at p50 and 0.8 % at p99 (density of |Z|).
"""

from dataclasses import replace

import numpy as np
import pytest
from synthetic_statistics import make_statistics, statistics_of_samples

from isonoise.error.shrinkage import relative_errors
from isonoise.error.stated_error import half_width_95, relative_standard_error, stated_error
from isonoise.statistics import Statistics
from isonoise.strategies.measures import image_floor

QUANTILES = (0.5, 0.95, 0.99)
HALF_NORMAL = np.array([0.67448975, 1.95996398, 2.57582930])  # quantiles of |Z|


def of_counts(x, count) -> Statistics:
    """Statistics of the first `count` samples of every pixel."""
    taken = np.arange(len(x))[:, None, None] < count
    mean = (x * taken).sum(axis=0) / count
    return make_statistics(count, mean, ((x - mean) ** 2 * taken).sum(axis=0) / (count - 1))


def true_quantiles(s, r):
    return np.quantile(np.abs(s.mean - r) / np.maximum(r, image_floor(r)), QUANTILES)


def smooth_field(rng, size, detail):
    """Normal field of unit variance with about `detail` bumps across the image."""
    k = np.fft.fftfreq(size) * size
    low_pass = np.exp(-(k[:, None] ** 2 + k**2) / (2 * detail**2))
    field = np.fft.ifft2(np.fft.fft2(rng.normal(size=(size, size))) * low_pass).real
    return field / field.std()


@pytest.mark.parametrize("shape", [(1, 1), (7, 5), (64, 64), (130, 67), (200, 1500), (30_000, 1), (1, 30_000)])
def test_equal_errors_are_normal_quantiles(shape):
    s = make_statistics(100, np.full(shape, 2.0), 4.0)  # se / mean = 0.1
    assert stated_error(s, QUANTILES) == pytest.approx(0.1 * HALF_NORMAL, rel=1e-3)


def test_a_mixture_of_two_errors():
    variance = np.ones((128, 128))
    variance[:64] = 9.0
    stated = stated_error(make_statistics(100, np.ones((128, 128)), variance), (0.5, 0.9, 0.99))
    # Half of P(|Z| <= e / 0.1) and half of P(|Z| <= e / 0.3), solved with a root finder.
    assert stated == pytest.approx([0.10785457, 0.38456824, 0.69790436], rel=1e-3)


def test_noiseless_pixels_count_as_zero():
    variance = np.ones((128, 128))
    variance[:64] = 0.0
    stated = stated_error(make_statistics(100, np.ones((128, 128)), variance), (0.4, 0.5, 0.95))
    assert stated[:2].tolist() == [0.0, 0.0]
    assert stated[2] == pytest.approx(0.1 * 1.64485363, rel=1e-3)  # 2 (q - 1/2) = 0.9 of the noisy half


@pytest.mark.parametrize("value", [0.0, 3.0])
def test_a_constant_image_has_no_error(value):
    assert stated_error(make_statistics(16, np.full((9, 9), value), 0.0), QUANTILES).tolist() == [0.0] * 3


def test_pixels_of_fewer_than_two_samples_have_an_infinite_error():
    ones = np.ones((10, 10))
    for count in (0, 1):
        assert np.isposinf(stated_error(make_statistics(count, ones, 0.0), (0.01, 0.5, 0.99))).all()
    count = np.full((10, 10), 16)
    count[0, :2] = [0, 1]
    stated = stated_error(make_statistics(count, ones, np.where(count > 1, 1.0, 0.0)), (0.5, 0.97, 0.98, 0.99))
    assert stated[0] == pytest.approx(0.25 * 0.69063345, rel=1e-3)  # |Z| at 0.5 / 0.98
    assert np.isfinite(stated[1])
    assert np.isposinf(stated[2:]).all()


def test_noise_around_black_has_an_infinite_error():
    assert np.isposinf(stated_error(make_statistics(16, np.zeros((8, 8)), 1.0), QUANTILES)).all()
    assert stated_error(make_statistics(16, np.zeros((8, 8)), 1.0), QUANTILES, floor=1.0) == pytest.approx(
        0.25 * HALF_NORMAL, rel=1e-3
    )


@pytest.mark.parametrize("q", [0.0, 1.0, -0.1, np.nan])
def test_quantiles_out_of_range(q):
    with pytest.raises(ValueError, match="quantiles"):
        stated_error(make_statistics(16, np.ones((4, 4)), 1.0), (0.5, q))


def test_scaling_the_light_changes_nothing():
    x = np.random.default_rng(1).gamma(0.4, size=(8, 100, 90))
    stated = stated_error(statistics_of_samples(x), QUANTILES)
    for power in (-20, 1, 20):
        assert (stated_error(statistics_of_samples(np.ldexp(x, power)), QUANTILES) == stated).all()
    assert stated_error(statistics_of_samples(x * 0.3), QUANTILES) == pytest.approx(stated, rel=1e-6)


def test_strips_do_not_change_the_result():
    """3 x 256 rows of 1024 pixels are processed in several strips, an image of a quarter of the width in one."""
    x = np.random.default_rng(2).exponential(size=(4, 256, 256))
    s = statistics_of_samples(x)
    tiled = make_statistics(4, np.tile(s.mean, (3, 4)), np.tile(s.variance, (3, 4)))
    assert stated_error(tiled, QUANTILES) == pytest.approx(stated_error(s, QUANTILES), rel=1e-9)


@pytest.mark.parametrize("n", [4, 8, 16, 64])
@pytest.mark.parametrize("sigma", [0.02, 0.5])
def test_equal_normal_noise(n, sigma):
    """A few degrees of freedom would widen the tail: unshrunk, p99 is 19 % high at n = 4 (48 % for sigma 0.5)."""
    rng = np.random.default_rng(n)
    s = statistics_of_samples(1 + sigma * rng.normal(size=(n, 256, 256)))
    expected = sigma / np.sqrt(n) * HALF_NORMAL
    assert stated_error(s, QUANTILES) == pytest.approx(expected, rel=0.05)
    assert stated_error(s, QUANTILES) == pytest.approx(true_quantiles(s, np.ones(s.shape)), rel=0.06)


@pytest.mark.parametrize("n", [4, 16])
@pytest.mark.parametrize("spread", [0.3, 0.7])
def test_smoothly_varying_noise(n, spread):
    rng = np.random.default_rng(10 + n)
    r = np.exp(0.5 * smooth_field(rng, 256, 6))
    sigma = 0.05 * np.exp(spread * smooth_field(rng, 256, 8))
    s = statistics_of_samples(r * (1 + sigma * rng.normal(size=(n, 256, 256))))
    assert stated_error(s, QUANTILES) == pytest.approx(true_quantiles(s, r), rel=0.05)


@pytest.mark.parametrize("n", [4, 16])
def test_noise_that_varies_from_pixel_to_pixel(n):
    rng = np.random.default_rng(20 + n)
    sigma = 0.05 * np.exp(0.3 * rng.normal(size=(256, 256)))
    s = statistics_of_samples(1 + sigma * rng.normal(size=(n, 256, 256)))
    assert stated_error(s, QUANTILES) == pytest.approx(true_quantiles(s, np.ones(s.shape)), rel=0.06)


@pytest.mark.parametrize("n", [8, 16, 64])
@pytest.mark.parametrize("shape", [1.0, 0.5])
def test_skewed_samples(n, shape):
    """Gamma samples (exponential for shape 1). Skewness makes |x - r| itself not normal: 12 % at n = 8."""
    x = np.random.default_rng(30 + n).gamma(shape, size=(n, 256, 256)) / shape
    s = statistics_of_samples(x)
    assert stated_error(s, QUANTILES) == pytest.approx(true_quantiles(s, np.ones(s.shape)), rel=0.12)
    assert stated_error(s, QUANTILES) == pytest.approx((n * shape) ** -0.5 * HALF_NORMAL, rel=0.08)


@pytest.mark.parametrize("n", [16, 64])
def test_fireflies_raise_the_error_of_pixels_without_one(n):
    """One sample in 50 has all the light. 28 % of the pixels of 16 samples have one, the others look noiseless.
    Unshrunk, the median error is 0 (n = 16) or half of the true one (n = 64)."""
    x = np.where(np.random.default_rng(40 + n).random((n, 256, 256)) < 0.02, 50.0, 0.0)
    stated = stated_error(statistics_of_samples(x), QUANTILES)
    assert stated == pytest.approx(np.sqrt(49 / n) * HALF_NORMAL, rel=0.2)


def test_a_noiseless_background_beside_noise():
    rng = np.random.default_rng(50)
    sigma, r = np.full((256, 256), 0.3), np.ones((256, 256))
    sigma[:, :100], r[:, :100] = 0.0, 0.5
    s = statistics_of_samples(r * (1 + sigma * rng.normal(size=(8, 256, 256))))
    stated = stated_error(s, (0.3, *QUANTILES[1:]))
    assert stated[0] == 0
    assert stated[1:] == pytest.approx(true_quantiles(s, r)[1:], rel=0.05)


@pytest.mark.parametrize("shape", [(128, 128), (127, 131), (3, 97), (101, 2), (1, 64), (256, 33)])
@pytest.mark.parametrize("edge", [0, 1, 5, 8])
@pytest.mark.parametrize("n", [16, 64])
def test_a_bright_lamp_in_a_dark_room(shape, edge, n):
    """Relative noise of 0.5 to 1, and a noiseless lamp 200 times as bright that covers 90 % of the pixels at its edge.

    No error may be far above the true ones, wherever the edge lies in the groups of 2x2 to 16x16 pixels.
    """
    rng = np.random.default_rng(55)
    y, x = np.indices(shape)
    lamp = (y % 32 >= 10 + edge) & (y % 32 < 16 + edge) & (x % 48 >= 16 - edge) & (x % 48 < 32)
    border = lamp & ((y % 32 == 10 + edge) | (x % 48 == 16 - edge))
    hits = rng.random((n, *shape)) < np.where(border, 0.9, lamp)
    gamma = rng.gamma(1.5, 1 / 1.5, size=(n, *shape))
    s = statistics_of_samples(np.where(hits, 20.0, 0.1 * gamma))
    p = np.where(border, 0.9, lamp)
    r = 20 * p + 0.1 * (1 - p)
    sigma = np.sqrt(p * 400 + (1 - p) * 0.01 * (1 + 1 / 1.5) - r * r) / r / np.sqrt(n)
    z = rng.normal(size=(200, *shape))
    expected = np.quantile(np.abs(z) * sigma, QUANTILES)
    stated = stated_error(s, QUANTILES)
    assert stated == pytest.approx(expected, rel=0.15 if s.count.size > 4000 else 0.35)
    largest = np.sqrt(relative_errors(s, slice(None), image_floor(s.mean))[0].max())
    assert largest < 6 * sigma.max()


def test_extreme_brightness_stays_finite():
    rng = np.random.default_rng(56)
    x = rng.exponential(size=(4, 70, 70)) * 10.0 ** rng.uniform(-30, 30, size=(70, 70))
    s = statistics_of_samples(x)
    for count in (4, 2**32 - 1):
        s = replace(s, count=np.full(s.shape, count, np.uint32))
        with np.errstate(all="raise", under="ignore"):
            stated = stated_error(s, QUANTILES)
            half_width = half_width_95(s)
        assert np.isfinite(stated).all()
        assert np.isfinite(half_width).all()


def test_varying_counts():
    rng = np.random.default_rng(60)
    sigma = 0.1 * np.exp(0.5 * smooth_field(rng, 256, 8))
    x = 1 + sigma * rng.normal(size=(64, 256, 256))
    for count in (rng.choice([4, 8, 16, 32, 64], size=sigma.shape), np.clip(1600 * sigma**2, 4, 64).astype(int)):
        s = of_counts(x, count)
        assert stated_error(s, QUANTILES) == pytest.approx(true_quantiles(s, np.ones(s.shape)), rel=0.05)


@pytest.mark.parametrize("d", [0.1, 1.7])
def test_the_design_effect_scales_the_error(d):
    """Normal means of the variance d s^2 / n: every error is sqrt(d) times that of independent samples."""
    rng = np.random.default_rng(90)
    mean = 1 + 0.1 * np.sqrt(d / 16) * rng.normal(size=(130, 197))
    variance = 0.01 * rng.chisquare(15, size=mean.shape) / 15
    s = make_statistics(16, mean, variance, design_effect=np.full(mean.shape, d))
    assert stated_error(s, QUANTILES) == pytest.approx(0.025 * np.sqrt(d) * HALF_NORMAL, rel=0.05)
    covered = np.mean(np.abs(mean - 1) <= half_width_95(s))
    assert abs(covered - 0.95) < 4.5 * np.sqrt(0.95 * 0.05 / mean.size)  # false alarms: 7e-6
    independent = replace(s, design_effect=None)
    assert relative_standard_error(s, 0.1) == pytest.approx(np.sqrt(d) * relative_standard_error(independent, 0.1))


def test_relative_standard_error_is_plain():
    s = make_statistics([[16, 16, 16, 1, 0]], [[2.0, 0.01, 0.0, 1.0, 0.0]], [[4.0, 4.0, 0.0, 0.0, 0.0]])
    layer = relative_standard_error(s, 0.1)
    assert layer.dtype == np.float32
    assert layer[0].tolist() == [0.25, 5.0, 0.0, np.inf, np.inf]
    assert relative_standard_error(s, 0.0)[0, 2] == 0.0


def test_half_width_of_equal_variances():
    """1.96 standard errors; the variance is the same everywhere, so that pooling it changes nothing."""
    count = np.array([[2, 3, 5, 16, 10001, 2**32 - 1]])
    half_width = half_width_95(make_statistics(count, np.ones(count.shape), 9.0))
    assert half_width == pytest.approx(1.959964 * 3 / np.sqrt(count), rel=1e-5)
    black = make_statistics(16, np.zeros((3, 3)), 0.0)
    assert (half_width_95(black) == 0).all()
    assert np.isposinf(half_width_95(make_statistics([[0, 1]], [[0.0, 1.0]], 0.0))).all()


@pytest.mark.parametrize("n", [16, 64])
def test_half_widths_know_the_neighbours_outliers(n):
    """One sample in 100 has all the light: intervals of the pixel's own variance cover 15 % (n = 16) or 47 %."""
    x = np.where(np.random.default_rng(75 + n).random((n, 256, 256)) < 0.01, 100.0, 0.0)
    s = statistics_of_samples(x)
    own = np.sqrt(s.variance_of_mean()) * 1.96
    assert np.mean(np.abs(s.mean - 1) <= own) < 0.5
    assert np.mean(np.abs(s.mean - 1) <= half_width_95(s)) > 0.9


@pytest.mark.parametrize("n", [16, 64])
@pytest.mark.parametrize("edge", [34, 35, 36, 38])
def test_black_pixels_beside_an_edge_have_no_error(n, edge):
    """Black rows, one row in which a sample in ten sees an object, and the object, whose samples are exponential.

    If black pixels counted as unlucky ones, p99 would be up to 2.2 times too high (edge = 36, n = 64).
    """
    rng = np.random.default_rng(77)
    truth = np.zeros((64, 96))
    truth[edge:], truth[edge - 1] = 1.0, 0.1
    x = truth * rng.exponential(size=(n, *truth.shape))
    x[:, edge - 1] = np.where(rng.random((n, 96)) < 0.1, rng.exponential(size=(n, 96)), 0)
    s = statistics_of_samples(x)
    stated = stated_error(s, (0.95, 0.99), floor=0.01)
    true = np.quantile(np.abs(s.mean - truth) / np.maximum(truth, 0.01), (0.95, 0.99))
    assert stated == pytest.approx(true, rel=0.05 if n == 64 else 0.25)


def test_half_widths_use_the_design_effect_of_the_neighbours():
    """Whether a pixel has seen an outlier decides about its own: here 0.1 or 1 at random, so all have 0.55."""
    design_effect = np.random.default_rng(76).choice([0.1, 1.0], size=(64, 64))
    half_width = half_width_95(make_statistics(10**6, np.ones((64, 64)), 4.0, design_effect=design_effect))
    assert half_width == pytest.approx(1.959964 * 2e-3 * np.sqrt(0.55), rel=0.15)  # 16x16 of them: 5 standard errors


@pytest.mark.parametrize("n", [2, 4, 16])
def test_half_width_covers_95_percent(n):
    """For n = 2 up to 0.5 % more: an estimate of a true share of 0 is above 0, which lowers the degrees of freedom."""
    s = statistics_of_samples(5 + np.random.default_rng(70 + n).normal(size=(n, 300, 300)))
    covered = np.mean(np.abs(s.mean - 5) <= half_width_95(s))
    sampling = 4.5 * np.sqrt(0.95 * 0.05 / 90_000)  # false alarms: 7e-6
    assert 0.95 - sampling < covered < 0.95 + sampling + (0.005 if n == 2 else 0)


def test_the_arrangement_of_counts_does_not_matter():
    """Two counts mixed at random, and one per half of the image, have the same stated error."""
    rng = np.random.default_rng(80)
    count = rng.choice([100, 400], size=(128, 128))
    stated = stated_error(make_statistics(count, np.ones(count.shape), 1.0), (0.5, 0.99))
    half = make_statistics(np.where(np.arange(128) < 64, 100, 400)[None].repeat(128, 0), np.ones(count.shape), 1.0)
    assert stated == pytest.approx(stated_error(half, (0.5, 0.99)), rel=0.01)
