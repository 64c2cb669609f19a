"""A render as its caller sees it: what the samples depend on and what not, and strategies of one's own."""

import itertools
import re
from pathlib import Path

import numpy as np
import pytest
from small_scene import BUILT_IN, PIXELS, assert_same_bits, assert_sound, lamp_over_floor, without

from isonoise.device.opencl import Device
from isonoise.errors import UserError
from isonoise.loop import render
from isonoise.renderer import Renderer
from isonoise.statistics import Statistics
from isonoise.strategies import Strategy, Wave, available_strategies
from isonoise.strategies.uniform_allocation import uniform_allocation

CHECKOUT = Path(__file__).resolve().parent.parent


# What the statistics depend on: seed, scene and counts; not the pool, the waves or the slices.


@pytest.fixture(scope="module")
def thirty_spp() -> Statistics:
    """Of `lamp_over_floor` in one wave of 30 samples per pixel, the median kept."""
    return render(lamp_over_floor(), spp=30, seed=3, strategy="relative-median:warmup=30").statistics


def test_the_scene_of_these_tests_has_light_noise_and_darkness(thirty_spp):
    assert_sound(thirty_spp)
    assert np.count_nonzero(thirty_spp.variance > 0) > 5
    assert np.count_nonzero(thirty_spp.mean == 0) > 5


@pytest.mark.parametrize(
    "pool_size",
    [
        1,
        10,
        1_000,
        100_000,
    ],
)
def test_the_pool_changes_no_bit(thirty_spp, pool_size):
    """1,050 samples: in slices of 16 through one slot, of 160, in one with slots used again, all at once."""
    options = {"seed": 3, "strategy": "relative-median:warmup=30", "pool_size": pool_size}
    assert_same_bits(render(lamp_over_floor(), spp=30, **options).statistics, thirty_spp)


def of_many_kinds() -> dict:
    """Surfaces, textures, materials and lights of which paths side by side meet different ones."""
    board = {"type": "checkerboard", "to_uv": np.diag([4.0, 4.0, 1.0, 1.0])}
    clear = {"type": "principled", "base_color": board, "spec_trans": 0.5}
    glossy = {"type": "roughconductor", "alpha": board, "distribution": "ggx"}
    tiles = {"type": "blendbsdf", "weight": board, "first": {"type": "roughplastic"}, "second": glossy}
    hung = np.eye(4)
    hung[:3, 3] = 0.3, 0.5, 0.2
    return lamp_over_floor(width=32, height=24, max_depth=8) | {
        "floor": {"type": "rectangle", "bsdf": {"type": "twosided", "inner": tiles}},
        "ball": {"type": "sphere", "radius": 0.3, "bsdf": clear},
        "glass": {"type": "sphere", "center": [-0.5, 0.0, 0.3], "radius": 0.2, "bsdf": {"type": "dielectric"}},
        "net": {"type": "disk", "to_world": hung, "bsdf": {"type": "mask", "opacity": board, "inner": glossy}},
        "group": {"type": "shapegroup", "box": {"type": "cube", "to_world": np.diag([0.1, 0.1, 0.1, 1.0])}},
        "box": {"type": "instance", "to_world": hung, "group": {"type": "ref", "id": "group"}},
        "spot": {"type": "spot", "to_world": hung, "intensity": 3.0},
        "sky": {"type": "constant", "radiance": 0.2},
    }


@pytest.mark.parametrize("scene", [lamp_over_floor, of_many_kinds])
def test_the_paths_of_a_work_item_change_no_bit(monkeypatch, scene):
    renders = []
    for lanes in (1, 64):
        monkeypatch.setattr(Device, "lanes", lanes)
        renders.append(render(scene(), spp=30, seed=3, strategy="uniform").statistics)
    assert_sound(renders[0])
    assert_same_bits(*renders)


