"""What the runs of a comparison are made from: compiled scenes, references, tasks; called by `runner`, `local_runs`."""

import time
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path

from isonoise.comparison.identity import ImageDigests, run_identity
from isonoise.comparison.plan import Plan, SceneEntry, variance_path
from isonoise.comparison.reference_files import read_scene_reference
from isonoise.comparison.run_order import PlannedRun
from isonoise.comparison.run_task import ReferenceArrays, RunTask
from isonoise.comparison.scene_source import compile_entry
from isonoise.comparison.strategy_specs import needs_variance, oracle_file, split_sampler, with_variance
from isonoise.loop import Stops
from isonoise.scene import CompiledScene
from isonoise.strategies import make_strategy

MAX_CACHED = 2
"""Scenes and references that are kept: workers may still render one scene while others begin with the next."""


class RunInputs:
    """Loads what the runs of the plan need, when it is needed.

    Parameters
    ----------
    plan : Plan
        The comparison.
    directory : Path
        Its folder.
    objects : mapping
        Scenes that are objects of a Python program, by `SceneEntry.source`.

    Attributes
    ----------
    stops : Stops
        The budget of a run.
    digests : dict
        Slug of a scene -> digests of its reference and variance. The caller adds those of a scene before the rest is
        asked for.
    """

    def __init__(self, plan: Plan, directory: Path, objects: Mapping[str, object]):
        self.plan, self._directory, self._objects = plan, directory, objects
        self.stops = Stops(time=plan.time, spp=plan.spp)
        self.digests: dict[str, ImageDigests] = {}
        self._load = lru_cache(MAX_CACHED)(self._load)
        self.reference = lru_cache(MAX_CACHED)(self.reference)

    def scene(self, entry: SceneEntry) -> CompiledScene:
        """The scene, as the plan changes it."""
        return self._load(entry)[0]

    def reference(self, entry: SceneEntry) -> ReferenceArrays:
        """The scene's reference. Raises UserError if it cannot be read."""
        image = read_scene_reference(self._directory, self.plan, entry)
        return image.rgb, image.standard_error

    def identity(self, run: PlannedRun) -> dict:
        return run_identity(self.plan, *run, self.digests[run.scene.slug])

    def task(self, run: PlannedRun) -> RunTask:
        """An oracle is an object, which has read its variances; other strategies are specs."""
        strategy, sampler = split_sampler(run.strategy.spec)
        if needs_variance(strategy):
            strategy = with_variance(strategy, variance_path(self._directory, run.scene))
        if oracle_file(strategy) is not None:
            strategy = make_strategy(strategy)
        load_s = self._load(run.scene)[1]
        return RunTask(run.scene.name, load_s, strategy, sampler, run.seed, self.stops, self.identity(run))

    def _load(self, entry: SceneEntry) -> tuple[CompiledScene, float]:
        """The scene, and the seconds it took to load it."""
        start = time.perf_counter()
        scene = compile_entry(entry, self._objects, self.plan.allow_outside)
        return scene, time.perf_counter() - start
