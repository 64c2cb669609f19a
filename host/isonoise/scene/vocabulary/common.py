"""Pieces that several plugins share."""

from isonoise.scene.vocabulary.plugin import IGNORED, Parameter


def ignored(type_: str, *names: str, why: str) -> tuple[Parameter, ...]:
    """Parameters that are read over: they cannot change the image, and `why` not."""
    return tuple(Parameter(name, type_, status=IGNORED, meaning=why) for name in names)


PLACED = (Parameter("to_world", "transform", meaning="from object to world space", unset="identity"),)
