"""Runs a plan: renders the references, then every missing run to its own file; called by `isonoise compare`."""

import os
import time
from collections.abc import Callable
from pathlib import Path

from isonoise.comparison.checked_files import InvalidFileError, make_folder, read_npz
from isonoise.comparison.folder_lock import FolderLock
from isonoise.comparison.identity import ImageDigests, run_identity
from isonoise.comparison.interruptible import interruptible_render
from isonoise.comparison.mitsuba_worker import MitsubaWorkers
from isonoise.comparison.plan import Plan, SceneEntry, StrategyEntry, run_path, variance_path
from isonoise.comparison.recorder import Recorder
from isonoise.comparison.reference_files import read_digests, read_scene_reference
from isonoise.comparison.references import ReferenceRenderer
from isonoise.comparison.strategy_specs import (
    MITSUBA_SAMPLERS,
    first_waves_spp,
    needs_variance,
    split_sampler,
    with_sampler,
    with_variance,
)
from isonoise.loop import Stops
from isonoise.progress import ProgressBar, format_count, format_duration, format_number, format_percent
from isonoise.renderer import Renderer
from isonoise.samplers import SAMPLERS
from isonoise.strategies import describe

WARM_UP_S = 1.0
"""Seconds of the discarded render before the first run of a strategy on a scene: drivers compile at first use, and
caches fill."""
MAX_NAMED_RUNS = 3
"""Runs that a warning names."""

_Run = tuple[SceneEntry, StrategyEntry, int]


def run_plan(
    plan: Plan, lock: FolderLock, device: str | None, log: Callable[[str], None], warn: Callable[[str], None]
) -> None:
    """Render the runs that the locked folder lacks; `log` receives a line for every finished file.

    Runs that are damaged, of something else, or measured against another reference are rendered again, before others;
    `warn` receives a line for each reason. Valid runs are not touched. An interrupt loses only the run in progress.
    Raises UserError.
    """
    _Runner(plan, lock, device, log, warn).run()


