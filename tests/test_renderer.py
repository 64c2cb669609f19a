"""The renderer: what the statistics depend on, exact budgets, and the scale of the lights."""

import gc
import itertools
import pickle
import re
import weakref
from pathlib import Path

import numpy as np
import pytest
from small_scene import BUILT_IN, PIXELS, assert_same_bits, assert_sound, lamp_over_floor, without

from isonoise.errors import UserError
from isonoise.render_scene import render
from isonoise.renderer import Renderer
from isonoise.scene import compile_scene, load_description
from isonoise.statistics import Statistics
from isonoise.strategies import available_strategies

CHECKOUT = Path(__file__).resolve().parent.parent


# The statistics depend on seed, scene and counts, not on the pool, the waves or the slices.


@pytest.fixture(scope="module")
def thirty_spp() -> Statistics:
    """Of `lamp_over_floor` in one wave of 30 samples per pixel, with medians."""
    return render(lamp_over_floor(), spp=30, seed=3, strategy="relative-median:warmup=30").statistics


def test_the_scene_has_light_noise_and_darkness(thirty_spp):
    assert_sound(thirty_spp)
    assert np.count_nonzero(thirty_spp.variance > 0) > 5
    assert np.count_nonzero(thirty_spp.mean == 0) > 5


@pytest.mark.parametrize("pool_size", [1, 10, 1_000, 100_000])
def test_the_pool_size_changes_no_bit(thirty_spp, pool_size):
    """1,050 samples: in slices of 16 and 160; in one slice with slots used again, and without."""
    options = {"seed": 3, "strategy": "relative-median:warmup=30", "pool_size": pool_size}
    assert_same_bits(render(lamp_over_floor(), spp=30, **options).statistics, thirty_spp)


