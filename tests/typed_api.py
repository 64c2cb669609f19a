"""Uses the public names as a program does, for type checkers: `mypy` in `.ci/run` and test_types.py. Nothing is run."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from typing_extensions import assert_type

import isonoise


def render_with_callbacks(path: Path) -> isonoise.Outcome:
    def show(row: isonoise.LogRow, statistics: isonoise.Statistics) -> None:
        assert_type(row.stated_p99, float)
        assert_type(row.true, isonoise.TrueError | None)
        assert_type(statistics.count, np.ndarray)
        assert_type(statistics.median, np.ndarray | None)

    first = isonoise.render(path, spp=4, size=(8, 8), strategy="uniform", seed=3)
    outcome = isonoise.render("cornell", time=1.0, reference=first, on_wave=show, progress=False)
    isonoise.render("cornell", reference=(first.rgb, None), progress=lambda elapsed, samples, error, left: None)
    assert_type(outcome.rgb, np.ndarray)
    assert_type(outcome.rows, list[isonoise.LogRow])
    return outcome


def iterate(view: isonoise.View) -> int:
    with isonoise.Renderer({"type": "scene"}, view=view, device=0) as renderer:
        for wave in renderer:
            assert_type(wave, isonoise.WaveRecord)
            assert_type(wave.statistics.mean, np.ndarray)
            if wave.number == 3:
                break
        renderer.reset(4)
        state = renderer.state()
        assert_type(state, isonoise.State)
        isonoise.write_checkpoint("state.npz", state)
    return renderer.samples


def loop(renderer: isonoise.Renderer) -> None:
    save = isonoise.Periodic(10.0, lambda loop: None)
    stops = isonoise.Stops(error=0.02, time=60)
    result = isonoise.RenderLoop(renderer, stops, periodic=[save]).run()
    assert_type(result, isonoise.Outcome)


def scenes() -> isonoise.CompiledScene:
    scene = isonoise.load("cornell", size=(32, 32))
    scene["film.size"] = (16, 16)
    assert_type(scene, isonoise.Scene)
    return scene.compile()


def images(path: Path) -> None:
    channels, header = isonoise.read_exr(path)
    assert_type(channels, dict[str, np.ndarray])
    isonoise.write_exr(path, {"": channels["R"]}, header)


class Own(isonoise.Strategy):
    """A strategy of a user: schedule and map."""

    name = "own"

    def __init__(self, window: int = 5):
        self.needs = isonoise.Needs(neighbours=window)

    def waves(self) -> Iterator[isonoise.Wave]:
        yield isonoise.Wave("uniform", 16)
        while True:
            yield isonoise.Wave("adaptive", 16)

    def allocate(self, statistics: isonoise.Statistics, budget: int | None) -> np.ndarray:
        floor = isonoise.measures.image_floor(statistics.mean)
        error = isonoise.measures.relative_mean(statistics, floor)
        return isonoise.allocation.distribute_in_proportion(error, budget or 1, statistics.samples)


class WithFixedNeeds(Own):
    """Needs as a class attribute."""

    needs = isonoise.Needs(median=True)


def strategies() -> list[isonoise.Outcome]:
    choices = [Own(7), WithFixedNeeds(), isonoise.Adaptive(measure="relative-mean", rule="sqrt")]
    return [isonoise.render("cornell", strategy=strategy) for strategy in choices]


def custom_pieces(renderer: isonoise.Renderer) -> isonoise.Strategy:
    def measure(statistics: isonoise.Statistics, floor: float) -> np.ndarray:
        return isonoise.measures.relative_mean(statistics, floor)

    def rule(count: np.ndarray, variance: np.ndarray, budget: int) -> np.ndarray:
        return isonoise.allocation.distribute_in_proportion(variance, budget, 0)

    for wave in isonoise.watch(renderer, spp=8):
        assert_type(wave, isonoise.WaveRecord)
    return isonoise.Adaptive(measure=measure, rule=rule)


def errors() -> str:
    try:
        isonoise.render("missing.xml")
    except (isonoise.SceneError, isonoise.DeviceError, isonoise.UserError) as error:
        return str(error)
    return ""
