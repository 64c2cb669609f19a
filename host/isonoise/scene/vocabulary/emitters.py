"""Emitters of the vocabulary. Their kinds on the device are in `scene/light/light_kinds.py`."""

from isonoise.scene.vocabulary.common import FIELD_OF_VIEW, TO_WORLD, ignored
from isonoise.scene.vocabulary.plugin import Child, Parameter, Plugin

P = Parameter
_WEIGHT = ignored(
    "float", "sampling_weight", why="only distributes samples; isonoise selects lights by power and importance"
)
_CHILDREN = (Child("medium"),)  # the medium around it, which only light tracing needs

EMITTERS = (
    Plugin(
        "emitter",
        "area",
        (
            P("radiance", "radiance", 1.0, texture=True, meaning="emitted radiance, W / (m² sr)"),
            *_WEIGHT,
        ),
        _CHILDREN,
        meaning="makes a shape emit, on the side of its normal",
    ),
    Plugin(
        "emitter",
        "point",
        (
            P("intensity", "radiance", 1.0, meaning="radiant intensity, W / sr"),
            P("position", "vector", meaning="position, instead of to_world", unset="0, 0, 0"),
            *TO_WORLD,
            *_WEIGHT,
        ),
        _CHILDREN,
        meaning="a point that emits the same in all directions",
    ),
    Plugin(
        "emitter",
        "spot",
        (
            P("intensity", "radiance", 1.0, meaning="radiant intensity at the centre, W / sr"),
            P("cutoff_angle", "float", 20.0, "(0, 90)", meaning="half the angle of the cone, degrees"),
            P(
                "beam_width",
                "float",
                interval="[0, 90)",
                meaning="half the angle of the part with constant intensity, degrees",
                unset="3/4 of cutoff_angle",
            ),
            P(
                "texture",
                "texture",
                texture=True,
                meaning="factor on the intensity, projected into the cone",
                unset="1",
            ),
            *TO_WORLD,
            *_WEIGHT,
        ),
        _CHILDREN,
        meaning="a point that emits into a cone around +z",
    ),
    Plugin(
        "emitter",
        "projector",
        (
            P("irradiance", "radiance", 1.0, texture=True, meaning="image: radiance of a white screen at distance 1"),
            P("scale", "float", 1.0, "[0, inf)", meaning="factor on the irradiance"),
            *FIELD_OF_VIEW,
            *TO_WORLD,
            *_WEIGHT,
        ),
        _CHILDREN,
        meaning="a point that projects an image along +z",
    ),
    Plugin(
        "emitter",
        "directional",
        (
            P("irradiance", "radiance", 1.0, meaning="irradiance perpendicular to the light, W / m²"),
            P("direction", "vector", meaning="direction of travel, instead of to_world", unset="0, 0, 1"),
            *TO_WORLD,
            *_WEIGHT,
        ),
        _CHILDREN,
        meaning="parallel light from infinity, along +z",
    ),
    Plugin(
        "emitter",
        "envmap",
        (
            P("filename", "file", meaning="an image in latitude-longitude format, y up", unset="required"),
            P("bitmap", "image", meaning="an image in memory instead of a file, in dicts only", unset="by filename"),
            P("scale", "float", 1.0, "[0, inf)", meaning="factor on its radiance"),
            *ignored("boolean", "mis_compensation", why="only distributes samples"),
            *TO_WORLD,
            *_WEIGHT,
        ),
        _CHILDREN,
        meaning="an image around the scene, importance-sampled",
    ),
    Plugin(
        "emitter",
        "constant",
        (P("radiance", "radiance", 1.0, meaning="radiance from all directions, W / (m² sr)"), *_WEIGHT),
        _CHILDREN,
        meaning="the same radiance from all directions",
    ),
)
