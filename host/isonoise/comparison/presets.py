"""Comparisons that can be named instead of spelled out."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Preset:
    """Pieces of a plan; options given besides replace them one by one."""

    meaning: str
    scenes: tuple[str, ...]
    strategies: tuple[str, ...]
    seeds: int
    time: float  # seconds a run


PRESETS = {
    "poster": Preset(
        meaning="the figures of the method's poster, from the built-in scenes",
        scenes=("bright-spots", "penumbra", "cornell"),
        strategies=("uniform", "relative-mean", "relative-median"),
        seeds=8,
        time=10.0,
    ),
}
