"""Makes a strategy from its text form (`NAME:key=value,...`) and back. The names are in `lookup`."""

import inspect

from isonoise.errors import UserError
from isonoise.strategies.base import Strategy
from isonoise.strategies.lookup import MEASURES, RULES, STRATEGIES
from isonoise.suggestions import suggestion

DEFAULT_STRATEGY = "pooled"
BUILT_IN = STRATEGIES.built_in
PIECES = {"measure": MEASURES, "rule": RULES}
"""Parameters of strategies that are functions, given by name."""


def available_strategies() -> list[str]:
    """Names for `make_strategy`: the built-in ones, then the entry points of installed packages, sorted."""
    return STRATEGIES.names()


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
    head, parameters = split_spec(spec)
    strategy = STRATEGIES.find(head)
    if not (inspect.isclass(strategy) and issubclass(strategy, Strategy)):
        raise UserError(f"strategy '{head}' is not a subclass of isonoise.strategies.Strategy")
    return strategy(**_convert(head, strategy, parameters))


def is_built_in(spec: str) -> bool:
    """Whether the strategy that `spec` names is a part of isonoise, so that making it imports no other code."""
    head, parameters = split_spec(spec)
    pieces = [(STRATEGIES, head)]
    pieces += [(kind, parameters[key]) for key, kind in PIECES.items() if key in parameters]
    return all(name in kind.built_in for kind, name in pieces)


def describe(strategy: Strategy) -> str:
    """The spec that makes this strategy again, with every parameter; for file headers and listings.

    A parameter's value is read from the attribute of the same name; a parameter without one is left out.
    """
    cls = type(strategy)
    values = {name: getattr(strategy, name) for name in _parameters(cls) if hasattr(strategy, name)}
    texts = [f"{name}={_text(name, value)}" for name, value in values.items()]
    return ":".join([STRATEGIES.name_of(cls), ",".join(texts)]).rstrip(":")


def split_spec(spec: str) -> tuple[str, dict[str, str]]:
    """The name or `module:Class` of a spec, and the parameters' values as text, which may contain colons.

    Raises UserError if a parameter is not of the form key=value, or given twice.
    """
    before, equals, _ = spec.partition("=")
    head, colon, _ = before.rpartition(":")
    if not colon or (not equals and head.strip() not in BUILT_IN):  # NAME or module:Class without parameters
        return spec.strip(), {}
    parameters = {}
    for item in spec[len(head) + 1 :].split(","):
        key, equals, value = (part.strip() for part in item.partition("="))
        if not (key and equals and value):
            raise UserError(f"strategy '{spec}': '{item}' is not of the form key=value")
        if key in parameters:
            raise UserError(f"strategy '{spec}': parameter '{key}' is given twice")
        parameters[key] = value
    return head.strip(), parameters


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
            raise UserError(f"strategy '{head}' has no parameter '{key}'{suggestion(key, known)}; known are {names}")
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
        expected = "true or false" if target_type is bool else "a whole number" if target_type is int else "a number"
        raise UserError(f"strategy '{head}': {key}={text} should be {expected}") from None


def _text(name: str, value: object) -> str:
    if callable(value) and name in PIECES:
        return PIECES[name].name_of(value)
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        short = f"{value:g}"
        return short if float(short) == value else repr(value)
    return str(value)
