"""From a strategy's name on the command line to the strategy, and back."""

import difflib
import importlib
import inspect
import sys
from collections.abc import Iterable

from isonoise.errors import UserError
from isonoise.strategies.base import Strategy

ENTRY_POINT_GROUP = "isonoise.strategies"
DEFAULT_STRATEGY = "pooled"

_BUILT_IN = {
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
"""Where they are, so that a render imports the one that it uses: isonoise's own, then those of others."""


def available_strategies() -> list[str]:
    """Names that `make_strategy` knows: the built-in ones, then those that installed packages bring, by name."""
    brought = {entry.name for entry in _entry_points()}
    return [*_BUILT_IN, *sorted(brought - set(_BUILT_IN))]


def make_strategy(spec: str | Strategy) -> Strategy:
    """The strategy that `spec` names: `NAME`, `module:Class`, either followed by `:key=value,key=value`.

    Names are looked up among the built-in strategies, then in the entry-point group `isonoise.strategies`. Modules are
    found as Python finds them, and in the current directory. A Strategy is returned as it is.
    Raises UserError for an unknown name or parameter, naming the nearest one that exists, and for a value out of range.
    """
    if isinstance(spec, Strategy):
        return spec
    head, parameters = _split(spec)
    strategy = _load(head) if ":" in head else _find(head)
    if not (inspect.isclass(strategy) and issubclass(strategy, Strategy)):
        raise UserError(f"strategy '{head}' is not a subclass of isonoise.strategies.Strategy")
    return strategy(**_convert(head, strategy, parameters))


def describe(strategy: Strategy) -> str:
    """The spec that makes this strategy again, every parameter written out; for file headers.

    A parameter's value is read from the attribute of its name; one kept under no such name is left out.
    """
    cls = type(strategy)
    place = f"{cls.__module__}:{cls.__qualname__}"
    head = cls.name if _BUILT_IN.get(getattr(cls, "name", None)) == place else place
    values = {name: getattr(strategy, name) for name in _parameters(cls) if hasattr(strategy, name)}
    return ":".join([head, ",".join(f"{name}={_text(value)}" for name, value in values.items())]).rstrip(":")


def _entry_points() -> Iterable:
    from importlib.metadata import entry_points  # costs as much time as the rest of the package's own modules

    return entry_points(group=ENTRY_POINT_GROUP)


def _split(spec: str) -> tuple[str, dict[str, str]]:
    """The name or `module:Class`, and the parameters as text."""
    head, colon, tail = spec.strip().rpartition(":")
    if not colon:
        return tail, {}
    if "=" not in tail and head not in _BUILT_IN:  # module:Class
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


def _find(name: str) -> type:
    if name in _BUILT_IN:
        module, _, strategy = _BUILT_IN[name].partition(":")
        return getattr(importlib.import_module(module), strategy)
    for entry in (entry for entry in _entry_points() if entry.name == name):
        try:
            return entry.load()
        except Exception as error:
            raise UserError(f"strategy '{name}' comes from '{entry.value}', which fails to import: {error}") from error
    known = available_strategies()
    raise UserError(
        f"there is no strategy '{name}'{_nearest(name, known)}; known are {', '.join(known)}; "
        "for a class of your own write module:Class"
    )


def _load(path: str) -> type:
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
    """Parameters that can be given by name."""
    by_name = (inspect.Parameter.KEYWORD_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
    signature = inspect.signature(cls, eval_str=True)
    return {name: parameter for name, parameter in signature.parameters.items() if parameter.kind in by_name}


def _convert(head: str, cls: type, texts: dict[str, str]) -> dict[str, object]:
    """Values of the parameters, by the type of each one's annotation, else of its default, else as text."""
    known = _parameters(cls)
    values = {}
    for key, text in texts.items():
        if key not in known:
            listed = ", ".join(known) or "none"
            raise UserError(
                f"strategy '{head}' has no parameter '{key}'{_nearest(key, known)}; its parameters: {listed}"
            )
        annotation, default = known[key].annotation, known[key].default
        kind = annotation if annotation is not inspect.Parameter.empty else type(default)
        values[key] = _value(head, key, text, kind)
    missing = [key for key, parameter in known.items() if parameter.default is parameter.empty and key not in values]
    if missing:
        raise UserError(f"strategy '{head}' needs {', '.join(f'{key}=...' for key in missing)}")
    return values


def _value(head: str, key: str, text: str, kind: object) -> object:
    try:
        if kind is bool:
            return {"true": True, "false": False}[text.lower()]
        return kind(text) if kind in (int, float) else text
    except (ValueError, KeyError):
        expected = {bool: "true or false", int: "a whole number", float: "a number"}[kind]
        raise UserError(f"strategy '{head}': {key}={text} should be {expected}") from None


def _text(value: object) -> str:
    return (
        str(value).lower() if isinstance(value, bool) else f"{value:.17g}" if isinstance(value, float) else str(value)
    )


def _nearest(name: str, known: Iterable[str]) -> str:
    close = difflib.get_close_matches(name, list(known), n=1)
    return f" (did you mean '{close[0]}'?)" if close else ""
