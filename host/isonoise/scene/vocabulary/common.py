"""Parameters that several plugins share."""

from isonoise.scene.vocabulary.plugin import IGNORED, Parameter


def ignored(type_: str, *names: str, why: str) -> tuple[Parameter, ...]:
    """Parameters that are accepted and ignored, because they do not change the image; `why` says the reason."""
    return tuple(Parameter(name, type_, status=IGNORED, meaning=why) for name in names)


TO_WORLD = (Parameter("to_world", "transform", meaning="from object to world space", unset="identity"),)
