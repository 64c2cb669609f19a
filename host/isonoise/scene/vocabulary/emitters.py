"""Emitters of the vocabulary."""

from isonoise.scene.registry import Parameter, Plugin
from isonoise.scene.vocabulary.common import PLACED, ignored

P = Parameter
_WEIGHT = ignored("float", "sampling_weight")

EMITTERS = (
    Plugin("emitter", "area", (P("radiance", "radiance", 1.0, texture=True), *_WEIGHT)),
    Plugin("emitter", "point", (P("intensity", "radiance", 1.0), P("position", "vector"), *PLACED, *_WEIGHT)),
    Plugin("emitter", "directional", (P("irradiance", "radiance", 1.0), P("direction", "vector"), *PLACED, *_WEIGHT)),
    Plugin("emitter", "constant", (P("radiance", "radiance", 1.0), *_WEIGHT)),
)
