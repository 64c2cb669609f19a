"""The arguments of `isonoise.compare`: their types and checks, and what they ask for; called by `compare_scenes`."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias, TypedDict

from isonoise.argument_checks import check_depth, check_flag, check_integer, check_number, check_size
from isonoise.comparison.experiment import Member, make_members
from isonoise.comparison.experiment_file import DEFAULT_SEEDS, is_experiment, read_experiment
from isonoise.comparison.plan import FIRST_REFERENCE_SEED
from isonoise.comparison.planning import MAX_SEEDS
from isonoise.comparison.request import Request, SceneRequest, StrategyRequest
from isonoise.errors import UserError
from isonoise.limits import MAX_STOP, MIN_STOP
from isonoise.scene import CompiledScene
from isonoise.scene.load_compiled import SceneSource
from isonoise.scene.scene import Scene
from isonoise.strategies import Strategy, describe
from isonoise.suggestions import suggestion

Scenes: TypeAlias = SceneSource | Sequence[SceneSource] | Mapping[str, SceneSource]
Strategies: TypeAlias = str | Strategy | Sequence[str | Strategy]


class ComparisonOptions(TypedDict, total=False):
    """Further keyword arguments of `isonoise.compare`.

    Attributes
    ----------
    time, spp : float, sequence of float, or None
        Budget of a run: seconds of rendering, or mean samples per pixel. Several make a comparison each.
    seeds : int, sequence of int, or None
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
        Keep the image of every run as an EXR file in the folder of the results.
    allow_outside : bool
        As for `load`.
    """

    time: float | Sequence[float] | None
    spp: float | Sequence[float] | None
    seeds: int | Sequence[int] | None
    size: tuple[int, int] | None
    max_depth: int | None
    references: Mapping[str, str | os.PathLike[str]] | Sequence[str | os.PathLike[str]]
    reference_time: float | None
    device: str | int | Sequence[str | int] | None
    metrics: Sequence[str]
    keep_images: bool
    allow_outside: bool


def comparisons_of(scenes: Scenes, strategies: Strategies, options: ComparisonOptions) -> list[Member]:
    """The comparisons that the arguments of `compare` ask for. Raises UserError."""
    known = ComparisonOptions.__annotations__
    for name in options:
        if name not in known:
            raise UserError(f"there is no argument '{name}'{suggestion(name, known)}; known are {', '.join(known)}")
    if not is_experiment(scenes):
        return _members(scenes, strategies, options)
    for name, value in {"strategies": strategies, **options}.items():
        if value not in (None, (), False):
            raise UserError(f"{name} is a key of an experiment's file: write it there")
    return read_experiment(scenes)  # type: ignore[arg-type]


def _members(scenes: Scenes, strategies: Strategies, options: ComparisonOptions) -> list[Member]:
    size, depth, reference_time = (options.get(name) for name in ("size", "max_depth", "reference_time"))
    named = _named_scenes(scenes)
    references, in_order = options.get("references", ()), []
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
    request = Request(
        scenes=requests,
        strategies=[StrategyRequest(_spec(strategy)) for strategy in _sequence(strategies)],
        seeds=_seeds(options.get("seeds")),
        references=in_order,
        reference_time=None if reference_time is None else _budget("reference_time", reference_time),
        metrics=_sequence(options.get("metrics")),
        keep_images=check_flag("keep_images", options.get("keep_images", False)),
        allow_outside=check_flag("allow_outside", options.get("allow_outside", False)),
    )
    budgets = {name: [_budget(name, value) for value in _sequence(options.get(name))] for name in ("time", "spp")}
    devices = [str(device) for device in _sequence(options.get("device"))]
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
    return str(scene) if name is None else name


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


def _sequence(values: Any) -> list[Any]:
    """None is empty, one value a list of it."""
    if values is None:
        return []
    one = isinstance(values, str | os.PathLike | Strategy) or not isinstance(values, Sequence)
    return [values] if one else list(values)
