"""Triangles of the mesh shapes in object space: from files and of the built-in flat ones."""

from dataclasses import dataclass

import numpy as np

_NONE = np.zeros((0, 3))
_RECTANGLE = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float)
_RECTANGLE_FACES = np.array([[0, 1, 2], [2, 3, 0]])
_CUBE = np.array([[x, y, z] for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)], float)
_CUBE_FACES = np.array(
    [[0, 2, 3], [3, 1, 0], [4, 5, 7], [7, 6, 4], [0, 1, 5], [5, 4, 0], [2, 6, 7], [7, 3, 2], [0, 4, 6], [6, 2, 0]]
    + [[1, 3, 7], [7, 5, 1]]
)


@dataclass
class Mesh:
    """Triangles as read: float64 positions, and normals where the file has them."""

    vertices: np.ndarray  # (v, 3)
    faces: np.ndarray  # (t, 3) indices into both
    normals: np.ndarray  # (v, 3), or (0, 3) if there are none


def read_shape(shape: dict) -> Mesh:
    """The triangles of a shape of the description that is made of them."""
    if shape["type"] == "rectangle":
        return Mesh(_RECTANGLE, _RECTANGLE_FACES, _NONE)
    if shape["type"] == "cube":
        return Mesh(_CUBE, _CUBE_FACES, _NONE)
    raise NotImplementedError


def smooth_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Unit vertex normals (v, 3): face normals weighted with the angle at the vertex (Thürmer and Wüthrich 1998)."""
    total = np.zeros((len(vertices), 3))
    corners = [vertices[faces[:, i]] for i in range(3)]
    normal = _unit(np.cross(corners[1] - corners[0], corners[2] - corners[0]))
    for i in range(3):
        towards = _unit(corners[(i + 1) % 3] - corners[i])
        back = _unit(corners[(i + 2) % 3] - corners[i])
        # Kahan's formula: exact to rounding for small and for straight angles alike.
        angle = 2.0 * np.arctan2(np.linalg.norm(towards - back, axis=1), np.linalg.norm(towards + back, axis=1))
        for axis in range(3):
            total[:, axis] += np.bincount(faces[:, i], normal[:, axis] * angle, len(vertices))
    return _unit(total)


def _unit(vectors: np.ndarray) -> np.ndarray:
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.divide(vectors, lengths, out=np.zeros_like(vectors), where=lengths > 0)
