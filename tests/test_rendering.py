"""The render loop: limits, deadlines, the log's rows, interruptions."""

import doctest
import importlib
import itertools
import time

import numpy as np
import pytest
from small_scene import BUILT_IN, HEIGHT, PIXELS, WIDTH, assert_same_bits, assert_sound, lamp_over_floor

import isonoise
from isonoise import loop
from isonoise.errors import UserError
from isonoise.loop import Periodic, RenderLoop, Stops, render_loop
from isonoise.render_scene import render
from isonoise.renderer import Renderer


@pytest.mark.parametrize(
    ("limits", "message"),
    [
        ({}, "needs a limit"),
        ({"spp": 0.0}, "spp has to be"),
        ({"spp": -1.0}, "spp has to be"),
        ({"time": np.inf}, "time has to be"),
        ({"error": np.nan}, "error has to be"),
        ({"error": 0.1, "quantile": 1.0}, "quantile has to"),
        ({"error": 0.1, "quantile": 0.0}, "quantile has to"),
    ],
)
def test_invalid_limits(limits, message):
    with pytest.raises(UserError, match=message):
        Stops(**limits)


@pytest.mark.parametrize("strategy", BUILT_IN)
def test_a_stated_error_ends_the_render(strategy):
    outcome = render(lamp_over_floor(), error=0.1, spp=100_000, strategy=strategy, sampler="independent")
    assert outcome.reason == "error"
    assert outcome.rows[-1].stated_p99 < outcome.error_bound < 0.1
    assert all(row.error_bound >= 0.1 for row in outcome.rows[:-1])
    assert outcome.error_bound > 0.08  # waves approach the limit: at most half more samples than needed


def test_the_error_is_that_of_the_given_quantile():
    outcome = render(lamp_over_floor(), error=0.05, quantile=0.5, spp=100_000, strategy="uniform")
    assert outcome.reason == "error"
    assert outcome.rows[-1].stated_p50 < 0.05 < outcome.rows[-1].stated_p99


@pytest.mark.parametrize(
    ("limits", "reason"),
    [
        ({"spp": 4, "error": 1e-9, "time": 600}, "spp"),
        ({"spp": 1e9, "error": 1e-9, "time": 0.05}, "time"),
        ({"spp": 1e9, "error": 100.0, "time": 600}, "error"),
        ({"spp": 16, "error": 100.0}, "error"),  # both at once: the error is the reported reason
    ],
)
def test_the_first_limit_reached_ends_the_render(limits, reason):
    assert render(lamp_over_floor(), strategy="uniform", **limits).reason == reason


def test_a_deadline_is_kept():
    """2 s with a tolerance of 0.15 s.

    Waves are sized by the speed so far, which other programs on the machine change: the best of three attempts counts.
    The strategy's own waves have four times the samples so far: without limits one render in 20 would pass by chance.
    """
    delays = []
    for seed in range(3):
        outcome = render(lamp_over_floor(), time=2.0, strategy="uniform:growth=4", seed=seed)
        assert outcome.reason == "time"
        assert outcome.elapsed_s > 1.99
        assert outcome.rows[-1].elapsed_s <= outcome.elapsed_s
        delays.append(outcome.elapsed_s - 2.0)
        if delays[-1] < 0.15:
            return
    pytest.fail(f"seconds late: {delays}")


@pytest.mark.parametrize("strategy", ["uniform", "relative-median"])
def test_rows_of_the_log(strategy):
    seen = []
    images = []

    def on_wave(row, statistics):
        seen.append(row)
        images.append(statistics)

    outcome = render_loop(Renderer(lamp_over_floor(), strategy=strategy), Stops(spp=200), on_wave=on_wave)
    assert seen == outcome.rows
    assert [image.samples for image in images] == [row.samples for row in seen]
    assert_same_bits(images[-1], outcome.statistics)
    assert [row.wave for row in seen] == list(range(1, len(seen) + 1))
    for before, after in itertools.pairwise(seen):
        assert before.samples < after.samples
        assert before.elapsed_s < after.elapsed_s
    for row in seen:
        assert row.spp == row.samples / PIXELS
        assert 0 < row.stated_p50 <= row.stated_p95 <= row.stated_p99
        assert row.rejected == 0
    assert seen[0].kind == "uniform"
    assert ("adaptive" in {row.kind for row in seen}) == (strategy != "uniform")
    assert seen[-1].samples == 200 * PIXELS


