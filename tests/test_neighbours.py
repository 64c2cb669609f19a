"""Averages of the neighbours on the device, kernels/stages/neighbours.cl, against the same in numpy."""

import numpy as np
import pytest

from isonoise import Renderer
from isonoise.device.form import FORMS
from isonoise.device.opencl import Device
from isonoise.selftest.synthetic_samples import Reducer
from isonoise.statistics import Needs
from isonoise.strategies.measures import with_neighbours

ROUNDING = 2e-6
"""Sums of up to 31x31 floats, each rounded to 2^-24, column by column."""


def reduced(window: int, shape: tuple[int, int], counts: tuple[int, ...], scale: float = 1.0):
    """Statistics of exponential samples, of which every pixel has one of the counts, on the device times `scale`."""
    rng = np.random.default_rng(7)
    samples = [scale * rng.exponential(size=rng.choice(counts)) for _ in range(shape[0] * shape[1])]
    reducer = Reducer(Device(), len(samples), Needs(neighbours=window, nets=True), shape[1])
    reducer.add(samples)
    return reducer.statistics(scale)


def assert_like_numpy(statistics, window: int) -> None:
    expected = with_neighbours(statistics, window)
    for name in ("neighbour_mean", "neighbour_variance"):
        np.testing.assert_allclose(getattr(statistics, name), getattr(expected, name), rtol=ROUNDING)


@pytest.mark.parametrize("shape", [(1, 1), (1, 200), (200, 1), (40, 64), (13, 65), (9, 130)])
@pytest.mark.parametrize("window", [3, 5, 31])
def test_averages_of_the_neighbours(shape, window):
    assert_like_numpy(reduced(window, shape, (4, 9)), window)


@pytest.mark.parametrize("window", [3, 7])
def test_pixels_of_fewer_than_two_samples_do_not_count(window):
    statistics = reduced(window, (20, 70), (0,) * 20 + (1, 5))
    assert_like_numpy(statistics, window)
    assert np.isinf(statistics.neighbour_variance).any()


@pytest.mark.parametrize("run", [1, pytest.param(16, marks=pytest.mark.long)])
def test_runs_of_any_length(run, monkeypatch):
    """Work-items of GPUs process one pixel."""
    monkeypatch.setattr(Device, "form", FORMS["lanes"]._replace(neighbour_run=run))
    assert_like_numpy(reduced(5, (11, 35), (4, 9)), 5)


@pytest.mark.parametrize("scale", [2.0**-40, 2.0**40])
def test_averages_are_in_units_of_the_scene(scale):
    statistics = reduced(3, (8, 9), (6,), scale)
    assert statistics.neighbour_variance.dtype == np.float64  # squares may be beyond float32
    assert_like_numpy(statistics, 3)


def test_a_pooled_render_has_them():
    renderer = Renderer("cornell", size=(40, 30), strategy="pooled:window=7")
    for _ in range(3):
        renderer.step()
    assert_like_numpy(renderer.statistics(), 7)
