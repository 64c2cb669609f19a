"""Renders on several workers: limits, signals, checkpoints, what is reported. The pool computes its tasks in `wait`."""

import csv
import functools
import itertools
import json
import signal
import sys
from contextlib import nullcontext

import numpy as np
import pytest
from small_scene import assert_same_bits, lamp_over_floor
from worker_pools import InlineCluster

from isonoise.cli import main
from isonoise.errors import DeviceError
from isonoise.film.exr import read_exr
from isonoise.loop import Periodic, RenderLoop, Stops
from isonoise.outcome import Outcome
from isonoise.renderer import Renderer
from isonoise.state.checkpoint import read_checkpoint, write_checkpoint

WIDTH, HEIGHT = 23, 19
"""Nine blocks of 8x8 pixels, so there are nine shards."""
POOL_SIZE = 128
"""Small, so that a task has many places at which it can stop."""
STOPS = Stops(spp=32)
STRATEGIES = ("pooled", *(pytest.param(name, marks=pytest.mark.long) for name in ("uniform", "relative-median")))


def make_renderer(workers: int = 0, strategy: str = "pooled", cluster: InlineCluster | None = None) -> Renderer:
    """On workers, or else on one device."""
    scene = lamp_over_floor(width=WIDTH, height=HEIGHT)
    cluster = InlineCluster(workers) if workers else cluster
    return Renderer(scene, strategy=strategy, pool_size=POOL_SIZE, cluster=cluster)


@functools.cache
def render_unbroken(strategy: str = "pooled") -> Outcome:
    """On one device."""
    return RenderLoop(make_renderer(strategy=strategy), STOPS).run()


@pytest.mark.parametrize("strategy", STRATEGIES)
def test_a_render_moves_between_one_device_and_several(strategy, tmp_path):
    """Stopped at random places, mostly in waves, and continued with another number of workers each time."""
    path, unbroken = tmp_path / "state.npz", render_unbroken(strategy)
    random, state, in_wave = np.random.default_rng(4), None, set()
    for part, workers in enumerate(itertools.cycle((0, 3, 0, 1, 2))):
        left = itertools.repeat(False, int(random.integers(2, (7 if workers else 20) if part < 10 else 10**6)))
        with make_renderer(workers, strategy) as renderer:
            loop = RenderLoop(
                renderer,
                STOPS,
                state=state,
                should_stop=lambda left=left: next(left, True),
                on_end=lambda loop: write_checkpoint(path, loop.state()),
            )
            outcome = loop.run()
        if outcome.reason != "interrupted":
            break
        state = read_checkpoint(path)
        wave = state.values["renderer"]["wave"]
        if wave and 0 < wave["traced"] < wave["planned"]:
            in_wave.add(workers > 0)
    assert in_wave == {False, True}
    assert_same_bits(outcome.statistics, unbroken.statistics)
    assert [row.samples for row in outcome.rows] == [row.samples for row in unbroken.rows]
    assert outcome.stated_error == unbroken.stated_error


def test_lost_tasks_and_workers_that_come_and_go_change_no_bit():
    """One in three tasks is lost; after each task a worker leaves, or another joins."""
    random = np.random.default_rng(5)

    def on_task(worker: str, task) -> bool:
        names = cluster.pools[0].names
        if random.random() < 0.5 and len(names) > 1:
            names.pop(int(random.integers(len(names))))
        else:
            names.append(f"late {task.number}")
        return bool(random.random() < 1 / 3)

    cluster = InlineCluster(3, on_task)
    renderer = make_renderer(cluster=cluster)
    outcome = RenderLoop(renderer, STOPS).run()
    assert_same_bits(outcome.statistics, render_unbroken().statistics)
    reports = renderer.worker_reports()
    assert sum(report.samples for report in reports) == renderer.samples == STOPS.spp * WIDTH * HEIGHT
    assert sum(report.lost for report in reports) > 0
    assert {report.is_ready for report in reports} == {False, True}


def test_what_is_reported_of_workers():
    with make_renderer(3) as renderer:
        one_device = make_renderer()
        assert renderer.features == one_device.features
        assert renderer.has_little_memory == one_device.has_little_memory is False
        assert renderer.device_seconds is None
        outcome = RenderLoop(renderer, STOPS).run()
        reports = renderer.worker_reports()
        assert [(report.name, report.device) for report in reports] == [
            (f"worker {number}", "a device") for number in range(3)
        ]
        assert sum(report.samples for report in reports) == renderer.samples
        assert all((report.tasks > 0) == (report.samples_per_s is not None) for report in reports)
        assert {row.workers for row in outcome.rows} <= {1, 2, 3}
        assert 0 <= outcome.client_share <= 1
        pool = renderer._distributed._pool
    assert pool.is_closed
    assert one_device.worker_reports() == []
    assert one_device.step().workers == 1
    assert RenderLoop(one_device, Stops(spp=1)).run().client_share is None


