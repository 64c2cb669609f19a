"""Compares rays per second of the stage `intersect` and of Embree on one thread: same mesh, same rays, in turn.

Two sets of rays: *coherent*, the camera rays in pixel order; *incoherent*, those after one diffuse bounce. Called by
`peers`.
"""

import time
from collections.abc import Callable, Mapping

import numpy as np

from isonoise.benchmark.prepared_scene import MeasuredDevice
from isonoise.benchmark.spread import spread
from isonoise.integrator.wavefront import Wavefront
from isonoise.scene.accel.build import build_scene_bvh
from isonoise.scene.compiled_scene import CompiledScene
from isonoise.scene.structs import NONE

MAX_RAYS = 2**20
"""Of a set of rays."""
SEED = 20110
ORIGIN_OFFSET = 1e-4
"""Offset of a bounce's origin over the extent of the scene, so that neither program hits the same triangle again."""


def is_triangles_only(scene: CompiledScene) -> bool:
    """Whether Embree can trace the same scene: no analytic shapes, no instances."""
    return len(scene.faces) > 0 and not len(scene.analytics) and not len(scene.instances)


class IntersectStage:
    """The stage `intersect` on given rays: origins and directions (n, 3), n up to `MAX_RAYS`."""

    def __init__(self, device: MeasuredDevice, scene: CompiledScene):
        start = time.perf_counter()
        bvh = build_scene_bvh(scene)
        self.build_s = time.perf_counter() - start
        self._device, self._wavefront = device, Wavefront(device, scene, bvh, pool_size=MAX_RAYS)
        self._wavefront.warm_up()
        self._rays = 0

    def upload(self, origins: np.ndarray, directions: np.ndarray) -> None:
        """Write rays to the device."""
        self._rays = len(origins)
        arguments = self._wavefront.stages.arguments
        plane_bytes = 4 * int(arguments["plane_stride"])

        def write(buffer: str, *planes: np.ndarray) -> None:
            for index, plane in enumerate(planes):
                self._device.write(arguments[buffer], plane, offset=index * plane_bytes)

        def constant(value: float) -> np.ndarray:
            return np.full(self._rays, value, np.float32)

        write("ray_origin", *origins.T.astype(np.float32), constant(np.inf))
        write("ray_direction", *directions.T.astype(np.float32), constant(-1.0))
        none = np.full(self._rays, NONE, np.uint32)
        write("path_ids", np.zeros_like(none), none)
        self._device.finish()

    def trace(self) -> float:
        """Trace the rays; returns the seconds until the device has finished."""
        start = time.perf_counter()
        self._wavefront.trace_rays("intersect", self._rays)
        self._device.finish()
        return time.perf_counter() - start

    def hits(self) -> tuple[np.ndarray, np.ndarray]:
        """Distances (n,) and triangles (n,); inf and NONE for a miss."""
        arguments = self._wavefront.stages.arguments
        distances = self._device.read(arguments["hit"], np.float32, self._rays)
        triangles = self._device.read(
            arguments["hit"], np.uint32, self._rays, offset=3 * int(arguments["plane_stride"])
        )
        return np.where(triangles == NONE, np.inf, distances), triangles


class EmbreeMesh:
    """The same for Embree through embreex: one thread, one ray at a time."""

    def __init__(self, scene: CompiledScene):
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        corners = np.ascontiguousarray(scene.vertices[scene.faces])
        start = time.perf_counter()
        self._scene = EmbreeScene()
        self._mesh = TriangleMesh(self._scene, corners)
        self._scene.run(
            np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32)
        )  # Embree builds its BVH with the first ray
        self.build_s = time.perf_counter() - start
        self._outside = scene.bounds.astype(float).max(axis=0) + np.ptp(scene.bounds.astype(float), axis=0)

    def upload(self, origins: np.ndarray, directions: np.ndarray) -> None:
        self._rays = [np.ascontiguousarray(xyz, np.float32) for xyz in (origins, directions)]

    def trace(self) -> float:
        start = time.perf_counter()
        self.triangles = self._scene.run(*self._rays)
        return time.perf_counter() - start

    def call_overhead(self) -> float:
        """Seconds for as many rays that start outside and leave: those of embreex, which Embree does not need."""
        origins = np.broadcast_to(self._outside.astype(np.float32), self._rays[0].shape).copy()
        directions = np.ones_like(origins)
        start = time.perf_counter()
        self._scene.run(origins, directions)
        return time.perf_counter() - start


