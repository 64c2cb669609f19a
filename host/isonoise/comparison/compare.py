"""`isonoise.compare`: compares strategies on scenes from Python, and returns the results as tables."""

import os
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from isonoise.argument_checks import check_depth, check_flag, check_integer, check_number, check_size
from isonoise.comparison.experiment import Member, make_members
from isonoise.comparison.experiment_file import DEFAULT_SEEDS, is_experiment, read_experiment
from isonoise.comparison.folder_lock import lock_folder
from isonoise.comparison.plan import FIRST_REFERENCE_SEED
from isonoise.comparison.planning import MAX_SEEDS
from isonoise.comparison.report_packages import check_packages
from isonoise.comparison.request import Request, SceneRequest, StrategyRequest
from isonoise.comparison.result_table import ResultTable
from isonoise.comparison.session import check_is_series, render_comparison
from isonoise.comparison.summary import summarise
from isonoise.comparison.summary_table import summary_table
from isonoise.comparison.tidy_tables import columns_of, runs_table, waves_table
from isonoise.errors import UserError
from isonoise.limits import MAX_STOP, MIN_STOP
from isonoise.scene import CompiledScene
from isonoise.scene.scene import Scene
from isonoise.strategies import Strategy, describe

AnyScene = str | os.PathLike | Mapping | Scene | CompiledScene
"""What `compare` takes as a scene."""


@dataclass(frozen=True)
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
    summaries: dict[str, dict]
    directory: Path | None

    def _repr_html_(self) -> str:
        """For notebooks: the summary."""
        return self.summary._repr_html_()


def compare(
    scenes: AnyScene | Sequence[AnyScene] | Mapping[str, AnyScene],
    strategies: str | Strategy | Sequence[str | Strategy] = (),
    *,
    output: str | os.PathLike | None = None,
    time: float | Sequence[float] | None = None,
    spp: float | Sequence[float] | None = None,
    seeds: int | Sequence[int] | None = None,
    size: tuple[int, int] | None = None,
    max_depth: int | None = None,
    references: Mapping[str, str | os.PathLike] | Sequence[str | os.PathLike] = (),
    reference_time: float | None = None,
    device: str | int | Sequence[str | int] | None = None,
    metrics: Sequence[str] = (),
    keep_images: bool = False,
    allow_outside: bool = False,
    rerun_changed: bool = False,
    log: Callable[[str], object] | None = None,
) -> Comparison:
    """Render scenes with several strategies and seeds, and measure every wave against a reference.

    Parameters
    ----------
    scenes : scene, sequence of scenes, or mapping from names to scenes
        A scene is a file, the name of a built-in scene, a dict as for Mitsuba's `load_dict`, a Scene or a
        CompiledScene. An experiment's TOML file is given alone, without all that the file has.
    strategies : str, Strategy or sequence of these
        As for `Renderer`; `name:sampler=independent` renders without stratification.
    output : path or None
        Folder of the results, with the report. Called again, `compare` resumes what was stopped. None: the results
        are returned only.
    time, spp : float or sequence of float
        Budget of a run: seconds of rendering, or mean samples per pixel. Several make a comparison each.
    seeds : int or sequence of int
        Number of runs of each strategy on each scene, or their seeds. None: 8.
    size : (width, height) or None
        Pixels. None: the scenes' own.
    max_depth : int or None
        Longest path in segments, -1 for no limit. None: the scenes' own.
    references : mapping from names to paths, or sequence of paths
        Converged images, by names of the scenes or in their order. Those of other scenes are rendered.
    reference_time : float or None
        Seconds to render a reference. None: 20 times the budget of a run.
    device : str, int, sequence of these, or None
        As for `Renderer`. Several make a comparison each.
    metrics : sequence of str
        Of the tables. Empty: all but `flip`.
    keep_images : bool
        Keep the image of every run as an EXR file in `output`.
    allow_outside : bool
        As for `load`.
    rerun_changed : bool
        Render again what an earlier call has rendered with another version, driver or device, or from an edited scene
        or strategy. Otherwise that is an error.
    log : callable or None
        Gets a line of text for every finished file, and for every warning.

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
    >>> import isonoise
    >>> comparison = isonoise.compare("cornell", ["uniform", "pooled"], spp=8, seeds=2, size=(16, 16))
    >>> comparison.runs["seed"].tolist()
    [0, 1, 0, 1]
    """
    settings = {
        "strategies": strategies,
        **{"time": time, "spp": spp, "seeds": seeds, "size": size, "max_depth": max_depth, "references": references},
        **{"reference_time": reference_time, "device": device, "metrics": metrics, "keep_images": keep_images},
        "allow_outside": allow_outside,
    }
    if is_experiment(scenes):
        for name, value in settings.items():
            if value not in (None, (), False):
                raise UserError(f"{name} is a key of an experiment's file: write it there")
        members = read_experiment(scenes)
    else:
        members = _members(scenes, settings)
    write = log or (lambda line: None)
    if output is not None:
        check_packages(members[0].request)
        return _compare(members, Path(output), write, rerun_changed, is_kept=True)
    with tempfile.TemporaryDirectory(prefix="isonoise-") as folder:
        return _compare(members, Path(folder), write, rerun_changed, is_kept=False)


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
        runs, waves = runs_table(directory), waves_table(directory)
    return Comparison(
        ResultTable("runs", runs, columns_of("runs", runs)),
        ResultTable("waves", waves, columns_of("waves", waves)),
        summary_table(summaries),
        summaries,
        directory if is_kept else None,
    )