@pytest.mark.parametrize("wave_spp", [1, 10])
def test_the_number_of_waves_changes_no_bit(wave_spp):
    renders = [render(lamp_over_floor(), spp=30, seed=3, strategy=f"uniform:wave_spp={spp}") for spp in (wave_spp, 30)]
    assert [len(each.rows) for each in renders] == [30 // wave_spp, 1]
    assert_same_bits(renders[0].statistics, renders[1].statistics)


@pytest.mark.parametrize("strategy", [pytest.param(name, id=name) for name in BUILT_IN])
def test_two_runs_are_the_same(strategy):
    a, b = (render(lamp_over_floor(), spp=41.3, seed=2**64 - 1, strategy=strategy) for _ in range(2))
    assert_same_bits(a.statistics, b.statistics)
    assert a.statistics.samples == round(41.3 * PIXELS)
    if strategy != "uniform":
        assert len(set(a.statistics.count.ravel().tolist())) > 2


def test_all_strategies_are_tested():
    assert available_strategies()[: len(BUILT_IN)] == BUILT_IN


def test_another_seed_gives_other_samples(thirty_spp):
    """Both halves of the seed count."""
    means = [thirty_spp.mean]
    for seed in (4, 3 + 2**32):
        means.append(render(lamp_over_floor(), spp=30, seed=seed, strategy="relative-median:warmup=30").statistics.mean)
    noisy = thirty_spp.variance > 0
    for a, b in itertools.combinations(means, 2):
        assert (a != b)[noisy].all()
        # two estimates of the same picture: 5.2 standard errors of the difference, false alarms 2e-7 by the normal law
        se = np.sqrt(2 * thirty_spp.variance.sum() / 30)
        assert abs(a.sum() - b.sum()) < 5.2 * se


@pytest.mark.parametrize("seed", [-1, 2**64])
def test_seeds_out_of_range(seed):
    with pytest.raises(UserError, match=re.escape("0 to 2^64 - 1")):
        Renderer(lamp_over_floor(), seed=seed)


@pytest.mark.parametrize(("width", "height"), [(1, 1), (67, 3), (3, 67)])
def test_odd_images(width, height):
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
        render(scene, spp=4096, size=size, strategy="relative-median:warmup=4096").statistics
        for size in ((9, 5), (1, 5))
    )
    a, b = wide.mean[:, 4], narrow.mean[:, 0]
    se = np.sqrt((wide.variance[:, 4] + narrow.variance[:, 0]) / 4096)
    assert (np.abs(a - b) <= 5.2 * se).all()  # false alarms: 1e-6 over the five pixels
    assert a.max() > 0


# Budgets are met exactly.


@pytest.mark.parametrize(("strategy", "spp"), [("uniform", 0.001), ("relative-median", 0.37), ("relative-mean", 17.9)])
def test_the_budget_is_met_exactly(strategy, spp):
    outcome = render(lamp_over_floor(), spp=spp, strategy=strategy)
    assert outcome.statistics.samples == max(1, round(spp * PIXELS)) == outcome.rows[-1].samples
    assert outcome.reason == "spp"


def test_a_uniform_wave_that_was_cut_goes_on_where_it_ended():
    renderer = Renderer(lamp_over_floor(), strategy="uniform:wave_spp=10")
    records = [renderer.step(limit) for limit in (3 * PIXELS, 7 * PIXELS, None)]
    assert [record.samples for record in records] == [3 * PIXELS, 7 * PIXELS, 10 * PIXELS]
    assert (renderer.statistics().count == 20).all()
    assert_same_bits(
        renderer.statistics(), render(lamp_over_floor(), spp=20, strategy="uniform:wave_spp=20").statistics
    )


def test_what_a_cut_leaves_is_spread_evenly():
    renderer = Renderer(lamp_over_floor(), strategy="uniform:wave_spp=10")
    for _ in range(10):
        renderer.step(33)
    count = renderer.statistics().count
    assert count.sum() == 330
    assert count.min() >= 5  # 330 / 35 = 9.4: each step leaves out two other pixels of the 35


# Scale of the lights: statistics are relative to it, counts do not know it.


@pytest.fixture(scope="module")
def adaptive() -> Statistics:
    return render(lamp_over_floor(5.0), spp=100, seed=5, strategy="relative-median").statistics


@pytest.mark.parametrize("power", [-20, 20, 120])
def test_light_scaled_by_a_power_of_two_scales_the_statistics_exactly(adaptive, power):
    """Near the end of float32 too: the scale is taken out before."""
    scaled = render(lamp_over_floor(5.0 * 2.0**power), spp=100, seed=5, strategy="relative-median").statistics
    assert np.array_equal(scaled.count, adaptive.count)
    for name, exponent in (("mean", 1), ("median", 1), ("rgb", 1), ("variance", 2)):
        expected = getattr(adaptive, name) * getattr(adaptive, name).dtype.type(2.0 ** (exponent * power))
        assert np.array_equal(getattr(scaled, name), expected), name


