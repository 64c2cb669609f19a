"""Traces rays with the kernel `intersect` alone, through the BVH or by brute force; and meshes to aim at."""

import numpy as np

from isonoise.device.opencl import Device
from isonoise.integrator.build_constants import build_constants
from isonoise.integrator.kernel_table import BRUTE_FORCE_KERNELS, KERNELS, STRUCTS
from isonoise.integrator.stages import Stages
from isonoise.scene import structs
from isonoise.scene.accel.bounds import analytic_bounds
from isonoise.scene.accel.bvh import Bvh, build_bvh
from isonoise.statistics import BASIC_NEEDS

_ON = ("TRIANGLES", "ANALYTICS", "SPHERES", "DISKS", "CYLINDERS")
_OFF = ("INSTANCES", "COUNT_TESTS", "NEXT_EVENT", "PARALLELOGRAM_LIGHTS")
_FEATURES = dict.fromkeys(_ON, True) | dict.fromkeys(_OFF, False)
_PADDING = 128  # a work-item of intersect_brute_force.cl reads all of its lanes

BVH, BRUTE_FORCE = "BVH", "brute force"


def methods(device: Device) -> tuple[str, ...]:
    """Returns the intersection methods of the device: brute force needs work-items that take several paths."""
    return (BVH, BRUTE_FORCE) if device.form.lanes > 1 else (BVH,)


class Tracer:
    """Triangles and analytic primitives on a device.

    Parameters
    ----------
    corners
        Triangles, (t, 3, 3). Brute force takes at most MAX_CORNERS different corners.
    analytics
        Records `structs.ANALYTIC`.
    method
        BVH or BRUTE_FORCE.
    count_tests
        Whether `trace` counts the BVH nodes and triangle blocks that each ray is tested against, in `tests`, (n, 2).
    """

    def __init__(
        self,
        device: Device,
        corners: np.ndarray,
        analytics: np.ndarray | None = None,
        method: str = BVH,
        count_tests: bool = False,
    ):
        self.device, self._method, self._count_tests = device, method, count_tests
        corners = np.asarray(corners, np.float32).reshape(-1, 3, 3)
        analytics = np.zeros(0, structs.ANALYTIC) if analytics is None else analytics
        kernels = BRUTE_FORCE_KERNELS if method == BRUTE_FORCE else KERNELS
        constants = build_constants(BASIC_NEEDS, device.form)
        features = _FEATURES | {"COUNT_TESTS": count_tests}
        self._stages = Stages(device, {"intersect": kernels["intersect"]}, features, constants, STRUCTS)
        self._stages.arguments["analytics"] = self._table(analytics)
        if method == BRUTE_FORCE:
            points, indices = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
            self._stages.arguments.update(
                corners=self._table(points),
                corner_count=np.uint32(len(points)),
                corner_indices=self._table(indices.reshape(-1, 3).astype(np.uint32)),
                triangle_count=np.uint32(len(corners)),
                analytic_count=np.uint32(len(analytics)),
            )
        else:
            self.use_bvh(build_bvh(corners, *analytic_bounds(analytics)))

    def use_bvh(self, bvh: Bvh) -> None:
        """Replaces the BVH."""
        self.bvh = bvh
        self._stages.arguments.update(
            nodes=self._table(bvh.nodes),
            triangle_blocks=self._table(bvh.blocks),
            first_analytic=np.uint32(bvh.first_analytic),
            rays_per_item=np.uint32(7),
        )

    def _table(self, array: np.ndarray):
        return self.device.buffer(array, "the geometry") if array.size else None

    def trace(
        self, origins: np.ndarray, directions: np.ndarray, t_max: float = np.inf
    ) -> tuple[np.ndarray, np.ndarray]:
        """Returns t and primitive of the closest hit of every ray, (n,) each; inf and NONE without a hit."""
        n = len(origins)
        stride = n + _PADDING
        origin, direction = np.zeros((2, 4, stride), np.float32)
        origin[:3, :n], origin[3, :n], direction[:3, :n] = origins.T, t_max, directions.T
        path = np.full((4, stride), structs.NONE, np.uint32)  # no ray starts on a primitive
        buffers = {
            "ray_origin": self.device.buffer(origin, "the rays"),
            "ray_direction": self.device.buffer(direction, "the rays"),
            "path_ids": self.device.buffer(path, "the rays"),
            "hit": self.device.buffer(16 * stride, "the hits"),
        }
        if self._count_tests:
            buffers["tests"] = self.device.buffer(8 * stride, "the counts of tests")
        lanes = self.device.form.lanes if self._method == BRUTE_FORCE else 1
        self._stages.launch("intersect", n, lanes, path_count=np.uint32(n), plane_stride=np.uint32(stride), **buffers)
        hit = self.device.read(buffers["hit"], np.float32, 4 * stride).reshape(4, stride)
        if self._count_tests:
            self.tests = self.device.read(buffers["tests"], np.uint32, 2 * n).reshape(n, 2)
        for buffer in buffers.values():
            self.device.allocated -= buffer.size
            buffer.release()
        return hit[0, :n], hit[3, :n].view(np.uint32)


def icosphere(level: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns vertices (v, 3) float64 of radius 1 and faces (20 * 4^level, 3) whose normals point outwards."""
    g = (1 + 5**0.5) / 2
    vertices = np.array([(-1, g, 0), (1, g, 0), (-1, -g, 0), (1, -g, 0)], float)
    vertices = np.concatenate([np.roll(vertices, k, axis=1) for k in (0, 1, 2)])
    distance = np.linalg.norm(vertices[:, None] - vertices, axis=-1)
    near = (distance > 0) & (distance < 2.1)
    faces = [
        (a, b, c) for a in range(12) for b in range(a) for c in range(b) if near[a, b] and near[b, c] and near[a, c]
    ]
    faces = np.array(faces)
    outwards = np.linalg.det(vertices[faces]) > 0
    faces[~outwards] = faces[~outwards][:, ::-1]
    for _ in range(level):
        edges = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        edges, indices = np.unique(edges, axis=0, return_inverse=True)
        ab, bc, ca = indices.reshape(-1, 3).T + len(vertices)
        vertices = np.concatenate([vertices, vertices[edges].mean(axis=1)])
        a, b, c = faces.T
        faces = np.stack([a, ab, ca, ab, b, bc, ca, bc, c, ab, bc, ca], axis=1).reshape(-1, 3)
    return vertices / np.linalg.norm(vertices, axis=1, keepdims=True), faces


def unique_edges(faces: np.ndarray) -> np.ndarray:
    """Returns pairs of vertices (e, 2), each edge once."""
    return np.unique(np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)


def closest_hits(corners: np.ndarray, origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns t and triangle of the closest hits, (n,) each, every ray against every triangle in float64.

    Moeller and Trumbore, "Fast, Minimum Storage Ray/Triangle Intersection", 1997.
    """
    a, b, c = np.asarray(corners, np.float64).transpose(1, 0, 2)
    best, triangle = np.full(len(origins), np.inf), np.full(len(origins), structs.NONE, np.uint32)
    origins, directions = origins.astype(np.float64), directions.astype(np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        for index, (corner, edge1, edge2) in enumerate(zip(a, b - a, c - a, strict=True)):
            p = np.cross(directions, edge2)
            determinant = p @ edge1
            s = origins - corner
            u = (s * p).sum(axis=1) / determinant
            q = np.cross(s, edge1)
            v = (directions * q).sum(axis=1) / determinant
            t = q @ edge2 / determinant
            closer = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0) & (t < best)
            best, triangle = np.where(closer, t, best), np.where(closer, np.uint32(index), triangle)
    return best, triangle
