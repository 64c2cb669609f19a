"""The design effect of kernels/stages/design_effect.cl: of independent samples, and of samples with a known error."""

import numpy as np
import pytest

from isonoise.device.opencl import Device
from isonoise.selftest.sampler import SobolNumbers
from isonoise.selftest.synthetic_samples import Reducer
from isonoise.statistics import Needs, Statistics

WIDTH = 64
PIXELS = WIDTH * WIDTH


@pytest.fixture(scope="module")
def device() -> Device:
    return Device()


def reduce(device: Device, samples: np.ndarray) -> Statistics:
    """Statistics of a square image, or of one row if the pixels are fewer; samples (pixels, n)."""
    reducer = Reducer(device, len(samples), Needs(nets=True), WIDTH if len(samples) == PIXELS else None)
    reducer.add(list(samples))
    return reducer.statistics()


def integrand(name: str, u: np.ndarray) -> np.ndarray:
    """A function over the unit square, with a noise that no pair of numbers can stratify."""
    x, y = u[..., 0], u[..., 1]
    values = {"smooth": x * y, "edge": (x + 0.37 * y > 0.6) * 1.0, "steep": 1 / (0.05 + x * y)}
    return 1.0 + values[name]


@pytest.mark.parametrize("n", [8, 20, 64, 100])
def test_of_independent_samples_it_is_one(device, n):
    samples = np.random.default_rng(n).gamma(2.0, size=(PIXELS, n))
    assert reduce(device, samples).design_effect.mean() == pytest.approx(1, abs=0.06)


@pytest.mark.parametrize("n", [16, 24, 64, 100, 256])
@pytest.mark.parametrize("name", ["edge", "steep"])
@pytest.mark.parametrize("noise", [0.3, 1.0])
def test_it_predicts_the_error_of_the_mean(device, name, n, noise):
    """The variance of the mean over the pixels, for which the design effect is pooled. It is extrapolated: good to 0.7
    to 1.2 at edges, and too large by up to 2.8 (1.7 for a standard error) where the error falls by 1 / n^2."""
    u = SobolNumbers(device)(np.arange(PIXELS)[:, None], np.arange(n), 2)
    samples = integrand(name, u) + noise * np.random.default_rng(n).gamma(1.0, size=(PIXELS, n))
    statistics = reduce(device, samples)
    true = samples.mean(axis=1).var()
    independent = float((statistics.variance / n).mean())
    low, high = {"edge": (0.7, 1.2), "steep": (0.8, 2.8)}[name]
    assert low < float(statistics.variance_of_mean().mean()) / true < high
    assert true < independent


def test_few_samples_and_none(device):
    for n in (1, 2, 7):
        assert (reduce(device, np.random.default_rng(n).random((20, n))).design_effect == 1).all()
    equal = reduce(device, np.full((20, 100), 0.7))
    assert (equal.design_effect == 1).all()
    assert (equal.variance_of_mean() == 0).all()


def test_a_rare_bright_sample_does_not_count_as_well_distributed(device):
    """One pixel in 20 has a sample that is 1000 times brighter than all others: its own error is that of independent
    samples, and those of the others stay small."""
    u = SobolNumbers(device)(np.arange(PIXELS)[:, None], np.arange(64), 2)
    samples = integrand("smooth", u)
    samples[::20, 37] += 1000.0
    effect = reduce(device, samples).design_effect.ravel()
    bright = np.arange(PIXELS) % 20 == 0
    assert effect[bright].mean() > 0.8
    assert effect[~bright].mean() < 0.2


def test_the_scale_does_not_matter(device):
    samples = np.random.default_rng(3).gamma(1.0, size=(500, 40))
    expected = reduce(device, samples).design_effect
    for scale in (2.0**-20, 2.0**20):
        assert (reduce(device, scale * samples).design_effect == expected).all()
