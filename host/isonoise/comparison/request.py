"""What a comparison is asked to do, before names are resolved; made by the command, `experiment_file` and `api`.

`planning.make_plan` makes a `Plan` of a `Request`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

PLACEHOLDER = "$"
"""First character of the settings that are values of an XML scene's placeholders."""


@dataclass(frozen=True)
class SceneRequest:
    """A scene, and what is changed in it.

    Attributes
    ----------
    source : str or scene
        A file, the name of a built-in scene, or a scene object of Python.
    settings : mapping
        `$name` of a placeholder, or path of a parameter -> value.
    size : (width, height) or None
        Pixels. None: the scene's.
    max_depth : int or None
        None: the scene's.
    reference : str or None
        File of its reference. None: it is rendered.
    name : str or None
        Its name in tables and files. None: made from the source.
    origin : str
        Where it is asked for, for messages.
    """

    source: object
    settings: Mapping[str, object] = field(default_factory=dict)
    size: tuple[int, int] | None = None
    max_depth: int | None = None
    reference: str | None = None
    name: str | None = None
    origin: str = ""


@dataclass(frozen=True)
class StrategyRequest:
    """A strategy by its spec, and those of its parameters that an experiment sets."""

    spec: str
    settings: Mapping[str, object] = field(default_factory=dict)


@dataclass(frozen=True)
class Request:
    """A comparison: every scene with every strategy and seed. One of `time` (seconds) and `spp` is the budget."""

    scenes: Sequence[SceneRequest]
    strategies: Sequence[StrategyRequest]
    seeds: Sequence[int]
    time: float | None = None
    spp: float | None = None
    device: str | None = None
    references: Sequence[str] = ()  # one file per scene, in order, or SCENE=FILE; others are in the scenes
    reference_time: float | None = None
    preset: str | None = None
    allow_outside: bool = False
    metrics: Sequence[str] = ()  # of the tidy tables; empty: those of the folder, or the default ones
    keep_images: bool = False  # the image of every run as an EXR file
    experiment: str | None = None  # text of the file that asks for it


def text_of(value: object) -> str:
    """The value of a setting as a user would write it in a strategy or on the command line."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list | tuple):
        return ",".join(map(text_of, value))
    return f"{value:.12g}" if isinstance(value, float) else str(value)