def test_light_scaled_by_another_factor_changes_nothing_but_roundings(adaptive):
    """Every sample is off by a few 2^-24, which may move a largest remainder from one pixel to another now and then."""
    factor = 1e6
    scaled = render(lamp_over_floor(5.0 * factor), spp=100, seed=5, strategy="relative-median").statistics
    off = np.abs(scaled.count.astype(int) - adaptive.count)
    assert off.max() <= 2
    same = off == 0
    assert same.mean() > 0.8
    assert scaled.mean[same] == pytest.approx(factor * adaptive.mean[same], rel=1e-5)
    assert scaled.median[same] == pytest.approx(factor * adaptive.median[same], rel=1e-5)
    assert scaled.variance[same] == pytest.approx(factor**2 * adaptive.variance[same], rel=1e-4)


# Where there is little or nothing.

DARK = {
    "without lights": without(lamp_over_floor(), "lamp"),
    "nothing at all": without(lamp_over_floor(), "lamp", "floor"),
    "a black lamp": lamp_over_floor(0.0),
}


@pytest.mark.parametrize("name", DARK)
def test_dark_scenes_are_black_and_end(name):
    outcome = render(DARK[name], spp=40)
    assert outcome.statistics.samples == 40 * PIXELS
    assert outcome.reason == "spp"
    assert outcome.floor == 0
    assert (outcome.rgb == 0).all()
    assert (outcome.error == 0).all()  # noiseless
    assert_sound(outcome.statistics)


def test_a_black_image_has_no_error():
    assert render(DARK["without lights"], error=0.01, strategy="uniform").reason == "error"


def test_an_environment_alone():
    sky = {"type": "constant", "radiance": {"type": "rgb", "value": [0.2, 0.4, 0.6]}}
    outcome = render(without(lamp_over_floor(), "lamp", "floor") | {"sky": sky}, spp=20)
    np.testing.assert_allclose(outcome.rgb, np.broadcast_to([0.2, 0.4, 0.6], outcome.rgb.shape), rtol=1e-6)
    assert (outcome.statistics.variance == 0).all()
    assert np.ptp(outcome.statistics.count) <= 2  # no pixel is noisier than another; waves are rounded, the last is cut


def test_depth_zero_is_black_and_depth_one_sees_lights_alone():
    """By the scene's integrator and by the option, which is the stronger one."""
    upwards = lamp_over_floor()["lamp"] | {"to_world": np.eye(4)}  # where the floor was, towards the camera
    black = render(lamp_over_floor(max_depth=0) | {"floor": upwards}, spp=64, strategy="uniform").statistics
    assert (black.count == 64).all()
    assert (black.rgb == 0).all()
    alone = without(lamp_over_floor(), "floor") | {"lamp": upwards}
    lights = render(alone, spp=64, strategy="uniform", max_depth=1).statistics
    assert lights.mean.max() == pytest.approx(5.0 * (0.2126 + 0.8 * 0.7152 + 0.6 * 0.0722), rel=1e-6)
    assert lights.mean.min() == 0
    unseen = render(lamp_over_floor(), spp=64, strategy="uniform", max_depth=1).statistics
    assert (unseen.rgb == 0).all()  # the lamp is turned away from the camera and lights nothing


# Samples that are not numbers.


def blinding_scene() -> dict:
    """A point light so near a tiny floor that its irradiance, 1e20, has no square in float32: legal, and not finite."""
    scene = without(lamp_over_floor(), "lamp")
    scene["sensor"] = scene["sensor"] | {"near_clip": 1e-12, "far_clip": 1.0, "fov": 90.0}
    camera = np.eye(4)
    camera[:3, 3] = (0, 0, 2e-10)
    scene["sensor"]["to_world"] = camera @ np.diag([1.0, -1.0, -1.0, 1.0])
    scene["floor"] = scene["floor"] | {"to_world": np.diag([1e-10, 1e-10, 1.0, 1.0])}
    scene["sun"] = {"type": "point", "position": [0.0, 0.0, 1e-10], "intensity": 1.0}
    return scene


