"""Shapes as world-space triangles or analytic primitives, oriented as in Mitsuba 3.

Mitsuba 3 takes the side of the shading normal for front (emission, one-sided materials). Here the winding of a triangle
says it: where a mirroring transform or a file turns shading and geometric normals apart, triangles are rewound.
"""

import math
import warnings
from dataclasses import dataclass, field

import numpy as np

from isonoise.errors import SceneError
from isonoise.scene import structs, transforms
from isonoise.scene.accel.bounds import analytic_extents
from isonoise.scene.mesh.load_mesh import load_mesh
from isonoise.scene.mesh.mesh import lengths, normalize, smooth_normals, used_vertices

_EMPTY_NORMALS = np.zeros((0, 3), np.float32)


@dataclass
class Surface:
    """One shape: triangles, or one analytic primitive (then `analytic` is set and there are no triangles)."""

    vertices: np.ndarray  # (v, 3) float32, world space
    faces: np.ndarray  # (t, 3) uint32
    normals: np.ndarray  # (v, 3) float32 unit vectors, or (0, 3) for flat shading
    analytic: np.ndarray | None = None  # (1,) structs.ANALYTIC without its shape
    flip: bool = False  # analytic only: the front is the other side
    uvs: np.ndarray = field(default_factory=lambda: np.zeros((0, 2), np.float32))  # (v, 2) float32, or (0, 2)
    attributes: dict[str, np.ndarray] = field(default_factory=dict)  # 'vertex_...', 'face_...': see `mesh.Mesh`
    reversed_winding: np.ndarray = field(
        default_factory=lambda: np.zeros(0, bool)
    )  # (t,) where the mesh's winding was turned

    @property
    def areas(self) -> np.ndarray:
        """World-space areas of the primitives, float64."""
        if self.analytic is None:
            return triangle_areas(self.vertices, self.faces)
        return np.array([_analytic_area(self.analytic[0])])

    @property
    def bounds(self) -> np.ndarray:
        """(2, 3) corners of the box around it, float64."""
        if self.analytic is None:
            used = used_vertices(self.vertices, self.faces)
            return np.stack([used.min(axis=0), used.max(axis=0)]).astype(float)
        return np.concatenate(analytic_extents(self.analytic))


def make_surface(shape: dict, where: str) -> Surface:
    """The surface of a shape of the description. `where` names it in errors."""
    to_world = shape.get("to_world", np.eye(4))
    make = {"sphere": _sphere, "disk": _disk, "cylinder": _cylinder}.get(shape["type"], _triangles)
    with np.errstate(over="ignore", invalid="ignore"):  # the checks here and of the bounds tell
        return make(shape, to_world, where)


def _triangles(shape: dict, to_world: np.ndarray, where: str) -> Surface:
    mesh = load_mesh(shape)
    vertices = transforms.transform_points(to_world, mesh.vertices)
    faces = mesh.faces
    mirrors = np.linalg.det(to_world[:3, :3]) < 0
    if shape["type"] in ("rectangle", "cube"):
        faces = faces[:, ::-1] if mirrors else faces  # their normals come along with the transform
        normals = _EMPTY_NORMALS
    elif shape["face_normals"]:
        normals = _EMPTY_NORMALS
    elif len(mesh.normals):
        normals = normalize(transforms.transform_normals(to_world, mesh.normals))
        normals = np.where(np.isfinite(normals), normals, 0.0)  # of transforms at the edge of what numbers can be
        faces = _wound_like(vertices, faces, normals)
        absent = ~normals.any(axis=1)
        if absent.any():
            normals[absent] = smooth_normals(vertices, faces)[absent]
    else:
        normals = smooth_normals(vertices, faces)
    if len(normals):
        normals = np.where(normals.any(axis=1)[:, None], normals, (0.0, 0.0, 1.0))  # corners of zero area have none
    if shape["flip_normals"]:
        faces, normals = faces[:, ::-1], -normals
    vertices = np.ascontiguousarray(vertices, np.float32)
    return Surface(
        vertices,
        np.ascontiguousarray(faces, np.uint32),
        np.ascontiguousarray(normals, np.float32),
        uvs=mesh.uvs,
        attributes=mesh.attributes,
        reversed_winding=faces[:, 0] != mesh.faces[:, 0],
    )