def test_true_errors_do_not_count_as_rendering_time(monkeypatch):
    """Even if the comparison with the reference is slow."""
    true_error = loop.true_error
    monkeypatch.setattr(loop, "true_error", lambda *images: time.sleep(0.05) or true_error(*images))
    reference = np.ones((HEIGHT, WIDTH, 3), np.float32), None
    renderer = Renderer(lamp_over_floor())
    begun = time.perf_counter()
    outcome = render_loop(renderer, Stops(spp=64), reference=reference)
    assert len(outcome.rows) > 2
    assert outcome.elapsed_s < time.perf_counter() - begun - 0.05 * len(outcome.rows)
    for before, after in itertools.pairwise(outcome.rows):
        assert before.elapsed_s < after.elapsed_s
    assert outcome.rows[-1].true.energy_ratio == pytest.approx(outcome.statistics.mean.mean(), rel=1e-6)
    assert outcome.floor == pytest.approx(0.01, rel=1e-6)  # the reference's


def test_on_wave_does_not_count_as_rendering_time():
    begun = time.perf_counter()
    outcome = render_loop(Renderer(lamp_over_floor()), Stops(spp=64), on_wave=lambda row, _: time.sleep(0.05))
    assert len(outcome.rows) > 2
    assert outcome.elapsed_s < time.perf_counter() - begun - 0.05 * len(outcome.rows)
    assert outcome.rows[-1].elapsed_s <= outcome.elapsed_s < outcome.rows[-1].elapsed_s + 0.1


@pytest.mark.parametrize("calls", [0, 1, 500])
def test_an_interrupted_render_has_valid_statistics(calls):
    """`should_stop` returns True after a number of calls: before the first wave, in it, and later."""
    left = iter([False] * calls)
    renderer = Renderer(lamp_over_floor(), pool_size=12)
    outcome = render_loop(renderer, Stops(spp=1e6), should_stop=lambda: next(left, True))
    assert outcome.reason == "interrupted"
    assert (outcome.statistics.samples == 0) == (calls < 2)
    assert outcome.statistics.samples < 1e6 * PIXELS
    assert (len(outcome.rows) == 0) == (calls == 0)
    if calls:
        assert outcome.rows[-1].samples == outcome.statistics.samples
    assert_sound(outcome.statistics)


def test_progress_is_reported():
    states = []
    render_loop(
        Renderer(lamp_over_floor(), strategy="uniform"),
        Stops(time=0.8, error=1e-9),
        on_progress=lambda *state: states.append(state),
    )
    assert len(states) >= 2
    elapsed, samples, error, remaining = zip(*states, strict=True)
    assert list(elapsed) == sorted(elapsed)
    assert list(samples) == sorted(samples)
    assert all(0 <= seconds <= 0.8 for seconds in remaining)
    assert error[-1] > 0


@pytest.mark.parametrize(
    "name",
    ["isonoise", "isonoise.render_scene", "isonoise.renderer", "isonoise.scene.scene", "isonoise.strategies.base"],
)
def test_examples_in_docstrings(name):
    result = doctest.testmod(importlib.import_module(name), extraglobs={"isonoise": isonoise})
    assert result.attempted > 0
    assert result.failed == 0


def test_an_action_happens_only_while_it_is_wanted_and_may_end_the_render():
    asked, seen = itertools.count(), []

    def act(loop):
        nonlocal asked
        asked = itertools.count()
        image = loop.renderer.image()  # in the middle of a wave without the other statistics
        assert image.tobytes() == loop.renderer.statistics().rgb.tobytes()
        seen.append((loop.renderer.wave_kind, loop.progress().samples))
        if len(seen) == 6:
            loop.stop()

    with Renderer(lamp_over_floor(), strategy="uniform", pool_size=32) as renderer:
        render = RenderLoop(renderer, Stops(spp=1e6), periodic=[Periodic(0.0, act, lambda: next(asked) >= 3)])
        outcome = render.run()
    assert outcome.reason == "interrupted"
    assert render.is_stopped
    assert len(seen) == 6
    assert "uniform" in [kind for kind, _ in seen]  # in the middle of a wave
    samples = [number for _, number in seen]
    assert samples == sorted(samples)
    never = Periodic(0.0, lambda loop: pytest.fail("not wanted"), lambda: False)
    with Renderer(lamp_over_floor(), strategy="uniform") as renderer:
        assert render_loop(renderer, Stops(spp=4), periodic=[never]).reason == "spp"
