"""Reads an experiment from a TOML file: scenes, strategies, their sweeps, seeds, budgets, devices.

Called by the command and by `api`. `host/docs/experiments.md` documents the keys.
"""

import os
import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from isonoise.argument_checks import check_choice, check_depth, check_integer, check_number, check_size
from isonoise.comparison.experiment import Member, make_members
from isonoise.comparison.experiment_table import Check, ExperimentTable, Value, read_toml
from isonoise.comparison.plan import FIRST_REFERENCE_SEED
from isonoise.comparison.planning import MAX_SEEDS, scene_name
from isonoise.comparison.request import PLACEHOLDER, Request, SceneRequest, StrategyRequest, text_of
from isonoise.comparison.strategy_specs import MITSUBA_SAMPLERS, describe_spec
from isonoise.comparison.sweep import Variant, variants
from isonoise.errors import UserError
from isonoise.limits import MAX_STOP, MIN_STOP
from isonoise.samplers import SAMPLERS

EXPERIMENT_SUFFIX = ".toml"
DEFAULT_SEEDS = 8
_SWEEP = ("set", "grid", "list")
_SCENE_KEYS = ("source", "name", "reference", "size", "max_depth", *_SWEEP)
_STRATEGY_KEYS = ("name", *_SWEEP)
_KEYS = (
    *("scenes", "strategies", "seeds", "first_seed", "time", "spp", "devices", "size", "max_depth", "sampler"),
    *("reference_time", "allow_outside", "metrics", "keep_images"),
)


def is_experiment(name: object) -> bool:
    """Whether a name is that of an experiment's file."""
    return isinstance(name, str | os.PathLike) and os.fspath(name).lower().endswith(EXPERIMENT_SUFFIX)


def read_experiment(path: str | os.PathLike) -> list[Member]:
    """The comparisons that an experiment's file asks for.

    Names of files are relative to its folder. That folder also has the modules of `module:Class`, unless the current
    one has them.

    Parameters
    ----------
    path : path
        A TOML file.

    Raises
    ------
    UserError
        If the file cannot be read, or a key is unknown or has a wrong value; the message names file and key.
    """
    path = Path(path)
    text, content = read_toml(path)
    table = ExperimentTable(f"experiment '{path}'", content, _KEYS)
    folder = path.resolve().parent
    if str(folder) not in sys.path:
        sys.path.append(str(folder))  # as `make_strategy` adds the current folder
    size, depth = table.take("size", _size), table.take("max_depth", _depth)
    scenes = [
        request
        for number, item in enumerate(table.take("scenes", _items, required=True))
        for request in _scenes(table.child("scenes", number, item, "source", _SCENE_KEYS), folder, size, depth)
    ]
    samplers = table.take("sampler", _one_or_more(_sampler), default=())
    strategies = [
        request
        for number, item in enumerate(table.take("strategies", _items, required=True))
        for request in _strategies(table.child("strategies", number, item, "name", _STRATEGY_KEYS), samplers)
    ]
    first_seed = table.take("first_seed", _seed, default=0)
    request = Request(
        scenes=_with_unique_names(scenes),
        strategies=strategies,
        seeds=table.take("seeds", _seeds(first_seed), default=range(first_seed, first_seed + DEFAULT_SEEDS)),
        reference_time=table.take("reference_time", _positive),
        allow_outside=table.take("allow_outside", _flag, default=False),
        metrics=table.take("metrics", _one_or_more(_text), default=()),
        keep_images=table.take("keep_images", _flag, default=False),
        experiment=text,
    )
    budgets = (table.take(name, _one_or_more(_positive), default=()) for name in ("time", "spp"))
    devices = table.take("devices", _one_or_more(_device), default=())
    with table.errors():
        return make_members(request, *budgets, devices)


def _scenes(
    table: ExperimentTable, folder: Path, size: tuple[int, int] | None, depth: int | None
) -> list[SceneRequest]:
    """The variants of a scene."""
    source = table.take("source", _text, required=True)
    if (folder / source).is_file():
        source = str(folder / source)
    own_size, own_depth = table.take("size", _size, default=size), table.take("max_depth", _depth, default=depth)
    reference = table.take("reference", _text)
    name = table.take("name", _text)
    found = _variants(table)
    if reference is not None and len(found) > 1:
        raise table.error("'reference' is one image for several scenes: leave it out, or write a scene for each")
    with table.errors():
        base = name or scene_name(source)
    requests = []
    for variant in found:
        values = dict(variant.values)
        values = {key: _checked(table, key, value) for key, value in values.items()}
        requests.append(
            SceneRequest(
                source,
                settings={key: value for key, value in values.items() if key not in ("size", "max_depth")},
                size=values.get("size", own_size),
                max_depth=values.get("max_depth", own_depth),
                reference=reference and str(folder / reference),
                name=f"{base} {_label(variant.swept)}" if variant.swept else name,
                origin=table.where,
            )
        )
    return requests


