"""Turns a shape of the description into world-space triangles or an analytic primitive, oriented as in Mitsuba 3.

Mitsuba 3 takes the side of the shading normal as the front (for emission and one-sided bsdfs). isonoise takes the
geometric normal, which follows from a triangle's winding. So where shading and geometric normal disagree, because of a
mirroring transform or the file itself, the winding is reversed.
"""

import math
import warnings
from dataclasses import dataclass, field

import numpy as np

from isonoise.errors import SceneError
from isonoise.scene import structs, transforms
from isonoise.scene.accel.bounds import analytic_extents
from isonoise.scene.mesh.load_mesh import load_mesh
from isonoise.scene.mesh.mesh import normalize, smooth_normals, used_vertices, vector_lengths
from isonoise.scene.placement import FLOAT_STEP

_MAX_ROUNDING = 2.0**-10
"""Of a mesh's vertices in its own space, over its size: beyond it there is a warning."""
_NO_NORMALS = np.zeros((0, 3), np.float32)


@dataclass
class Surface:
    """One shape: triangles, or one analytic primitive (then `analytic` is set and there are no triangles)."""

    vertices: np.ndarray  # (v, 3) float32, world space
    faces: np.ndarray  # (t, 3) uint32
    normals: np.ndarray  # (v, 3) float32 unit vectors, or (0, 3) for flat shading
    analytic: np.ndarray | None = None  # (1,) structs.ANALYTIC; the index of the shape is not set
    flip_normals: bool = False  # analytic primitives only: the front is the other side
    uvs: np.ndarray = field(default_factory=lambda: np.zeros((0, 2), np.float32))  # (v, 2) float32, or (0, 2)
    attributes: dict[str, np.ndarray] = field(default_factory=dict)  # 'vertex_...', 'face_...': see `mesh.Mesh`
    # (t,) bool: the corners are in reverse order of the mesh file
    reversed_winding: np.ndarray = field(default_factory=lambda: np.zeros(0, bool))

    @property
    def areas(self) -> np.ndarray:
        """World-space areas of the primitives, float64."""
        if self.analytic is None:
            return triangle_areas(self.vertices, self.faces)
        return np.array([_analytic_area(self.analytic[0])])

    @property
    def bounds(self) -> np.ndarray:
        """(2, 3) float64 corners of the bounding box."""
        if self.analytic is None:
            used = used_vertices(self.vertices, self.faces)
            return np.stack([used.min(axis=0), used.max(axis=0)]).astype(float)
        return np.concatenate(analytic_extents(self.analytic))


def make_surface(shape: dict, name: str) -> Surface:
    """The surface of a shape of the description. `name` names it in errors."""
    to_world = shape.get("to_world", np.eye(4))
    make = {"sphere": _sphere, "disk": _disk, "cylinder": _cylinder}.get(shape["type"], _triangles)
    with np.errstate(over="ignore", invalid="ignore"):  # checked here and when the bounds are computed
        return make(shape, to_world, name)


def _triangles(shape: dict, to_world: np.ndarray, name: str) -> Surface:
    mesh = load_mesh(shape)
    _warn_if_coarse(mesh.vertices, name)
    vertices = transforms.transform_points(to_world, mesh.vertices)
    faces = mesh.faces
    if shape["type"] in ("rectangle", "cube"):
        is_mirrored = np.linalg.det(to_world[:3, :3]) < 0
        faces = faces[:, ::-1] if is_mirrored else faces  # their normals are transformed with them
        normals = _NO_NORMALS
    elif shape["face_normals"]:
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
    return Surface(
        np.ascontiguousarray(vertices, np.float32),
        np.ascontiguousarray(faces, np.uint32),
        np.ascontiguousarray(normals, np.float32),
        uvs=mesh.uvs,
        attributes=mesh.attributes,
        reversed_winding=faces[:, 0] != mesh.faces[:, 0],
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


def _analytic_record(kind: int, to_world: np.ndarray, name: str) -> np.ndarray:
    record = np.zeros(1, structs.ANALYTIC)
    record["kind"] = kind
    record["to_world"] = to_world[:3].ravel()
    record["to_object"] = np.linalg.inv(to_world)[:3].ravel()
    if not (np.isfinite(record["to_world"]).all() and np.isfinite(record["to_object"]).all()):
        raise SceneError(f"{name}: its size exceeds the range of 32-bit floats")
    return record


def _sphere(shape: dict, to_world: np.ndarray, name: str) -> Surface:
    rotation, stretch = transforms.polar_decomposition(to_world)
    _warn_if_non_uniform(stretch, (0, 1, 2), name)
    radius = shape["radius"] * abs(stretch[0, 0])
    sphere_to_world = np.eye(4)
    sphere_to_world[:3, :3] = rotation * radius
    sphere_to_world[:3, 3] = transforms.transform_points(to_world, np.array([shape["center"]]))[0]
    record = _analytic_record(structs.ANALYTIC_SPHERE, sphere_to_world, name)
    record["center"], record["radius"] = sphere_to_world[:3, 3], radius
    is_mirrored = np.linalg.det(to_world[:3, :3]) < 0
    return _analytic_surface(record, shape["flip_normals"] != is_mirrored)


def _disk(shape: dict, to_world: np.ndarray, name: str) -> Surface:
    return _analytic_surface(_analytic_record(structs.ANALYTIC_DISK, to_world, name), shape["flip_normals"])


def _cylinder(shape: dict, to_world: np.ndarray, name: str) -> Surface:
    p0, axis = np.array(shape["p0"]), np.subtract(shape["p1"], shape["p0"])
    length, radius = np.linalg.norm(axis), shape["radius"]
    rotation = transforms.rotation_from_z(axis / length)
    cylinder_to_world = to_world @ transforms.translate(p0) @ rotation @ transforms.scale((radius, radius, length))
    if not np.isfinite(cylinder_to_world).all():
        raise SceneError(f"{name}: its size exceeds the range of 64-bit floats")
    rotation, stretch = transforms.polar_decomposition(cylinder_to_world)
    _warn_if_non_uniform(stretch, (0, 1), name)
    size = (stretch[0, 0], stretch[0, 0], stretch[2, 2])  # negative if mirrored: then the axis is mirrored too
    cylinder_to_world[:3, :3] = rotation * size
    record = _analytic_record(structs.ANALYTIC_CYLINDER, cylinder_to_world, name)
    return _analytic_surface(record, shape["flip_normals"])


def _warn_if_non_uniform(stretch: np.ndarray, axes: tuple[int, ...], name: str):
    """Mitsuba 3 warns as well and uses the scale of the first axis; the images agree."""
    diagonal = stretch.diagonal()[list(axes)]
    if np.abs(diagonal - diagonal[0]).max() > 1e-4 * abs(diagonal[0]):
        warnings.warn(f"{name}: non-uniform scale; the scale of the first axis is used, as in Mitsuba 3", stacklevel=2)


def _analytic_surface(record: np.ndarray, flip_normals: bool) -> Surface:
    return Surface(_NO_NORMALS, _NO_NORMALS.astype(np.uint32), _NO_NORMALS, record, bool(flip_normals))


def _analytic_area(record) -> float:
    if record["kind"] == structs.ANALYTIC_SPHERE:
        return 4.0 * math.pi * float(record["radius"]) ** 2
    x, y, z = record["to_world"].reshape(3, 4)[:, :3].astype(float).T
    if record["kind"] == structs.ANALYTIC_DISK:
        return math.pi * float(np.linalg.norm(np.cross(x, y)))
    return 2.0 * math.pi * float(np.linalg.norm(x) * np.linalg.norm(z))