@pytest.mark.parametrize("strategy", ["uniform", "relative-median"])
def test_samples_that_are_not_finite_are_counted_apart(strategy):
    outcome = render(blinding_scene(), spp=50, size=(16, 16), strategy=strategy)
    statistics = outcome.statistics
    rejected = int(statistics.rejected.sum())
    assert rejected > 0
    assert statistics.samples + rejected == 50 * 256
    assert outcome.rows[-1].rejected == rejected
    assert statistics.rejected[8, 8] > 0  # the floor fills the middle
    assert statistics.count[8, 8] == 0
    assert statistics.rejected[0, 0] == 0  # and not the corner
    assert (statistics.rgb[8, 8] == 0).all()
    assert_sound(statistics)
    assert np.isposinf(outcome.error[8, 8])  # nothing is known there


def test_rejected_samples_have_an_index_too():
    """Else the next wave would draw the same numbers again, and samples that count would count twice."""
    renders = [
        render(blinding_scene(), spp=30, size=(16, 16), strategy=f"uniform:wave_spp={spp}").statistics
        for spp in (10, 30)
    ]
    assert ((renders[0].rejected > 0) & (renders[0].count > 0)).any()
    assert_same_bits(*renders)


def test_a_picture_of_rejected_samples_alone_ends():
    scene = blinding_scene()
    scene["sensor"] = scene["sensor"] | {"fov": 1.0}
    outcome = render(scene, spp=30)
    assert outcome.reason == "spp"
    assert outcome.statistics.samples == 0
    assert outcome.rows[-1].rejected == 30 * PIXELS
    assert outcome.rows[-1].stated_p99 == np.inf


def test_stopped_in_the_middle_of_a_wave(thirty_spp):
    """Slices of 192 samples: after two, pixels 0 to 11 have their 30 samples, pixel 12 has 24, the rest none."""
    entered = []
    renderer = Renderer(lamp_over_floor(), seed=3, strategy="relative-median:warmup=30", pool_size=12)

    def should_continue(samples: int) -> bool:
        entered.append(samples)
        return samples < 384

    record = renderer.step(should_continue=should_continue)
    assert (record.kind, record.samples, record.planned) == ("uniform", 384, 30 * PIXELS)
    assert entered == sorted(entered)
    statistics = renderer.statistics()
    assert statistics.count.ravel().tolist() == [30] * 12 + [24] + [0] * 22
    for name, plane in vars(statistics).items():
        if plane is not None:
            whole = getattr(thirty_spp, name)
            assert np.array_equal(plane.reshape(PIXELS, -1)[:12], whole.reshape(PIXELS, -1)[:12]), name
    assert_sound(statistics)


# Strategies of one's own.


def example_of_the_readme() -> str:
    """The strategy that host/docs/extending.md shows."""
    text = (CHECKOUT / "host" / "docs" / "extending.md").read_text()
    (block,) = re.findall(r"```python\n(.*?class .*?)```", text, re.DOTALL)
    return block


def test_the_strategy_of_the_readme(tmp_path, monkeypatch):
    """Ten lines, by name and as an object, and it does what the text says."""
    text = example_of_the_readme()
    assert len([line for line in text.splitlines() if line.strip() and not line.startswith(("import", "from"))]) <= 10
    (tmp_path / "proportional.py").write_text(text)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    by_name = render(lamp_over_floor(), spp=24, strategy="proportional:Proportional").statistics
    from proportional import Proportional

    as_object = render(lamp_over_floor(), spp=24, strategy=Proportional()).statistics
    assert_same_bits(by_name, as_object)
    assert by_name.samples == 24 * PIXELS
    assert (
        by_name.count[by_name.variance == 0] <= 17
    ).all()  # 16 of the uniform waves, 8 to 16 in all if it did nothing
    assert by_name.count.max() > 32


class Wrong(Strategy):
    """Plans and returns whatever it is given."""

    name = "wrong"

    def __init__(self, waves, maps=()):
        self.planned, self.maps = waves, iter(maps)

    def waves(self):
        return iter(self.planned)

    def allocate(self, statistics, budget):
        return next(self.maps)(statistics.shape, budget)