@pytest.mark.parametrize("wave_spp", [1, 10])
def test_the_number_of_waves_changes_no_bit(wave_spp):
    renders = [render(lamp_over_floor(), spp=30, seed=3, strategy=f"uniform:wave_spp={spp}") for spp in (wave_spp, 30)]
    assert [len(each.rows) for each in renders] == [30 // wave_spp, 1]
    assert_same_bits(renders[0].statistics, renders[1].statistics)


@pytest.mark.parametrize("strategy", [pytest.param(name, id=name) for name in BUILT_IN])
def test_renders_are_repeatable(strategy):
    a, b = (render(lamp_over_floor(), spp=41.3, seed=2**64 - 1, strategy=strategy) for _ in range(2))
    assert_same_bits(a.statistics, b.statistics)
    assert a.statistics.samples == round(41.3 * PIXELS)
    if strategy != "uniform":
        assert len(set(a.statistics.count.ravel().tolist())) > 2


def test_a_compiled_scene_renders_to_the_same_bits_also_after_it_was_pickled(thirty_spp):
    scene = pickle.loads(pickle.dumps(compile_scene(load_description(lamp_over_floor()))))
    options = {"spp": 30, "seed": 3, "strategy": "relative-median:warmup=30"}
    assert_same_bits(render(scene, **options).statistics, thirty_spp)
    with pytest.raises(UserError, match="a compiled scene has its size"):
        Renderer(scene, size=(8, 6))


def test_the_first_strategies_are_tested():
    assert available_strategies()[: len(BUILT_IN)] == BUILT_IN


def test_another_seed_gives_other_samples(thirty_spp):
    """In both halves of the 64-bit seed."""
    means = [thirty_spp.mean]
    for seed in (4, 3 + 2**32):
        means.append(render(lamp_over_floor(), spp=30, seed=seed, strategy="relative-median:warmup=30").statistics.mean)
    noisy = thirty_spp.variance > 0
    for a, b in itertools.combinations(means, 2):
        assert (a != b)[noisy].all()
        # two estimates of the same image: 5.2 standard errors of the difference, false alarms 2e-7 by the normal law
        se = np.sqrt(2 * thirty_spp.variance_of_mean().sum())
        assert abs(a.sum() - b.sum()) < 5.2 * se


@pytest.mark.parametrize("seed", [-1, 2**64])
def test_seeds_out_of_range(seed):
    with pytest.raises(UserError, match=re.escape("0 to 2^64 - 1")):
        Renderer(lamp_over_floor(), seed=seed)


@pytest.mark.parametrize(("width", "height"), [(1, 1), (67, 3), (3, 67)])
def test_odd_image_sizes(width, height):
    statistics = render(lamp_over_floor(), spp=5, size=(width, height), strategy="relative-median:warmup=2").statistics
    assert statistics.shape == (height, width)
    assert statistics.rgb.shape == (height, width, 3)
    assert statistics.samples == 5 * width * height
    assert statistics.count.min() >= 2
    assert_sound(statistics)


def test_rows_and_columns_are_not_mixed_up():
    """The middle column of a wide image is the middle column of a narrow one; fov_axis is y in both."""
    scene = lamp_over_floor()
    scene["sensor"] = without(scene["sensor"], "fov") | {"fov": 50.0, "fov_axis": "y"}
    wide, narrow = (
        render(scene, spp=4096, size=size, strategy="relative-median:warmup=4096", sampler="independent").statistics
        for size in ((9, 5), (1, 5))
    )
    a, b = wide.mean[:, 4], narrow.mean[:, 0]
    se = np.sqrt(wide.variance_of_mean()[:, 4] + narrow.variance_of_mean()[:, 0])
    assert (np.abs(a - b) <= 5.2 * se).all()  # false alarms: 1e-6 over the five pixels
    assert a.max() > 0


# Budgets are met exactly.


@pytest.mark.parametrize(("strategy", "spp"), [("uniform", 0.001), ("relative-median", 0.37), ("relative-mean", 17.9)])
def test_the_budget_is_met_exactly(strategy, spp):
    outcome = render(lamp_over_floor(), spp=spp, strategy=strategy)
    assert outcome.statistics.samples == max(1, round(spp * PIXELS)) == outcome.rows[-1].samples
    assert outcome.reason == "spp"


def test_a_shortened_uniform_wave_is_resumed():
    renderer = Renderer(lamp_over_floor(), strategy="uniform:wave_spp=10")
    records = [renderer.step(limit) for limit in (3 * PIXELS, 7 * PIXELS, None)]
    assert [record.samples for record in records] == [3 * PIXELS, 7 * PIXELS, 10 * PIXELS]
    assert (renderer.statistics().count == 20).all()
    assert_same_bits(
        renderer.statistics(), render(lamp_over_floor(), spp=20, strategy="uniform:wave_spp=20").statistics
    )


def test_shortened_waves_are_spread_evenly():
    renderer = Renderer(lamp_over_floor(), strategy="uniform:wave_spp=10")
    for _ in range(10):
        renderer.step(33)
    count = renderer.statistics().count
    assert count.sum() == 330
    assert count.min() >= 5  # 330 / 35 = 9.4: each step leaves out two other pixels of the 35


# Scaling the lights scales the statistics and changes no count.


@pytest.fixture(scope="module")
def adaptive() -> Statistics:
    return render(lamp_over_floor(5.0), spp=100, seed=5, strategy="relative-median").statistics


@pytest.mark.parametrize("power", [-20, 20, 120])
def test_light_scaled_by_a_power_of_two_scales_the_statistics_exactly(adaptive, power):
    """Also near the limit of float32: the scale is removed before."""
    scaled = render(lamp_over_floor(5.0 * 2.0**power), spp=100, seed=5, strategy="relative-median").statistics
    assert np.array_equal(scaled.count, adaptive.count)
    for name, exponent in (("mean", 1), ("median", 1), ("rgb", 1), ("variance", 2)):
        values = getattr(scaled, name)
        expected = getattr(adaptive, name).astype(values.dtype) * values.dtype.type(2.0 ** (exponent * power))
        assert np.array_equal(values, expected), name


def test_light_scaled_by_another_factor_changes_only_roundings(adaptive):
    """Samples differ by a few 2^-24, which may move a largest remainder to another pixel."""
    factor = 1e6
    scaled = render(lamp_over_floor(5.0 * factor), spp=100, seed=5, strategy="relative-median").statistics
    difference = np.abs(scaled.count.astype(int) - adaptive.count)
    assert difference.max() <= 2
    same = difference == 0
    assert same.mean() > 0.8
    assert scaled.mean[same] == pytest.approx(factor * adaptive.mean[same], rel=1e-5)
    assert scaled.median[same] == pytest.approx(factor * adaptive.median[same], rel=1e-5)
    assert scaled.variance[same] == pytest.approx(factor**2 * adaptive.variance[same], rel=1e-4)


def test_a_dropped_renderer_frees_its_buffers_at_once():
    """Nothing refers to it in a circle: until Python looks for circles, renders in a loop would fill the memory."""
    renderer = Renderer(lamp_over_floor(), on_compile=lambda *progress: None)
    renderer.step()
    wavefront = weakref.ref(renderer._wavefront)
    gc.disable()
    try:
        del renderer
        assert wavefront() is None
    finally:
        gc.enable()
