"""Turns shapes of the description into world-space triangles or analytic primitives, oriented as in Mitsuba 3.

Mitsuba 3 takes the side of the shading normal as the front (for emission and one-sided bsdfs). isonoise takes the
geometric normal, which follows from a triangle's winding. So where shading and geometric normal disagree, because of a
mirroring transform or the file itself, the winding is reversed.
"""

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from isonoise.scene import structs, transforms
from isonoise.scene.accel.bounds import analytic_extents
from isonoise.scene.mesh.analytic import analytic_areas, cylinder_records, disk_records, sphere_records
from isonoise.scene.mesh.load_mesh import load_mesh
from isonoise.scene.mesh.mesh import normalize, smooth_normals, used_vertices, vector_lengths
from isonoise.scene.placement import FLOAT_STEP

_MAX_ROUNDING = 2.0**-10
"""Of a mesh's vertices in its own space, over its size: beyond it there is a warning."""
_CHUNK_SHAPES = 2**10
"""Shapes made at once: keeps their float64 temporaries small."""
_NO_NORMALS = np.zeros((0, 3), np.float32)
_NO_UVS = np.zeros((0, 2), np.float32)
_ANALYTIC = {"sphere": sphere_records, "disk": disk_records, "cylinder": cylinder_records}


@dataclass
class Surfaces:
    """Shapes of one kind: n meshes with v vertices and t triangles each, or n analytic primitives, with v and t 0."""

    index: np.ndarray  # (n,) of the shapes
    vertices: np.ndarray  # (n, v, 3) float32, in the space of the shapes
    faces: np.ndarray  # (n, t, 3) uint32: vertices of the same mesh
    normals: np.ndarray  # (n, v, 3) float32 unit vectors, or (n, 0, 3) for flat shading
    analytics: np.ndarray  # (n,) structs.ANALYTIC without the index of the shape, or (0,)
    is_flipped: np.ndarray  # (n,) bool, analytic primitives only: the front is the other side
    reversed_winding: np.ndarray  # (n, t) bool: the corners are in reverse order of the mesh file
    uvs: np.ndarray  # (v, 2) float32, or (0, 2); the same for all
    attributes: dict[str, np.ndarray]  # 'vertex_...', 'face_...': see `mesh.Mesh`; the same for all

    def areas(self) -> np.ndarray:
        """Areas (n, t) float64 of the triangles, or (n, 1) of the analytic primitives."""
        if len(self.analytics):
            return analytic_areas(self.analytics)[:, None]
        return np.stack([triangle_areas(*mesh) for mesh in zip(self.vertices, self.faces, strict=True)])

    def boxes(self) -> np.ndarray:
        """(n, 2, 3) float64 corners of the bounding boxes."""
        if len(self.analytics):
            return np.stack(analytic_extents(self.analytics), axis=1)
        vertices = self.vertices if len(self.index) > 1 else used_vertices(self.vertices[0], self.faces[0])[None]
        return np.stack([vertices.min(axis=1), vertices.max(axis=1)], axis=1).astype(float)

    def select(self, number: int) -> "Surfaces":
        """One of the shapes."""
        one = slice(number, number + 1)
        arrays = ("index", "vertices", "faces", "normals", "analytics", "is_flipped", "reversed_winding")
        return replace(self, **{name: getattr(self, name)[one] for name in arrays})


def make_surfaces(shapes: list[dict], first_index: int, name: Callable[[int], str]) -> list[Surfaces]:
    """The surfaces of the shapes of a space; `first_index` is the index of the first one among all shapes.

    Shapes without a file are made many at once. `name` names a shape in errors, by its position in the list.
    """
    by_type: dict[str, list[int]] = {}
    for position, shape in enumerate(shapes):
        by_type.setdefault(shape["type"], []).append(position)
    surfaces = []
    with np.errstate(over="ignore", invalid="ignore"):  # checked here and when the bounds are computed
        for type_, positions in by_type.items():
            for begin in range(0, len(positions), _CHUNK_SHAPES):
                chunk = positions[begin : begin + _CHUNK_SHAPES]
                surfaces += _make_chunk(type_, [shapes[i] for i in chunk], np.array(chunk), first_index, name)
    return surfaces