def test_a_wrong_allocation_map_is_an_error():
    maps = {
        "sum 71": lambda shape, budget: uniform_allocation(shape, budget + 1, 0),
        "int64": lambda shape, budget: uniform_allocation(shape, budget, 0).astype(np.int64),
        "float64": lambda shape, budget: uniform_allocation(shape, budget, 0).astype(np.float64),
        r"shape \(7, 5\)": lambda shape, budget: uniform_allocation(shape[::-1], budget, 0),
        r"shape \(35,\)": lambda shape, budget: uniform_allocation(shape, budget, 0).ravel(),
        "sum 150323855325": lambda shape, budget: np.full(shape, 2**32 - 1, np.uint32),
        "object": lambda shape, budget: None,
    }
    renderer = Renderer(lamp_over_floor(), strategy=Wrong([Wave("adaptive", 2.0)] * len(maps), maps.values()))
    for said in maps:
        with pytest.raises(UserError, match=f"strategy 'wrong' returned an allocation map of .*{said}"):
            renderer.step()
    assert renderer.statistics().samples == 0


def test_a_wrong_schedule_is_an_error():
    wrong = [Wave("uniform", 0.0), Wave("uniform", np.nan), Wave("adaptive", np.inf), Wave("random", 1.0)]
    wrong += [Wave("uniform", None), Wave("random", None), Wave("adaptive", 0)]
    renderer = Renderer(lamp_over_floor(), strategy=Wrong([Wave("uniform", 3), *wrong]))
    assert renderer.step().samples == 3 * PIXELS
    for wave in wrong:
        with pytest.raises(UserError, match=re.escape(f"strategy 'wrong' planned {wave}")):
            renderer.step()
    with pytest.raises(UserError, match="strategy 'wrong' plans no more waves"):
        renderer.step()
    assert renderer.statistics().samples == 3 * PIXELS


# Waves whose number of samples is the strategy's own.


def one_in_three(shape, budget):
    """A map of 100 samples in every third pixel, 1,200 in all; asked for without a budget."""
    assert budget is None
    return np.where(np.arange(PIXELS) % 3 == 1, 100, 0).astype(np.uint32).reshape(shape)


def test_a_wave_without_a_number_takes_the_map_as_it_is():
    renderer = Renderer(lamp_over_floor(), strategy=Wrong([Wave("adaptive", None)] * 2, [one_in_three] * 2))
    for wave in range(1, 3):
        record = renderer.step(samples=1200 if wave == 1 else None)
        assert (record.kind, record.samples, record.planned) == ("adaptive", 1200, 1200)
        assert (renderer.statistics().count == wave * one_in_three((5, 7), None)).all()


@pytest.mark.parametrize("samples", [1, 11, 12, 600, 1199])
def test_a_wave_without_a_number_is_scaled_down_in_proportion(samples):
    renderer = Renderer(lamp_over_floor(), strategy=Wrong([Wave("adaptive", None)], [one_in_three]))
    record = renderer.step(samples=samples)
    assert record.samples == record.planned == samples
    count = renderer.statistics().count.ravel()
    assert count.sum() == samples
    assert set(count[1::3].tolist()) <= {samples // 12, samples // 12 + 1}


def test_a_wrong_map_of_a_wave_without_a_number_is_an_error():
    maps = {
        "sum 0;": lambda shape, budget: np.zeros(shape, np.uint32),
        "int64": lambda shape, budget: np.ones(shape, np.int64),
        r"shape \(7, 5\)": lambda shape, budget: np.ones(shape[::-1], np.uint32),
    }
    renderer = Renderer(lamp_over_floor(), strategy=Wrong([Wave("adaptive", None)] * len(maps), maps.values()))
    for said in maps:
        with pytest.raises(UserError, match=f"returned an allocation map of .*{said}.*sum 1 or more"):
            renderer.step(samples=50)
    assert renderer.statistics().samples == 0


def test_a_render_of_waves_without_numbers_meets_its_budget():
    endless = itertools.chain([Wave("uniform", 2)], itertools.repeat(Wave("adaptive", None)))
    strategy = Wrong(endless, itertools.repeat(one_in_three))
    outcome = render(lamp_over_floor(), spp=100.3, strategy=strategy)
    assert [row.samples for row in outcome.rows] == [70, 1270, 2470, round(100.3 * PIXELS)]
