"""A renderer that is iterated over, begins anew, is closed, and lives beside others."""

import gc
import itertools
import weakref

import numpy as np
import pytest
from small_scene import PIXELS, assert_same_bits, lamp_over_floor

import isonoise
from isonoise.errors import UserError
from isonoise.loop import Stops, render_loop
from isonoise.render_scene import render
from isonoise.renderer import Renderer
from isonoise.strategies import Strategy, Wave
from isonoise.strategies.uniform_allocation import uniform_allocation

STRATEGY = "relative-median:warmup=4"


class Learning(Strategy):
    """Keeps something from wave to wave, that it makes in the first one."""

    name = "learning"

    def waves(self):
        while True:
            yield Wave("adaptive", 4)

    def allocate(self, statistics, budget):
        self.calls = getattr(self, "calls", 0) + 1
        return uniform_allocation(statistics.shape, budget, self.calls)


def test_waves_are_iterated_over():
    with Renderer(lamp_over_floor(), strategy=STRATEGY) as renderer:
        records = list(itertools.islice(renderer, 3))
        assert [record.number for record in records] == [1, 2, 3]
        assert sum(record.samples for record in records) == renderer.samples == renderer.statistics().samples
        assert next(iter(renderer)).number == 4  # another loop goes on


def test_a_shortened_wave_is_finished_by_the_next_step():
    with Renderer(lamp_over_floor(), strategy=STRATEGY) as renderer:
        renderer.begin_wave()
        assert not renderer.continue_wave(lambda samples: False)
        record = next(iter(renderer))
        assert (record.number, record.samples) == (1, 4 * PIXELS)


def test_the_statistics_of_a_wave():
    with Renderer(lamp_over_floor(), strategy=STRATEGY) as renderer:
        first, second = (renderer.step() for _ in range(2))
        with pytest.raises(UserError, match="after wave 1 are gone"):
            _ = first.statistics
        kept = second.statistics
        assert kept is renderer.statistics()
        count, rgb = kept.count.copy(), kept.rgb.copy()
        third = renderer.step()
        assert second.statistics is kept
        assert np.array_equal(kept.count, count)
        assert np.array_equal(kept.rgb, rgb)
    with pytest.raises(UserError, match="gone on or is closed"):
        _ = third.statistics


@pytest.mark.parametrize(
    ("strategy", "device"),
    [
        ("uniform", None),
        (STRATEGY, None),
        ("pooled:unbiased=true,warmup=4", None),
        ("uniform", "0/2"),
        pytest.param(STRATEGY, "0/2", marks=pytest.mark.long),
        pytest.param("pooled:unbiased=true,warmup=4", "0/2", marks=pytest.mark.long),
    ],
)
def test_a_renderer_begins_anew(strategy, device):
    """Bit by bit as a new one: with the same seed, another one, and the first one again."""
    expected = [render(lamp_over_floor(), spp=20, seed=seed, strategy=strategy).statistics for seed in (1, 2**40)]
    with Renderer(lamp_over_floor(), seed=1, strategy=strategy, device=device) as renderer:
        kept = renderer.step().statistics
        before = kept.mean.copy()
        for seed, statistics in ((None, expected[0]), (2**40, expected[1]), (1, expected[0])):
            renderer.reset(seed)
            assert renderer.samples == renderer.statistics().samples == 0
            assert not renderer.statistics().rgb.any()
            assert_same_bits(render_loop(renderer, Stops(spp=20)).statistics, statistics)
            assert renderer.settings["seed"] == renderer.seed == (seed or 1)
        assert np.array_equal(kept.mean, before)


@pytest.mark.parametrize("device", [None, pytest.param("0/2", marks=pytest.mark.long)])
def test_layers_begin_anew(device):
    options = {"strategy": STRATEGY, "device": device, "layers": ("depth", "albedo")}
    with Renderer(lamp_over_floor(), seed=1, **options) as renderer:
        renderer.step()
        renderer.reset(2)
        renderer.step()
        with Renderer(lamp_over_floor(), seed=2, **options) as other:
            other.step()
            for name, layer in other.layers().items():
                assert layer.any()
                assert renderer.layers()[name].tobytes() == layer.tobytes()


def test_a_strategy_forgets_what_it_has_learned():
    strategy = Learning()
    with Renderer(lamp_over_floor(), strategy=strategy) as renderer:
        for _ in range(2):
            renderer.step()
            renderer.step()
            assert strategy.calls == 2
            assert renderer.strategy is strategy
            renderer.reset()
            assert vars(strategy) == {}


def test_a_strategy_that_cannot_be_copied():
    strategy = Learning()
    strategy.numbers = (number for number in ())
    with Renderer(lamp_over_floor(), strategy=strategy) as renderer:
        renderer.step()
        with pytest.raises(UserError, match="'learning' cannot begin anew"):
            renderer.reset()


def test_a_closed_renderer():
    with Renderer(lamp_over_floor(), strategy=STRATEGY) as renderer:
        renderer.step()
        statistics = renderer.statistics()
        wavefront = weakref.ref(renderer._wavefront)
        gc.disable()
    try:
        assert wavefront() is None  # its buffers are free at once
    finally:
        gc.enable()
    assert statistics.rgb.any()
    renderer.close()
    for use in (renderer.step, renderer.statistics, renderer.reset, renderer.image, lambda: renderer.features):
        with pytest.raises(UserError, match="the renderer is closed"):
            use()
    assert renderer.samples == 4 * PIXELS


def test_five_renderers_at_a_time():
    """In turn, wave by wave: each has the image that it has alone."""
    seeds = range(5)
    renderers = [Renderer(lamp_over_floor(), seed=seed, strategy=STRATEGY) for seed in seeds]
    for _ in range(3):
        for renderer in renderers:
            renderer.step()
    for renderer in renderers:
        with Renderer(lamp_over_floor(), seed=renderer.seed, strategy=STRATEGY) as alone:
            for _ in range(3):
                alone.step()
            assert_same_bits(renderer.statistics(), alone.statistics())
        renderer.close()


@pytest.mark.long
def test_a_hundred_renderers_one_after_the_other():
    """The process grows by less than a tenth of what one of them takes."""

    def resident_bytes() -> int:
        gc.collect()
        with open("/proc/self/statm") as file:
            return int(file.read().split()[1]) * 4096

    def one() -> int:
        with isonoise.Renderer("cornell", size=(256, 256), strategy="pooled") as renderer:
            renderer.step()
            return renderer._wavefront.device.allocated

    allocated = max(one() for _ in range(5))
    before = resident_bytes()
    for _ in range(100):
        one()
    assert resident_bytes() - before < 0.1 * allocated
