"""Reads what a comparison has left in its folder: the plan, the runs that are finished, the references."""

import json
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from isonoise.errors import UserError
from isonoise.film.exr import read_exr, read_reference
from isonoise.luminance import luminance
from isonoise.strategies.measures import image_floor


@dataclass(frozen=True)
class Run:
    """One finished run; arrays and texts are read from the file when they are asked for.

    `rows`: list of dicts, one a wave (the log's columns and `device_s`), None read as nan. `facts`: dict.
    `count`: uint32 (height, width). `snapshot_s`: float64 (K,). `errors`: float16 (K, height, width), signed relative
    errors at these times, the last those of the final image.
    """

    path: Path
    seed: int

    @property
    def rows(self) -> list[dict]:
        rows = json.loads(str(self._read("rows")))
        return [{key: np.nan if value is None else value for key, value in row.items()} for row in rows]

    @property
    def facts(self) -> dict:
        return json.loads(str(self._read("facts")))

    @property
    def count(self) -> np.ndarray:
        return self._read("count")

    @property
    def snapshot_s(self) -> np.ndarray:
        return self._read("snapshot_s")

    @property
    def errors(self) -> np.ndarray:
        return self._read("errors")

    def _read(self, name: str) -> np.ndarray:
        try:
            with np.load(self.path) as file:
                return file[name]
        except (OSError, KeyError, ValueError, EOFError, zipfile.BadZipFile) as error:
            raise UserError(f"cannot read the run '{self.path}': {error}; delete it and start again") from error


@dataclass(frozen=True)
class Reference:
    """A scene's reference: RGB, luminance, floor, and its own relative standard error se / max(r, floor) or None."""

    rgb: np.ndarray
    luminance: np.ndarray
    floor: float
    relative_se: np.ndarray | None
    mean_relative_se: float
    """Standard error of the mean luminance over the mean luminance (pixels independent); 0 where none is stated."""


class Results:
    """A comparison's folder.

    `plan`: the content of plan.json. `scenes`, `strategies`: its entries, in its order. `baseline`: slug of the
    strategy that all others are compared with: `uniform` if it is among them, else the first.
    Raises UserError if there is no plan that can be read.
    """

    def __init__(self, directory: Path):
        self.directory = Path(directory)
        path = self.directory / "plan.json"
        try:
            self.plan = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise UserError(f"cannot read the comparison's plan '{path}': {error}") from error
        self.scenes: Sequence[Mapping] = self.plan["scenes"]
        self.strategies: Sequence[Mapping] = self.plan["strategies"]
        slugs = [strategy["slug"] for strategy in self.strategies]
        self.baseline: str = "uniform" if "uniform" in slugs else slugs[0]

    def runs(self, scene: str) -> dict[str, dict[int, Run]]:
        """Finished runs of a scene (its slug): strategy's slug -> seed -> run, in the plan's order; those with any."""
        found = {}
        for strategy in self.strategies:
            folder = self.directory / "runs" / scene / strategy["slug"]
            paths = {seed: folder / f"{seed}.npz" for seed in self.plan["seeds"]}
            runs = {seed: Run(path, seed) for seed, path in paths.items() if path.is_file()}
            if runs:
                found[strategy["slug"]] = runs
        return found

    def reference(self, scene: Mapping) -> Reference:
        """The reference that a scene's runs were measured against. Raises UserError if it cannot be read."""
        rgb, rgb_se = read_reference(self.directory / scene["reference"])
        r = luminance(rgb)
        floor = image_floor(r)
        if rgb_se is None:
            return Reference(rgb, r, floor, None, 0.0)
        # The three channels of a path share all its random decisions: they err together.
        se = luminance(np.abs(rgb_se))
        scale = np.maximum(r, floor)
        relative = np.divide(se, scale, out=np.zeros_like(se), where=scale > 0)
        total = float(r.sum())
        return Reference(rgb, r, floor, relative, float(np.sqrt(np.square(se).sum()) / total) if total > 0 else 0.0)

    def variance(self, scene: str) -> np.ndarray | None:
        """Relative variance of one sample, (height, width), where the comparison has it."""
        path = self.directory / "references" / f"{scene}-variance.exr"
        return read_exr(path)[0].get("variance") if path.is_file() else None


def common_seeds(runs: Mapping[str, Mapping[int, Run]]) -> list[int]:
    """Seeds that every strategy with finished runs has: figures over the seeds are compared at equal seeds only."""
    sets = [set(of_strategy) for of_strategy in runs.values()]
    return sorted(set.intersection(*sets)) if sets else []
