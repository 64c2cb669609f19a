"""Textures of the vocabulary."""

from isonoise.scene.registry import Parameter, Plugin
from isonoise.scene.vocabulary.common import ignored

P = Parameter
_UV = P("to_uv", "transform")

TEXTURES = (
    Plugin(
        "texture",
        "bitmap",
        (
            P("filename", "file", required=True),
            P("filter_type", "string", "bilinear", choices=("bilinear", "nearest")),
            P("wrap_mode", "string", "repeat", choices=("repeat", "mirror", "clamp")),
            P("raw", "boolean", False),
            _UV,
            *ignored("string", "format"),
            *ignored("boolean", "accel"),
        ),
    ),
    Plugin(
        "texture",
        "checkerboard",
        (P("color0", "reflectance", 0.4, texture=True), P("color1", "reflectance", 0.2, texture=True), _UV),
    ),
    Plugin("texture", "mesh_attribute", (P("name", "string", required=True), P("scale", "float", 1.0))),
)
