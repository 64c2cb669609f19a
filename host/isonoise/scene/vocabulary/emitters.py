"""Emitters of the vocabulary."""

from isonoise.scene.vocabulary.common import TO_WORLD, ignored
from isonoise.scene.vocabulary.plugin import UNSUPPORTED, Child, Parameter, Plugin

P = Parameter
_WEIGHT = ignored("float", "sampling_weight", why="moves samples between lights; isonoise picks them by itself")
_CHILDREN = (Child("medium"),)  # where it stands: only tracers from the lights ask for that

EMITTERS = (
    Plugin(
        "emitter",
        "area",
        (
            P("radiance", "radiance", 1.0, texture=True, meaning="emitted radiance, W / (m² sr)"),
            *_WEIGHT,
        ),
        _CHILDREN,
        meaning="makes a shape shine, on the side of its normal",
    ),
    Plugin(
        "emitter",
        "point",
        (
            P("intensity", "radiance", 1.0, meaning="radiant intensity, W / sr"),
            P("position", "vector", meaning="where it stands, in place of to_world", unset="0, 0, 0"),
            *TO_WORLD,
            *_WEIGHT,
        ),
        _CHILDREN,
        meaning="a point that shines the same in all directions",
    ),
    Plugin(
        "emitter",
        "spot",
        (
            P("intensity", "radiance", 1.0, meaning="radiant intensity in the middle, W / sr"),
            P("cutoff_angle", "float", 20.0, "(0, 90)", meaning="half the angle of the cone, degrees"),
            P(
                "beam_width",
                "float",
                interval="[0, 90)",
                meaning="half the angle within which intensity does not fall off, degrees",
                unset="3/4 of cutoff_angle",
            ),
            P("texture", "texture", status=UNSUPPORTED, meaning="a picture in the cone is not built"),
            *TO_WORLD,
            *_WEIGHT,
        ),
        _CHILDREN,
        meaning="a point that shines into a cone around +z",
    ),
    Plugin(
        "emitter",
        "directional",
        (
            P("irradiance", "radiance", 1.0, meaning="power a unit of area at right angles to the light, W / m²"),
            P("direction", "vector", meaning="where the light goes, in place of to_world", unset="0, 0, 1"),
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
            P("filename", "file", required=True, meaning="an image in latitude-longitude format, y up"),
            P("scale", "float", 1.0, "[0, inf)", meaning="factor on its radiance"),
            *ignored("boolean", "mis_compensation", why="moves samples alone"),
            *TO_WORLD,
            *_WEIGHT,
        ),
        _CHILDREN,
        meaning="an image around the scene, sampled by its brightness",
    ),
    Plugin(
        "emitter",
        "constant",
        (P("radiance", "radiance", 1.0, meaning="radiance from all directions, W / (m² sr)"), *_WEIGHT),
        _CHILDREN,
        meaning="the same light from all directions",
    ),
)
