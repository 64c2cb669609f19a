"""Parameters that several plugins share."""

from isonoise.scene.vocabulary.plugin import IGNORED, Parameter


def ignored(type_: str, *names: str, why: str) -> tuple[Parameter, ...]:
    """Parameters that are accepted and ignored, because they do not change the image; `why` says the reason."""
    return tuple(Parameter(name, type_, status=IGNORED, meaning=why) for name in names)


FIELD_OF_VIEW = (
    Parameter(
        "fov", "float", interval="(0, 180)", meaning="angle of view along fov_axis, degrees", unset="by focal_length"
    ),
    Parameter("focal_length", "string", meaning="of a 35 mm camera, as in 50mm", unset="50mm"),
    Parameter(
        "fov_axis", "string", "x", choices=("x", "y", "diagonal", "smaller", "larger"), meaning="side that fov spans"
    ),
)
TO_WORLD = (Parameter("to_world", "transform", meaning="from object to world space", unset="identity"),)
