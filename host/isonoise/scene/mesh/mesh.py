"""Triangle meshes in object space, and the helpers that all mesh readers share."""

import warnings
from dataclasses import dataclass, field

import numpy as np

from isonoise.scene.parse.elements import SourceLocation

_NO_UVS = np.zeros((0, 2), np.float32)


@dataclass
class Mesh:
    """Triangles as read from a file, in float64."""

    vertices: np.ndarray  # (v, 3)
    faces: np.ndarray  # (t, 3) vertex indices
    normals: np.ndarray  # (v, 3), zero for vertices without a normal; or (0, 3)
    uvs: np.ndarray = field(default_factory=lambda: _NO_UVS)
    """(v, 2) float32 finite texture coordinates, zero for vertices without; or (0, 2)."""
    attributes: dict[str, np.ndarray] = field(default_factory=dict)
    """Other values by Mitsuba 3's names, float32, perhaps not finite: 'vertex_...' are (v, c), 'face_...' (t, c)."""


def validate_mesh(mesh: Mesh, location: SourceLocation) -> Mesh:
    """Raise SceneError where a number is not finite or a vertex index is out of range; return the mesh."""
    if not (np.isfinite(mesh.vertices).all() and np.isfinite(mesh.normals).all()):
        location.raise_error("a vertex or normal is not a finite number")
    if mesh.faces.min() < 0 or mesh.faces.max() >= len(mesh.vertices):
        location.raise_error(f"a face uses a vertex that does not exist (there are {len(mesh.vertices)})")
    return mesh


def make_uvs(values: np.ndarray, flip: bool) -> np.ndarray:
    """Texture coordinates (n, 2) float32 from values (n, 2); `flip` replaces v by 1 - v.

    Values that are not finite become 0: exporters write NaN for triangles of zero area, which are never visible.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        uvs = np.stack([values[:, 0], 1.0 - values[:, 1] if flip else values[:, 1]], axis=1).astype(np.float32)
    return np.where(np.isfinite(uvs), uvs, np.float32(0))


def parse_numbers(text: bytes) -> np.ndarray:
    """The numbers of a text, float64. At a word that is not a number, older numpy stops and newer returns nothing."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # older numpy stops at such a word, newer raises
        try:
            return np.fromstring(text, np.float64, sep=" ") if text.strip() else np.zeros(0)
        except ValueError:
            return np.zeros(0)


def smooth_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Unit vertex normals (v, 3): face normals weighted by the angle at the vertex (Thürmer and Wüthrich 1998)."""
    total = np.zeros((len(vertices), 3))
    corners = [vertices[faces[:, i]] for i in range(3)]
    edges = [normalize(corners[(i + 1) % 3] - corners[i]) for i in range(3)]
    normal = normalize(np.cross(corners[1] - corners[0], corners[2] - corners[0]))
    for i in range(3):
        to_next, to_previous = edges[i], -edges[i - 1]
        # Kahan's formula: accurate to rounding for small and for straight angles
        angle = 2.0 * np.arctan2(vector_lengths(to_next - to_previous), vector_lengths(to_next + to_previous))
        for axis in range(3):
            total[:, axis] += np.bincount(faces[:, i], normal[:, axis] * angle, len(vertices))
    return normalize(total)


def normalize(vectors: np.ndarray) -> np.ndarray:
    """Unit vectors (n, 3); vectors of length 0 stay 0."""
    length = vector_lengths(vectors)[:, None]
    return np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0)


def vector_lengths(vectors: np.ndarray) -> np.ndarray:
    """Euclidean lengths (n,) of vectors (n, 3)."""
    return np.sqrt(np.einsum("ij,ij->i", vectors, vectors))


def used_vertices(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """The vertices that a face uses."""
    is_used = np.zeros(len(vertices), bool)
    is_used[faces] = True
    return vertices if is_used.all() else vertices[is_used]
