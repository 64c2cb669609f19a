"""A light of a scene, parametrised over the unit square, in float64."""

import numpy as np

from isonoise.scene import structs
from isonoise.scene.light.light_kinds import light_bits

GRID = 240


class Patch:
    """A light, parametrised over the unit square: positions and texture coordinates."""

    def __init__(self, scene, light: int):
        self.scene, self.record = scene, scene.lights[light]
        on_mesh = self.record["kind"] & light_bits("triangle", "parallelogram")
        self.shape = None if on_mesh else scene.analytics[self.record["primitive"]]
        if on_mesh:  # corners: one, its neighbours, and of a parallelogram that beyond the diagonal
            first = int(self.record["primitive"])
            self.corners = scene.faces[first]
        self.is_parallelogram = self.record["kind"] == light_bits("parallelogram")
        if self.is_parallelogram:
            self.corners = np.roll(self.corners, -(int(self.record["apexes"]) & 3))
            self.corners = np.append(self.corners, scene.faces[first + 1][int(self.record["apexes"]) >> 2])

    @property
    def primitive(self) -> int:
        flag = 1 << 30 if self.is_parallelogram else 0 if self.shape is None else 1 << 31
        return int(self.record["primitive"]) | flag

    def _weights(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Weights of the corners."""
        if not self.is_parallelogram:
            return np.stack([1 - x, x * (1 - y), x * y], axis=1)
        near, far = np.maximum(1 - x - y, 0), np.maximum(x + y - 1, 0)
        return np.stack([near, np.where(far > 0, 1 - y, x), np.where(far > 0, 1 - x, y), far], axis=1)

    def points(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Returns positions (n, 3) and uv (n, 2)."""
        if self.shape is None:
            weights, corners = self._weights(x, y), self.corners
            return weights @ self.scene.vertices[corners].astype(float), weights @ self.scene.uvs[corners].astype(float)
        m = self.shape["to_world"].reshape(3, 4).astype(float)
        turn = 2 * np.pi * (y if self.shape["kind"] == structs.ANALYTIC_DISK else x)
        around = np.stack([np.cos(turn), np.sin(turn)])
        if self.shape["kind"] == structs.ANALYTIC_SPHERE:
            local = np.stack([*(np.sin(np.pi * y) * around), np.cos(np.pi * y)], axis=1)
        elif self.shape["kind"] == structs.ANALYTIC_DISK:
            local = np.stack([*(x * around), 0 * x], axis=1)
        else:
            local = np.stack([*around, y], axis=1)
        return local @ m[:, :3].T + m[:, 3], np.stack([x, y], axis=1)

    def parameters(self, position: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The inverse of `points`."""
        if self.shape is None:
            a, b, c = self.scene.vertices[self.corners[:3]].astype(float)
            second, third = np.linalg.lstsq(np.stack([b - a, c - a], axis=1), (position - a).T, rcond=None)[0]
            return (second, third) if self.is_parallelogram else (second + third, third / (second + third))
        m = self.shape["to_world"].reshape(3, 4).astype(float)
        local = np.linalg.solve(m[:, :3], (position - m[:, 3]).T)
        turn = np.arctan2(local[1], local[0]) / (2 * np.pi) % 1
        if self.shape["kind"] == structs.ANALYTIC_SPHERE:
            return turn, np.arctan2(np.hypot(local[0], local[1]), local[2]) / np.pi
        return (np.hypot(local[0], local[1]), turn) if self.shape["kind"] == structs.ANALYTIC_DISK else (turn, local[2])

    def grid(self, reference: np.ndarray, flipped: bool) -> dict[str, np.ndarray]:
        """Returns a grid of positions, their solid angles (0 where the light faces away) and normals."""
        steps = (np.arange(GRID) + 0.5) / GRID
        x, y = (a.ravel() for a in np.meshgrid(steps, steps, indexing="ij"))
        (position, uv), h = self.points(x, y), 1e-5
        along = (self.points(x + h, y)[0] - self.points(x - h, y)[0]) / (2 * h)
        across = (self.points(x, y + h)[0] - self.points(x, y - h)[0]) / (2 * h)
        element = np.cross(along, across) / GRID**2
        outward = -1 if self.shape is not None and self.shape["kind"] == structs.ANALYTIC_SPHERE else 1
        element *= -outward if flipped else outward
        arm = position - reference
        distance = np.linalg.norm(arm, axis=1)
        solid = np.maximum(-(element * arm).sum(axis=1), 0) / distance**3
        size = np.maximum(np.linalg.norm(element, axis=1, keepdims=True), 1e-300)
        return {
            "position": position,
            "uv": uv,
            "normal": element / size,
            "solid": solid,
            "direction": arm / distance[:, None],
        }
