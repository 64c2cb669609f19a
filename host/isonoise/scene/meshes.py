"""Triangles of the mesh shapes in object space: from files and of the built-in flat ones."""

import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from isonoise.errors import SceneError

_NONE = np.zeros((0, 3))
_RECTANGLE = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float)
_RECTANGLE_FACES = np.array([[0, 1, 2], [2, 3, 0]])
_CUBE = np.array([[x, y, z] for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)], float)
_CUBE_FACES = np.array(
    [
        *([0, 2, 3], [3, 1, 0], [4, 5, 7], [7, 6, 4], [0, 1, 5], [5, 4, 0]),
        *([2, 6, 7], [7, 3, 2], [0, 4, 6], [6, 2, 0], [1, 3, 7], [7, 5, 1]),
    ]
)


@dataclass
class Mesh:
    """Triangles as read: float64 positions, and normals where the file has them (0 for vertices without)."""

    vertices: np.ndarray  # (v, 3)
    faces: np.ndarray  # (t, 3) indices into both
    normals: np.ndarray  # (v, 3), or (0, 3) if there are none


def read_shape(shape: dict) -> Mesh:
    """The triangles of a shape of the description that is made of them. Raises SceneError where its file is bad."""
    if shape["type"] == "rectangle":
        return Mesh(_RECTANGLE, _RECTANGLE_FACES, _NONE)
    if shape["type"] == "cube":
        return Mesh(_CUBE, _CUBE_FACES, _NONE)
    if shape["type"] == "mesh":
        return Mesh(shape["vertices"], shape["faces"], shape.get("normals", _NONE))
    if shape["type"] == "obj":
        from isonoise.scene.obj import read_obj

        return read_obj(Path(shape["filename"])).mesh
    from isonoise.scene.ply import read_ply

    return read_ply(Path(shape["filename"]))


def read_bytes(path: Path) -> bytes:
    """A whole file."""
    try:
        return path.read_bytes()
    except OSError as error:
        raise SceneError(f"{path}: cannot be read ({error.strerror})") from None


def parse_numbers(text: bytes) -> np.ndarray:
    """All numbers of a text, float64; none, or those before it, where a word is no number."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # older numpy stops at such a word, newer raises
        try:
            return np.fromstring(text, np.float64, sep=" ") if text.strip() else np.zeros(0)
        except ValueError:
            return np.zeros(0)


def smooth_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Unit vertex normals (v, 3): face normals weighted with the angle at the vertex (Thürmer and Wüthrich 1998)."""
    total = np.zeros((len(vertices), 3))
    corners = [vertices[faces[:, i]] for i in range(3)]
    edges = [unit(corners[(i + 1) % 3] - corners[i]) for i in range(3)]
    normal = unit(np.cross(corners[1] - corners[0], corners[2] - corners[0]))
    for i in range(3):
        towards, back = edges[i], -edges[i - 1]
        # Kahan's formula: exact to rounding for small and for straight angles alike.
        angle = 2.0 * np.arctan2(lengths(towards - back), lengths(towards + back))
        for axis in range(3):
            total[:, axis] += np.bincount(faces[:, i], normal[:, axis] * angle, len(vertices))
    return unit(total)


def unit(vectors: np.ndarray) -> np.ndarray:
    """Normalised (n, 3); vectors of length 0 stay 0."""
    size = lengths(vectors)[:, None]
    return np.divide(vectors, size, out=np.zeros_like(vectors), where=size > 0)


def lengths(vectors: np.ndarray) -> np.ndarray:
    """Euclidean lengths (n,) of vectors (n, 3)."""
    return np.sqrt(np.einsum("ij,ij->i", vectors, vectors))


def used_vertices(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Those of the vertices that some face names."""
    used = np.zeros(len(vertices), bool)
    used[faces] = True
    return vertices if used.all() else vertices[used]
