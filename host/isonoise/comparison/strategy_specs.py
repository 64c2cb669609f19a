"""Strategy specs of a comparison: isonoise's own with a sampler, the oracle, other renderers."""

from itertools import islice, takewhile
from pathlib import Path

from isonoise.errors import UserError
from isonoise.samplers import SAMPLERS
from isonoise.strategies import Strategy, describe, make_strategy
from isonoise.strategies.registry import split_spec

MITSUBA_SAMPLERS = {"mitsuba-independent": "independent", "mitsuba-multijitter": "multijitter"}
"""Strategies that Mitsuba 3 renders, and its sampler."""
ORACLE = "oracle"
FIRST_WAVES = 8
"""A strategy that plans no adaptive wave among these is taken as uniform."""


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


def split_sampler(spec: str) -> tuple[str, str]:
    """The spec without the parameter `sampler`, which all strategies have in a comparison; its value or the default.

    Raises UserError if there is no such sampler.
    """
    if "sampler=" not in spec:
        return spec, SAMPLERS[0]
    head, parameters = split_spec(spec)
    if "sampler" not in parameters:
        return spec, SAMPLERS[0]
    sampler = parameters.pop("sampler")
    if sampler not in SAMPLERS:
        raise UserError(f"strategy '{spec}': there is no sampler '{sampler}'; known are {', '.join(SAMPLERS)}")
    others = ",".join(f"{name}={value}" for name, value in parameters.items())
    return (f"{head}:{others}" if others else head), sampler


def independent_counterpart(spec: str) -> str:
    """The spec with independent samples in place of stratified ones; the spec itself if its samples are."""
    if spec in MITSUBA_SAMPLERS:
        return next(name for name, sampler in MITSUBA_SAMPLERS.items() if sampler == "independent")
    strategy, _ = split_sampler(spec)
    return with_sampler(strategy, "independent")


def with_sampler(spec: str, sampler: str) -> str:
    """The spec with the parameter `sampler`, which it must not have."""
    return f"{spec}{',' if '=' in spec else ':'}sampler={sampler}"


def needs_variance(spec: str) -> bool:
    """Whether the spec is an oracle without file=; the comparison renders its variance."""
    return spec.partition(":")[0].strip() == ORACLE and oracle_file(spec) is None


def oracle_file(spec: str) -> Path | None:
    """The file that an oracle names; None for other specs."""
    head, _, parameters = spec.partition(":")
    files = [item.strip().removeprefix("file=") for item in parameters.split(",") if item.strip().startswith("file=")]
    return Path(files[0]) if head.strip() == ORACLE and files else None


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
    spec, sampler = split_sampler(spec)
    return with_sampler(_describe_strategy(spec), sampler)


def first_waves_spp(strategy: Strategy) -> tuple[float, float | None]:
    """Samples per pixel of the first wave, and of all before the first adaptive wave.

    The latter is None if the first waves are uniform.
    """
    waves = list(islice(strategy.waves(), FIRST_WAVES))
    before = [wave.spp for wave in takewhile(lambda wave: wave.kind == "uniform", waves)]
    return waves[0].spp, sum(before) if len(before) < len(waves) else None


def make_spec(spec: str) -> Strategy:
    """The strategy of a spec that may have a sampler; an oracle whose file the comparison makes has read none.

    Raises UserError as `describe_spec`.
    """
    spec, _ = split_sampler(spec)
    return make_strategy(with_variance(spec, Path("variance.exr")) if needs_variance(spec) else spec)


def _describe_strategy(spec: str) -> str:
    text = describe(make_spec(spec))
    if not needs_variance(spec):
        return text
    items = text.split(",")
    head, _, first = items[0].partition(":")
    return f"{head}:{','.join(item for item in [first, *items[1:]] if not item.startswith('file='))}".rstrip(":")
