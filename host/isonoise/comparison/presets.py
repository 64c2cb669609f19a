"""Comparisons that can be named instead of spelled out."""

from dataclasses import dataclass

from isonoise.strategies.registry import DEFAULT_STRATEGY

POSTER = "poster"


@dataclass(frozen=True)
class Preset:
    """Pieces of a plan; options given besides replace them one by one."""

    meaning: str
    scenes: tuple[str, ...]
    strategies: tuple[str, ...]
    seeds: int
    time: float  # seconds a run


PRESETS = {
    POSTER: Preset(
        meaning="the figures of the method's poster, from the built-in scenes",
        scenes=("bright-spots", "penumbra", "cornell"),
        strategies=(
            "uniform",
            "relative-mean",
            "relative-median",
            "relative-median:kappa=inf,batch=1",  # as the poster writes it
            "relative-median:kappa=inf,batch=1,literal=true",  # as it can be read: the variance over M_x
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
