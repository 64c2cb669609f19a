"""Presets of `isonoise compare`: named lists of scenes, strategies, seeds and budget."""

from dataclasses import dataclass

from isonoise.strategies.registry import DEFAULT_STRATEGY

POSTER = "poster"
MITSUBA = ("mitsuba-multijitter", "mitsuba-independent")
BUILT_IN_SCENES = ("bright-spots", "penumbra", "cornell")


@dataclass(frozen=True)
class Preset:
    """Defaults of a plan; every option that is given replaces the preset's value. The budget is `time` or `spp`."""

    description: str
    scenes: tuple[str, ...]
    strategies: tuple[str, ...]
    seeds: int
    time: float | None = None  # seconds a run
    spp: tuple[float, ...] = ()  # samples per pixel; a comparison for each


PRESETS = {
    POSTER: Preset(
        description="the figures of the poster, from the built-in scenes",
        scenes=BUILT_IN_SCENES,
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
    "equal-samples": Preset(
        description="samplers and the default at equal samples per pixel, valid ones for multijitter",
        scenes=BUILT_IN_SCENES,
        strategies=(
            "uniform",
            "uniform:sampler=independent",
            DEFAULT_STRATEGY,
            "oracle:rule=sqrt",
            *MITSUBA,
        ),
        seeds=8,
        spp=(64, 256, 1024),
    ),
    "equal-time": Preset(
        description="the default at equal time, with its bound and the peer renderer",
        scenes=BUILT_IN_SCENES,
        strategies=("uniform", DEFAULT_STRATEGY, "oracle:rule=sqrt", *MITSUBA),
        seeds=8,
        time=10.0,
    ),
    "strategies": Preset(
        description="all strategies at equal time",
        scenes=BUILT_IN_SCENES,
        strategies=(
            "uniform",
            DEFAULT_STRATEGY,
            f"{DEFAULT_STRATEGY}:rule=deficit",
            f"{DEFAULT_STRATEGY}:ratio=inf",
            "relative-median",
            "relative-median:ratio=inf",
            "relative-median:kappa=inf,batch=1,literal=true",
            "relative-mean",
            "relative-mean:ratio=inf",
            "absolute",
            "purgathofer",
            "tsallis",
            "tsallis:q=1",
            "dammertz:threshold=0.003",
            "cycles:threshold=0.05",
            "tungsten",
            "luxcore",
            "oracle:rule=deficit",
            "oracle:rule=sqrt",
            *MITSUBA,
        ),
        seeds=8,
        time=10.0,
    ),
    "error-vs-time": Preset(
        description="the plot of the README: error against time",
        scenes=("penumbra",),
        strategies=("uniform", DEFAULT_STRATEGY, "cycles:threshold=0.05", "tungsten", "luxcore", *MITSUBA),
        seeds=5,
        time=8.0,
    ),
}
