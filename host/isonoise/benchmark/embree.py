"""Rays per second of the stage `intersect` against Embree on one thread: the same mesh, the same rays, in turn.

Two sets of rays: *coherent*, the camera's, pixel by pixel; *incoherent*, what follows them after one diffuse bounce.
"""

import time
from collections.abc import Callable, Mapping

import numpy as np

from isonoise.benchmark.spread import Spread
from isonoise.benchmark.subject import MeasuredDevice
from isonoise.integrator.wavefront import Wavefront
from isonoise.scene.accel.build import build_scene_bvh
from isonoise.scene.compiled_scene import CompiledScene
from isonoise.scene.structs import NONE

RAYS = 2**20
"""Rays of a set at most."""
SEED = 20110
NEAREST = 1e-4
"""A bounce's origin is lifted by this share of the scene's extent, so that neither program meets the triangle again."""


def has_rays(scene: CompiledScene) -> bool:
    """Whether Embree can hold the same: triangles in the world, nothing else."""
    return len(scene.faces) > 0 and not len(scene.analytics) and not len(scene.instances)


class IntersectStage:
    """The stage `intersect` on rays that are given: origins and directions (n, 3), n up to `RAYS`."""

    def __init__(self, device: MeasuredDevice, scene: CompiledScene):
        begun = time.perf_counter()
        bvh = build_scene_bvh(scene)
        self.build_s = time.perf_counter() - begun
        self._device, self._wavefront = device, Wavefront(device, scene, bvh, pool_size=RAYS)
        self._wavefront.warm_up()
        self._rays = 0

    def take(self, origins: np.ndarray, directions: np.ndarray) -> None:
        """Sends rays to the device."""
        self._rays = len(origins)
        of = self._wavefront.stages.arguments
        plane = 4 * int(of["plane_stride"])  # bytes

        def write(buffer: str, *members: np.ndarray) -> None:
            for place, member in enumerate(members):
                self._device.write(of[buffer], member, offset=place * plane)

        def all_of(value: float) -> np.ndarray:
            return np.full(self._rays, value, np.float32)

        write("ray_origin", *origins.T.astype(np.float32), all_of(np.inf))
        write("ray_direction", *directions.T.astype(np.float32), all_of(-1.0))
        none = np.full(self._rays, NONE, np.uint32)
        write("path", np.zeros_like(none), none)
        self._device.finish()

    def trace(self) -> float:
        """Seconds, up to the end of the device's work."""
        begun = time.perf_counter()
        self._wavefront.trace_rays("intersect", self._rays)
        self._device.finish()
        return time.perf_counter() - begun

    def hits(self) -> tuple[np.ndarray, np.ndarray]:
        """Distances (n,), infinite where nothing was met, and triangles (n,), NONE there."""
        of = self._wavefront.stages.arguments
        distances = self._device.read(of["hit"], np.float32, self._rays)
        triangles = self._device.read(of["hit"], np.uint32, self._rays, offset=3 * int(of["plane_stride"]))
        return np.where(triangles == NONE, np.inf, distances), triangles


class EmbreeMesh:
    """The same in Embree, through embreex: one thread, one ray after the other."""

    def __init__(self, scene: CompiledScene):
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        corners = np.ascontiguousarray(scene.vertices[scene.faces])
        begun = time.perf_counter()
        self._scene = EmbreeScene()
        self._mesh = TriangleMesh(self._scene, corners)
        self._scene.run(
            np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32)
        )  # the tree is built with the first ray
        self.build_s = time.perf_counter() - begun

    def take(self, origins: np.ndarray, directions: np.ndarray) -> None:
        self._rays = [np.ascontiguousarray(xyz, np.float32) for xyz in (origins, directions)]

    def trace(self) -> float:
        begun = time.perf_counter()
        self.triangles = self._scene.run(*self._rays)
        return time.perf_counter() - begun


def measure_rays(
    name: str, scene: CompiledScene, device: MeasuredDevice, repeat: int, say: Callable[[float, str], None]
) -> dict[str, object]:
    """The rows of one scene, coherent and incoherent, as the JSON has them. `has_rays` has to hold."""
    say(0.0, "hierarchies")
    ours, embree = IntersectStage(device, scene), EmbreeMesh(scene)
    origins, directions = camera_rays(scene)
    rows = [_row("coherent", ours, embree, (origins, directions), repeat)]
    say(0.5, "incoherent rays")
    ours.take(origins, directions)
    ours.trace()
    rows.append(_row("incoherent", ours, embree, bounced_rays(scene, origins, directions, *ours.hits()), repeat))
    return {
        "scene": name,
        "scene_hash": scene.hash,
        "triangles": len(scene.faces),
        "build_s": ours.build_s,
        "embree_build_s": embree.build_s,
        "rays": rows,
    }


def _row(kind: str, ours: IntersectStage, embree: EmbreeMesh, rays: tuple, repeat: int) -> Mapping[str, object]:
    number = len(rays[0])
    for each in (ours, embree):
        each.take(*rays)
        each.trace()  # warm-up
    met = ours.hits()[1]
    same = float(np.mean(met.view(np.int32) == embree.triangles))
    times = [(ours.trace(), embree.trace()) for _ in range(repeat)]
    return {
        "kind": kind,
        "rays": number,
        "hit_share": float(np.mean(met != NONE)),
        "same_triangle_share": same,
        "mrays_per_s": Spread.of(1e-6 * number / mine for mine, _ in times).json(),
        "embree_mrays_per_s": Spread.of(1e-6 * number / theirs for _, theirs in times).json(),
        "ratio": Spread.of(theirs / mine for mine, theirs in times).json(),
    }


def camera_rays(scene: CompiledScene) -> tuple[np.ndarray, np.ndarray]:
    """Origins and unit directions (n, 3) through a grid of the camera's view, row by row: as a pinhole sees it."""
    camera = scene.camera[0]
    side = int(RAYS**0.5)
    across = 1 - 2 * (np.arange(side) + 0.5) / side  # +x points left, +y up
    y, x = np.meshgrid(across, across, indexing="ij")
    tangents = camera["tan_half_fov"].astype(float)
    ahead = np.stack([x * tangents[0], y * tangents[1], np.ones_like(x)], axis=-1).reshape(-1, 3)
    to_world = camera["to_world"].reshape(3, 4).astype(float)
    directions = ahead @ to_world[:, :3].T
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return np.broadcast_to(to_world[:, 3], directions.shape).copy(), directions


def bounced_rays(
    scene: CompiledScene, origins: np.ndarray, directions: np.ndarray, distance: np.ndarray, triangle: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """From where rays met the mesh on, in directions with the density of diffuse reflection; in the rays' order."""
    met = triangle != NONE
    if not met.any():  # the camera looks past the mesh: anything else would be no bounce
        return origins, directions
    a, b, c = (scene.vertices[scene.faces[triangle[met], k]].astype(float) for k in range(3))
    normal = np.cross(b - a, c - a)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), np.finfo(float).tiny)
    normal *= -np.sign(np.sum(normal * directions[met], axis=1, keepdims=True))
    z = np.random.default_rng(SEED).normal(size=normal.shape)
    z /= np.linalg.norm(z, axis=1, keepdims=True)
    scattered = normal + z  # a point of the unit sphere around the normal's end: cosine-distributed
    scattered /= np.maximum(np.linalg.norm(scattered, axis=1, keepdims=True), np.finfo(float).tiny)
    lift = NEAREST * float(np.linalg.norm(np.ptp(scene.bounds.astype(float), axis=0)))
    return origins[met] + distance[met, None] * directions[met] + lift * normal, scattered
