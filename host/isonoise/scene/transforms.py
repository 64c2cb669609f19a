"""4x4 transforms in float64: the operations of Mitsuba 3's <transform>, and decompositions for shapes and cameras."""

import numpy as np

_LAST_ROW = (0.0, 0.0, 0.0, 1.0)


def translate(offset) -> np.ndarray:
    """Translation by a vector."""
    x, y, z = offset
    return np.array([(1.0, 0.0, 0.0, x), (0.0, 1.0, 0.0, y), (0.0, 0.0, 1.0, z), _LAST_ROW])


def scale(factors) -> np.ndarray:
    """Scaling along the axes, by three factors or by one."""
    x, y, z = (factors,) * 3 if isinstance(factors, (int, float)) else factors
    return np.array([(x, 0.0, 0.0, 0.0), (0.0, y, 0.0, 0.0), (0.0, 0.0, z, 0.0), _LAST_ROW])


def rotate(axis, degrees: float) -> np.ndarray:
    """Rotation about an axis through the origin, counter-clockwise as seen from its tip (Rodrigues).

    As in Mitsuba 3, the axis is not normalised: if it is not a unit vector, the matrix scales and shears.
    """
    x, y, z = (float(component) for component in axis)
    angle = np.deg2rad(degrees)
    sine, cosine = float(np.sin(angle)), float(np.cos(angle))
    rest = 1.0 - cosine
    return np.array(
        [
            (cosine + rest * (x * x), -sine * z + rest * (x * y), sine * y + rest * (x * z), 0.0),
            (sine * z + rest * (y * x), cosine + rest * (y * y), -sine * x + rest * (y * z), 0.0),
            (-sine * y + rest * (z * x), sine * x + rest * (z * y), cosine + rest * (z * z), 0.0),
            _LAST_ROW,
        ]
    )


def look_at(origin, target, up=None) -> np.ndarray:
    """Camera-to-world matrix of a camera at `origin` that looks at `target`: +z forward, +x left (Mitsuba 3).

    Raises ValueError if the vectors do not define an orientation.
    """
    origin, target = np.asarray(origin, float), np.asarray(target, float)
    forward = _unit(target - origin)
    if up is None or not np.any(up):
        up = perpendicular(forward)
    left = _unit(np.cross(np.asarray(up, float), forward))
    matrix = np.eye(4)
    matrix[:3, :4] = np.stack([left, np.cross(forward, left), forward, origin], axis=1)
    return matrix


def perpendicular(normal: np.ndarray) -> np.ndarray:
    """A unit vector at right angles to a unit vector; Duff et al. 2017, "Building an Orthonormal Basis, Revisited"."""
    x, y, z = normal
    sign = 1.0 if z >= 0 else -1.0
    a = -1.0 / (sign + z)
    return np.array([1.0 + sign * x * x * a, sign * x * y * a, -sign * x])


def rotation_from_z(normal: np.ndarray) -> np.ndarray:
    """Rotation of +z to a unit vector."""
    tangent = perpendicular(normal)
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([tangent, np.cross(normal, tangent), normal], axis=1)
    return matrix


def polar_decomposition(matrices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(Q, S), both (n, 3, 3), of affine matrices (n, 4, 4): their linear parts are Q S, with Q a rotation.

    S is symmetric, and negative definite if the matrix mirrors.
    """
    u, sigma, vt = np.linalg.svd(matrices[:, :3, :3])
    rotation = u @ vt
    sign = np.where(np.linalg.det(rotation) > 0, 1.0, -1.0)[:, None, None]
    return sign * rotation, sign * ((vt.transpose(0, 2, 1) * sigma[:, None]) @ vt)


def transform_points(matrix: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points (..., k, 3) transformed by affine matrices (..., 4, 4)."""
    return np.einsum("...ij,...kj->...ik", points, matrix[..., :3, :3]) + matrix[..., None, :3, 3]


def transform_normals(matrix: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Normals (n, 3) transformed by the inverse transpose; not normalised."""
    return np.einsum("ij,jk->ik", normals, np.linalg.inv(matrix[:3, :3]))


def _unit(vector: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(vector)
    if not (np.isfinite(length) and length > 0):
        raise ValueError("the direction is zero or not finite")
    return vector / length
