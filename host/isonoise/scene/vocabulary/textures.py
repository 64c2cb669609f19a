"""Textures of the vocabulary."""

from isonoise.scene.vocabulary.common import ignored
from isonoise.scene.vocabulary.plugin import Parameter, Plugin

P = Parameter
_UV = P("to_uv", "transform", meaning="applied to the texture coordinates", unset="identity")

TEXTURES = (
    Plugin(
        "texture",
        "bitmap",
        (
            P("filename", "file", meaning="PNG, JPEG, BMP, TGA, OpenEXR or Radiance HDR", unset="required"),
            P("bitmap", "image", meaning="an image in memory instead of a file, in dicts only", unset="by filename"),
            P(
                "data",
                "image",
                meaning="an array (h, w, c): bytes are sRGB, floats linear; dicts only",
                unset="by filename",
            ),
            P(
                "filter_type",
                "string",
                "bilinear",
                choices=("bilinear", "nearest"),
                meaning="interpolation between texels",
            ),
            P("wrap_mode", "string", "repeat", choices=("repeat", "mirror", "clamp"), meaning="uv outside [0, 1]"),
            P("raw", "boolean", False, meaning="do not decode sRGB"),
            _UV,
            *ignored("string", "format", why="precision of texels in Mitsuba"),
            *ignored("boolean", "accel", why="texture units in Mitsuba"),
        ),
        meaning="an image",
    ),
    Plugin(
        "texture",
        "checkerboard",
        (
            P("color0", "reflectance", 0.4, texture=True, meaning="colour of the square at 0, 0"),
            P("color1", "reflectance", 0.2, texture=True, meaning="colour of the other squares"),
            _UV,
        ),
        meaning="a checkerboard with 2 x 2 squares per unit of uv",
    ),
    Plugin(
        "texture",
        "mesh_attribute",
        (
            P("name", "string", required=True, meaning="name of the attribute: vertex_... or face_..."),
            P("scale", "float", 1.0, meaning="factor on its values"),
        ),
        meaning="vertex or face colours of a mesh",
    ),
    Plugin(
        "texture",
        "rawconstant",
        (P("value", "raw", required=True, meaning="a number, or three as a vector"),),
        meaning="the same everywhere, as it is written",
    ),
    Plugin(
        "texture",
        "srgb",
        (P("color", "reflectance", required=True, meaning="its colour"),),
        meaning="the same colour everywhere, as <rgb>",
    ),
    Plugin(
        "texture",
        "uniform",
        (P("value", "float", interval="[0, inf)", required=True, meaning="its value"),),
        meaning="the same value everywhere, as a number",
    ),
    Plugin(
        "texture",
        "d65",
        (
            P("color", "radiance", meaning="factor on white", unset="1"),
            P("scale", "float", 1.0, "[0, inf)", meaning="factor on its colour"),
        ),
        meaning="white light: the standard illuminant D65",
    ),
)

CONSTANT_TEXTURES = ("rawconstant", "srgb", "uniform", "d65")
"""Textures that are constant: where one is a parameter, the parameter gets its value."""
