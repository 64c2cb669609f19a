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
            P("filename", "file", required=True, meaning="PNG, JPEG, BMP, TGA, OpenEXR or Radiance HDR"),
            P("filter_type", "string", "bilinear", choices=("bilinear", "nearest"), meaning="between texels"),
            P("wrap_mode", "string", "repeat", choices=("repeat", "mirror", "clamp"), meaning="beyond [0, 1]"),
            P("raw", "boolean", False, meaning="values are numbers: the curve of sRGB is not taken off"),
            _UV,
            *ignored("string", "format", why="the precision of texels on Mitsuba's device"),
            *ignored("boolean", "accel", why="how texels are fetched on Mitsuba's device"),
        ),
        meaning="an image",
    ),
    Plugin(
        "texture",
        "checkerboard",
        (
            P("color0", "reflectance", 0.4, texture=True, meaning="of the squares at 0, 0"),
            P("color1", "reflectance", 0.2, texture=True, meaning="of the others"),
            _UV,
        ),
        meaning="a checkerboard of 2 x 2 squares a unit of texture coordinates",
    ),
    Plugin(
        "texture",
        "mesh_attribute",
        (
            P("name", "string", required=True, meaning="of the attribute: vertex_... or face_..."),
            P("scale", "float", 1.0, meaning="factor on its values"),
        ),
        meaning="colours of a mesh's vertices or faces",
    ),
)
