"""Concatenates the surfaces of all shapes to the arrays of CompiledScene, and computes the scene's bounds.

Called by `compile.py`. A space is the world or a shape group; each is a dict of surfaces by the name for errors.
"""

from dataclasses import dataclass

import numpy as np

from isonoise.errors import SceneError
from isonoise.scene import structs
from isonoise.scene.accel.bounds import instance_extents
from isonoise.scene.mesh.surfaces import Surface

_MAX_COORDINATE = 1e18  # the square of a distance, 1.2e37 at most, fits in 32-bit floats


def merge_meshes(surfaces: list[Surface]) -> dict[str, np.ndarray]:
    """The arrays of CompiledScene that all meshes share: vertices, faces, vertex_normals, triangle_shape."""
    meshes = [surface for surface in surfaces if surface.analytic is None]
    first_vertex = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])[:-1].astype(np.uint32)
    normals = np.zeros((0, 3), np.float32)
    if any(len(mesh.normals) for mesh in meshes):
        normals = _concatenate([m.normals if len(m.normals) else np.zeros_like(m.vertices) for m in meshes], np.float32)
    mesh_indices = np.array([i for i, surface in enumerate(surfaces) if surface.analytic is None], np.uint32)
    return {
        "vertices": _concatenate([mesh.vertices for mesh in meshes], np.float32),
        "faces": _concatenate([m.faces + first for m, first in zip(meshes, first_vertex, strict=True)], np.uint32),
        "vertex_normals": normals,
        "triangle_shape": np.repeat(mesh_indices, [len(mesh.faces) for mesh in meshes]),
    }


def merge_analytics(surfaces: list[Surface]) -> np.ndarray:
    """(A,) structs.ANALYTIC records of all analytic primitives, with the index of their shape."""
    records = [np.zeros(0, structs.ANALYTIC)]
    for index, surface in enumerate(surfaces):
        if surface.analytic is not None:
            records.append(surface.analytic.copy())
            records[-1]["shape"] = index
    return np.concatenate(records)


def first_primitives(surfaces: list[Surface]) -> list[int]:
    """Index of each shape's first triangle, or of its analytic primitive."""
    result, triangles, analytics = [], 0, 0
    for surface in surfaces:
        is_mesh = surface.analytic is None
        result.append(triangles if is_mesh else analytics)
        triangles += len(surface.faces)
        analytics += not is_mesh
    return result


def merge_uvs(meshes: list[Surface]) -> tuple[np.ndarray, np.ndarray]:
    """(uvs, reversed_winding) of all meshes, as in CompiledScene."""
    uvs, reversed_winding = np.zeros((0, 2), np.float32), np.zeros(0, bool)
    if not all(len(mesh.uvs) for mesh in meshes):
        reversed_winding = np.concatenate([mesh.reversed_winding for mesh in meshes])
    if any(len(mesh.uvs) for mesh in meshes):
        uvs = np.concatenate(
            [mesh.uvs if len(mesh.uvs) else np.zeros((len(mesh.vertices), 2), np.float32) for mesh in meshes]
        )
    return uvs, reversed_winding


def group_offsets(spaces: list[dict[str, Surface]]) -> np.ndarray:
    """(groups + 1, 2) uint32: triangles and analytic primitives before each group, and in total; the world is first."""
    counts = [
        [sum(len(s.faces) for s in space.values()), sum(s.analytic is not None for s in space.values())]
        for space in spaces
    ]
    return np.cumsum(counts, axis=0, dtype=np.uint32)


@dataclass(frozen=True)
class Boxes:
    """The boxes around the shapes of a space; in the world, instances follow the other shapes."""

    names: list[str]  # for errors
    corners: np.ndarray  # (n, 2, 3) float64

    def union(self) -> np.ndarray:
        """The box (2, 3) around all; zeros if there are none."""
        if not self.names:
            return np.zeros((2, 3))
        return np.stack([self.corners[:, 0].min(axis=0), self.corners[:, 1].max(axis=0)])

    def check(self) -> None:
        """Raise SceneError if distances overflow."""
        largest = np.abs(self.corners).max(axis=(1, 2))
        if not largest.max(initial=0) <= _MAX_COORDINATE:
            raise SceneError(
                f"{self.names[int(np.argmax(largest))]} extends beyond {_MAX_COORDINATE:g}: distances overflow 32-bit "
                "floats; scale the scene down"
            )


def shape_boxes(spaces: list[dict[str, Surface]], instances: np.ndarray, instance_names: list[str]) -> list[Boxes]:
    """The boxes of all spaces; the world is first."""
    boxes = [
        Boxes(list(space), np.array([surface.bounds for surface in space.values()]).reshape(-1, 2, 3))
        for space in spaces
    ]
    if len(instances):
        unions = np.stack([space.union() for space in boxes])
        extents = np.stack(instance_extents(instances, unions[instances["root"]]), axis=1)
        corners = np.concatenate([boxes[0].corners, extents])
        boxes[0] = Boxes([*boxes[0].names, *instance_names], corners)
    return boxes


def _concatenate(arrays: list[np.ndarray], dtype) -> np.ndarray:
    return np.concatenate(arrays).astype(dtype, copy=False) if arrays else np.zeros((0, 3), dtype)
