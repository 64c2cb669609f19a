"""Strategies as the comparison names them: the renderer's own, oracles that need a file, and other renderers."""

from pathlib import Path

from isonoise.errors import UserError
from isonoise.strategies import describe, make_strategy

PEERS = {"mitsuba-independent": "independent", "mitsuba-multijitter": "multijitter"}
"""Strategies that are another renderer, with its sampler."""
ORACLE = "oracle"


def split_specs(text: str) -> list[str]:
    """The strategies of a comma-separated list, whose parameters have commas too: `a:k=v,k=v,b` is two.

    An item with '=' but without 'name:' before it belongs to the spec before. Raises UserError if there is none.
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
    """Whether the strategy is an oracle that was not told where its variance is: the comparison renders it."""
    head, _, parameters = spec.partition(":")
    return head.strip() == ORACLE and not any(item.strip().startswith("file=") for item in parameters.split(","))


def with_variance(spec: str, path: Path) -> str:
    """The oracle's spec with the file that holds the variance."""
    if "," in str(path):
        raise UserError(f"'{path}' cannot be handed to a strategy: its name has a comma; compare into another folder")
    return f"{spec}{',' if ':' in spec else ':'}file={path}"


def title_of(spec: str) -> str:
    """The name that people read."""
    return f"Mitsuba 3 {PEERS[spec]}" if spec in PEERS else spec


def describe_spec(spec: str) -> str:
    """The spec with every parameter written out; an oracle's file is left out where the comparison makes it.

    Raises UserError if there is no such strategy or parameter, or a value is out of range.
    """
    if spec in PEERS:
        return spec
    if not needs_variance(spec):
        return describe(make_strategy(spec))
    items = describe(make_strategy(with_variance(spec, Path("variance.exr")))).split(",")
    head, _, first = items[0].partition(":")
    return f"{head}:{','.join(item for item in [first, *items[1:]] if not item.startswith('file='))}".rstrip(":")
