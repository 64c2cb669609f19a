"""Cuts polygons into triangles. Called by the readers of OBJ and PLY.

A polygon becomes a fan from its first corner. Where a triangle of the fan would leave the polygon, which is then
concave, it is cut by ear clipping (Meisters 1975).
"""

from itertools import pairwise

import numpy as np

_MAX_EAR_TESTS = 5_000_000
"""Of points in triangles, for one polygon: what then remains of it becomes a fan."""
_RELATIVE_ROUNDING = 1e-9
_OTHER_DIAGONAL = np.array([[1, 2, 3], [1, 3, 0]])  # the cut of a quadrilateral whose first diagonal is outside


def triangle_fans(sizes: np.ndarray) -> np.ndarray:
    """Corner numbers (t, 3) of the triangles of polygons with these corner counts."""
    first = np.cumsum(sizes) - sizes
    count = sizes - 2
    within = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    start = np.repeat(first, count)
    return np.stack([start, start + within + 1, start + within + 2], axis=1)


def triangulate(points: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """Like `triangle_fans`, but no triangle of a concave polygon leaves its outline.

    `points` (c, 3) are the corners of all polygons, one polygon after the other.
    """
    triangles = triangle_fans(sizes)
    first_corners, first_triangles = np.cumsum(sizes) - sizes, np.cumsum(sizes - 2) - (sizes - 2)
    for size in np.unique(sizes[sizes > 3]).tolist():
        polygons = np.flatnonzero(sizes == size)
        outlines = [points[first_corners[polygons] + i] for i in range(size)]
        normals, leaves = _check_fans(outlines)
        if not leaves.any():
            continue
        if size == 4:
            cuts = np.broadcast_to(_OTHER_DIAGONAL, (int(leaves.sum()), 2, 3))
        else:
            flat = _project(np.stack([corners[leaves] for corners in outlines], axis=1), normals[leaves])
            cuts = np.array([_clip_ears(outline) for outline in flat.tolist()])
        rows = first_triangles[polygons[leaves]][:, None] + np.arange(size - 2)
        triangles[rows] = first_corners[polygons[leaves]][:, None, None] + cuts
    return triangles


def _check_fans(outlines: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """(normals (p, 3), whether a fan leaves the polygon) of polygons whose n corners are (p, 3) each.

    A fan stays inside a polygon if its triangles turn like the whole polygon.
    """
    with np.errstate(over="ignore", invalid="ignore"):  # polygons that are too large stay fans
        edges = [corners - outlines[0] for corners in outlines[1:]]
        crosses = [_cross(first, second) for first, second in pairwise(edges)]
        normals = sum(crosses)
        limit = -_RELATIVE_ROUNDING * np.einsum("pi,pi->p", normals, normals)
        turns = [np.einsum("pi,pi->p", cross, normals) for cross in crosses]
        return normals, np.any([turn < limit for turn in turns], axis=0)


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cross products (n, 3), several times as fast as numpy's."""
    (ax, ay, az), (bx, by, bz) = a.T, b.T
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=1)


def _project(outlines: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """(p, n, 2): the polygons along the axis of their normals' largest component, counter-clockwise."""
    axis = np.argmax(np.abs(normals), axis=1)
    numbers = np.arange(len(outlines))
    u = np.swapaxes(outlines, 1, 2)[numbers, (axis + 1) % 3]
    v = np.swapaxes(outlines, 1, 2)[numbers, (axis + 2) % 3]
    return np.stack([u * np.sign(normals[numbers, axis])[:, None], v], axis=2)


def _clip_ears(outline: list) -> list[tuple[int, int, int]]:
    """Corner numbers of the n - 2 triangles of a counter-clockwise polygon. Without an ear, any corner is cut."""
    remaining, triangles, tests = list(range(len(outline))), [], 0
    position = 0
    while len(remaining) > 3:
        for _ in range(len(remaining) if tests < _MAX_EAR_TESTS else 0):
            ear = remaining[position - 1], remaining[position], remaining[(position + 1) % len(remaining)]
            tests += len(remaining)
            if _is_ear(outline, remaining, ear):
                break
            position = (position + 1) % len(remaining)
        triangles.append((remaining[position - 1], remaining[position], remaining[(position + 1) % len(remaining)]))
        del remaining[position]
        position = position % len(remaining)
    return [*triangles, tuple(remaining)]


def _is_ear(outline: list, remaining: list[int], ear: tuple[int, int, int]) -> bool:
    """Whether the corner in the middle is convex and no other corner lies in the triangle."""
    a, b, c = (outline[i] for i in ear)
    if _doubled_area(a, b, c) <= 0:
        return False
    for i in remaining:
        p = outline[i]
        if i in ear or p in (a, b, c):  # a corner twice: a bridge to a hole
            continue
        if _doubled_area(a, b, p) >= 0 and _doubled_area(b, c, p) >= 0 and _doubled_area(c, a, p) >= 0:
            return False
    return True


def _doubled_area(a: list[float], b: list[float], c: list[float]) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
