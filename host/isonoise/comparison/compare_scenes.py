"""`isonoise.compare`: compares strategies on scenes from Python, and returns the results as tables."""

from __future__ import annotations  # `help` shows the names of types

import os
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from isonoise.argument_checks import check_callable, check_flag
from isonoise.comparison.compare_arguments import ComparisonOptions, Scenes, Strategies, comparisons_of
from isonoise.comparison.experiment import Member
from isonoise.comparison.folder_lock import lock_folder
from isonoise.comparison.report_packages import check_packages
from isonoise.comparison.result_table import ResultTable
from isonoise.comparison.session import check_is_series, render_comparison
from isonoise.comparison.summary import summarise
from isonoise.comparison.summary_table import summary_table
from isonoise.comparison.tidy_tables import columns_of, runs_table, waves_table

if TYPE_CHECKING:
    from typing_extensions import Unpack


@dataclass(frozen=True, repr=False)
class Comparison:
    """The results of `isonoise.compare`.

    Attributes
    ----------
    runs : ResultTable
        A row per run: scene, strategy, seed, budget and the metrics of its final image.
    waves : ResultTable
        A row per run and wave.
    summary : ResultTable
        A row per scene and strategy: figures over the seeds, with ratios to the baseline and their 95 % intervals.
    summaries : dict of str to dict
        Everything that summary.json has, by folder; the folder is empty if there is one budget and one device.
    directory : Path or None
        The folder of the results; None if they were not to be kept.
    """

    runs: ResultTable
    waves: ResultTable
    summary: ResultTable
    summaries: dict[str, dict[str, Any]]
    directory: Path | None

    def __repr__(self) -> str:
        return repr(self.summary)

    def _repr_html_(self) -> str:
        """For notebooks: the summary."""
        return self.summary._repr_html_()


def compare(
    scenes: Scenes,
    strategies: Strategies = (),
    *,
    output: str | os.PathLike[str] | None = None,
    rerun_changed: bool = False,
    log: Callable[[str], object] | None = None,
    **options: Unpack[ComparisonOptions],
) -> Comparison:
    """Render scenes with several strategies and seeds, and measure every wave against a reference.

    Parameters
    ----------
    scenes : scene, sequence of scenes, or mapping from names to scenes
        A scene is a file, the name of a built-in scene, a dict as for Mitsuba's `load_dict`, a Scene or a
        CompiledScene. An experiment's TOML file is given alone: it has the strategies and the options.
    strategies : str, Strategy or sequence of these
        As for `Renderer`; `NAME:sampler=independent` renders without stratification.
    output : path or None
        Folder of the results, with the report. Called again, `compare` resumes what was stopped. None: the results
        are returned only.
    rerun_changed : bool
        Render again what an earlier call has rendered with another version, driver or device, or from an edited scene
        or strategy. Otherwise that is an error.
    log : callable or None
        Gets a line of text for every finished file, and for every warning.
    **options
        `time` or `spp`, the budget of a run: seconds of rendering, or mean samples per pixel; a number or several.
        `seeds`: number of runs of each strategy on each scene, or their seeds (8).
        `size` (width, height) and `max_depth`, in place of the scenes' own.
        `references`: converged images, a mapping from names of scenes to paths, or a sequence of paths; others are
        rendered, for `reference_time` seconds (20 times the budget).
        `device`, as for `Renderer`, or several.
        `metrics` of the tables (all but `flip`); `keep_images`: keep every run's image as EXR; `allow_outside`, as for
        `load`.

    Returns
    -------
    Comparison

    Raises
    ------
    UserError
        If an argument is wrong, a file cannot be read or written, or `output` holds another comparison. SceneError and
        DeviceError are kinds of it.

    Examples
    --------
    >>> comparison = isonoise.compare("cornell", ["uniform", "pooled"], spp=8, seeds=2, size=(16, 16))
    >>> comparison.runs["seed"].tolist()
    [0, 1, 0, 1]
    """
    members = comparisons_of(scenes, strategies, options)
    write = (lambda line: None) if log is None else check_callable("log", log)
    if output is not None:
        check_packages(members[0].request)
        return _compare(members, Path(output), write, check_flag("rerun_changed", rerun_changed), is_kept=True)
    with tempfile.TemporaryDirectory(prefix="isonoise-") as folder:
        return _compare(members, Path(folder), write, rerun_changed=False, is_kept=False)


def _compare(
    members: Sequence[Member], directory: Path, log: Callable[[str], object], rerun_changed: bool, is_kept: bool
) -> Comparison:
    with lock_folder(directory) as lock:
        if len(members) == 1:
            render_comparison(members[0].request, lock, log, log, None, rerun_changed)
        else:
            check_is_series(directory)
            for member in members:
                with lock_folder(directory / member.folder) as member_lock:
                    shared = directory / member.shares_with
                    render_comparison(member.request, member_lock, log, log, None, rerun_changed, shared)
        summaries = {member.folder: _summary(directory / member.folder, is_kept) for member in members}
        if is_kept and len(members) > 1:
            from isonoise.comparison.series import write_series

            write_series(directory, members, {member: summaries[member.folder] for member in members}, lambda _: None)
        tables = {
            "runs": runs_table(directory),
            "waves": waves_table(directory),
            "summary": summary_table(directory, summaries),
        }
    return Comparison(
        **{name: ResultTable(name, table, columns_of(name, table)) for name, table in tables.items()},
        summaries=summaries,
        directory=directory if is_kept else None,
    )


def _summary(directory: Path, is_kept: bool) -> dict[str, Any]:
    if not is_kept:
        return summarise(directory)
    from isonoise.comparison.report import write_report

    return write_report(directory)
