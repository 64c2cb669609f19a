"""Pieces that several plugins share."""

from isonoise.scene.registry import IGNORED, Parameter


def ignored(type_: str, *names: str) -> tuple[Parameter, ...]:
    """Parameters that are read over: they cannot change the image."""
    return tuple(Parameter(name, type_, status=IGNORED) for name in names)


PLACED = (Parameter("to_world", "transform"),)
