"""The table of built-in strategies; makes a strategy from its text form (`NAME:key=value,...`) and back."""

import difflib
import importlib
import inspect
import sys
from collections.abc import Iterable

from isonoise.errors import UserError
from isonoise.strategies.base import Strategy

ENTRY_POINT_GROUP = "isonoise.strategies"
DEFAULT_STRATEGY = "pooled"

BUILT_IN = {
    "uniform": "isonoise.strategies.uniform:Uniform",
    "pooled": "isonoise.strategies.adaptive:Pooled",
    "relative-median": "isonoise.strategies.adaptive:RelativeMedian",
    "relative-mean": "isonoise.strategies.adaptive:RelativeMean",
    "absolute": "isonoise.strategies.adaptive:Absolute",
    "tsallis": "isonoise.strategies.adaptive:Tsallis",
    "oracle": "isonoise.strategies.oracle:Oracle",
    "purgathofer": "isonoise.strategies.purgathofer:Purgathofer",
    "dammertz": "isonoise.strategies.dammertz:Dammertz",
    "cycles": "isonoise.strategies.cycles:Cycles",
    "tungsten": "isonoise.strategies.tungsten:Tungsten",
    "luxcore": "isonoise.strategies.luxcore:LuxCore",
}
"""Name -> module:Class, in the order of listings. A render imports only the strategy that it uses."""


def available_strategies() -> list[str]:
    """Names for `make_strategy`: the built-in ones, then the entry points of installed packages, sorted."""
    installed = {entry.name for entry in _entry_points()}
    return [*BUILT_IN, *sorted(installed - set(BUILT_IN))]


def make_strategy(spec: str | Strategy) -> Strategy:
    """Make the strategy that `spec` names.

    Parameters
    ----------
    spec : str or Strategy
        `NAME` or `module:Class`, either followed by `:key=value,key=value`. Names are looked up among the built-in
        strategies, then in the entry-point group `isonoise.strategies`; modules on Python's path and in the current
        directory. A Strategy is returned unchanged.

    Raises
    ------
    UserError
        If a name or parameter is unknown (the message names the nearest one) or a value is out of range.
    """
    if isinstance(spec, Strategy):
        return spec
    head, parameters = _split(spec)
    strategy = _class_of_path(head) if ":" in head else _class_of_name(head)
    if not (inspect.isclass(strategy) and issubclass(strategy, Strategy)):
        raise UserError(f"strategy '{head}' is not a subclass of isonoise.strategies.Strategy")
    return strategy(**_convert(head, strategy, parameters))


def is_built_in(spec: str) -> bool:
    """Whether the strategy that `spec` names is a part of isonoise, so that making it imports no other code."""
    return _split(spec)[0] in BUILT_IN


def describe(strategy: Strategy) -> str:
    """The spec that makes this strategy again, with every parameter; for file headers and listings.

    A parameter's value is read from the attribute of the same name; a parameter without one is left out.
    """
    cls = type(strategy)
    path = f"{cls.__module__}:{cls.__qualname__}"
    head = cls.name if BUILT_IN.get(getattr(cls, "name", None)) == path else path
    values = {name: getattr(strategy, name) for name in _parameters(cls) if hasattr(strategy, name)}
    return ":".join([head, ",".join(f"{name}={_text(value)}" for name, value in values.items())]).rstrip(":")


def _entry_points() -> Iterable:
    from importlib.metadata import entry_points  # slow: as much time as all other modules of the package

    return entry_points(group=ENTRY_POINT_GROUP)


def _split(spec: str) -> tuple[str, dict[str, str]]:
    """The name or `module:Class`, and the parameters' values as text."""
    head, colon, tail = spec.strip().rpartition(":")
    if not colon:
        return tail, {}
    if "=" not in tail and head not in BUILT_IN:  # module:Class without parameters
        return f"{head}:{tail}", {}
    parameters = {}
    for item in tail.split(","):
        key, equals, value = (part.strip() for part in item.partition("="))
        if not (key and equals and value):
            raise UserError(f"strategy '{spec}': '{item}' is not of the form key=value")
        if key in parameters:
            raise UserError(f"strategy '{spec}': parameter '{key}' is given twice")
        parameters[key] = value
    return head, parameters


def _class_of_name(name: str) -> type:
    if name in BUILT_IN:
        module, _, strategy = BUILT_IN[name].partition(":")
        return getattr(importlib.import_module(module), strategy)
    for entry in (entry for entry in _entry_points() if entry.name == name):
        try:
            return entry.load()
        except Exception as error:
            raise UserError(f"strategy '{name}': cannot import '{entry.value}': {error}") from error
    known = available_strategies()
    raise UserError(
        f"there is no strategy '{name}'{_nearest(name, known)}; known are {', '.join(known)}; "
        "name your own class as module:Class"
    )


def _class_of_path(path: str) -> type:
    module_name, _, class_name = path.partition(":")
    if "" not in sys.path:
        sys.path.append("")  # the current directory, as `python -m` has it
    try:
        module = importlib.import_module(module_name)
    except Exception as error:
        raise UserError(f"strategy '{path}': cannot import '{module_name}': {error}") from error
    if not hasattr(module, class_name):
        names = [name for name, value in vars(module).items() if inspect.isclass(value)]
        raise UserError(f"strategy '{path}': '{module_name}' has no '{class_name}'{_nearest(class_name, names)}")
    return getattr(module, class_name)


def _parameters(cls: type) -> dict[str, inspect.Parameter]:
    """Parameters that can be passed by name."""
    by_name = (inspect.Parameter.KEYWORD_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
    signature = inspect.signature(cls, eval_str=True)
    return {name: parameter for name, parameter in signature.parameters.items() if parameter.kind in by_name}


def _convert(head: str, cls: type, texts: dict[str, str]) -> dict[str, object]:
    """Texts converted to the type of each parameter's annotation, else of its default; else left as text."""
    known = _parameters(cls)
    values = {}
    for key, text in texts.items():
        if key not in known:
            names = ", ".join(known) or "none"
            raise UserError(f"strategy '{head}' has no parameter '{key}'{_nearest(key, known)}; known are {names}")
        annotation, default = known[key].annotation, known[key].default
        target_type = annotation if annotation is not inspect.Parameter.empty else type(default)
        values[key] = _value(head, key, text, target_type)
    missing = [key for key, parameter in known.items() if parameter.default is parameter.empty and key not in values]
    if missing:
        raise UserError(f"strategy '{head}' needs {', '.join(f'{key}=...' for key in missing)}")
    return values


def _value(head: str, key: str, text: str, target_type: object) -> object:
    try:
        if target_type is bool:
            return {"true": True, "false": False}[text.lower()]
        return target_type(text) if target_type in (int, float) else text
    except (ValueError, KeyError):
        expected = {bool: "true or false", int: "a whole number", float: "a number"}[target_type]
        raise UserError(f"strategy '{head}': {key}={text} should be {expected}") from None


def _text(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        short = f"{value:g}"
        return short if float(short) == value else repr(value)
    return str(value)


def _nearest(name: str, known: Iterable[str]) -> str:
    close = difflib.get_close_matches(name, list(known), n=1)
    return f" (did you mean '{close[0]}'?)" if close else ""
