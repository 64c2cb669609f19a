"""The error estimate on the device, kernels/stages/relative_errors.cl, against the same in numpy.

Tolerance: the device rounds an error to a bin, by 0.4 % at most if all pixels have the same.
"""

import numpy as np
import pytest
from small_scene import lamp_over_floor
from synthetic_statistics import make_statistics, statistics_of_samples

from isonoise import Renderer
from isonoise.device.opencl import Device
from isonoise.error.distribution import ErrorDistribution, histogram_position
from isonoise.error.stated_error import error_distribution, stated_error
from isonoise.selftest.errors import BIN, QUANTILES, device_distribution, noisy_image
from isonoise.strategies.measures import image_floor


@pytest.fixture(scope="module")
def device():
    return Device()


def assert_like_the_host(device, statistics, floor):
    measured, expected = device_distribution(device, statistics, floor), error_distribution(statistics, floor)
    assert measured.noiseless == expected.noiseless
    assert measured.quantiles(QUANTILES) == pytest.approx(expected.quantiles(QUANTILES), rel=BIN)


@pytest.mark.parametrize("shape", [(1, 1), (1, 300), (300, 1), (64, 64), (65, 63), (131, 257)])
def test_images_of_any_size(device, shape):
    x = np.random.default_rng(1).exponential(size=(8, *shape))
    s = statistics_of_samples(x)
    assert_like_the_host(device, s, image_floor(s.mean))


@pytest.mark.parametrize("seed", [2, 3])
def test_jumps_black_pixels_and_unknown_ones(device, seed):
    s = noisy_image(150, 200, seed)
    assert_like_the_host(device, s, image_floor(s.mean))


@pytest.mark.parametrize("n", [2, 4, 64])
def test_rare_bright_samples(device, n):
    """One sample in 100 has all the light."""
    x = 100.0 * (np.random.default_rng(n).random((n, 128, 128)) < 0.01)
    s = statistics_of_samples(x)
    assert_like_the_host(device, s, image_floor(s.mean))


def test_one_pixel_has_all_the_light(device):
    mean, variance = np.zeros((70, 70)), np.zeros((70, 70))
    mean[40, 3], variance[40, 3] = 1e9, 1e20
    assert_like_the_host(device, make_statistics(100, mean, variance), 1e-3)


@pytest.mark.parametrize("scale", [1e-15, 1.0, 1e15])
def test_bright_and_dark_images(device, scale):
    x = scale * np.random.default_rng(4).gamma(0.5, size=(16, 80, 80))
    s = statistics_of_samples(x)
    assert_like_the_host(device, s, image_floor(s.mean))


def test_means_far_above_the_floor_are_cut(device):
    """Without the limit their squares would overflow."""
    s = make_statistics(16, np.full((64, 64), 1e15), 1e28)
    assert_like_the_host(device, s, 1.0)


def test_work_groups_of_any_size_write_the_same_bits(device):
    """The form of GPUs, with many work-items a tile, and that of CPUs."""
    s = noisy_image(100, 140, seed=5)
    one, many = (device_distribution(device, s, 0.1, work_items) for work_items in (1, 64))
    assert one.quantiles(QUANTILES).tolist() == many.quantiles(QUANTILES).tolist()


@pytest.mark.parametrize("sampler", ["sobol", "independent"])
def test_a_render_has_the_errors_of_its_statistics(sampler):
    renderer = Renderer("cornell", size=(90, 70), sampler=sampler)
    for _ in range(3):
        renderer.step()
        statistics = renderer.statistics()
        floor = image_floor(statistics.mean)
        measured = renderer.error_distribution(floor).quantiles(QUANTILES)
        assert measured == pytest.approx(stated_error(statistics, QUANTILES), rel=BIN)


def test_a_black_image_has_no_scale():
    scene = lamp_over_floor()
    scene["sensor"]["to_world"][:3, :3] = np.eye(3)  # looks away
    renderer = Renderer(scene, size=(8, 8))
    assert renderer.error_distribution(0.0).quantiles([0.5]).tolist() == [np.inf]  # no sample yet
    renderer.step()
    assert renderer.error_distribution(0.0).quantiles([0.5]).tolist() == [0.0]


def test_entries_count_as_many_pixels():
    squares, bins, number = np.array([0.01, 0.25]), np.array([8, 3]), np.array([5, 2])
    one_by_one, together = ErrorDistribution(8), ErrorDistribution(8)
    one_by_one.add(histogram_position(np.repeat(squares, number)), np.repeat(bins, number))
    together.add(histogram_position(squares.copy()), bins, number)
    assert together.quantiles(QUANTILES[:3]) == pytest.approx(one_by_one.quantiles(QUANTILES[:3]), rel=1e-12)
    assert one_by_one.quantiles([0.95]).tolist() == [np.inf]  # one of 8 pixels is unknown