@pytest.mark.parametrize("stops", [Stops(error=8.0), Stops(time=0.2)], ids=("error", "time"))
def test_limits(stops):
    """With a limit of time sums are exact; with others so is every bit. Images are saved all the time."""
    saved = []
    save = Periodic(0.0, lambda loop: saved.append(loop.outcome_so_far("unfinished").statistics.samples))
    renderer = make_renderer(2)
    outcome = RenderLoop(renderer, stops, periodic=[save]).run()
    assert outcome.statistics.samples == renderer.samples
    assert len(set(saved)) > len(outcome.rows)  # within waves, too
    if stops.time is not None:
        assert outcome.reason == "time"
        return
    unbroken = RenderLoop(make_renderer(), stops).run()
    assert outcome.reason == unbroken.reason
    assert outcome.error_bound == unbroken.error_bound
    assert_same_bits(outcome.statistics, unbroken.statistics)


@pytest.mark.parametrize(
    "error",
    [DeviceError("the last one is gone"), pytest.param(KeyboardInterrupt(), marks=pytest.mark.long)],
    ids=("failure", "signal"),
)
def test_a_render_that_fails_in_a_wave_can_be_continued(error, tmp_path):
    """With what has entered the statistics; a program that uses `Renderer` gets its Ctrl-C as an exception."""
    left = itertools.repeat(None, 4)

    def on_task(worker, task) -> None:
        if next(left, error) is not None:
            raise error

    loop = RenderLoop(make_renderer(cluster=InlineCluster(3, on_task)), STOPS)
    with pytest.raises(type(error)):
        loop.run()
    samples = loop.renderer.samples
    assert 0 < samples < STOPS.spp * WIDTH * HEIGHT
    assert loop.outcome_so_far("failed").statistics.samples == samples
    write_checkpoint(tmp_path / "state.npz", loop.state())
    state = read_checkpoint(tmp_path / "state.npz")
    assert state.values["renderer"]["wave"] is not None
    outcome = RenderLoop(make_renderer(), STOPS, state=state).run()
    assert_same_bits(outcome.statistics, render_unbroken().statistics)


def test_the_command_reports_workers_and_continues_without_them(monkeypatch, tmp_path, capsys):
    """Image, log, checkpoint and --json of a render on workers; then a continuation on one device, with a warning."""
    monkeypatch.chdir(tmp_path)
    small = ("render", "cornell", "--size", f"{WIDTH}x{HEIGHT}", "--checkpoint", "a.npz", "--json")
    cluster = InlineCluster(2)
    with monkeypatch.context() as patch:
        patch.setattr("isonoise.commands.render.cluster_of", lambda options: nullcontext(cluster))
        assert main([*small, "--spp", "8", "-o", "a.exr", "-o", "a.png", "--log", "a.csv"]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    result = json.loads(out)
    assert [worker["name"] for worker in result["workers"]] == cluster.names
    assert sum(worker["samples"] for worker in result["workers"]) == result["samples"] == 8 * WIDTH * HEIGHT
    assert 0 <= result["client_share"] <= 1
    assert read_exr("a.exr")[1]["isonoise.device"] == result["device"] == "a device"
    with open("a.csv", newline="") as file:
        assert list(csv.DictReader(file))[-1]["workers"] == str(result["last_wave"]["workers"])
    assert cluster.pools[0].is_closed
    assert main([*small, "--resume", "a.npz", "--spp", "16", "-o", "b.exr"]) == 0
    out, err = capsys.readouterr()
    assert err.startswith("isonoise: warning: the render was begun on a device; its last bits may differ on ")
    assert json.loads(out)["workers"] == []


@pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals")
@pytest.mark.usefixtures("in_tmp_path")
def test_a_signal_ends_a_render_on_workers_with_its_image(monkeypatch):
    cluster = InlineCluster(2, lambda worker, task: signal.raise_signal(signal.SIGTERM) if task.number == 3 else None)
    monkeypatch.setattr("isonoise.commands.render.cluster_of", lambda options: nullcontext(cluster))
    code = main(["render", "cornell", "--size", f"{WIDTH}x{HEIGHT}", "--spp", "64", "-o", "a.exr"])
    assert code == 128 + signal.SIGTERM
    channels, header = read_exr("a.exr")
    assert header["isonoise.stopped_by"] == "interrupted"
    assert 0 < channels["samples"].sum() < 64 * WIDTH * HEIGHT
    assert cluster.pools[0].is_closed
