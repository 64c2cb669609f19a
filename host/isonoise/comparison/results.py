"""Reads a comparison's folder: the plan, the finished runs, the references; called by `summary`, `report`, `poster`."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from isonoise.comparison.checked_files import InvalidFileError, read_npz
from isonoise.comparison.identity import run_identity
from isonoise.comparison.plan import PLAN_FILE, SceneEntry, read_plan, run_path
from isonoise.comparison.reference_error import neighbour_mean, reference_rel_mse, relative_to_floor
from isonoise.comparison.reference_files import read_digests, read_scene_reference, read_variance
from isonoise.error.true_error import luminance_standard_error
from isonoise.errors import UserError
from isonoise.luminance import luminance
from isonoise.strategies.measures import image_floor


@dataclass(frozen=True)
class Run:
    """One finished run. Every property reads and checks the file anew; `Recorder.pack` lists the arrays of the file.

    `rows` is a list of dicts, one per wave (the log's columns and `device_s`), with nan for null.
    """

    path: Path
    seed: int
    identity: Mapping

    @property
    def rows(self) -> list[dict]:
        rows = json.loads(str(self._read("rows")))
        return [{key: np.nan if value is None else value for key, value in row.items()} for row in rows]

    @property
    def facts(self) -> dict:
        return json.loads(str(self._read("facts")))

    @property
    def rgb(self) -> np.ndarray:
        return self._read("rgb")

    @property
    def count(self) -> np.ndarray:
        return self._read("count")

    @property
    def snapshot_s(self) -> np.ndarray:
        return self._read("snapshot_s")

    @property
    def errors(self) -> np.ndarray:
        return self._read("errors")

    def is_valid(self) -> bool:
        """Whether the file is undamaged and has this identity."""
        try:
            read_npz(self.path, self.identity)
        except InvalidFileError:
            return False
        return True

    def _read(self, name: str) -> np.ndarray:
        return read_npz(self.path, self.identity)[name]


@dataclass(frozen=True)
class Reference:
    """A scene's reference; its own errors are None or 0 if the file has no standard errors."""

    rgb: np.ndarray
    luminance: np.ndarray
    floor: float
    relative_se: np.ndarray | None
    """Standard error of the luminance over max(luminance, floor)."""
    mean_relative_se: float = 0.0
    """Standard error of the mean luminance over the mean luminance (pixels independent)."""
    rel_mse: float = 0.0
    """Mean over pixels and RGB of se^2 / (r^2 + 0.01)."""

    @cached_property
    def bias_weight(self) -> np.ndarray:
        """max(r, floor) / max(m, floor), m the mean of r over the pixel's neighbours; see `metrics.bias`."""
        scale = np.maximum(neighbour_mean(self.luminance), self.floor)
        return np.divide(np.maximum(self.luminance, self.floor), scale, out=np.zeros_like(scale), where=scale > 0)


class Results:
    """A comparison's folder. Raises UserError if its plan cannot be read.

    `baseline` is the slug of the strategy that all others are compared with: `uniform` if it is in the plan, else the
    first.
    """

    def __init__(self, directory: Path):
        self.directory = Path(directory)
        plan = read_plan(self.directory)
        if plan is None:
            raise UserError(f"'{directory}' has no {PLAN_FILE}: it is not the folder of a comparison")
        self.plan = plan
        slugs = [strategy.slug for strategy in plan.strategies]
        self.baseline: str = "uniform" if "uniform" in slugs else slugs[0]
        self._runs: dict[str, dict[str, dict[int, Run]]] = {}

    def runs(self, scene: SceneEntry) -> dict[str, dict[int, Run]]:
        """Finished runs of a scene: strategy's slug -> seed -> run.

        Runs that are damaged or of something else are not finished. Strategies without runs are left out.
        """
        if scene.slug not in self._runs:
            self._runs[scene.slug] = self._find_runs(scene)
        return self._runs[scene.slug]

    def all_runs(self, scene: SceneEntry) -> list[Run]:
        """Finished runs of a scene, by strategy and seed in the order of the plan."""
        return [run for runs in self.runs(scene).values() for run in runs.values()]

    def _find_runs(self, scene: SceneEntry) -> dict[str, dict[int, Run]]:
        try:
            digests = read_digests(self.directory, self.plan, scene)
        except InvalidFileError:  # no run was measured against it
            return {}
        runs_by_strategy = {}
        for strategy in self.plan.strategies:
            runs = {}
            for seed in self.plan.seeds:
                path = run_path(self.directory, scene, strategy, seed)
                run = Run(path, seed, run_identity(self.plan, scene, strategy, seed, digests))
                if run.is_valid():
                    runs[seed] = run
            if runs:
                runs_by_strategy[strategy.slug] = runs
        return runs_by_strategy

    def reference(self, scene: SceneEntry) -> Reference:
        """Reference of a scene. Raises UserError if it cannot be read."""
        image = read_scene_reference(self.directory, self.plan, scene)
        r = luminance(image.rgb)
        floor = image_floor(r)
        if image.standard_error is None:
            return Reference(image.rgb, r, floor, None)
        se = luminance_standard_error(image.standard_error)
        total = float(r.sum())
        mean_se = float(np.sqrt(np.square(se).sum()) / total) if total > 0 else 0.0
        rel_mse = reference_rel_mse(image.rgb, image.standard_error)
        return Reference(image.rgb, r, floor, relative_to_floor(se, r, floor), mean_se, rel_mse)

    def variance(self, scene: SceneEntry) -> np.ndarray | None:
        """Relative variance of one sample, (height, width), or None if there is no valid one."""
        try:
            return read_variance(self.directory, self.plan, scene)[0]
        except InvalidFileError:
            return None


def common_seeds(runs: Mapping[str, Mapping[int, Run]]) -> list[int]:
    """Seeds that every strategy with finished runs has; all figures are computed from these."""
    sets = [set(by_seed) for by_seed in runs.values()]
    return sorted(set.intersection(*sets)) if sets else []
