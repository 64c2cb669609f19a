"""The kernels `reduce` and `summarise` against float64, for all statistics and several sizes of chunks.

The checks of `isonoise selftest` (tests/test_selftest.py) cover large means, 10^8 samples, equal and rejected samples.

Tolerances: a mean of x carries 48 bits over full blocks of 16, within which plain float32 sums of differences from the
running mean round by at most 16 * 2^-24 of their size; so 2e-6 of the samples' spread, plus the 2^-24 of an RGB image
in float32. OpenCL allows powr 16 ulp, 2e-6, and log 3.
"""

from itertools import pairwise

import numpy as np
import pytest

from isonoise.device.opencl import Device
from isonoise.errors import UserError
from isonoise.integrator import accumulator
from isonoise.selftest.synthetic_samples import Reducer, chunk_median_mean, luminance32, to_rgb32
from isonoise.statistics import BASIC_NEEDS, Needs, Statistics

ALL = Needs(median=True, power=1.3, half=True)
LONG_BATCHES = Needs(median=True, chunk=7, batch=1000, power=1.0, half=True)
VARIANTS = [
    pytest.param(ALL, id="all"),
    pytest.param(Needs(median=True, chunk=1, power=1), id="chunk 1, entropy"),
    pytest.param(Needs(median=True, chunk=3, batch=7, power=0.5), id="3 of 7, root"),
    pytest.param(Needs(median=True, chunk=31, batch=2, power=2), id="31 of 2, square"),
]


def reduce(samples: list[np.ndarray], cuts=(), needs: Needs = ALL, scale: float = 1.0) -> Statistics:
    """Returns the statistics of the pixels' samples, reduced in slices that end at the given fractions."""
    reducer = Reducer(Device(), len(samples), needs)
    edges = [0.0, *cuts, 1.0]
    for a, b in pairwise(edges):
        reducer.add([s[int(a * len(s)) : int(b * len(s))] for s in samples])
    return reducer.statistics(scale)


def powers(x: np.ndarray, q: float) -> np.ndarray:
    """max(x, 0)^q, for q = 1 of x ln x."""
    x = np.maximum(x, 0)
    return x * np.log(np.where(x > 0, x, 1)) if q == 1 else x ** float(np.float32(q))


def check(statistics, samples, needs=ALL, scale=1.0):
    """Compares every statistic of every pixel with float64. The device had `scale` times the samples."""
    for pixel, s in enumerate(samples):
        x, rgb = luminance32(s), to_rgb32(s).astype(np.float64)
        assert statistics.count[0, pixel] == len(x)
        spread = x.std() if len(x) else 0.0
        expected = x.mean() if len(x) else 0.0
        assert statistics.mean[0, pixel] == pytest.approx(expected, abs=2e-6 * spread, rel=2e-7)
        if len(x) > 1:
            assert statistics.variance[0, pixel] == pytest.approx(x.var(ddof=1), rel=2e-5, abs=1e-37)
        if len(x):
            assert statistics.median[0, pixel] == pytest.approx(chunk_median_mean(x, needs), rel=1e-6)
            size = 1e-6 * abs(rgb).mean()
            assert statistics.rgb[0, pixel] == pytest.approx(rgb.mean(axis=0), rel=2e-6, abs=size)
            raised = powers(x, needs.power)
            # x ln x passes zero where the rounding of the device's x ln(scale x) does not
            size = 2e-6 * abs(raised).mean() + 2e-7 * (1 + abs(np.log(scale))) * x.clip(0).mean()
            assert statistics.power[0, pixel] == pytest.approx(raised.mean(), rel=2e-6, abs=size)
        if needs.half:
            half = rgb[1::2].mean(axis=0) if len(x) > 1 else np.zeros(3)
            assert statistics.half[0, pixel] == pytest.approx(half, rel=2e-7, abs=1e-7 * abs(rgb[1::2]).max(initial=0))


def assert_same_bits(a: Statistics, b: Statistics, names=tuple(Statistics.__dataclass_fields__)) -> None:
    for name in names:
        plane, other = getattr(a, name), getattr(b, name)
        assert (plane is None) == (other is None), name
        assert plane is None or np.array_equal(plane, other), name


def colours() -> list[np.ndarray]:
    random = np.random.default_rng(1)
    counts = (1, 2, 3, 4, 5, 6, 7, 8, 13, 14, 15, 16, 17, 20, 21, 31, 32, 33, 61, 62, 63, 1000)
    return [random.exponential(size=(n, 3)) for n in counts]


def decades() -> list[np.ndarray]:
    random = np.random.default_rng(3)
    return [10 ** random.uniform(-15, 15, n) for n in (10, 1000, 100_000)]