def _strategies(table: ExperimentTable, samplers: Sequence[str]) -> list[StrategyRequest]:
    """The variants of a strategy, with each of the samplers of the experiment."""
    name = table.take("name", _text, required=True)
    requests = []
    for variant in _variants(table):
        texts = {}
        for key, value in variant.values.items():
            texts[key] = text_of(value)
            if not re.fullmatch(r"[^,\s=]+", key) or "," in texts[key]:
                raise table.error(f"'{key}' = {value!r} is no parameter of a strategy: it has a comma or a space")
        own = "sampler=" in name or "sampler" in texts or name in MITSUBA_SAMPLERS
        for sampler in [None] if own or not samplers else samplers:
            values = texts if sampler is None else {**texts, "sampler": sampler}
            added = ",".join(f"{key}={value}" for key, value in values.items())
            spec = f"{name}{',' if '=' in name else ':'}{added}" if added else name
            swept = sampler is not None and len(samplers) > 1
            settings = {**variant.values, **({"sampler": sampler} if swept else {})}
            with table.errors():
                describe_spec(spec)
            requests.append(StrategyRequest(spec, settings))
    return requests


def _variants(table: ExperimentTable) -> list[Variant]:
    fixed, grid, lists = (table.take(key, _table, default={}) for key in _SWEEP)
    for key, values in ((key, values) for part in (grid, lists) for key, values in part.items()):
        if not isinstance(values, list):
            raise table.error(f"'{key}' = {values!r} is one value: write it in 'set', or a list of values")
    with table.errors():
        return variants(fixed, grid, lists)


def _checked(table: ExperimentTable, key: str, value: object) -> object:
    """The value of a scene's setting; size and depth are checked here, others by the scene."""
    if key == PLACEHOLDER:
        raise table.error(f"'{PLACEHOLDER}' is not followed by a name")
    check = {"size": _size, "max_depth": _depth}.get(key)
    return value if check is None else table.check(key, value, check)


def _with_unique_names(scenes: Sequence[SceneRequest]) -> list[SceneRequest]:
    """Tables of materials have long texts, which may be the same for several: their names get a number."""
    seen: dict[str, int] = {}
    unique = []
    for scene in scenes:
        if scene.name is None:
            unique.append(scene)
            continue
        seen[scene.name] = seen.get(scene.name, 0) + 1
        number = seen[scene.name]
        unique.append(scene if number == 1 else replace(scene, name=f"{scene.name} ({number})"))
    return unique


def _label(values: Mapping[str, object]) -> str:
    """Swept values for a name, such as `film.size=64,48`."""
    return " ".join(f"{key}={_short(value)}" for key, value in values.items())


def _short(value: object) -> str:
    if isinstance(value, dict):
        return str(value.get("type", "table"))
    return text_of(value)


def _one_or_more(check: Check[Value]) -> Check[list[Value]]:
    def check_all(name: str, value: object) -> list[Value]:
        values = [check(name, item) for item in (value if isinstance(value, list) else [value])]
        if not values:
            raise UserError(f"{name} = {value!r} is empty")
        if any(values.count(item) > 1 for item in values):
            raise UserError(f"{name} = {value!r} has a value twice")
        return values

    return check_all


def _seeds(first: int) -> Check[Sequence[int]]:
    def check(name: str, value: object) -> Sequence[int]:
        if not isinstance(value, list):
            return range(first, first + check_integer(name, value, 1, MAX_SEEDS))
        if first:
            raise UserError(f"{name} = {value!r} lists the seeds: leave out first_seed")
        return _one_or_more(_seed)(name, value)

    return check


def _seed(name: str, value: object) -> int:
    return check_integer(name, value, 0, FIRST_REFERENCE_SEED - 1)


def _items(name: str, value: object) -> list:
    if not isinstance(value, list) or not value or not all(isinstance(item, str | dict) for item in value):
        raise UserError(f"{name} should be a list of names or tables, not {value!r}")
    return value


def _text(name: str, value: object) -> str:
    if not isinstance(value, str) or not value.strip():
        raise UserError(f"{name} = {value!r} is not a text")
    return value


def _flag(name: str, value: object) -> bool:
    if not isinstance(value, bool):
        raise UserError(f"{name} = {value!r} is neither true nor false")
    return value


def _table(name: str, value: object) -> dict:
    if not isinstance(value, dict):
        raise UserError(f"{name} should be a table of keys and values, not {value!r}")
    return value


def _depth(name: str, value: object) -> int:
    return check_depth(value)


def _positive(name: str, value: object) -> float:
    return check_number(name, value, lambda number: MIN_STOP <= number <= MAX_STOP, "a number above 0")


def _size(name: str, value: object) -> tuple[int, int]:
    if isinstance(value, str) and (match := re.fullmatch(r"(\d{1,9})x(\d{1,9})", value)):
        value = int(match[1]), int(match[2])
    return check_size(value)


def _sampler(name: str, value: object) -> str:
    return check_choice(name, value, SAMPLERS)


def _device(name: str, value: object) -> str:
    return str(value) if isinstance(value, int) and not isinstance(value, bool) else _text(name, value)
