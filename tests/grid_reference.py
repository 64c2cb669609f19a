"""Values of grids in space, in float64, and volumes for tests."""

import numpy as np

CORNERS = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)])


def wrapped(index: np.ndarray, size: int, wrap: str) -> np.ndarray:
    """Returns indices within a grid for indices of any size."""
    if wrap == "clamp":
        return np.clip(index, 0, size - 1)
    if wrap == "repeat":
        return index % size
    index = index % (2 * size)
    return np.where(index < size, index, 2 * size - 1 - index)


def value_at(values: np.ndarray, points: np.ndarray, wrap: str = "clamp", nearest: bool = False) -> np.ndarray:
    """Returns the values (n, channels) of a grid (nz, ny, nx, channels) at points (n, 3) of the unit cube's space."""
    size = np.array(values.shape[2::-1])
    at = points * size - (0.0 if nearest else 0.5)
    lower = np.floor(at).astype(int)
    total = np.zeros((len(points), values.shape[3]))
    for corner in CORNERS[:1] if nearest else CORNERS:
        weight = 1.0 if nearest else np.prod(np.where(corner, at - lower, 1 - (at - lower)), axis=1)[:, None]
        x, y, z = (wrapped(lower[:, a] + corner[a], size[a], wrap) for a in range(3))
        total += weight * values[z, y, x]
    return total


def grid(values: np.ndarray, to_world: np.ndarray | None = None, **more) -> dict:
    """Returns a gridvolume."""
    return {"type": "gridvolume", "data": values, **({} if to_world is None else {"to_world": to_world}), **more}


def ramp(lower: float, upper: float, count: int = 16) -> np.ndarray:
    """Returns a grid whose values rise linearly along z, (count, 2, 2) float32."""
    return np.linspace(lower, upper, count, dtype=np.float32)[:, None, None] * np.ones((count, 2, 2), np.float32)
