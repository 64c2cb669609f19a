"""Runs a plan: renders the references, then every missing run to its own file; called by `isonoise compare`."""

import time
from collections.abc import Callable
from pathlib import Path

from isonoise.comparison.mitsuba_worker import MitsubaWorkers
from isonoise.comparison.plan import Plan, SceneEntry, StrategyEntry, run_path, variance_path
from isonoise.comparison.recorder import Recorder
from isonoise.comparison.references import ensure_reference, ensure_variance
from isonoise.comparison.strategy_specs import (
    MITSUBA_SAMPLERS,
    first_waves_spp,
    needs_variance,
    split_sampler,
    with_sampler,
    with_variance,
)
from isonoise.film.exr import read_reference
from isonoise.loop import Stops, render_loop
from isonoise.progress import ProgressBar, format_count, format_duration, format_percent
from isonoise.renderer import Renderer
from isonoise.samplers import SAMPLERS
from isonoise.strategies import describe

WARM_UP_S = 1.0
"""Seconds of the discarded render before the first run of a strategy on a scene: drivers compile at first use, and
caches fill."""


def run_plan(plan: Plan, directory: Path, device: str | None, log: Callable[[str], None]) -> None:
    """Render the missing runs to `directory`; `log` receives a line for every finished file.

    Finished runs are not touched. An interrupt loses only the run in progress. Raises UserError.
    """
    _Runner(plan, directory, device, log).run()


class _Runner:
    def __init__(self, plan: Plan, directory: Path, device: str | None, log: Callable[[str], None]):
        self.plan, self.directory, self.device, self.log = plan, directory, device, log
        self.stops = Stops(time=plan.time, spp=plan.spp)
        self.missing = [
            (scene, strategy, seed)
            for scene in plan.scenes
            for seed in plan.seeds
            # strategies alternate, so that drifts of the machine's speed affect all of them equally
            for strategy in plan.strategies
            if not run_path(directory, scene, strategy, seed).exists()
        ]
        self.total = len(self.missing)
        self.start = time.perf_counter()
        self.finished = 0
        self.warmed_up: set[tuple[str, str]] = set()

    def run(self) -> None:
        for scene in self.plan.scenes:
            runs = [(strategy, seed) for run_scene, strategy, seed in self.missing if run_scene is scene]
            self._ensure_references(scene, [strategy for strategy, _ in runs])
            reference = read_reference(self.directory / scene.reference) if runs else None
            with MitsubaWorkers(scene, self.plan.size, self.plan.max_depth) as workers:
                for strategy, seed in runs:
                    self._run(scene, strategy, seed, reference, workers)

    def _ensure_references(self, scene: SceneEntry, strategies: list[StrategyEntry]) -> None:
        """Render the reference, and the variance if one of the strategies is an oracle that needs it."""
        start = time.perf_counter()
        budget = Stops(time=self.plan.reference_time, spp=self.plan.spp if self.plan.reference_time is None else None)
        with ProgressBar() as bar:
            ensure_reference(self._renderer, scene, self.directory, budget, self.log, bar.show)
            if any(needs_variance(strategy.spec) for strategy in strategies):
                ensure_variance(self._renderer, scene, self.directory, budget, self.log, bar.show)
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
        with ProgressBar() as bar:

            def progress(elapsed_s: float, samples: int, *_) -> None:
                run = f"{scene.name}, {strategy.title}, seed {seed}"
                bar.show(
                    self.finished + self._progress(elapsed_s, samples, scene), self.total, f"{run}{self._remaining()}"
                )

            if strategy.spec in MITSUBA_SAMPLERS:
                last = workers.run(strategy.spec, seed, self.stops, reference, path, progress)
            else:
                last = self._render(scene, strategy, seed, reference, path, progress)
        self.finished += 1
        self.log(
            f"{scene.name}  {strategy.title}  seed {seed}  {format_duration(last['elapsed_s'])}  "
            f"{format_count(last['samples'])} samples  p99 {format_percent(last['true_p99'])}  "
            f"relMSE {last['true_rel_mse']:.3g}  "
            f"image mean ratio {last['true_energy_ratio']:.4f}  [{self.finished} of {self.total}{self._remaining()}]"
        )

    def _render(self, scene: SceneEntry, strategy: StrategyEntry, seed: int, reference, path: Path, progress) -> dict:
        """Render one run with isonoise; returns its last row."""
        spec, sampler = split_sampler(strategy.spec)
        if needs_variance(spec):
            spec = with_variance(spec, variance_path(self.directory, scene))
        if (scene.slug, strategy.slug) not in self.warmed_up:
            seconds = min(WARM_UP_S, self.stops.time or WARM_UP_S)
            warm_up = self._renderer(scene, strategy=spec, sampler=sampler, seed=seed)
            render_loop(warm_up, Stops(time=seconds, spp=self.stops.spp))
            self.warmed_up.add((scene.slug, strategy.slug))
        renderer = self._renderer(scene, strategy=spec, sampler=sampler, seed=seed, profile=True)
        recorder = Recorder(self.stops, *reference)
        outcome = render_loop(
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
        recorder.write(path, outcome.rows[-1], outcome.statistics.rgb, outcome.statistics.count, facts)
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
