"""The reduce stage against float64: made samples go in, statistics come out.

Tolerances: a mean of x carries 48 bits over full blocks of 16, within which plain float32 sums of differences from the
running mean round by at most 16 * 2^-24 of their size; so 2e-6 of the samples' spread, plus the 2^-24 of an RGB image
in float32.
"""

from itertools import pairwise

import numpy as np
import pytest

from isonoise.device.opencl import Device
from isonoise.device.program import stage_source
from isonoise.integrator.accumulator import BLOCK, CHUNK, Accumulator

SLICE = 2**22


class Reducer:
    """One reduce stage over pixels in a row, fed with samples as the wavefront would."""

    def __init__(self, pixels: int):
        self.device = Device()
        self.accumulator = Accumulator(self.device, (1, pixels), with_median=True)
        source, options = stage_source("reduce.cl", {}, {"BLOCK": BLOCK, "CHUNK": CHUNK}, {"MEDIAN": True})
        self.kernel = self.device.build(source, options)["reduce"]
        self.offsets = self.device.buffer(4 * pixels, "offsets")

    def feed(self, samples: list[np.ndarray]) -> None:
        """One slice; samples of each pixel, (n,) grey or (n, 3)."""
        rgb = [np.repeat(s[:, None], 3, axis=1) if s.ndim == 1 else s for s in samples]
        flat = np.concatenate(rgb).astype(np.float32)
        ends = np.cumsum([len(s) for s in samples])
        self.device.write(self.offsets, (ends - [len(s) for s in samples]).astype(np.uint32))
        buffer = self.device.buffer(flat, "samples")
        a, u = self.accumulator, np.uint32
        self.device.launch(
            self.kernel,
            len(samples),
            (
                *(buffer, u(0), u(len(samples)), u(len(flat)), self.offsets, u(len(samples))),
                *(a.count, a.rejected, a.sums, a.block_sums, a.medians),
            ),
        )
        self.device.finish()
        buffer.release()

    def statistics(self):
        return self.accumulator.statistics()


def reduce(samples: list[np.ndarray], cuts=()):
    """Statistics of the pixels' samples, brought in slices that end at the given fractions."""
    reducer = Reducer(len(samples))
    edges = [0.0, *cuts, 1.0]
    for a, b in pairwise(edges):
        reducer.feed([s[int(a * len(s)) : int(b * len(s))] for s in samples])
    return reducer.statistics()


def luminance32(samples: np.ndarray) -> np.ndarray:
    """x as the kernel computes it: float32, left to right."""
    v = samples.astype(np.float32)
    r, g, b = (v, v, v) if v.ndim == 1 else v.T
    f = np.float32
    return (r * f(0.2126) + g * f(0.7152) + b * f(0.0722)).astype(np.float64)


