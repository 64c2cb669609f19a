"""4x4 transforms in float64: the operations of Mitsuba 3's <transform>, and what shapes and cameras ask of them."""

import numpy as np


def translate(offset) -> np.ndarray:
    """Translation by a vector."""
    matrix = np.eye(4)
    matrix[:3, 3] = offset
    return matrix


def scale(factors) -> np.ndarray:
    """Scaling along the axes."""
    return np.diag([*np.broadcast_to(np.asarray(factors, float), 3), 1.0])


def rotate(axis, degrees: float) -> np.ndarray:
    """Rotation about an axis through the origin, counter-clockwise seen from its tip (Rodrigues).

    The axis is used as it is: Mitsuba 3 does not normalise it, so one that is not a unit vector scales and shears.
    """
    x, y, z = np.asarray(axis, float)
    sine, cosine = np.sin(np.deg2rad(degrees)), np.cos(np.deg2rad(degrees))
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    matrix = np.eye(4)
    matrix[:3, :3] = cosine * np.eye(3) + sine * cross + (1.0 - cosine) * np.outer(axis, axis)
    return matrix


def look_at(origin, target, up=None) -> np.ndarray:
    """Camera-to-world of a camera at `origin` that looks along +z at `target`, with +x to its left (Mitsuba 3).

    Raises ValueError where the three leave the orientation open.
    """
    origin, target = np.asarray(origin, float), np.asarray(target, float)
    ahead = _unit(target - origin)
    if up is None or not np.any(up):
        up = perpendicular(ahead)
    left = _unit(np.cross(np.asarray(up, float), ahead))
    matrix = np.eye(4)
    matrix[:3, :4] = np.stack([left, np.cross(ahead, left), ahead, origin], axis=1)
    return matrix


def perpendicular(normal: np.ndarray) -> np.ndarray:
    """A unit vector at right angles to a unit vector; Duff et al. 2017, "Building an Orthonormal Basis, Revisited"."""
    x, y, z = normal
    sign = 1.0 if z >= 0 else -1.0
    a = -1.0 / (sign + z)
    return np.array([1.0 + sign * x * x * a, sign * x * y * a, -sign * x])


def rotation_from_z(normal: np.ndarray) -> np.ndarray:
    """Rotation that takes +z to a unit vector."""
    tangent = perpendicular(normal)
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([tangent, np.cross(normal, tangent), normal], axis=1)
    return matrix


def polar_decomposition(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(Q, S) with matrix[:3, :3] = Q S, Q a rotation and S symmetric; S is negative where the matrix mirrors."""
    u, sigma, vt = np.linalg.svd(matrix[:3, :3])
    sign = 1.0 if np.linalg.det(u @ vt) > 0 else -1.0
    return sign * (u @ vt), sign * (vt.T * sigma) @ vt


def transform_points(matrix: np.ndarray, positions: np.ndarray) -> np.ndarray:
    """Positions (n, 3) taken through an affine transform."""
    return np.einsum("ij,kj->ik", positions, matrix[:3, :3]) + matrix[:3, 3]


def transform_normals(matrix: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Normals (n, 3) taken through the inverse transpose; not normalised."""
    return np.einsum("ij,jk->ik", directions, np.linalg.inv(matrix[:3, :3]))


def _unit(vector: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(vector)
    if not (np.isfinite(length) and length > 0):
        raise ValueError("the direction is zero or not finite")
    return vector / length
