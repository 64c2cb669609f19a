"""Shapes of the vocabulary."""

from isonoise.scene.vocabulary.common import TO_WORLD, ignored
from isonoise.scene.vocabulary.plugin import Child, Parameter, Plugin

P = Parameter
_SHAPE = (
    *TO_WORLD,
    P("flip_normals", "boolean", False, meaning="swap front and back"),
    *ignored("float", "silhouette_sampling_weight", why="only for derivatives"),
)
_CHILDREN = (
    Child("bsdf"),
    Child("emitter", types=("area",)),
    Child("medium", max_count=2, names=("interior", "exterior")),
)
_FACE_NORMALS = P("face_normals", "boolean", False, meaning="flat shading: ignore vertex normals and compute none")
_MESH = (P("filename", "file", required=True, meaning="file name"), *_SHAPE, _FACE_NORMALS)
_FLIP_TEX_COORDS = "replace v by 1 - v"

_SIMPLE_SHAPES = (
    Plugin("shape", "rectangle", _SHAPE, _CHILDREN, meaning="the square [-1, 1] x [-1, 1] in the plane z = 0"),
    Plugin("shape", "cube", _SHAPE, _CHILDREN, meaning="the cube [-1, 1] x [-1, 1] x [-1, 1]"),
    Plugin(
        "shape",
        "sphere",
        (
            P("center", "vector", (0.0, 0.0, 0.0), meaning="before to_world"),
            P("radius", "float", 1.0, "(0, inf)", meaning="before to_world"),
            *_SHAPE,
        ),
        _CHILDREN,
        meaning="a sphere; with a non-uniform scale, the first axis is used",
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
        meaning="a cylinder without caps",
    ),
    Plugin(
        "shape",
        "obj",
        (*_MESH, P("flip_tex_coords", "boolean", True, meaning=_FLIP_TEX_COORDS)),
        _CHILDREN,
        meaning="a Wavefront OBJ file; its materials are ignored",
    ),
    Plugin(
        "shape",
        "ply",
        (*_MESH, P("flip_tex_coords", "boolean", False, meaning=_FLIP_TEX_COORDS)),
        _CHILDREN,
        meaning="a PLY file, ASCII or binary, with vertex and face attributes",
    ),
    Plugin(
        "shape",
        "serialized",
        (*_MESH, P("shape_index", "integer", 0, "[0, 2147483647]", meaning="index of the mesh in the file, from 0")),
        _CHILDREN,
        meaning="Mitsuba's own mesh format, versions 3 and 4",
    ),
    Plugin(  # isonoise's own, for bare mesh files
        "shape",
        "mesh",
        (
            P("vertices", "positions", required=True, meaning="(n, 3)"),
            P("faces", "indices", required=True, meaning="(n, 3) vertex indices"),
            P("normals", "positions", meaning="(n, 3), per vertex", unset="computed from the faces"),
            P("texcoords", "uvs", meaning="(n, 2), per vertex, v = 0 is the top row of an image", unset="none"),
            P("attributes", "attributes", meaning="arrays by name: vertex_... (n, c), face_... (m, c)", unset="none"),
            *_SHAPE,
            _FACE_NORMALS,
        ),
        _CHILDREN,
        meaning="triangles in arrays; isonoise's own, in dicts only",
    ),
)

SHAPES = (
    *_SIMPLE_SHAPES,
    Plugin(
        "shape",
        "shapegroup",
        ignored("transform", "to_world", why="Mitsuba 3 ignores it too"),
        (Child("shape", max_count=1 << 32, min_count=1, types=tuple(plugin.name for plugin in _SIMPLE_SHAPES)),),
        meaning="shapes that are visible only through instances",
    ),
    Plugin(
        "shape",
        "instance",
        TO_WORLD,
        (Child("shape", min_count=1, types=("shapegroup",)),),
        meaning="a copy of a shapegroup",
    ),
)
