"""The statistics of the device against float64: made samples go in, statistics come out.

Tolerances: a mean of x carries 48 bits over full blocks of 16, within which plain float32 sums of differences from the
running mean round by at most 16 * 2^-24 of their size; so 2e-6 of the samples' spread, plus the 2^-24 of an RGB image
in float32. OpenCL allows powr 16 ulp, 2e-6, and log 3.
"""

from itertools import pairwise

import numpy as np
import pytest

from isonoise.device.opencl import Device
from isonoise.errors import UserError
from isonoise.integrator.accumulator import STRIP
from isonoise.selftest.synthetic_samples import Reducer, chunk_medians, colour, luminance32
from isonoise.statistics import BASIC_NEEDS, Needs, Statistics

SLICE = 2**22
ALL = Needs(median=True, power=1.3, half=True)
VARIANTS = [
    pytest.param(ALL, id="all"),
    pytest.param(Needs(median=True, chunk=1, power=1), id="chunk 1, entropy"),
    pytest.param(Needs(median=True, chunk=3, batch=7, power=0.5), id="3 of 7, root"),
    pytest.param(Needs(median=True, chunk=31, batch=2, power=2), id="31 of 2, square"),
]


def reduce(samples: list[np.ndarray], cuts=(), needs: Needs = ALL, scale: float = 1.0) -> Statistics:
    """Statistics of the pixels' samples, brought in slices that end at the given fractions."""
    reducer = Reducer(Device(), len(samples), needs)
    edges = [0.0, *cuts, 1.0]
    for a, b in pairwise(edges):
        reducer.feed([s[int(a * len(s)) : int(b * len(s))] for s in samples])
    return reducer.statistics(scale)


def powers(x: np.ndarray, q: float) -> np.ndarray:
    """max(x, 0)^q, for q = 1 of x ln x."""
    x = np.maximum(x, 0)
    return x * np.log(np.where(x > 0, x, 1)) if q == 1 else x ** float(np.float32(q))


def check(statistics, samples, needs=ALL, scale=1.0):
    """Every statistic of every pixel against float64; the device had `scale` times the samples."""
    for place, s in enumerate(samples):
        x, rgb = luminance32(s), colour(s).astype(np.float64)
        assert statistics.count[0, place] == len(x)
        spread = x.std() if len(x) else 0.0
        expected = x.mean() if len(x) else 0.0
        assert statistics.mean[0, place] == pytest.approx(expected, abs=2e-6 * spread, rel=2e-7)
        if len(x) > 1:
            assert statistics.variance[0, place] == pytest.approx(x.var(ddof=1), rel=2e-5, abs=1e-37)
        if len(x):
            assert statistics.median[0, place] == pytest.approx(chunk_medians(x, needs), rel=1e-6)
            size = 1e-6 * abs(rgb).mean()
            assert statistics.rgb[0, place] == pytest.approx(rgb.mean(axis=0), rel=2e-6, abs=size)
            raised = powers(x, needs.power)
            # x ln x passes zero where the rounding of the device's x ln(scale x) does not
            size = 2e-6 * abs(raised).mean() + 2e-7 * (1 + abs(np.log(scale))) * x.clip(0).mean()
            assert statistics.power[0, place] == pytest.approx(raised.mean(), rel=2e-6, abs=size)
        if needs.half:
            half = rgb[1::2].mean(axis=0) if len(x) > 1 else np.zeros(3)
            assert statistics.half[0, place] == pytest.approx(half, rel=2e-7, abs=1e-7 * abs(rgb[1::2]).max(initial=0))


def assert_same_bits(a: Statistics, b: Statistics, names=tuple(Statistics.__dataclass_fields__)) -> None:
    for name in names:
        plane, other = getattr(a, name), getattr(b, name)
        assert (plane is None) == (other is None), name
        assert plane is None or np.array_equal(plane, other), name


@pytest.mark.parametrize("needs", VARIANTS)
def test_ordinary_samples_in_colour(needs):
    random = np.random.default_rng(1)
    counts = (1, 2, 3, 4, 5, 6, 7, 8, 13, 14, 15, 16, 17, 20, 21, 31, 32, 33, 61, 62, 63, 1000)
    samples = [random.exponential(size=(n, 3)) for n in counts]
    check(reduce(samples, needs=needs), samples, needs)


