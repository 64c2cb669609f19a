"""Emitters of the vocabulary."""

from isonoise.scene.registry import UNSUPPORTED, Parameter, Plugin
from isonoise.scene.vocabulary.common import PLACED, ignored

P = Parameter
_WEIGHT = ignored("float", "sampling_weight")

EMITTERS = (
    Plugin("emitter", "area", (P("radiance", "radiance", 1.0, texture=True), *_WEIGHT)),
    Plugin("emitter", "point", (P("intensity", "radiance", 1.0), P("position", "vector"), *PLACED, *_WEIGHT)),
    Plugin(
        "emitter",
        "spot",
        (
            P("intensity", "radiance", 1.0),
            P("cutoff_angle", "float", 20.0, "(0, 90)"),
            P("beam_width", "float", interval="[0, 90)"),
            P("texture", "texture", status=UNSUPPORTED),
            *PLACED,
            *_WEIGHT,
        ),
    ),
    Plugin("emitter", "directional", (P("irradiance", "radiance", 1.0), P("direction", "vector"), *PLACED, *_WEIGHT)),
    Plugin(
        "emitter",
        "envmap",
        (P("filename", "file", required=True), P("scale", "float", 1.0, "[0, inf)"), *PLACED, *_WEIGHT),
    ),
    Plugin("emitter", "constant", (P("radiance", "radiance", 1.0), *_WEIGHT)),
)
