"""Finds a camera that frames a model: from its points, the direction of view and the image's shape.

Called by `staging.py`.
"""

import math
from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np

from isonoise.errors import SceneError
from isonoise.scene.mesh.mesh import used_vertices
from isonoise.scene.transforms import look_at, transform_points
from isonoise.scene.view import are_parallel

FILL = 0.9
"""Share of the image that the model spans, in the direction in which it is larger for the image."""
THREE_QUARTER_VIEW = (0.55, 0.5, 1.0)
"""From the model to the camera, if y is up and z is to the front: from 24 degrees above."""
_MAX_FLATNESS = 1e-3  # thickness of a flat model, in its size
_MIN_FACING = 0.7  # cosine of the largest angle at which a flat model is seen
_MIN_DISTANCE = 0.1  # of the camera from the nearest point, in the model's sizes
_MAX_GROUP_POINTS = 1000  # of a group with several instances: beyond it, only the outermost in many directions
_DIRECTIONS = 400
_CIRCLE_POINTS = 64
_MIDDLE_STEPS = 6


class Extent(NamedTuple):
    """Where a model is."""

    points: np.ndarray  # (n, 3): all vertices; of other shapes, points on their outline
    meshes: list[Mapping]  # in the world
    low: np.ndarray
    high: np.ndarray

    @property
    def center(self) -> np.ndarray:
        """(3,): the middle of the box around the model."""
        return self.low + 0.5 * (self.high - self.low)

    @property
    def size(self) -> float:
        """Half the diagonal of the box around the model."""
        return 0.5 * float(np.linalg.norm(self.high - self.low))

    def facing(self) -> np.ndarray:
        """(3,): sum of the normals of all triangles, times twice their areas."""
        total = np.zeros(3)
        for mesh in self.meshes:
            vertices = transform_points(_to_world(mesh), np.asarray(mesh["vertices"], float))
            a, b, c = (vertices[np.asarray(mesh["faces"])[:, corner]] for corner in range(3))
            total += np.cross(b - a, c - a).sum(axis=0)
        return total


def find_extent(scene: Mapping, file: str) -> Extent:
    """The extent of all shapes of a scene dict. `file` names it in errors. Raises SceneError if it is a point."""
    points = np.concatenate([*_points(scene)] or [np.zeros((1, 3))])
    meshes = [part for part in scene.values() if isinstance(part, Mapping) and part.get("type") == "mesh"]
    extent = Extent(points, meshes, points.min(axis=0), points.max(axis=0))
    with np.errstate(over="ignore"):
        if not (np.isfinite(extent.size) and extent.size > 0):
            raise SceneError(f"{file}: the model has no extent: it has no shape, or all its vertices are one point")
    return extent


def _points(scene: Mapping) -> Iterator[np.ndarray]:
    """Points (n, 3) of every shape in the world."""
    instances: dict[int, list] = {}  # by id() of the group: the group, then the matrices
    for part in scene.values():
        if not isinstance(part, Mapping) or part.get("type") == "shapegroup":
            continue
        if part.get("type") == "instance":
            group = next(child for child in part.values() if isinstance(child, Mapping) and child.get("type"))
            group = scene[group["id"]] if group["type"] == "ref" else group
            instances.setdefault(id(group), [group]).append(_to_world(part))
        else:
            yield from _points_of_shape(part)
    for group, *matrices in instances.values():
        parts = [points for part in group.values() if isinstance(part, Mapping) for points in _points_of_shape(part)]
        points = np.concatenate(parts)
        if len(matrices) > 1 and len(points) > _MAX_GROUP_POINTS:
            points = _outermost(points)
        yield from (transform_points(matrix, points) for matrix in matrices)


def _points_of_shape(part: Mapping) -> Iterator[np.ndarray]:
    """Points of a shape; none of other parts of a scene."""
    if part.get("type") == "mesh":
        points = used_vertices(np.asarray(part["vertices"], float), np.asarray(part["faces"]))
    elif part.get("type") in _OUTLINES:
        points = _OUTLINES[part["type"]](part)
    else:
        return
    yield transform_points(_to_world(part), points) if "to_world" in part else points


def _to_world(part: Mapping) -> np.ndarray:
    return np.asarray(part.get("to_world", np.eye(4)), float)


def _sphere_points(center=(0.0, 0.0, 0.0), radius: float = 1.0) -> np.ndarray:
    """Points on a sphere: `_DIRECTIONS` of a Fibonacci lattice, and the six on the axes."""
    z = 1 - (2 * np.arange(_DIRECTIONS) + 1) / _DIRECTIONS
    angle = np.pi * (3 - np.sqrt(5)) * np.arange(_DIRECTIONS)
    ring = np.sqrt(1 - z * z)
    lattice = np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=1)
    return np.asarray(center) + radius * np.concatenate([lattice, np.eye(3), -np.eye(3)])


def _circle(radius: float = 1.0) -> np.ndarray:
    angle = 2 * np.pi * np.arange(_CIRCLE_POINTS) / _CIRCLE_POINTS
    return radius * np.stack([np.cos(angle), np.sin(angle), np.zeros(_CIRCLE_POINTS)], axis=1)