def _wound_like(vertices: np.ndarray, faces: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Faces rewound where the sum of their vertex normals points away from the geometric normal."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    along = np.einsum("ij,ij->i", np.cross(b - a, c - a), normals[faces].sum(axis=1))
    return np.where((along < 0)[:, None], faces[:, ::-1], faces)


def triangle_areas(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Areas (t,) in float64."""
    a, b, c = (vertices[faces[:, i]].astype(np.float64) for i in range(3))
    return 0.5 * lengths(np.cross(b - a, c - a))


def _analytic(kind: int, to_world: np.ndarray, where: str) -> np.ndarray:
    record = np.zeros(1, structs.ANALYTIC)
    record["kind"] = kind
    record["to_world"] = to_world[:3].ravel()
    record["to_object"] = np.linalg.inv(to_world)[:3].ravel()
    if not (np.isfinite(record["to_world"]).all() and np.isfinite(record["to_object"]).all()):
        raise SceneError(f"{where}: its size leaves the range of 32-bit floats")
    return record


def _sphere(shape: dict, to_world: np.ndarray, where: str) -> Surface:
    rotation, stretch = transforms.polar_decomposition(to_world)
    _warn_if_stretched(stretch, (0, 1, 2), where)
    radius = shape["radius"] * abs(stretch[0, 0])
    placed = np.eye(4)
    placed[:3, :3] = rotation * radius
    placed[:3, 3] = transforms.transform_points(to_world, np.array([shape["center"]]))[0]
    record = _analytic(structs.ANALYTIC_SPHERE, placed, where)
    record["center"], record["radius"] = placed[:3, 3], radius
    return _analytic_surface(record, shape["flip_normals"] != (np.linalg.det(to_world[:3, :3]) < 0))


def _disk(shape: dict, to_world: np.ndarray, where: str) -> Surface:
    return _analytic_surface(_analytic(structs.ANALYTIC_DISK, to_world, where), shape["flip_normals"])


def _cylinder(shape: dict, to_world: np.ndarray, where: str) -> Surface:
    foot, axis = np.array(shape["p0"]), np.subtract(shape["p1"], shape["p0"])
    length, radius = np.linalg.norm(axis), shape["radius"]
    along = transforms.rotation_from_z(axis / length)
    placed = to_world @ transforms.translate(foot) @ along @ transforms.scale((radius, radius, length))
    if not np.isfinite(placed).all():
        raise SceneError(f"{where}: its size leaves the range of numbers")
    rotation, stretch = transforms.polar_decomposition(placed)
    _warn_if_stretched(stretch, (0, 1), where)
    size = (stretch[0, 0], stretch[0, 0], stretch[2, 2])  # negative if mirrored: the tube goes the mirrored way
    placed[:3, :3] = rotation * size
    return _analytic_surface(_analytic(structs.ANALYTIC_CYLINDER, placed, where), shape["flip_normals"])


def _warn_if_stretched(stretch: np.ndarray, axes: tuple[int, ...], where: str):
    """Mitsuba 3 warns and goes on with the first axis; so that images agree, so does this."""
    diagonal = stretch.diagonal()[list(axes)]
    if np.abs(diagonal - diagonal[0]).max() > 1e-4 * abs(diagonal[0]):
        warnings.warn(f"{where}: is scaled unevenly; only its first axis counts, as in Mitsuba 3", stacklevel=2)


def _analytic_surface(record: np.ndarray, flip: bool) -> Surface:
    none = np.zeros((0, 3), np.float32)
    return Surface(none, none.astype(np.uint32), none, record, bool(flip))


def _analytic_area(record) -> float:
    if record["kind"] == structs.ANALYTIC_SPHERE:
        return 4.0 * math.pi * float(record["radius"]) ** 2
    x, y, z = record["to_world"].reshape(3, 4)[:, :3].astype(float).T
    if record["kind"] == structs.ANALYTIC_DISK:
        return math.pi * float(np.linalg.norm(np.cross(x, y)))
    return 2.0 * math.pi * float(np.linalg.norm(x) * np.linalg.norm(z))
