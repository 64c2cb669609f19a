"""Presets of `isonoise compare`: named lists of scenes, strategies, seeds and budget."""

from dataclasses import dataclass

from isonoise.strategies.registry import DEFAULT_STRATEGY

POSTER = "poster"


@dataclass(frozen=True)
class Preset:
    """Defaults of a plan; every option that is given replaces the preset's value."""

    description: str
    scenes: tuple[str, ...]
    strategies: tuple[str, ...]
    seeds: int
    time: float  # seconds a run


PRESETS = {
    POSTER: Preset(
        description="the figures of the poster, from the built-in scenes",
        scenes=("bright-spots", "penumbra", "cornell"),
        strategies=(
            "uniform",
            "relative-mean",
            "relative-median",
            "relative-median:kappa=inf,batch=1",  # the definition in the poster
            "relative-median:kappa=inf,batch=1,literal=true",  # the literal reading: the variance over M_x
            "relative-mean:ratio=inf",  # without alternation
            "relative-median:ratio=inf",
            "tsallis",
            "tsallis:q=1",
            DEFAULT_STRATEGY,
        ),
        seeds=8,
        time=10.0,
    ),
}