def chunk_medians(x: np.ndarray) -> float:
    if len(x) < CHUNK:
        return float(np.median(x))
    return float(np.median(x[: len(x) // CHUNK * CHUNK].reshape(-1, CHUNK), axis=1).mean())


def check(statistics, samples, mean_of_spread=2e-6, relative=2e-7, variance=2e-5):
    for place, s in enumerate(samples):
        x = luminance32(s)
        assert statistics.count[0, place] == len(x)
        spread = x.std() if len(x) else 0.0
        expected = x.mean() if len(x) else 0.0
        assert statistics.mean[0, place] == pytest.approx(expected, abs=mean_of_spread * spread, rel=relative)
        if len(x) > 1:
            assert statistics.variance[0, place] == pytest.approx(x.var(ddof=1), rel=variance, abs=1e-37)
        if len(x):
            assert statistics.median[0, place] == pytest.approx(chunk_medians(x), rel=1e-6)
            rgb = s if s.ndim == 2 else np.repeat(s[:, None], 3, axis=1)
            expected_rgb = rgb.astype(np.float32).astype(np.float64).mean(axis=0)
            assert statistics.rgb[0, place] == pytest.approx(expected_rgb, rel=2e-6, abs=1e-6 * abs(rgb).mean())


def test_ordinary_samples_in_colour():
    random = np.random.default_rng(1)
    samples = [random.exponential(size=(n, 3)) for n in (1, 2, 3, 4, 5, 6, 15, 16, 17, 31, 32, 33, 1000)]
    check(reduce(samples), samples)


def test_small_noise_on_a_large_mean():
    # float32 has a step of 1/16 at 1e6: sigma 1e-2 survives only in the samples that round to a neighbour
    random = np.random.default_rng(2)
    samples = [1e6 + 1e-2 * random.standard_normal(100_000), 1e6 + random.standard_normal(100_000)]
    statistics = reduce(samples)
    for place, s in enumerate(samples):
        x = luminance32(s)
        assert statistics.mean[0, place] == pytest.approx(x.mean(), rel=1e-9)
        assert statistics.variance[0, place] == pytest.approx(x.var(ddof=1), rel=1e-3)


def test_values_over_thirty_decades():
    random = np.random.default_rng(3)
    samples = [10 ** random.uniform(-15, 15, n) for n in (10, 1000, 100_000)]
    check(reduce(samples), samples)


@pytest.mark.parametrize("alpha", [1.1, 1.5, 2.5])
def test_pareto_tails(alpha):
    random = np.random.default_rng(int(10 * alpha))
    samples = [1 + random.pareto(alpha, n) for n in (100, 10_000, 100_000)]
    check(reduce(samples), samples)


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
    for plane in (statistics.mean, statistics.variance, statistics.median, statistics.rgb):
        assert np.isfinite(plane).all()
    assert statistics.mean[0, 0] == 0


def test_samples_that_are_not_finite_are_counted_apart():
    random = np.random.default_rng(5)
    good = random.exponential(size=(997, 3))
    good[::9] *= -1  # negative ones are numbers like any other
    bad = np.array([[np.nan, 1, 1], [1, np.inf, 1], [1, 1, -np.inf], [1e38, 1e38, 1e38], [np.nan] * 3])
    mixed = np.insert(good, [0, 3, 500, 996, 997], bad, axis=0)
    statistics, expected = reduce([mixed, bad]), reduce([good, np.zeros((0, 3))])
    assert statistics.rejected.tolist() == [[5, 5]]
    for name in ("count", "mean", "variance", "median", "rgb"):
        assert np.array_equal(getattr(statistics, name), getattr(expected, name)), name
    check(statistics, [good, np.zeros((0, 3))])


def test_any_cut_into_slices_gives_the_same_bits():
    random = np.random.default_rng(6)
    samples = [random.pareto(1.5, size=(n, 3)) for n in (1, 4, 17, 100, 1234, 5000)]
    whole = reduce(samples)
    for cuts in [(0.5,), (0.01, 0.02, 0.3, 0.77), np.linspace(0, 1, 101)[1:-1]]:
        cut = reduce(samples, cuts)
        for name in ("count", "mean", "variance", "median", "rgb"):
            assert np.array_equal(getattr(whole, name), getattr(cut, name)), name


def test_scaling_by_a_power_of_two_scales_the_statistics_exactly():
    random = np.random.default_rng(7)
    samples = [random.pareto(2.5, size=(n, 3)).astype(np.float32) for n in (3, 100, 5000)]
    plain, scaled = reduce(samples), reduce([s * 2.0**20 for s in samples])
    assert np.array_equal(plain.mean * 2.0**20, scaled.mean)
    assert np.array_equal(plain.variance * 2.0**40, scaled.variance)
    assert np.array_equal(plain.median * 2.0**20, scaled.median)


@pytest.mark.long
def test_a_hundred_million_samples():
    """A constant 0.5 and a mix, where plain float32 sums go wrong from 10^7 on; 10^8 samples each."""
    reducer = Reducer(2)
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
    assert statistics.median[0, 1] == pytest.approx(chunk_medians(x), rel=1e-4)  # the period of 7 meets the slice's end
