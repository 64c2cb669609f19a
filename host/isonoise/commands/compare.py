"""`isonoise compare`: checks the plan, renders the missing runs, writes tables, plots and the report."""

import argparse
import signal
from pathlib import Path
from typing import TYPE_CHECKING

from isonoise.command_output import logger, print_json
from isonoise.commands import EXIT_DONE
from isonoise.commands.shared_options import cluster_of
from isonoise.comparison.experiment import Member, make_members
from isonoise.comparison.experiment_file import DEFAULT_SEEDS, is_experiment, read_experiment
from isonoise.comparison.folder_lock import FolderLock, lock_folder
from isonoise.comparison.presets import PRESETS, Preset
from isonoise.comparison.report_packages import check_packages
from isonoise.comparison.request import Request, SceneRequest, StrategyRequest
from isonoise.comparison.session import KEPT, check_is_series, has_runs, render_comparison
from isonoise.comparison.strategy_specs import split_specs
from isonoise.errors import UserError
from isonoise.signals import exit_code

if TYPE_CHECKING:
    from isonoise.comparison.cluster.workers import ClusterWorkers
    from isonoise.distributed.cluster import Cluster

DEFAULT_TIME = 10.0
"""Seconds of a run."""
EXPERIMENT_OPTIONS = (
    *("strategies", "preset", "seeds", "seed", "time", "spp", "size", "max_depth", "device", "allow_outside"),
    *("reference", "reference_time", "metrics", "keep_images"),
)
"""Options for which an experiment's file has keys."""


def run(options: argparse.Namespace) -> int:
    """Run the command; return the exit code."""
    directory = Path(options.output)
    members = _members(options)
    check_packages(members[0].request)
    with lock_folder(directory) as lock, cluster_of(options) as cluster:
        workers = _workers_of(cluster)
        if len(members) > 1:
            return _compare_series(options, members, directory, workers)
        code, summary = _compare(members[0].request, lock, workers, options.rerun_changed)
        if options.json:
            print_json(summary)
        return code


def _members(options: argparse.Namespace) -> list[Member]:
    """The comparisons that the options or the experiment's file ask for."""
    if any(is_experiment(name) for name in options.scenes):
        _check_alone(options)
        return read_experiment(options.scenes[0])
    preset = _preset(options)
    spps = options.spp or ([] if options.time is not None or not preset else list(preset.spp))
    time = options.time
    if time is None and not spps:
        time = preset.time if preset else DEFAULT_TIME
    return make_members(_request(options, preset), [] if time is None else [time], spps)


def _check_alone(options: argparse.Namespace) -> None:
    """Raises UserError if there are scenes or options beside an experiment's file, which has all of them."""
    if len(options.scenes) > 1:
        raise UserError("an experiment's file is given alone: name the scenes in the file")
    for name in EXPERIMENT_OPTIONS:
        if getattr(options, name):
            raise UserError(f"--{name.replace('_', '-')} is a key of an experiment's file: write it there")


def _workers_of(cluster: "Cluster | None") -> "ClusterWorkers | None":
    if cluster is None:
        return None
    from isonoise.comparison.cluster.workers import ClusterWorkers

    return ClusterWorkers(cluster, logger.warning)


def _compare_series(
    options: argparse.Namespace, members: list[Member], directory: Path, workers: "ClusterWorkers | None"
) -> int:
    """The comparisons of an experiment with several budgets or devices, and tables over all of them."""
    from isonoise.comparison.series import write_series

    check_is_series(directory)
    code, summaries = EXIT_DONE, {}
    for member in members:
        shared = directory / member.shares_with
        with lock_folder(directory / member.folder) as lock:
            code, summaries[member] = _compare(member.request, lock, workers, options.rerun_changed, shared)
        if code != EXIT_DONE:
            break
    write_series(directory, members, summaries, _print)
    if options.json:
        print_json({member.folder: summary for member, summary in summaries.items()})
    return code


def _compare(
    request: Request,
    lock: FolderLock,
    workers: "ClusterWorkers | None",
    rerun_changed: bool,
    shared: Path | None = None,
) -> tuple[int, dict | None]:
    """One comparison in the locked folder, with the references of another one in the folder `shared`.

    Returns the exit code and the summary; None if no run is finished.
    """
    directory = lock.directory
    try:
        render_comparison(request, lock, _print, logger.warning, workers, rerun_changed, shared)
        return EXIT_DONE, _report(directory)
    except (KeyboardInterrupt, UserError) as error:
        # a signal may have reached Mitsuba's process first, and its end is a UserError
        if isinstance(error, UserError) and exit_code() is None:
            raise
    logger.error(f"interrupted; {KEPT}")
    summary = None
    if has_runs(directory):
        try:
            summary = _report(directory)
        except UserError as error:  # such as a full disk; the exit code is the signal's
            logger.error(error)
    return exit_code() or 128 + signal.SIGINT, summary


def _report(directory: Path) -> dict:
    """Write the report and print its tables; return the summary."""
    from isonoise.comparison.report import write_report
    from isonoise.comparison.summary import summary_text

    summary = write_report(directory)
    _print(summary_text(directory))
    _print(f"report  {directory / 'report.html'}")
    return summary


def _preset(options: argparse.Namespace) -> Preset | None:
    if options.preset and options.preset not in PRESETS:
        raise UserError(f"there is no preset '{options.preset}'; known are {', '.join(PRESETS)}")
    return PRESETS[options.preset] if options.preset else None


def _request(options: argparse.Namespace, preset: Preset | None) -> Request:
    """The preset's settings, replaced by the given options; without the budget."""
    strategies = [spec for text in options.strategies for spec in split_specs(text)]
    if not preset and not options.scenes:
        raise UserError("nothing to compare: give a SCENE or a --preset")
    if not preset and not strategies:
        raise UserError("nothing to compare: give --strategies or a --preset")
    seeds = options.seeds or (preset.seeds if preset else DEFAULT_SEEDS)
    return Request(
        scenes=[
            SceneRequest(name, size=options.size, max_depth=options.max_depth)
            for name in options.scenes or preset.scenes
        ],
        strategies=[StrategyRequest(spec) for spec in strategies or preset.strategies],
        seeds=range(options.seed, options.seed + seeds),
        device=options.device,
        references=options.reference,
        reference_time=options.reference_time,
        preset=options.preset,
        allow_outside=options.allow_outside,
        metrics=[name.strip() for name in options.metrics.split(",")] if options.metrics else (),
        keep_images=options.keep_images,
    )


def _print(text: str) -> None:
    print(text, flush=True)
