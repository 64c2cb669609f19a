"""Which runs a comparison has, in which order they are rendered, and which of the existing ones are invalid.

Called by `runner`.
"""

import os
from collections.abc import Callable, Iterable, Mapping
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

from isonoise.comparison.checked_files import InvalidFileError, read_npz
from isonoise.comparison.plan import Plan, SceneEntry, StrategyEntry, run_path

MAX_NAMED_RUNS = 3
"""Runs that a warning names."""


class PlannedRun(NamedTuple):
    """A run of the plan."""

    scene: SceneEntry
    strategy: StrategyEntry
    seed: int

    @property
    def title(self) -> str:
        return f"{self.scene.name}, {self.strategy.title}, seed {self.seed}"


def planned_runs(plan: Plan) -> list[PlannedRun]:
    """All runs. Strategies alternate, so that drifts of the machine's speed affect all of them equally."""
    return [
        PlannedRun(scene, strategy, seed)
        for scene in plan.scenes
        for seed in plan.seeds
        for strategy in plan.strategies
    ]


def split_existing(runs: Iterable[PlannedRun], directory: Path) -> tuple[list[PlannedRun], list[PlannedRun]]:
    """Those that have a file, sound or not, and those that have none."""
    existing, missing = [], []
    for run in runs:
        (existing if os.path.lexists(run_path(directory, *run)) else missing).append(run)
    return existing, missing


def find_invalid(
    runs: Iterable[PlannedRun], directory: Path, identity: Callable[[PlannedRun], Mapping]
) -> dict[PlannedRun, str]:
    """The existing runs that have to be rendered again, with the reason; `identity` says what a run should be."""
    reasons = {}
    for run in runs:
        try:
            read_npz(run_path(directory, *run), identity(run))
        except InvalidFileError as error:
            reasons[run] = error.reason
    return reasons


def invalid_run_messages(reasons: Mapping[PlannedRun, str]) -> list[str]:
    """A message for each reason."""
    messages = []
    for reason in dict.fromkeys(reasons.values()):
        names = [str(run_path(Path(), *run)) for run in reasons if reasons[run] == reason]
        more = f" and {len(names) - MAX_NAMED_RUNS} more" if len(names) > MAX_NAMED_RUNS else ""
        messages.append(f"rendering again {', '.join(names[:MAX_NAMED_RUNS])}{more}: {reason}")
    return messages


def runs_by_scene(runs: Iterable[PlannedRun]) -> list[list[PlannedRun]]:
    """Consecutive runs of the same scene."""
    return [list(group) for _, group in groupby(runs, key=lambda run: run.scene)]
