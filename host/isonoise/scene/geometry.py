"""Merges the surfaces of all shapes to the arrays of CompiledScene, in the order of the shapes; boxes around them.

Called by `compile.py`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from isonoise.errors import SceneError
from isonoise.scene import structs
from isonoise.scene.mesh.surfaces import Surfaces

_MAX_COORDINATE = 1e18  # the square of a distance, 1.2e37 at most, fits in 32-bit floats


class Layout:
    """Where the parts of each shape are in the merged arrays: arrays (n,) by index of the shape."""

    def __init__(self, surfaces: list[Surfaces], shape_count: int):
        self.vertex_count, self.triangle_count = (np.zeros(shape_count, np.int64) for _ in range(2))
        self.is_analytic, self.has_normals, self.has_uvs, self.is_flipped = np.zeros((4, shape_count), bool)
        for part in surfaces:
            self.vertex_count[part.index], self.triangle_count[part.index] = part.vertices.shape[1], part.faces.shape[1]
            self.is_analytic[part.index] = len(part.analytics) > 0
            self.has_normals[part.index], self.has_uvs[part.index] = part.normals.shape[1] > 0, len(part.uvs) > 0
            self.is_flipped[part.index] = part.is_flipped
        self.first_vertex, self.first_triangle, self.first_analytic = (
            np.cumsum(counts) - counts for counts in (self.vertex_count, self.triangle_count, self.is_analytic)
        )

    @cached_property
    def first_primitive(self) -> np.ndarray:
        """Index of each shape's first triangle, or of its analytic primitive."""
        return np.where(self.is_analytic, self.first_analytic, self.first_triangle)


def _scatter(merged: np.ndarray, first: np.ndarray, parts: np.ndarray) -> None:
    """Put parts (n, k, ...) into the merged array, each from its first row on."""
    if len(parts) == 1:
        merged[first[0] : first[0] + parts.shape[1]] = parts[0]
    else:
        merged[first[:, None] + np.arange(parts.shape[1])] = parts


def merge_meshes(surfaces: list[Surfaces], layout: Layout) -> dict[str, np.ndarray]:
    """The arrays of CompiledScene that all meshes share: vertices, faces, vertex_normals, triangle_shape."""
    vertex_count, triangle_count = int(layout.vertex_count.sum()), int(layout.triangle_count.sum())
    vertices, faces = np.empty((vertex_count, 3), np.float32), np.empty((triangle_count, 3), np.uint32)
    normals = np.zeros((vertex_count if layout.has_normals.any() else 0, 3), np.float32)
    for part in surfaces:
        first_vertex = layout.first_vertex[part.index]
        _scatter(vertices, first_vertex, part.vertices)
        _scatter(faces, layout.first_triangle[part.index], part.faces + first_vertex.astype(np.uint32)[:, None, None])
        if part.normals.shape[1]:
            _scatter(normals, first_vertex, part.normals)
    return {
        "vertices": vertices,
        "faces": faces,
        "vertex_normals": normals,
        "triangle_shape": np.repeat(np.arange(len(layout.triangle_count), dtype=np.uint32), layout.triangle_count),
    }


def merge_analytics(surfaces: list[Surfaces], layout: Layout) -> np.ndarray:
    """(A,) structs.ANALYTIC records of all analytic primitives, with the index of their shape."""
    records = np.empty(np.count_nonzero(layout.is_analytic), structs.ANALYTIC)
    for part in surfaces:
        if len(part.analytics):
            records[layout.first_analytic[part.index]] = part.analytics
    records["shape"] = np.flatnonzero(layout.is_analytic)
    return records


def merge_uvs(surfaces: list[Surfaces], layout: Layout) -> tuple[np.ndarray, np.ndarray]:
    """(uvs, reversed_winding) of all meshes, as in CompiledScene."""
    has_uvs, is_mesh = layout.has_uvs, ~layout.is_analytic
    vertex_count, triangle_count = int(layout.vertex_count.sum()), int(layout.triangle_count.sum())
    uvs = np.zeros((vertex_count if has_uvs.any() else 0, 2), np.float32)
    reversed_winding = np.zeros(0 if has_uvs[is_mesh].all() else triangle_count, bool)
    for part in surfaces:
        if len(part.uvs):
            _scatter(
                uvs, layout.first_vertex[part.index], np.broadcast_to(part.uvs, (len(part.index), *part.uvs.shape))
            )
        if len(reversed_winding):
            _scatter(reversed_winding, layout.first_triangle[part.index], part.reversed_winding)
    return uvs, reversed_winding


def group_offsets(layout: Layout, space_sizes: list[int]) -> np.ndarray:
    """(groups + 1, 2) uint32: triangles and analytic primitives before each group, and in total; the world is first.

    `space_sizes` are the numbers of shapes of the world and of each group.
    """
    ends = np.cumsum(space_sizes)
    totals = [np.append(0, np.cumsum(counts)) for counts in (layout.triangle_count, layout.is_analytic)]
    return np.stack([total[ends] for total in totals], axis=1).astype(np.uint32)


@dataclass(frozen=True)
class Boxes:
    """The boxes around the shapes of a space; in the world, instances follow the other shapes."""

    name: Callable[[int], str]  # of a shape, for errors
    corners: np.ndarray  # (n, 2, 3) float64

    def union(self) -> np.ndarray:
        """The box (2, 3) around all; zeros if there are none."""
        if not len(self.corners):
            return np.zeros((2, 3))
        return np.stack([self.corners[:, 0].min(axis=0), self.corners[:, 1].max(axis=0)])

    def check(self) -> None:
        """Raise SceneError if distances overflow."""
        largest = np.abs(self.corners).max(axis=(1, 2))
        if not largest.max(initial=0) <= _MAX_COORDINATE:
            raise SceneError(
                f"{self.name(int(np.argmax(largest)))} extends beyond {_MAX_COORDINATE:g}: distances overflow 32-bit "
                "floats; scale the scene down"
            )


def shape_boxes(surfaces: list[Surfaces], shape_count: int) -> np.ndarray:
    """(n, 2, 3) float64 boxes by index of the shape."""
    boxes = np.zeros((shape_count, 2, 3))
    for part in surfaces:
        boxes[part.index] = part.boxes()
    return boxes
