"""Loop's subdivision of triangle meshes, as pbrt does it. Called by `shapes.py`.

C. Loop, "Smooth Subdivision Surfaces Based on Triangles", 1987; weights of the pbrt book, third edition, section 3.8.
"""

import numpy as np

_MAX_FACES = 1 << 22


def subdivide(vertices: np.ndarray, faces: np.ndarray, levels: int) -> tuple[np.ndarray, np.ndarray]:
    """Vertices on the limit surface and faces, four times as many at each level."""
    for _ in range(levels):
        vertices, faces = _refine(vertices, faces)
    return _move_to_limit(vertices, _Edges(faces, len(vertices))), faces


def possible_levels(face_count: int, levels: int) -> int:
    """The number of levels that does not exceed the largest number of faces."""
    while levels and face_count << 2 * levels > _MAX_FACES:
        levels -= 1
    return levels


class _Edges:
    """The edges of a mesh."""

    def __init__(self, faces: np.ndarray, vertex_count: int):
        ends = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
        self.ends, edge_of_side, face_counts = np.unique(ends, axis=0, return_inverse=True, return_counts=True)
        self.of_faces = edge_of_side.reshape(3, -1).T  # (n, 3): of the sides 01, 12, 20
        self.is_interior = face_counts == 2
        opposite = np.concatenate([faces[:, 2], faces[:, 0], faces[:, 1]])
        order = np.argsort(edge_of_side.ravel(), kind="stable")
        first = np.concatenate([[0], np.cumsum(face_counts)[:-1]])
        self.opposite = opposite[order][np.stack([first, np.minimum(first + 1, first + face_counts - 1)], axis=1)]
        self.vertex_count = vertex_count
        self.is_boundary_vertex = np.zeros(vertex_count, bool)
        self.is_boundary_vertex[self.ends[~self.is_interior]] = True

    def neighbour_sums(self, vertices: np.ndarray, used: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Sums (v, 3) of the neighbours along the edges that are used, and their number (v,)."""
        first, second = self.ends[used].T
        ends = np.concatenate([first, second])
        others = vertices[np.concatenate([second, first])]
        sums = np.stack([np.bincount(ends, others[:, axis], self.vertex_count) for axis in range(3)], axis=1)
        return sums, np.bincount(ends, minlength=self.vertex_count)


def _interior_weight(valences: np.ndarray) -> np.ndarray:
    return np.where(valences == 3, 3 / 16, 3 / (8 * np.maximum(valences, 1)))


def _weighted(vertices: np.ndarray, edges: _Edges, interior, boundary: float) -> np.ndarray:
    """Vertices moved towards their neighbours; `interior(valences)` and `boundary` are the weights of one neighbour."""
    sums, valences = edges.neighbour_sums(vertices, np.ones(len(edges.ends), bool))
    weights = interior(valences)[:, None]
    inside = (1 - weights * valences[:, None]) * vertices + weights * sums
    border_sums, border_valences = edges.neighbour_sums(vertices, ~edges.is_interior)
    border = (1 - boundary * border_valences[:, None]) * vertices + boundary * border_sums
    return np.where(edges.is_boundary_vertex[:, None], border, inside)


def _refine(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    edges = _Edges(faces, len(vertices))
    even = _weighted(vertices, edges, _interior_weight, 1 / 8)
    ends, opposite = vertices[edges.ends].sum(axis=1), vertices[edges.opposite].sum(axis=1)
    odd = np.where(edges.is_interior[:, None], 3 / 8 * ends + 1 / 8 * opposite, 0.5 * ends)
    middle = edges.of_faces + len(vertices)
    corners = [np.stack([faces[:, i], middle[:, i], middle[:, i - 1]], axis=1) for i in range(3)]
    return np.concatenate([even, odd]), np.concatenate([*corners, middle])


def _move_to_limit(vertices: np.ndarray, edges: _Edges) -> np.ndarray:
    return _weighted(vertices, edges, lambda valences: 1 / (valences + 3 / (8 * _interior_weight(valences))), 1 / 5)
