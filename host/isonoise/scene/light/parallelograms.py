"""Finds the parallelograms among the triangles of an emissive mesh: each is one light. Called by `compile_lights`.

A parallelogram is two triangles in a row, such as a rectangle, a face of a cube, or a quad that a mesh file splits.
"""

import numpy as np

_CHUNK_TRIANGLES = 2**17  # processed at once: keeps temporaries small
_MAX_GAP = 1e-4
"""Largest distance of the fourth corner from where it should be, over the shortest side."""
_MAX_AREA_DIFFERENCE = 2.0**-15
"""Of the two triangles, over their sum: as much as their stated density is off."""


def find_parallelograms(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Disjoint pairs of triangles that follow each other and form a parallelogram.

    Parameters
    ----------
    vertices : (v, 3) positions
    faces : (t, 3)

    Returns
    -------
    first : (p,) the first triangle of each pair, ascending; the second is the next one
    apexes : (p, 2) corner, 0 to 2, of the first and the second triangle that is not on the diagonal
    """
    apexes = np.full((max(len(faces) - 1, 0), 2), -1)
    for begin in range(0, len(apexes), _CHUNK_TRIANGLES):
        chunk = vertices[faces[begin : begin + _CHUNK_TRIANGLES + 1]]
        apexes[begin : begin + _CHUNK_TRIANGLES] = _apexes(chunk[:-1], chunk[1:])
    is_pair = apexes[:, 0] >= 0
    # of pairs that overlap, such as those of a strip, every second one from the start of a run
    index = np.arange(len(is_pair))
    run_start = np.maximum.accumulate(np.where(is_pair & ~np.append(False, is_pair[:-1]), index, 0))
    first = np.flatnonzero(is_pair & ((index - run_start) % 2 == 0))
    return first, apexes[first]


def _apexes(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Corners (n, 2) of triangles a and b, (n, 3, 3), opposite the diagonal; -1 where they form no parallelogram."""
    found = np.full((len(a), 2), -1)
    for i in range(3):
        for k in range(3):
            # neighbours of the same orientation pass their common side in opposite directions
            from_a, to_a, from_b, to_b = a[:, i - 2], a[:, i - 1], b[:, k - 2], b[:, k - 1]
            shared = np.flatnonzero(((from_a == to_b) & (to_a == from_b)).all(axis=1))
            is_parallelogram = _is_parallelogram(a[shared, i], from_a[shared], b[shared, k], to_a[shared])
            found[shared[is_parallelogram]] = i, k
    return found


def _is_parallelogram(p: np.ndarray, q: np.ndarray, r: np.ndarray, s: np.ndarray) -> np.ndarray:
    """Whether the corners (n, 3), in order around it, are those of a parallelogram with an area."""
    p, q, r, s = (corner.astype(np.float64) for corner in (p, q, r, s))
    gap = np.linalg.norm((r - q) - (s - p), axis=1)
    side = np.minimum(np.linalg.norm(q - p, axis=1), np.linalg.norm(s - p, axis=1))
    first, second = (np.linalg.norm(np.cross(u, v), axis=1) for u, v in ((q - p, s - p), (s - r, q - r)))
    is_even = np.abs(first - second) <= _MAX_AREA_DIFFERENCE * (first + second)
    return (gap <= _MAX_GAP * side) & is_even & (np.minimum(first, second) > 0)
