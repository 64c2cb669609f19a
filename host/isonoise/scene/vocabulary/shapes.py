"""Shapes of the vocabulary."""

from isonoise.scene.registry import Child, Parameter, Plugin
from isonoise.scene.vocabulary.common import PLACED, ignored

P = Parameter
_SHAPE = (*PLACED, P("flip_normals", "boolean", False), *ignored("float", "silhouette_sampling_weight"))
_CHILDREN = (Child("bsdf"), Child("emitter", types=("area",)), Child("medium", most=2))
_MESH = (P("filename", "file", required=True), *_SHAPE, P("face_normals", "boolean", False))

_PLAIN = (
    Plugin("shape", "rectangle", _SHAPE, _CHILDREN),
    Plugin("shape", "cube", _SHAPE, _CHILDREN),
    Plugin(
        "shape",
        "sphere",
        (P("center", "vector", (0.0, 0.0, 0.0)), P("radius", "float", 1.0, "(0, inf)"), *_SHAPE),
        _CHILDREN,
    ),
    Plugin("shape", "disk", _SHAPE, _CHILDREN),
    Plugin(
        "shape",
        "cylinder",
        (
            P("p0", "vector", (0.0, 0.0, 0.0)),
            P("p1", "vector", (0.0, 0.0, 1.0)),
            P("radius", "float", 1.0, "(0, inf)"),
            *_SHAPE,
        ),
        _CHILDREN,
    ),
    Plugin("shape", "obj", (*_MESH, P("flip_tex_coords", "boolean", True)), _CHILDREN),
    Plugin("shape", "ply", (*_MESH, P("flip_tex_coords", "boolean", False)), _CHILDREN),
    Plugin("shape", "serialized", (*_MESH, P("shape_index", "integer", 0, "[0, 2147483647]")), _CHILDREN),
    Plugin(  # isonoise's own: what meshes without a scene become
        "shape",
        "mesh",
        (
            P("vertices", "positions", required=True),
            P("faces", "indices", required=True),
            P("normals", "positions"),
            *_SHAPE,
            P("face_normals", "boolean", False),
        ),
        _CHILDREN,
    ),
)

SHAPES = (
    *_PLAIN,
    Plugin(
        "shape",
        "shapegroup",
        ignored("transform", "to_world"),  # Mitsuba 3 reads it and does nothing with it
        (Child("shape", most=1 << 32, least=1, types=tuple(plugin.name for plugin in _PLAIN)),),
    ),
    Plugin("shape", "instance", PLACED, (Child("shape", least=1, types=("shapegroup",)),)),
)
