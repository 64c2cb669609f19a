"""Reads the primitives of glTF meshes: triangles with their vertex attributes. Called by `shapes.py`."""

from dataclasses import dataclass, field

import numpy as np

from isonoise.scene.formats.gltf.accessors import Accessors
from isonoise.scene.formats.gltf.extensions import ADVICE, COMPRESSED_MESHES
from isonoise.scene.formats.gltf.json_objects import JsonObject
from isonoise.scene.formats.report import ImportReport
from isonoise.scene.mesh.mesh import make_uvs

_TRIANGLES, _STRIP, _FAN = 4, 5, 6
_LINES_AND_POINTS = {0: "points", 1: "lines", 2: "a line loop", 3: "a line strip"}
_MAX_UV_SETS = 8


@dataclass(frozen=True)
class Geometry:
    """Triangles of a primitive, in the space of its mesh."""

    vertices: np.ndarray  # (v, 3) float32
    faces: np.ndarray  # (t, 3) int64
    normals: np.ndarray | None = None  # (v, 3); None: flat shading
    uv_sets: list[np.ndarray] = field(default_factory=list)  # (v, 2) float32 each
    colours: np.ndarray | None = None  # (v, 3) float32, linear
    alphas: np.ndarray | None = None  # (v, 1) float32


def read_geometry(primitive: JsonObject, accessors: Accessors, report: ImportReport) -> Geometry | None:
    """The triangles of a primitive; None if it has none. Raises SceneError where it is invalid."""
    mode = primitive.integer("mode", _TRIANGLES, 0, _FAN)
    attributes = _attributes(primitive)
    if mode in _LINES_AND_POINTS:
        report.use("lines_points", f"{primitive.place} ({_LINES_AND_POINTS[mode]})")
        return None
    if "POSITION" not in attributes:
        report.limit("triangles", "it has no POSITION and is left out", primitive.place)
        return None
    compressed = next((name for name in COMPRESSED_MESHES if primitive.extension(name)), None)
    if compressed and "bufferView" not in accessors.document.referenced(attributes, "POSITION", "accessors"):
        primitive.fail("", f"it has no data but those of {compressed}; {ADVICE[compressed]}")
    vertices = accessors.read_floats(attributes, "POSITION", "VEC3")
    if not np.isfinite(vertices).all():
        attributes.fail("POSITION", "a position is not a finite number")
    faces = _read_faces(primitive, mode, len(vertices), accessors, report)
    if not len(faces):
        return None
    report.use("triangles" if mode == _TRIANGLES else "strips_fans", primitive.place)
    if "TANGENT" in attributes:
        report.use("tangents", primitive.place)
    normals = read_vertex_values(attributes, "NORMAL", len(vertices), accessors, "VEC3")
    if normals is not None:
        report.use("normals", primitive.place)
        normals = np.where(np.isfinite(normals).all(axis=1, keepdims=True), normals, np.float32(0))
    colours = read_vertex_values(attributes, "COLOR_0", len(vertices), accessors, "VEC3", "VEC4")
    if colours is not None:
        report.use("vertex_colours", primitive.place)
        colours = np.clip(np.nan_to_num(colours), 0.0, 1.0)
        colours = None if (colours == 1).all() else colours
    return Geometry(
        vertices,
        faces,
        normals,
        _read_uv_sets(attributes, len(vertices), accessors, report),
        None if colours is None else colours[:, :3],
        colours[:, 3:] if colours is not None and colours.shape[1] == 4 else None,
    )


def _attributes(primitive: JsonObject) -> JsonObject:
    attributes = primitive.object("attributes")
    if attributes is None:
        primitive.fail("attributes", "it is missing")
    return attributes


def read_vertex_values(
    attributes: JsonObject, name: str, count: int, accessors: Accessors, *types: str
) -> np.ndarray | None:
    """An attribute as (count, components) float32; None if the primitive does not have it."""
    if name not in attributes:
        return None
    values = accessors.read_floats(attributes, name, *types)
    if len(values) != count:
        attributes.fail(name, f"it has {len(values)} elements, but there are {count} positions")
    return values


def _read_uv_sets(attributes: JsonObject, count: int, accessors: Accessors, report: ImportReport) -> list[np.ndarray]:
    """TEXCOORD_0, TEXCOORD_1, ... as far as they are numbered without a gap."""
    sets: list[np.ndarray] = []
    while len(sets) < _MAX_UV_SETS:
        values = read_vertex_values(attributes, f"TEXCOORD_{len(sets)}", count, accessors, "VEC2")
        if values is None:
            break
        sets.append(make_uvs(values, flip=False))
    if sets:
        report.use("uvs", attributes.place)
    if len(sets) > 1:
        report.use("uv_sets", attributes.place)
    return sets


def _read_faces(
    primitive: JsonObject, mode: int, vertex_count: int, accessors: Accessors, report: ImportReport
) -> np.ndarray:
    """(t, 3) int64 vertex indices of triangles (glTF 2.0 section 3.7.2.1)."""
    if "indices" in primitive:
        corners = accessors.read_integers(primitive, "indices", "SCALAR")[:, 0].astype(np.int64)
        if len(corners) and corners.max() >= vertex_count:
            primitive.fail("indices", f"index {corners.max()} is out of range; there are {vertex_count} positions")
    else:
        corners = np.arange(vertex_count)
    if mode == _TRIANGLES:
        if len(corners) % 3:
            report.limit("triangles", "the last corners make no whole triangle and are left out", primitive.place)
        return corners[: len(corners) - len(corners) % 3].reshape(-1, 3)
    if len(corners) < 3:
        return np.zeros((0, 3), np.int64)
    first = np.arange(len(corners) - 2)
    if mode == _STRIP:
        faces = corners[np.stack([first, first + 1 + first % 2, first + 2 - first % 2], axis=1)]
    else:
        faces = corners[np.stack([first + 1, first + 2, np.zeros_like(first)], axis=1)]
    is_degenerate = (faces == np.roll(faces, 1, axis=1)).any(axis=1)  # strips are joined by such triangles
    return faces[~is_degenerate]


def has_mirrored_uvs(geometry: Geometry, uvs: np.ndarray) -> np.ndarray:
    """(t,) bool: whether the image of the texture is mirrored on a triangle, seen from its front.

    There, the cross product of shading normal and direction of u points down in the image and not up, as glTF's normal
    maps need it.
    """
    corner_uvs, corners = uvs[geometry.faces].astype(float), geometry.vertices[geometry.faces].astype(float)
    (u1, v1), (u2, v2) = ((corner_uvs[:, i] - corner_uvs[:, 0]).T for i in (1, 2))
    is_mirrored = u1 * v2 - u2 * v1 > 0  # v grows downwards
    if geometry.normals is None:
        return is_mirrored
    winding = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = geometry.normals[geometry.faces].astype(float).sum(axis=1)
    return is_mirrored != (np.einsum("ij,ij->i", winding, normals) < 0)


def is_closed(geometry: Geometry) -> bool:
    """Whether every edge has a second triangle, on the other side; vertices at the same position count as one."""
    _, point = np.unique(geometry.vertices, axis=0, return_inverse=True)
    corners = point.reshape(-1)[geometry.faces]
    begin, end = corners.ravel(), np.roll(corners, -1, axis=1).ravel()
    is_edge = begin != end
    forward, backward = begin * len(geometry.vertices) + end, end * len(geometry.vertices) + begin
    return np.array_equal(np.sort(forward[is_edge]), np.sort(backward[is_edge]))
