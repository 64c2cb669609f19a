"""Shapes of the vocabulary."""

from isonoise.scene.vocabulary.common import PLACED, ignored
from isonoise.scene.vocabulary.plugin import Child, Parameter, Plugin

P = Parameter
_SHAPE = (
    *PLACED,
    P("flip_normals", "boolean", False, meaning="the front is the other side"),
    *ignored("float", "silhouette_sampling_weight", why="for derivatives alone"),
)
_CHILDREN = (Child("bsdf"), Child("emitter", types=("area",)), Child("medium", most=2, names=("interior", "exterior")))
_FACE_NORMALS = P("face_normals", "boolean", False, meaning="flat: normals of vertices are neither read nor made")
_MESH = (P("filename", "file", required=True, meaning="the file"), *_SHAPE, _FACE_NORMALS)
_V = "the file's v runs downwards"

_PLAIN = (
    Plugin("shape", "rectangle", _SHAPE, _CHILDREN, meaning="the square from -1, -1 to 1, 1 in the plane z = 0"),
    Plugin("shape", "cube", _SHAPE, _CHILDREN, meaning="the cube from -1, -1, -1 to 1, 1, 1"),
    Plugin(
        "shape",
        "sphere",
        (
            P("center", "vector", (0.0, 0.0, 0.0), meaning="before to_world"),
            P("radius", "float", 1.0, "(0, inf)", meaning="before to_world"),
            *_SHAPE,
        ),
        _CHILDREN,
        meaning="a sphere; of an uneven scale the first axis counts",
    ),
    Plugin("shape", "disk", _SHAPE, _CHILDREN, meaning="the unit disk in the plane z = 0"),
    Plugin(
        "shape",
        "cylinder",
        (
            P("p0", "vector", (0.0, 0.0, 0.0), meaning="one end of its axis"),
            P("p1", "vector", (0.0, 0.0, 1.0), meaning="the other end"),
            P("radius", "float", 1.0, "(0, inf)", meaning="before to_world"),
            *_SHAPE,
        ),
        _CHILDREN,
        meaning="a tube, open at both ends",
    ),
    Plugin(
        "shape",
        "obj",
        (*_MESH, P("flip_tex_coords", "boolean", True, meaning=_V)),
        _CHILDREN,
        meaning="a Wavefront OBJ file; its materials are not read",
    ),
    Plugin(
        "shape",
        "ply",
        (*_MESH, P("flip_tex_coords", "boolean", False, meaning=_V)),
        _CHILDREN,
        meaning="a PLY file, ASCII or binary, with attributes of vertices and faces",
    ),
    Plugin(
        "shape",
        "serialized",
        (
            *_MESH,
            P("shape_index", "integer", 0, "[0, 2147483647]", meaning="which mesh of the file, counted from 0"),
        ),
        _CHILDREN,
        meaning="Mitsuba's own mesh format, versions 3 and 4",
    ),
    Plugin(  # isonoise's own: what meshes without a scene become
        "shape",
        "mesh",
        (
            P("vertices", "positions", required=True, meaning="(n, 3)"),
            P("faces", "indices", required=True, meaning="(n, 3), of vertices"),
            P("normals", "positions", meaning="(n, 3), of vertices", unset="made from the faces"),
            *_SHAPE,
            _FACE_NORMALS,
        ),
        _CHILDREN,
        meaning="triangles in arrays: dicts only, isonoise's own",
    ),
)

SHAPES = (
    *_PLAIN,
    Plugin(
        "shape",
        "shapegroup",
        ignored("transform", "to_world", why="Mitsuba 3 reads it and does nothing with it"),
        (Child("shape", most=1 << 32, least=1, types=tuple(plugin.name for plugin in _PLAIN)),),
        meaning="shapes that are not seen themselves, but where an instance stands",
    ),
    Plugin(
        "shape",
        "instance",
        PLACED,
        (Child("shape", least=1, types=("shapegroup",)),),
        meaning="a shapegroup in one more place",
    ),
)