class _Runner:
    def __init__(
        self,
        plan: Plan,
        lock: FolderLock,
        device: str | None,
        log: Callable[[str], None],
        warn: Callable[[str], None],
    ):
        self.plan, self.lock, self.device, self.log, self.warn = plan, lock, device, log, warn
        self.directory = lock.directory
        self.stops = Stops(time=plan.time, spp=plan.spp)
        self.references = ReferenceRenderer(self._renderer, plan, self.directory, log, warn)
        self.digests: dict[str, ImageDigests] = {}
        self.total = self.finished = 0
        self.start = time.perf_counter()
        self.warmed_up: set[tuple[str, str]] = set()

    def run(self) -> None:
        planned = [
            (scene, strategy, seed)
            for scene in self.plan.scenes
            for seed in self.plan.seeds
            # strategies alternate, so that drifts of the machine's speed affect all of them equally
            for strategy in self.plan.strategies
        ]
        existing = {run: os.path.lexists(run_path(self.directory, *run)) for run in planned}
        invalid = self._find_invalid([run for run in planned if existing[run]])
        missing = [run for run in planned if not existing[run]]
        self.total = len(invalid) + len(missing)
        for runs in (invalid, missing):
            for scene in self.plan.scenes:
                self._render_runs(scene, [run for run in runs if run[0] == scene])

    def _find_invalid(self, runs: list[_Run]) -> list[_Run]:
        """Those of the existing runs that have to be rendered again; a warning for each reason."""
        reasons = {}
        for scene, strategy, seed in runs:
            self._ensure_references(scene)
            try:
                read_npz(run_path(self.directory, scene, strategy, seed), self._identity(scene, strategy, seed))
            except InvalidFileError as error:
                reasons[scene, strategy, seed] = error.reason
        for reason in dict.fromkeys(reasons.values()):
            names = [str(run_path(Path(), *run)) for run in reasons if reasons[run] == reason]
            more = f" and {len(names) - MAX_NAMED_RUNS} more" if len(names) > MAX_NAMED_RUNS else ""
            self.warn(f"rendering again {', '.join(names[:MAX_NAMED_RUNS])}{more}: {reason}")
        return list(reasons)

    def _identity(self, scene: SceneEntry, strategy: StrategyEntry, seed: int) -> dict:
        return run_identity(self.plan, scene, strategy, seed, self.digests[scene.slug])

    def _render_runs(self, scene: SceneEntry, runs: list[_Run]) -> None:
        if not runs:
            return
        self._ensure_references(scene)
        reference = read_scene_reference(self.directory, self.plan, scene)
        with MitsubaWorkers(scene, self.plan.size, self.plan.max_depth) as workers:
            for _, strategy, seed in runs:
                self._run(scene, strategy, seed, (reference.rgb, reference.standard_error), workers)

    def _ensure_references(self, scene: SceneEntry) -> None:
        """Render the reference, and the variance if a strategy is an oracle that needs it, unless they are valid."""
        if scene.slug in self.digests:
            return
        self.lock.check()
        start = time.perf_counter()
        with ProgressBar() as bar:
            self.references.ensure_reference(scene, bar.show)
            if any(needs_variance(strategy.spec) for strategy in self.plan.strategies):
                self.references.ensure_variance(scene, bar.show)
        self.digests[scene.slug] = read_digests(self.directory, self.plan, scene)
        self.start += time.perf_counter() - start  # the estimate of the remaining time is based on the runs alone

    def _renderer(self, scene: SceneEntry, sampler: str = SAMPLERS[0], **options) -> Renderer:
        """A renderer with the size, depth and device of the comparison; the sampler of the scene is ignored."""
        return Renderer(
            scene.source,
            device=self.device,
            size=self.plan.size,
            max_depth=self.plan.max_depth,
            sampler=sampler,
            allow_outside=self.plan.allow_outside,
            **options,
        )

    def _run(self, scene: SceneEntry, strategy: StrategyEntry, seed: int, reference, workers: MitsubaWorkers) -> None:
        path = run_path(self.directory, scene, strategy, seed)
        identity = self._identity(scene, strategy, seed)
        self.lock.check()
        make_folder(path.parent)
        with ProgressBar() as bar:

            def progress(elapsed_s: float, samples: int, *_) -> None:
                run = f"{scene.name}, {strategy.title}, seed {seed}"
                bar.show(
                    self.finished + self._progress(elapsed_s, samples, scene), self.total, f"{run}{self._remaining()}"
                )

            if strategy.spec in MITSUBA_SAMPLERS:
                last = workers.run(strategy.spec, seed, self.stops, reference, path, identity, progress)
            else:
                last = self._render(scene, strategy, seed, reference, path, identity, progress)
        self.finished += 1
        self.log(
            f"{scene.name}  {strategy.title}  seed {seed}  {format_duration(last['elapsed_s'])}  "
            f"{format_count(last['samples'])} samples  p99 {format_percent(last['true_p99'])}  "
            f"relMSE {format_number(last['true_rel_mse'])}  "
            f"image mean ratio {last['true_energy_ratio']:.4f}  [{self.finished} of {self.total}{self._remaining()}]"
        )

    def _render(
        self, scene: SceneEntry, strategy: StrategyEntry, seed: int, reference, path: Path, identity: dict, progress
    ) -> dict:
        """Render one run with isonoise; returns its last row."""
        spec, sampler = split_sampler(strategy.spec)
        if needs_variance(spec):
            spec = with_variance(spec, variance_path(self.directory, scene))
        if (scene.slug, strategy.slug) not in self.warmed_up:
            seconds = min(WARM_UP_S, self.stops.time or WARM_UP_S)
            warm_up = self._renderer(scene, strategy=spec, sampler=sampler, seed=seed)
            interruptible_render(warm_up, Stops(time=seconds, spp=self.stops.spp))
            self.warmed_up.add((scene.slug, strategy.slug))
        renderer = self._renderer(scene, strategy=spec, sampler=sampler, seed=seed, profile=True)
        recorder = Recorder(self.stops, *reference)
        outcome = interruptible_render(
            renderer,
            self.stops,
            on_wave=lambda row, statistics: recorder.wave(row, statistics.rgb, renderer.device_seconds),
            on_progress=progress,
            reference=reference,
        )
        first_wave_spp, warm_up_spp = first_waves_spp(renderer.strategy)
        facts = {
            "strategy": with_sampler(describe(renderer.strategy), sampler),
            "first_wave_spp": first_wave_spp,
            "warm_up_spp": warm_up_spp,
            "scene": scene.name,
            "seed": seed,
            "device": f"{renderer.device_name}, {renderer.driver}",
            "setup_s": sum(renderer.setup_times.values()),
            "samples": outcome.statistics.samples,
            "elapsed_s": outcome.elapsed_s,
            "stopped_by": outcome.reason,
        }
        recorder.write(path, outcome.rows[-1], outcome.statistics.rgb, outcome.statistics.count, facts, identity)
        return recorder.rows[-1]

    def _progress(self, elapsed_s: float, samples: int, scene: SceneEntry) -> float:
        """Finished share of the run in progress."""
        if self.stops.time is not None:
            return min(elapsed_s / self.stops.time, 1.0)
        return min(samples / (self.stops.spp * scene.width * scene.height), 1.0)

    def _remaining(self) -> str:
        """Remaining time as text, estimated from the finished runs; empty if none is finished or missing."""
        if not self.finished or self.finished == self.total:
            return ""
        seconds = (time.perf_counter() - self.start) / self.finished * (self.total - self.finished)
        return f", {format_duration(seconds)} left"