def test_small_noise_on_a_large_mean():
    # float32 has a step of 1/16 at 1e6: sigma 1e-2 survives only in the samples that round to a neighbour
    random = np.random.default_rng(2)
    samples = [1e6 + 1e-2 * random.standard_normal(100_000), 1e6 + random.standard_normal(100_000)]
    statistics = reduce(samples)
    for place, s in enumerate(samples):
        x = luminance32(s)
        assert statistics.mean[0, place] == pytest.approx(x.mean(), rel=1e-9)
        assert statistics.variance[0, place] == pytest.approx(x.var(ddof=1), rel=1e-3)


@pytest.mark.parametrize("needs", VARIANTS)
def test_values_over_thirty_decades(needs):
    random = np.random.default_rng(3)
    samples = [10 ** random.uniform(-15, 15, n) for n in (10, 1000, 100_000)]
    check(reduce(samples, needs=needs), samples, needs)


@pytest.mark.parametrize("alpha", [1.1, 1.5, 2.5])
def test_pareto_tails(alpha):
    random = np.random.default_rng(int(10 * alpha))
    samples = [1 + random.pareto(alpha, n) for n in (100, 10_000, 100_000)]
    for needs in (ALL, Needs(median=True, chunk=7, batch=1000, power=1.0, half=True)):
        check(reduce(samples, needs=needs), samples, needs)


@pytest.mark.parametrize("value", [0.0, 1.0, 0.1, 1e-30, 1e15])
def test_equal_samples_have_no_variance(value):
    samples = [np.full(n, value) for n in (1, 2, 5, 16, 17, 10_000)]
    statistics = reduce(samples)
    assert (statistics.variance == 0).all()
    x = luminance32(samples[0])[0]
    assert statistics.mean == pytest.approx(x, rel=1e-7)
    assert statistics.median == pytest.approx(x, rel=1e-7)


def test_one_sample_with_all_the_energy():
    samples = []
    for place in (0, 7, 16, 999):
        s = np.full(1000, 1e-3)
        s[place] = 1e9
        samples.append(s)
    statistics = reduce(samples)
    check(statistics, samples)
    assert statistics.median == pytest.approx(1e-3, rel=1e-6)


def test_without_samples():
    statistics = reduce([np.zeros(0), np.ones(3), np.zeros(0)])
    assert statistics.count.tolist() == [[0, 3, 0]]
    for name, plane in vars(statistics).items():
        assert (plane[0, [0, 2]] == 0).all(), name
        assert np.isfinite(plane).all(), name


def test_samples_that_are_no_radiance_are_counted_apart():
    random = np.random.default_rng(5)
    good = random.exponential(size=(997, 3))
    bad = np.array([[np.nan, 1, 1], [1, np.inf, 1], [1, 1, -np.inf], [1e38, 1e38, 1e38], [np.nan] * 3, [1, -1e-3, 1]])
    mixed = np.insert(good, [0, 3, 500, 996, 997, 997], bad, axis=0)
    statistics, expected = reduce([mixed, bad]), reduce([good, np.zeros((0, 3))])
    assert statistics.rejected.tolist() == [[6, 6]]
    assert_same_bits(statistics, expected, set(vars(statistics)) - {"rejected"})
    check(statistics, [good, np.zeros((0, 3))])


@pytest.mark.parametrize("needs", VARIANTS)
def test_any_cut_into_slices_gives_the_same_bits(needs):
    random = np.random.default_rng(6)
    samples = [random.pareto(1.5, size=(n, 3)) for n in (1, 4, 17, 100, 1234, 5000)]
    whole = reduce(samples, needs=needs)
    for cuts in [(0.5,), (0.01, 0.02, 0.3, 0.77), np.linspace(0, 1, 101)[1:-1]]:
        assert_same_bits(whole, reduce(samples, cuts, needs))


def test_what_is_kept_beside_them_changes_no_bit_of_the_others():
    random = np.random.default_rng(8)
    samples = [random.pareto(1.5, size=(n, 3)) for n in (1, 4, 17, 100, 1234)]
    feature_superset = reduce(samples)
    for needs in (BASIC_NEEDS, Needs(median=True), Needs(power=ALL.power), Needs(half=True)):
        statistics = reduce(samples, needs=needs)
        kept = {name for name, plane in vars(statistics).items() if plane is not None}
        optional = {"median": needs.median, "power": needs.power is not None, "half": needs.half}
        assert kept == {"count", "rejected", "rgb", "mean", "variance"} | {name for name in optional if optional[name]}
        assert_same_bits(statistics, feature_superset, kept)


