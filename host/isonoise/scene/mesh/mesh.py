"""Triangle meshes in object space, and what their readers share."""

import warnings
from dataclasses import dataclass, field

import numpy as np

from isonoise.scene.parse.elements import SourceLocation

_NO_UVS = np.zeros((0, 2), np.float32)


@dataclass
class Mesh:
    """Triangles as read: float64 positions, and normals where the file has them (0 for vertices without)."""

    vertices: np.ndarray  # (v, 3)
    faces: np.ndarray  # (t, 3) indices into all that vertices have
    normals: np.ndarray  # (v, 3), or (0, 3) if there are none
    uvs: np.ndarray = field(default_factory=lambda: _NO_UVS)
    """(v, 2) float32 finite texture coordinates, 0 for vertices without; (0, 2) if there are none."""
    attributes: dict[str, np.ndarray] = field(default_factory=dict)
    """Further values by Mitsuba 3's names, float32, unchecked: 'vertex_...' are (v, c), 'face_...' (t, c)."""


@dataclass
class Part:
    """The triangles of one material."""

    mesh: Mesh
    reflectance: tuple[float, ...] = (0.5, 0.5, 0.5)
    radiance: tuple[float, ...] | None = None
    flat: bool = False


def checked(mesh: Mesh, location: SourceLocation) -> Mesh:
    """The mesh of a file. Raises SceneError where a number is not finite or a face names a vertex that is not there."""
    if not (np.isfinite(mesh.vertices).all() and np.isfinite(mesh.normals).all()):
        location.raise_error("a vertex or normal is not a finite number")
    if mesh.faces.min() < 0 or mesh.faces.max() >= len(mesh.vertices):
        location.raise_error(f"a face names a vertex that does not exist (there are {len(mesh.vertices)})")
    return mesh


def texture_coordinates(values: np.ndarray, flip: bool) -> np.ndarray:
    """(n, 2) float32 of numbers (n, 2); `flip` turns v into 1 - v.

    What is not finite becomes 0: exporters write NaN for triangles without area, whose picture nobody sees.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        uvs = np.stack([values[:, 0], 1.0 - values[:, 1] if flip else values[:, 1]], axis=1).astype(np.float32)
    return np.where(np.isfinite(uvs), uvs, np.float32(0))


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
    edges = [normalize(corners[(i + 1) % 3] - corners[i]) for i in range(3)]
    normal = normalize(np.cross(corners[1] - corners[0], corners[2] - corners[0]))
    for i in range(3):
        towards, back = edges[i], -edges[i - 1]
        # Kahan's formula: exact to rounding for small and for straight angles alike.
        angle = 2.0 * np.arctan2(lengths(towards - back), lengths(towards + back))
        for axis in range(3):
            total[:, axis] += np.bincount(faces[:, i], normal[:, axis] * angle, len(vertices))
    return normalize(total)


def normalize(vectors: np.ndarray) -> np.ndarray:
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