def pareto() -> list[np.ndarray]:
    random = np.random.default_rng(11)
    return [1 + random.pareto(alpha, n) for alpha in (1.1, 1.5, 2.5) for n in (100, 10_000, 100_000)]


def one_bright_sample() -> list[np.ndarray]:
    return [np.where(np.arange(1000) == index, 1e9, 1e-3) for index in (0, 7, 16, 999)]


SAMPLES = [colours, decades, pareto, one_bright_sample]


@pytest.mark.parametrize("needs", [*VARIANTS, pytest.param(LONG_BATCHES, id="7 of 1000, entropy")])
@pytest.mark.parametrize("samples", SAMPLES, ids=[make.__name__ for make in SAMPLES])
def test_all_statistics(samples, needs):
    samples = samples()
    check(reduce(samples, needs=needs), samples, needs)


def test_one_bright_sample_does_not_change_the_median():
    statistics = reduce(one_bright_sample())
    assert statistics.median == pytest.approx(1e-3, rel=1e-6)


def test_small_noise_on_a_large_mean():
    # float32 has a step of 1/16 at 1e6
    samples = [1e6 + np.random.default_rng(2).standard_normal(100_000)]
    statistics, x = reduce(samples), luminance32(samples[0])
    assert statistics.mean[0, 0] == pytest.approx(x.mean(), rel=1e-9)
    assert statistics.variance[0, 0] == pytest.approx(x.var(ddof=1), rel=1e-3)


def test_without_samples():
    statistics = reduce([np.zeros(0), np.ones(3), np.zeros(0)])
    assert statistics.count.tolist() == [[0, 3, 0]]
    for name, plane in statistics.planes().items():
        assert (plane[0, [0, 2]] == 0).all(), name
        assert np.isfinite(plane).all(), name


@pytest.mark.parametrize("needs", VARIANTS)
def test_slices_change_no_bit(needs):
    random = np.random.default_rng(6)
    samples = [random.pareto(1.5, size=(n, 3)) for n in (1, 4, 17, 100, 1234, 5000)]
    whole = reduce(samples, needs=needs)
    for cuts in [(0.5,), (0.01, 0.02, 0.3, 0.77), np.linspace(0, 1, 101)[1:-1]]:
        assert_same_bits(whole, reduce(samples, cuts, needs))


def test_optional_statistics_change_no_bit_of_the_others():
    random = np.random.default_rng(8)
    samples = [random.pareto(1.5, size=(n, 3)) for n in (1, 4, 17, 100, 1234)]
    all_statistics = reduce(samples)
    for needs in (BASIC_NEEDS, Needs(median=True), Needs(power=ALL.power), Needs(half=True)):
        statistics = reduce(samples, needs=needs)
        present = set(statistics.planes())
        optional = {"median": needs.median, "power": needs.power is not None, "half": needs.half}
        assert present == {"count", "rejected", "rgb", "mean", "variance"} | {
            name for name in optional if optional[name]
        }
        assert_same_bits(statistics, all_statistics, present)


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
def test_statistics_are_in_units_of_the_scene(needs, scale):
    """The samples on the device are `scale` times the scene's radiance."""
    random = np.random.default_rng(9)
    samples = [random.pareto(2.5, size=(n, 3)).astype(np.float32) for n in (1, 3, 100, 5000)]
    check(reduce([s * np.float32(scale) for s in samples], needs=needs, scale=scale), samples, needs, scale)


@pytest.mark.filterwarnings("ignore:overflow")  # the RGB image is float32 in any units
@pytest.mark.parametrize("power", [1.0, 2.0, 3.0, 40.0])
@pytest.mark.parametrize("scale", [2.0**-900, 1.0, 2.0**900])
def test_powers_do_not_overflow(power, scale):
    """Up to the largest accepted luminance, 2^62, and in any units of radiance."""
    samples = [np.full(40, 2.0**61), np.full(3, 2.0**-120), np.zeros(3)]
    power_mean = reduce(samples, needs=Needs(power=power), scale=scale).power[0]
    assert np.isfinite(power_mean).all()
    assert power_mean[2] == 0
    if scale <= 1:
        assert power_mean[0] > 1e19


def test_images_larger_than_a_strip(monkeypatch):
    """Pixels on both sides of the borders of strips, and in the last, narrower strip."""
    monkeypatch.setattr(accumulator, "SUMMARY_STRIP_PIXELS", 1000)
    reducer = Reducer(Device(), 2 * accumulator.SUMMARY_STRIP_PIXELS + 100, ALL)
    pixels = reducer.accumulator.pixels
    for k in range(3):
        reducer.add(list(np.arange(pixels, dtype=np.float32)[:, None] + k))
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