def test_scaling_by_a_power_of_two_scales_the_statistics_exactly():
    random = np.random.default_rng(7)
    samples = [random.pareto(2.5, size=(n, 3)).astype(np.float32) for n in (3, 100, 5000)]
    plain, scaled = reduce(samples), reduce([s * 2.0**20 for s in samples])
    assert np.array_equal(plain.mean * 2.0**20, scaled.mean)
    assert np.array_equal(plain.variance * 2.0**40, scaled.variance)
    for name in ("median", "rgb", "half"):
        assert np.array_equal(getattr(plain, name) * 2.0**20, getattr(scaled, name)), name


@pytest.mark.parametrize("scale", [2.0**-40, 0.5, 1.0, 8.0, 2.0**40])
@pytest.mark.parametrize("needs", VARIANTS)
def test_statistics_in_the_units_of_the_scene(needs, scale):
    """Samples on the device are `scale` times the scene's."""
    random = np.random.default_rng(9)
    samples = [random.pareto(2.5, size=(n, 3)).astype(np.float32) for n in (1, 3, 100, 5000)]
    check(reduce([s * np.float32(scale) for s in samples], needs=needs, scale=scale), samples, needs, scale)


@pytest.mark.filterwarnings("ignore:overflow")  # the RGB image is float32 in any units
@pytest.mark.parametrize("power", [1.0, 2.0, 3.0, 40.0])
@pytest.mark.parametrize("scale", [2.0**-900, 1.0, 2.0**900])
def test_powers_do_not_overflow(power, scale):
    """Up to the largest luminance that enters, 2^62, and in any scene's units."""
    samples = [np.full(40, 2.0**61), np.full(3, 2.0**-120), np.zeros(3)]
    power_mean = reduce(samples, needs=Needs(power=power), scale=scale).power[0]
    assert np.isfinite(power_mean).all()
    assert power_mean[2] == 0
    if scale <= 1:
        assert power_mean[0] > 1e19


def test_images_larger_than_a_strip():
    """Pixels on both sides of the seams, and of the last, narrower strip."""
    reducer = Reducer(Device(), 2 * STRIP + 1000, ALL)
    pixels = reducer.accumulator.pixels
    for k in range(3):
        reducer.feed(list(np.arange(pixels, dtype=np.float32)[:, None] + k))
    statistics = reducer.statistics()
    x = luminance32(np.arange(pixels)) + luminance32(np.arange(pixels) + 1) + luminance32(np.arange(pixels) + 2)
    assert statistics.mean[0] == pytest.approx(x / 3, rel=1e-6)
    assert statistics.median[0] == pytest.approx(x / 3, rel=1e-6)
    for channel in range(3):
        assert statistics.rgb[0, :, channel] == pytest.approx(np.arange(pixels) + 1, rel=1e-6)
        assert np.array_equal(statistics.half[0, :, channel], np.arange(pixels) + 1)


@pytest.mark.parametrize(
    "needs",
    [{"chunk": 4}, {"chunk": 33}, {"chunk": -1}, {"batch": 0}, {"batch": 1.5}, {"power": 0}, {"power": np.inf}],
)
def test_needs_out_of_range(needs):
    with pytest.raises(UserError, match=str(next(iter(needs.values())))):
        Needs(median=True, **needs)


@pytest.mark.long
def test_a_hundred_million_samples():
    """A constant 0.5 and a mix, where plain float32 sums go wrong from 10^7 on; 10^8 samples each."""
    reducer = Reducer(Device(), 2, ALL)
    mix = np.resize(np.array([0.1, 0.9, 0.3, 2.7, 0.0, 1e-3, 40.0], np.float32), SLICE // 2)
    constant = np.full(SLICE // 2, 0.5, np.float32)
    rounds = 48
    for _ in range(rounds):
        reducer.feed([constant, mix])
    statistics = reducer.statistics()
    n = rounds * len(mix)
    assert n > 1e8
    assert statistics.count.tolist() == [[n, n]]
    x = luminance32(mix)
    assert statistics.mean[0, 0] == luminance32(constant[:1])[0]
    assert statistics.variance[0, 0] == 0
    assert statistics.mean[0, 1] == pytest.approx(x.mean(), rel=1e-7)
    assert statistics.variance[0, 1] == pytest.approx(x.var() * n / (n - 1), rel=1e-6)
    assert statistics.rgb[0, 0] == pytest.approx(0.5, rel=1e-7)
    assert statistics.median[0, 1] == pytest.approx(
        chunk_medians(x, ALL), rel=1e-4
    )  # the period of 7 meets the slice's end