def _summary(directory: Path, is_kept: bool) -> dict:
    if not is_kept:
        return summarise(directory)
    from isonoise.comparison.report import write_report

    return write_report(directory)


def _members(scenes: object, settings: Mapping[str, Any]) -> list[Member]:
    """The comparisons that the arguments of `compare` ask for."""
    size, depth = settings["size"], settings["max_depth"]
    named = _named_scenes(scenes)
    references, in_order = settings["references"], []
    if not isinstance(references, Mapping):
        in_order = [os.fspath(path) for path in _sequence(references)]
        references = {}
    for name in references:
        if name not in [_label(*each) for each in named]:
            raise UserError(f"references has '{name}', which is no scene of this comparison")
    requests = [
        SceneRequest(
            scene,
            size=None if size is None else check_size(size),
            max_depth=None if depth is None else check_depth(depth),
            reference=os.fspath(path) if (path := references.get(_label(name, scene))) else None,
            name=name,
        )
        for name, scene in named
    ]
    reference_time = settings["reference_time"]
    request = Request(
        scenes=requests,
        strategies=[StrategyRequest(_spec(strategy)) for strategy in _sequence(settings["strategies"])],
        seeds=_seeds(settings["seeds"]),
        references=in_order,
        reference_time=None if reference_time is None else _budget("reference_time", reference_time),
        metrics=_sequence(settings["metrics"]),
        keep_images=check_flag("keep_images", settings["keep_images"]),
        allow_outside=check_flag("allow_outside", settings["allow_outside"]),
    )
    budgets = {name: [_budget(name, value) for value in _sequence(settings[name])] for name in ("time", "spp")}
    devices = [str(device) for device in _sequence(settings["device"])]
    return make_members(request, budgets["time"], budgets["spp"], devices)


def _named_scenes(scenes: object) -> list[tuple[str | None, Any]]:
    """Names and scenes; scenes in files have no name yet."""
    if isinstance(scenes, Mapping) and not isinstance(scenes, Scene) and not isinstance(scenes.get("type"), str):
        return [(str(name), scene) for name, scene in scenes.items()]
    if isinstance(scenes, str | os.PathLike | Mapping | CompiledScene):
        scenes = [scenes]
    if not isinstance(scenes, Sequence):
        raise UserError(f"{scenes!r} is no scene: name a file or a built-in scene, or give a dict or a Scene")
    found: list[tuple[str | None, Any]] = []
    for scene in scenes:
        name = None
        if not isinstance(scene, str | os.PathLike):
            base = Path(scene.name).stem if isinstance(scene, Scene) else "scene"
            taken = [other for other, _ in found]
            name = next(
                each for each in [base, *(f"{base}-{n}" for n in range(2, len(found) + 3))] if each not in taken
            )
        found.append((name, scene))
    return found


def _label(name: str | None, scene: object) -> str:
    """The name by which a scene's reference is given."""
    return os.fspath(scene) if name is None else name  # type: ignore[arg-type]


def _spec(strategy: object) -> str:
    if isinstance(strategy, Strategy):
        return describe(strategy)
    if not isinstance(strategy, str):
        raise UserError(f"strategies has {strategy!r}, which is neither a strategy's name nor an object of Strategy")
    return strategy


def _seeds(seeds: object) -> Sequence[int]:
    if seeds is None:
        return range(DEFAULT_SEEDS)
    if isinstance(seeds, Sequence) and not isinstance(seeds, str):
        return [check_integer("seeds", seed, 0, FIRST_REFERENCE_SEED - 1) for seed in seeds]
    return range(check_integer("seeds", seeds, 1, MAX_SEEDS))


def _budget(name: str, value: object) -> float:
    return check_number(name, value, lambda number: MIN_STOP <= number <= MAX_STOP, "a number above 0")


def _sequence(values: Any) -> list:
    """None is empty, one value a list of it."""
    if values is None:
        return []
    one = isinstance(values, str | os.PathLike | Strategy) or not isinstance(values, Sequence)
    return [values] if one else list(values)