def _make_chunk(
    type_: str, shapes: list[dict], positions: np.ndarray, first_index: int, name: Callable[[int], str]
) -> list[Surfaces]:
    """The surfaces of shapes of one type, which have `positions` in their space."""
    index, identity = positions + first_index, np.eye(4)
    if type_ not in (*_ANALYTIC, "rectangle", "cube"):
        return [_mesh_file(shape, i, name(p)) for shape, i, p in zip(shapes, index, positions, strict=True)]
    to_world = np.array([shape.get("to_world", identity) for shape in shapes])
    is_flipped = np.array([shape["flip_normals"] for shape in shapes])
    if type_ not in _ANALYTIC:
        return [_rectangles_or_cubes(shapes[0], index, to_world, is_flipped)]
    records = _ANALYTIC[type_](shapes, to_world, lambda number: name(int(positions[number])))
    if type_ == "sphere":
        is_flipped = is_flipped != (np.linalg.det(to_world[:, :3, :3]) < 0)
    none = np.zeros((len(shapes), 0, 3), np.float32)
    no_faces, no_windings = none.astype(np.uint32), none[:, :, 0].astype(bool)
    return [Surfaces(index, none, no_faces, none, records, is_flipped, no_windings, _NO_UVS, {})]


def _rectangles_or_cubes(shape: dict, index: np.ndarray, to_world: np.ndarray, is_flipped: np.ndarray) -> Surfaces:
    mesh = load_mesh(shape)
    vertices = transforms.transform_points(to_world, mesh.vertices)
    # mirrored normals are transformed with the shape
    is_reversed = (np.linalg.det(to_world[:, :3, :3]) < 0) != is_flipped
    faces = np.where(is_reversed[:, None, None], mesh.faces[:, ::-1], mesh.faces)
    return Surfaces(
        index,
        vertices.astype(np.float32),
        faces.astype(np.uint32),
        np.zeros((len(index), 0, 3), np.float32),
        np.zeros(0, structs.ANALYTIC),
        np.zeros(len(index), bool),
        faces[:, :, 0] != mesh.faces[:, 0],
        mesh.uvs,
        {},
    )


def _mesh_file(shape: dict, index: int, name: str) -> Surfaces:
    mesh = load_mesh(shape)
    _warn_if_coarse(mesh.vertices, name)
    to_world = shape.get("to_world", np.eye(4))
    vertices = transforms.transform_points(to_world, mesh.vertices)
    faces = mesh.faces
    if shape["face_normals"]:
        normals = _NO_NORMALS
    elif len(mesh.normals):
        normals = normalize(transforms.transform_normals(to_world, mesh.normals))
        normals = np.where(np.isfinite(normals), normals, 0.0)  # extreme transforms overflow
        faces = _wind_like_normals(vertices, faces, normals)
        is_missing = ~normals.any(axis=1)
        if is_missing.any():
            normals[is_missing] = smooth_normals(vertices, faces)[is_missing]
    else:
        normals = smooth_normals(vertices, faces)
    if len(normals):
        # vertices whose triangles all have zero area have no normal
        normals = np.where(normals.any(axis=1)[:, None], normals, (0.0, 0.0, 1.0))
    if shape["flip_normals"]:
        faces, normals = faces[:, ::-1], -normals
    return Surfaces(
        np.array([index]),
        np.ascontiguousarray(vertices, np.float32)[None],
        np.ascontiguousarray(faces, np.uint32)[None],
        np.ascontiguousarray(normals, np.float32)[None],
        np.zeros(0, structs.ANALYTIC),
        np.zeros(1, bool),
        (faces[:, 0] != mesh.faces[:, 0])[None],
        mesh.uvs,
        mesh.attributes,
    )


def _warn_if_coarse(vertices: np.ndarray, name: str):
    """Warn if a mesh file has rounded its own vertices: 32-bit floats, far from their origin."""
    largest, size = np.abs(vertices).max(), np.ptp(vertices, axis=0).max()
    rounding = FLOAT_STEP * largest / size if size > 0 else 0.0
    if rounding > _MAX_ROUNDING and (vertices == vertices.astype(np.float32)).all():
        warnings.warn(
            f"{name}: its vertices are 32-bit floats far from their origin, rounded to {rounding:.1%} of its size; "
            "export it again, near the origin",
            stacklevel=2,
        )


def _wind_like_normals(vertices: np.ndarray, faces: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Faces, reversed where the sum of their vertex normals points away from the geometric normal."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    cosine_sign = np.einsum("ij,ij->i", np.cross(b - a, c - a), normals[faces].sum(axis=1))
    return np.where((cosine_sign < 0)[:, None], faces[:, ::-1], faces)


def triangle_areas(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Areas (t,) in float64."""
    a, b, c = (vertices[faces[:, i]].astype(np.float64) for i in range(3))
    return 0.5 * vector_lengths(np.cross(b - a, c - a))
