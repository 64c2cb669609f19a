"""Carries out a plan: references first, then every run that is not there yet; each is a file that appears whole."""

import time
from collections.abc import Callable
from pathlib import Path

from isonoise.comparison.mitsuba_peer import Peers
from isonoise.comparison.plan import Plan, SceneEntry, StrategyEntry
from isonoise.comparison.recording import Recorder
from isonoise.comparison.references import ensure_reference, ensure_variance
from isonoise.comparison.specs import PEERS, needs_variance, with_variance
from isonoise.film.exr import read_reference
from isonoise.loop import Stops, render_loop
from isonoise.progress import ProgressBar, format_count, format_duration, format_percent
from isonoise.renderer import Renderer
from isonoise.strategies import describe

WARM_UP = 1.0
"""Seconds of the render that is thrown away before the first run of a strategy on a scene: drivers compile at first
use, and caches fill."""


def run_path(directory: Path, scene: SceneEntry, strategy: StrategyEntry, seed: int) -> Path:
    """Where a run's file is."""
    return directory / "runs" / scene.slug / strategy.slug / f"{seed}.npz"


def execute(plan: Plan, directory: Path, device: str | None, say: Callable[[str], None]) -> None:
    """Render what is missing below `directory`; `device` chooses one, `say` gets a line for all that is finished.

    Runs that are there stay as they are. An interrupt drops the run in flight and nothing else. Raises UserError.
    """
    _Runner(plan, directory, device, say).run()


class _Runner:
    def __init__(self, plan: Plan, directory: Path, device: str | None, say: Callable[[str], None]):
        self.plan, self.directory, self.device, self.say = plan, directory, device, say
        self.stops = Stops(time=plan.time, spp=plan.spp)
        self.missing = [
            (scene, strategy, seed)
            for scene in plan.scenes
            for seed in plan.seeds
            # strategies alternate, so that drifts of the machine's speed hit all alike
            for strategy in plan.strategies
            if not run_path(directory, scene, strategy, seed).exists()
        ]
        self.total = len(self.missing)
        self.begun = time.perf_counter()
        self.done = 0
        self.warm: set[tuple[str, str]] = set()

    def run(self) -> None:
        for scene in self.plan.scenes:
            runs = [(strategy, seed) for of, strategy, seed in self.missing if of is scene]
            self._prepare(scene, [strategy for strategy, _ in runs])
            reference = read_reference(self.directory / scene.reference) if runs else None
            with Peers(scene, self.plan.size, self.plan.max_depth) as peers:
                for strategy, seed in runs:
                    self._one(scene, strategy, seed, reference, peers)

    def _prepare(self, scene: SceneEntry, strategies: list[StrategyEntry]) -> None:
        """The reference, and the variance where an oracle asks for it."""
        begun = time.perf_counter()
        budget = Stops(time=self.plan.reference_time, spp=self.plan.spp if self.plan.reference_time is None else None)
        with ProgressBar() as bar:
            ensure_reference(self._renderer, scene, self.directory, budget, self.say, bar.show)
            if any(needs_variance(strategy.spec) for strategy in strategies):
                ensure_variance(self._renderer, scene, self.directory, budget, self.say, bar.show)
        self.begun += time.perf_counter() - begun  # the estimate of the time left goes by the runs alone

    def _renderer(self, scene: SceneEntry, **options) -> Renderer:
        size, depth = self.plan.size, self.plan.max_depth
        return Renderer(scene.source, device=self.device, size=size, max_depth=depth, **options)

    def _one(self, scene: SceneEntry, strategy: StrategyEntry, seed: int, reference, peers: Peers) -> None:
        path = run_path(self.directory, scene, strategy, seed)
        with ProgressBar() as bar:

            def progress(elapsed_s: float, samples: int, *_) -> None:
                where = f"{scene.name}, {strategy.title}, seed {seed}"
                bar.show(self.done + self._share(elapsed_s, samples, scene), self.total, f"{where}{self._left()}")

            if strategy.spec in PEERS:
                last = peers.run(strategy.spec, seed, self.stops, reference, path, progress)
            else:
                last = self._render(scene, strategy, seed, reference, path, progress)
        self.done += 1
        self.say(
            f"{scene.name}  {strategy.title}  seed {seed}  {format_duration(last['elapsed_s'])}  "
            f"{format_count(last['samples'])} samples  p99 {format_percent(last['true_p99'])}  "
            f"relMSE {last['true_rel_mse']:.3g}  "
            f"image mean ratio {last['true_energy_ratio']:.4f}  [{self.done} of {self.total}{self._left()}]"
        )

    def _render(self, scene: SceneEntry, strategy: StrategyEntry, seed: int, reference, path: Path, progress) -> dict:
        """One run of a strategy of the renderer's own; returns its last row."""
        spec = strategy.spec
        if needs_variance(spec):
            spec = with_variance(spec, self.directory / "references" / f"{scene.slug}-variance.exr")
        if (scene.slug, strategy.slug) not in self.warm:
            seconds = min(WARM_UP, self.stops.time or WARM_UP)
            render_loop(self._renderer(scene, strategy=spec, seed=seed), Stops(time=seconds, spp=self.stops.spp))
            self.warm.add((scene.slug, strategy.slug))
        renderer = self._renderer(scene, strategy=spec, seed=seed, profile=True)
        recorder = Recorder(self.stops, reference[0])
        outcome = render_loop(
            renderer,
            self.stops,
            on_wave=lambda row, statistics: recorder.wave(row, statistics.rgb, renderer.device_seconds),
            on_progress=progress,
            reference=reference,
        )
        facts = {
            "strategy": describe(renderer.strategy),
            "scene": scene.name,
            "seed": seed,
            "device": renderer.device_name,
            "setup_s": sum(renderer.setup_times.values()),
            "samples": outcome.statistics.samples,
            "elapsed_s": outcome.elapsed_s,
            "stopped_by": outcome.reason,
        }
        recorder.write(path, outcome.rows[-1], outcome.statistics.rgb, outcome.statistics.count, facts)
        return recorder.rows[-1]

    def _share(self, elapsed_s: float, samples: int, scene: SceneEntry) -> float:
        """How much of the run in flight is done."""
        if self.stops.time is not None:
            return min(elapsed_s / self.stops.time, 1.0)
        return min(samples / (self.stops.spp * scene.width * scene.height), 1.0)

    def _left(self) -> str:
        """How long the runs that are missing will take, at the pace so far."""
        if not self.done or self.done == self.total:
            return ""
        seconds = (time.perf_counter() - self.begun) / self.done * (self.total - self.done)
        return f", {format_duration(seconds)} left"