def measure_rays(
    name: str, scene: CompiledScene, device: MeasuredDevice, repeat: int, show: Callable[[float, str], None]
) -> dict[str, object]:
    """An entry of the JSON field `meshes`, with its coherent and incoherent rays. `is_triangles_only` must hold."""
    show(0.0, "BVHs")
    isonoise, embree = IntersectStage(device, scene), EmbreeMesh(scene)
    origins, directions = camera_rays(scene)
    rows = [_row("coherent", isonoise, embree, (origins, directions), repeat, device.compute_units)]
    show(0.5, "incoherent rays")
    isonoise.upload(origins, directions)
    isonoise.trace()
    rows.append(
        _row(
            "incoherent",
            isonoise,
            embree,
            bounced_rays(scene, origins, directions, *isonoise.hits()),
            repeat,
            device.compute_units,
        )
    )
    return {
        "scene": name,
        "scene_hash": scene.hash,
        "triangles": len(scene.faces),
        "build_s": isonoise.build_s,
        "embree_build_s": embree.build_s,
        "rays": rows,
    }


def _row(
    kind: str, isonoise: IntersectStage, embree: EmbreeMesh, rays: tuple, repeat: int, cores: int
) -> Mapping[str, object]:
    for program in (isonoise, embree):
        program.upload(*rays)
        program.trace()  # warm-up
    triangles = isonoise.hits()[1]
    mrays = 1e-6 * len(rays[0])
    times = [(isonoise.trace(), embree.trace(), embree.call_overhead()) for _ in range(repeat)]
    return {
        "kind": kind,
        "rays": len(rays[0]),
        "hit_share": float(np.mean(triangles != NONE)),
        "same_triangle_share": float(np.mean(triangles.view(np.int32) == embree.triangles)),
        "mrays_per_s": spread(mrays / mine for mine, _, _ in times),
        "embree_mrays_per_s": spread(mrays / theirs for _, theirs, _ in times),
        "speedup": spread(theirs / mine for mine, theirs, _ in times),
        "embree_overhead_share": spread(overhead / theirs for _, theirs, overhead in times),
        "speedup_per_core": spread((theirs - overhead) / mine / cores for mine, theirs, overhead in times),
    }


def camera_rays(scene: CompiledScene) -> tuple[np.ndarray, np.ndarray]:
    """Origins and unit directions (n, 3) of a pinhole camera through a grid of points, row by row."""
    camera = scene.camera[0]
    side = int(MAX_RAYS**0.5)
    grid = 1 - 2 * (np.arange(side) + 0.5) / side  # +x points left, +y up
    y, x = np.meshgrid(grid, grid, indexing="ij")
    tangents = camera["tan_half_fov"].astype(float)
    local = np.stack([x * tangents[0], y * tangents[1], np.ones_like(x)], axis=-1).reshape(-1, 3)
    to_world = camera["to_world"].reshape(3, 4).astype(float)
    directions = local @ to_world[:, :3].T
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return np.broadcast_to(to_world[:, 3], directions.shape).copy(), directions


def bounced_rays(
    scene: CompiledScene, origins: np.ndarray, directions: np.ndarray, distance: np.ndarray, triangle: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Rays from the hits, in cosine-distributed directions, in the order of the incoming rays."""
    is_hit = triangle != NONE
    if not is_hit.any():  # the camera does not see the mesh
        return origins, directions
    a, b, c = (scene.vertices[scene.faces[triangle[is_hit], k]].astype(float) for k in range(3))
    normal = np.cross(b - a, c - a)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), np.finfo(float).tiny)
    normal *= -np.sign(np.sum(normal * directions[is_hit], axis=1, keepdims=True))
    z = np.random.default_rng(SEED).normal(size=normal.shape)
    z /= np.linalg.norm(z, axis=1, keepdims=True)
    scattered = normal + z  # a uniform point of the unit sphere around the normal's end
    scattered /= np.maximum(np.linalg.norm(scattered, axis=1, keepdims=True), np.finfo(float).tiny)
    offset = ORIGIN_OFFSET * float(np.linalg.norm(np.ptp(scene.bounds.astype(float), axis=0)))
    return origins[is_hit] + distance[is_hit, None] * directions[is_hit] + offset * normal, scattered
