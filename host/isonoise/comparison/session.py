"""Begins or continues the comparison of a folder and renders what is missing; called by the command and by `api`."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from isonoise.comparison.checked_files import make_folder
from isonoise.comparison.environment import record_environment
from isonoise.comparison.folder_lock import FolderLock
from isonoise.comparison.plan import PLAN_FILE, Plan, read_plan, write_plan
from isonoise.comparison.plan_changes import additions, differences
from isonoise.comparison.planning import make_plan, scene_objects
from isonoise.comparison.request import Request
from isonoise.comparison.strategy_specs import needs_variance, with_variance
from isonoise.errors import UserError
from isonoise.film.files import remove_temporary_files, write_atomically
from isonoise.signals import exit_code

if TYPE_CHECKING:
    from isonoise.comparison.cluster.workers import ClusterWorkers

EXPERIMENT_FILE = "experiment.toml"
"""The copy in the folder of a comparison."""
RERUN_CHANGED = "--rerun-changed"
KEPT = "finished runs are kept: rerun the same command to resume"


def render_comparison(
    request: Request,
    lock: FolderLock,
    log: Callable[[str], object],
    warn: Callable[[str], object],
    workers: "ClusterWorkers | None" = None,
    rerun_changed: bool = False,
    shared: Path | None = None,
) -> None:
    """Render the runs of a comparison that its locked folder lacks.

    Parameters
    ----------
    log, warn : callable
        For a line about what is finished, and about what is rendered again.
    workers : ClusterWorkers or None
        Where to render; None: on the request's device.
    rerun_changed : bool
        Whether runs of another version, driver or device, and those of edited scenes and strategies are rendered
        again. Otherwise they are an error.
    shared : Path or None
        Folder of another comparison of the same scenes, whose references are used.

    Raises
    ------
    SceneError, DeviceError, UserError
        As `make_plan` and `run_plan`; also if the folder holds another comparison.
    """
    directory = lock.directory
    stored = read_plan(directory)
    plan = make_plan(request, stored, workers and workers.common_device(stored and stored.device))
    if any(needs_variance(strategy.spec) for strategy in plan.strategies):
        with_variance("oracle", directory.resolve())
    _begin(directory, stored, plan, log, warn, rerun_changed)
    _record(directory, request, has_workers=workers is not None)

    from isonoise.comparison.runner import run_plan

    if shared is not None and shared != directory:
        from isonoise.comparison.series import share_references

        share_references(shared, directory, plan)
    objects: Mapping[str, object] = scene_objects(request)
    try:
        # with workers the option names their device, and this process takes its default
        run_plan(plan, lock, None if workers else request.device, log, warn, workers, objects)
    except UserError as error:
        if has_runs(directory) and exit_code() is None:
            raise UserError(f"{error}; {KEPT}") from error
        raise


def check_is_series(directory: Path) -> None:
    """Raises UserError if the folder of an experiment with several budgets or devices holds a single comparison."""
    if (directory / PLAN_FILE).exists():
        raise UserError(f"'{directory}' holds a comparison with one budget and device: choose another folder with -o")


def has_runs(directory: Path) -> bool:
    """Whether a run of the comparison is finished."""
    return any((directory / "runs").glob("*/*/[0-9]*.npz"))


def _begin(
    directory: Path,
    stored: Plan | None,
    plan: Plan,
    log: Callable[[str], object],
    warn: Callable[[str], object],
    rerun_changed: bool,
) -> None:
    """Write the plan, unless the folder holds another comparison."""
    if stored is None and _holds_series(directory):
        raise UserError(
            f"'{directory}' holds comparisons with several budgets or devices: choose another folder with -o"
        )
    if stored is not None:
        found = differences(stored, plan)
        if found.settings:
            raise UserError(
                f"'{directory}' holds another comparison: {'; '.join(found.settings)}. Give the same settings (scenes, "
                "strategies and seeds can be added) to resume it, or another folder with -o"
            )
        if found.changes and not rerun_changed:
            raise UserError(
                f"'{directory}' was rendered with something else: {'; '.join(found.changes)}. Restore it, or give "
                f"{RERUN_CHANGED} to render again what depends on it, or another folder with -o"
            )
        for change in found.changes:
            warn(f"{change}: what depends on it is rendered again")
        added = additions(stored, plan)
        log(f"resuming {directory}" + (f", added: {', '.join(added)}" if added else ""))
    remove_temporary_files(directory)
    make_folder(directory / "references")
    write_plan(directory, plan)


def _holds_series(directory: Path) -> bool:
    """Whether the folder is that of an experiment with several budgets or devices: `experiment.make_members`."""
    folders = ("spp-*", "time-*", "device-*", "device-*/*")
    return any(path for folder in folders for path in directory.glob(f"{folder}/{PLAN_FILE}"))


def _record(directory: Path, request: Request, has_workers: bool) -> None:
    """Write what renders the comparison, and the experiment's file that it is a part of."""
    from isonoise.device.selection import select_device

    record_environment(directory, None if has_workers else select_device(request.device))
    if text := request.experiment:
        write_atomically(directory / EXPERIMENT_FILE, lambda file: file.write_text(text, encoding="utf-8"))
