"""A run of a comparison as a pure function: from settings, scene and reference to the content of the run's file.

Called by `local_runs` in this process and by `cluster.runs` on a worker.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from isonoise.comparison.interruptible import interruptible_render
from isonoise.comparison.recorder import Recorder
from isonoise.comparison.strategy_specs import first_waves_spp, with_sampler
from isonoise.device.selection import SelectedDevice
from isonoise.errors import UserError
from isonoise.loop import Stops
from isonoise.renderer import Renderer
from isonoise.scene import CompiledScene
from isonoise.strategies import Strategy, describe

WARM_UP_S = 1.0
"""Seconds of the discarded render before the first run of a strategy on a scene: drivers compile at first use, and
caches fill."""

ReferenceArrays = tuple[np.ndarray, np.ndarray | None]
"""Linear RGB of a reference and its standard errors."""


@dataclass(frozen=True)
class RunTask:
    """What a run depends on, beside its scene and its reference."""

    scene_name: str
    load_s: float
    """Seconds that it took to load the scene."""
    strategy: str | Strategy
    sampler: str
    seed: int
    stops: Stops
    identity: Mapping
    """Of the file, see `identity`."""


class RunStoppedError(UserError):
    """`should_stop` has ended a run, which has no result."""


def warm_up(
    task: RunTask, scene: CompiledScene, device: SelectedDevice, should_stop: Callable[[], bool] = lambda: False
) -> None:
    """Render a second of the run, and discard it."""
    renderer = Renderer(scene, device, task.strategy, task.seed, sampler=task.sampler)
    seconds = min(WARM_UP_S, task.stops.time or WARM_UP_S)
    interruptible_render(renderer, Stops(time=seconds, spp=task.stops.spp), should_stop)


def render_run(
    task: RunTask,
    scene: CompiledScene,
    reference: ReferenceArrays,
    device: SelectedDevice,
    on_progress: Callable[..., None] | None = None,
    should_stop: Callable[[], bool] = lambda: False,
    worker: str | None = None,
) -> bytes:
    """Render a run.

    Parameters
    ----------
    device : SelectedDevice
        What to render on.
    on_progress, should_stop : callable
        As for `RenderLoop`.
    worker : str or None
        Name of the worker of a cluster that this process is.

    Returns
    -------
    bytes
        The content of the run's file, made by `Recorder.pack`.

    Raises
    ------
    RunStoppedError
        If `should_stop` has returned True.
    UserError
        As for `Renderer`.
    """
    renderer = Renderer(scene, device, task.strategy, task.seed, sampler=task.sampler, profile=True)
    recorder = Recorder(task.stops, *reference)
    outcome = interruptible_render(
        renderer,
        task.stops,
        should_stop,
        on_wave=lambda row, statistics: recorder.wave(row, statistics.rgb, renderer.device_seconds, statistics),
        on_progress=on_progress,
        reference=reference,
    )
    if outcome.reason == "interrupted":
        raise RunStoppedError("the run was stopped")
    first_wave_spp, warm_up_spp = first_waves_spp(renderer.strategy)
    facts = {
        "strategy": with_sampler(describe(renderer.strategy), task.sampler),
        "first_wave_spp": first_wave_spp,
        "warm_up_spp": warm_up_spp,
        "scene": task.scene_name,
        "seed": task.seed,
        "device": f"{device.kind}, {renderer.driver}",
        "parts": device.parts,
        "worker": worker,
        "setup_s": task.load_s + sum(renderer.setup_times.values()),
        "samples": outcome.statistics.samples,
        "elapsed_s": outcome.elapsed_s,
        "stopped_by": outcome.reason,
    }
    return recorder.pack(outcome.rows[-1], outcome.statistics.rgb, outcome.statistics.count, facts, task.identity)