def _cylinder_points(shape: Mapping) -> np.ndarray:
    """Points on both ends of a cylinder."""
    p0, p1 = (np.asarray(shape.get(name, default), float) for name, default in (("p0", (0, 0, 0)), ("p1", (0, 0, 1))))
    away = np.eye(3)[int(np.argmin(np.abs(p1 - p0)))]
    ends = look_at(p0, p1, away)
    ring = transform_points(ends, _circle(shape.get("radius", 1.0)))
    return np.concatenate([ring, ring + (p1 - p0)])


def _corners(z: tuple[float, ...]) -> np.ndarray:
    return np.array([(x, y, depth) for x in (-1.0, 1.0) for y in (-1.0, 1.0) for depth in z])


_OUTLINES = {
    "sphere": lambda shape: _sphere_points(shape.get("center", (0, 0, 0)), shape.get("radius", 1.0)),
    "disk": lambda shape: _circle(),
    "cylinder": _cylinder_points,
    "rectangle": lambda shape: _corners((0.0,)),
    "cube": lambda shape: _corners((-1.0, 1.0)),
}
"""Points of the shapes that are no meshes, before `to_world`."""


def _outermost(points: np.ndarray) -> np.ndarray:
    """The points that are outermost in many directions; to 1 % of the size, the others lie between them."""
    return points[np.unique([int(np.argmax(points @ direction)) for direction in _sphere_points()])]


def three_quarter_direction(extent: Extent, to_world: np.ndarray) -> np.ndarray:
    """The unit vector from the model to the camera. `to_world` (3, 3) rotates y to the model's up.

    If a flat model stands, its own front is to the front. If it lies, the camera is higher, so that it is seen at an
    angle of 45 degrees.
    """
    direction = np.array(THREE_QUARTER_VIEW) / np.linalg.norm(THREE_QUARTER_VIEW)
    normal = _normal_of_flat(extent)
    if normal is not None:
        normal = to_world.T @ normal
        normal = normal if normal[1] >= -_MIN_FACING else -normal
        if abs(normal[1]) <= _MIN_FACING:
            direction = turn_to(normal) @ direction
        facing = direction @ normal
        if facing < _MIN_FACING:
            aside = direction - facing * normal
            aside /= np.linalg.norm(aside)
            direction = _MIN_FACING * normal + math.sqrt(1 - _MIN_FACING**2) * aside
    return to_world @ direction


def _normal_of_flat(extent: Extent) -> np.ndarray | None:
    """The unit normal of a flat model, on the side to which most of its triangles face; None if it is not flat."""
    centered = (extent.points - extent.center) / extent.size
    _, axes = np.linalg.eigh(centered.T @ centered)  # the direction in which it is thinnest comes first
    normal = axes[:, 0]
    if np.ptp(centered @ normal) > _MAX_FLATNESS:
        return None
    side = float(extent.facing() @ normal)
    if side == 0:
        side = float(normal @ np.array(THREE_QUARTER_VIEW))
    return normal * math.copysign(1.0, side)


def turn_to(direction: np.ndarray) -> np.ndarray:
    """(3, 3): the rotation about y that takes +z to the horizontal part of a direction; the identity if it has none."""
    x, _, z = direction
    length = math.hypot(x, z)
    sine, cosine = (x / length, z / length) if length > 1e-6 else (0.0, 1.0)
    return np.array([[cosine, 0, sine], [0, 1, 0], [-sine, 0, cosine]])


def frame(extent: Extent, to_camera: np.ndarray, up: np.ndarray, tan_half_fov: tuple[float, float]) -> np.ndarray:
    """Camera-to-world matrix of the nearest camera in this direction that sees all points, with a margin.

    The model spans `FILL` of the image's width or height, and is in its middle in both. With l and f the coordinates of
    a point to the side and forward, a camera at (x, z) sees it if |l - x| <= k (f - z): so x - k z is at least the
    largest l - k f, and -x - k z at least the largest -l - k f. The largest z for which an x exists is minus half the
    sum of both, over k. The camera takes the smaller z of width and height.

    Parameters
    ----------
    to_camera : unit vector from the model to the camera
    up : direction that is up in the image
    tan_half_fov : tangents of half the angles of view, horizontal and vertical
    """
    axis = up if not are_parallel(up, to_camera) else _any_perpendicular(to_camera)
    matrix = look_at(np.zeros(3), -to_camera, axis)
    *sides, forward = ((extent.points - extent.center) @ matrix[:3, :3]).T
    nearest = float(forward.min()) - _MIN_DISTANCE * extent.size
    for side, tangent in zip(sides, tan_half_fov, strict=True):
        k = FILL * tangent
        nearest = min(nearest, -0.5 * float((side - k * forward).max() + (-side - k * forward).max()) / k)
    middle = [_middle(side, forward - nearest) for side in sides]
    matrix[:3, 3] = extent.center + matrix[:3, :3] @ np.array([*middle, nearest])
    return matrix


def _middle(side: np.ndarray, depth: np.ndarray) -> float:
    """The x for which the largest and the smallest (side - x) / depth are opposite."""
    x = 0.5 * float(side.max() + side.min())
    for _ in range(_MIDDLE_STEPS):  # exact once the outermost points stay the same
        ratio = (side - x) / depth
        left, right = int(np.argmax(ratio)), int(np.argmin(ratio))
        x = float((side[left] * depth[right] + side[right] * depth[left]) / (depth[left] + depth[right]))
    return x


def _any_perpendicular(direction: np.ndarray) -> np.ndarray:
    return np.eye(3)[int(np.argmin(np.abs(direction)))]
