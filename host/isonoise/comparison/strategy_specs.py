"""Strategy specs of a comparison: isonoise's own, the oracle, whose file the comparison makes, and other renderers."""

from pathlib import Path

from isonoise.errors import UserError
from isonoise.strategies import describe, make_strategy

MITSUBA_SAMPLERS = {"mitsuba-independent": "independent", "mitsuba-multijitter": "multijitter"}
"""Strategies that Mitsuba 3 renders, and its sampler."""
ORACLE = "oracle"


def split_specs(text: str) -> list[str]:
    """Splits a comma-separated list of specs, whose parameters contain commas, too: `a:k=v,k=v,b` has two specs.

    An item with '=' and without 'name:' belongs to the spec before it. Raises UserError if there is none.
    """
    specs = []
    for item in text.split(","):
        before, equals, _ = item.partition("=")
        if equals and ":" not in before:
            if not specs:
                raise UserError(f"strategies '{text}': '{item}' is a parameter without a strategy before it")
            specs[-1] += f",{item}"
        elif item.strip():
            specs.append(item.strip())
    return specs


def needs_variance(spec: str) -> bool:
    """Whether the spec is an oracle without file=; the comparison renders its variance."""
    head, _, parameters = spec.partition(":")
    return head.strip() == ORACLE and not any(item.strip().startswith("file=") for item in parameters.split(","))


def with_variance(spec: str, path: Path) -> str:
    """The oracle's spec with the file of the variance. Raises UserError if the path cannot be part of a spec."""
    if "," in str(path):
        raise UserError(
            f"'{path}' cannot be a parameter of a strategy: it contains a comma; choose another folder with -o"
        )
    return f"{spec}{',' if ':' in spec else ':'}file={path}"


def strategy_title(spec: str) -> str:
    """Title of a strategy in tables and plots."""
    return f"Mitsuba 3 {MITSUBA_SAMPLERS[spec]}" if spec in MITSUBA_SAMPLERS else spec


def describe_spec(spec: str) -> str:
    """The spec with all parameters, without the oracle's file if the comparison makes it.

    Raises UserError if there is no such strategy or parameter, or a value is out of range.
    """
    if spec in MITSUBA_SAMPLERS:
        return spec
    if not needs_variance(spec):
        return describe(make_strategy(spec))
    items = describe(make_strategy(with_variance(spec, Path("variance.exr")))).split(",")
    head, _, first = items[0].partition(":")
    return f"{head}:{','.join(item for item in [first, *items[1:]] if not item.startswith('file='))}".rstrip(":")
