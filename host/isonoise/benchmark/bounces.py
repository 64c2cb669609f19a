"""Rays by bounce: the samples of a run in pools of their own, so that all paths of a launch have the same depth."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from isonoise.benchmark.spread import Spread
from isonoise.benchmark.subject import Subject
from isonoise.device.opencl import Device, list_devices
from isonoise.integrator.wavefront import Wavefront

SHADOW_KERNELS = ("shadow", "shadow_transmittance")
BLOCK = 8
"""Triangles of a block, which one operation tests, and counts, whether or not all of its places are taken."""


@dataclass
class Bounce:
    """What the launches of one depth did in one pass over the samples; depth 1 are the camera's rays."""

    rays: int = 0
    seconds: float = 0.0
    shadow_seconds: float = 0.0


@dataclass(frozen=True)
class RayTests:
    """Rays of one depth, with the sums of the nodes and triangles that they were tested against."""

    rays: int = 0
    nodes: int = 0
    triangles: int = 0

    def __add__(self, other: "RayTests") -> "RayTests":
        return RayTests(self.rays + other.rays, self.nodes + other.nodes, self.triangles + other.triangles)


def pools(allocation: np.ndarray, size: int) -> Iterator[np.ndarray]:
    """The allocation map cut into maps of `size` samples (the last one may have fewer), in pixel order."""
    ends = np.cumsum(allocation.ravel(), dtype=np.int64)
    begins = ends - allocation.ravel()
    for begin in range(0, int(ends[-1]), size):
        piece = np.minimum(ends, begin + size) - np.maximum(begins, begin)
        yield np.maximum(piece, 0).astype(np.uint32).reshape(allocation.shape)


def count_shadow_rays(subject: Subject) -> list[int]:
    """Shadow rays of every bounce: shade leaves a direction of length 0 where there is none."""
    wavefront = subject.wavefront
    directions = wavefront.stages.arguments.get("shadow_direction")
    if directions is None:
        return []
    counts: list[int] = []
    depth = 0

    def on_bounce(paths: int) -> None:
        nonlocal depth
        lengths = 3 * int(wavefront.stages.arguments["plane_stride"])  # the last plane
        rays = subject.device.read(directions, np.float32, paths, offset=lengths)
        counts.extend([0] * (depth + 1 - len(counts)))
        counts[depth] += int(np.count_nonzero(rays))
        depth += 1

    subject.begin(profile=False)
    wavefront.on_bounce = on_bounce
    try:
        for allocation in pools(subject.allocation, subject.pool_size):
            depth = 0
            wavefront.trace(allocation)
    finally:
        wavefront.on_bounce = None
    return counts


def timed_bounces(subject: Subject) -> list[Bounce]:
    """One pass over the samples of a run, in the same order, with the times of the stages that trace rays."""
    bounces: list[Bounce] = []
    depth = 0

    def on_launch(kernel: str, items: int, seconds: float) -> None:
        nonlocal depth
        if kernel == "intersect":
            depth += 1
            if depth > len(bounces):
                bounces.append(Bounce())
            bounces[depth - 1].rays += items
            bounces[depth - 1].seconds += seconds
        elif kernel in SHADOW_KERNELS:
            bounces[depth - 1].shadow_seconds += seconds

    subject.begin(profile=True)
    subject.device.on_launch = on_launch
    for allocation in pools(subject.allocation, subject.pool_size):
        depth = 0
        subject.wavefront.trace(allocation)
    subject.device.on_launch = None
    return bounces


def count_tests(subject: Subject, rays: list[int]) -> list[RayTests]:
    """The tests of every bounce of a run, of which the number of rays is known (`bounces.timed_bounces`).

    `intersect` is built once more, counting, and traces the run's samples again. Without a hierarchy nothing needs to
    be counted: every ray is tested against all triangles.
    """
    if subject.wavefront.brute_force:
        return [RayTests(number, 0, number * len(subject.scene.faces)) for number in rays]
    device = Device(list_devices().index(subject.device.device))  # its buffers are none of those that are reported
    feature_override = subject.wavefront.features | {"COUNT_TESTS": True}
    wavefront = Wavefront(
        device, subject.scene, subject.bvh, pool_size=subject.pool_size, feature_override=feature_override
    )
    sums = [RayTests()] * len(rays)
    depth = 0

    def on_bounce(paths: int) -> None:
        nonlocal depth
        nodes, blocks = device.read(wavefront.stages.arguments["tests"], np.uint32, 2 * paths).reshape(-1, 2).T
        sums[depth] += RayTests(paths, int(nodes.sum(dtype=np.int64)), BLOCK * int(blocks.sum(dtype=np.int64)))
        depth += 1

    wavefront.on_bounce = on_bounce
    for allocation in pools(subject.allocation, subject.pool_size):
        depth = 0
        wavefront.trace(allocation)
    return sums


def ray_facts(passes: list[list[Bounce]], shadow_rays: list[int], tests: list[RayTests]) -> dict[str, object]:
    """Rays and Mrays/s by kind and by bounce; `passes` trace the same samples, so they differ in times alone.

    `tests`: of the rays of every bounce; those of shadow rays are not counted.
    """
    first = passes[0]
    shadow_rays = shadow_rays or [0] * len(first)

    def rate(rays: int, seconds: list[float]) -> dict[str, float] | None:
        """None where there are no rays, or too few for the device's clock."""
        return Spread.of(1e-6 * rays / s for s in seconds).json() if rays and min(seconds) > 0 else None

    def row(rays: int, seconds: list[float]) -> dict[str, object]:
        return {"rays": rays, "mrays_per_s": rate(rays, seconds)}

    def kind(name: str, depths: slice) -> dict[str, object]:
        seconds = [sum(bounce.seconds for bounce in each[depths]) for each in passes]
        done = sum(tests[depths], RayTests())
        per_ray = [number / done.rays if done.rays else None for number in (done.nodes, done.triangles)]
        return {
            "kind": name,
            **row(sum(bounce.rays for bounce in first[depths]), seconds),
            **dict(zip(("node_tests_per_ray", "triangle_tests_per_ray"), per_ray, strict=True)),
        }

    shadow_seconds = [sum(bounce.shadow_seconds for bounce in each) for each in passes]
    kinds = [
        kind("camera", slice(0, 1)),
        kind("bounce", slice(1, None)),
        {
            "kind": "shadow",
            **row(sum(shadow_rays), shadow_seconds),
            "node_tests_per_ray": None,
            "triangle_tests_per_ray": None,
        },
    ]
    bounces = [
        {
            "depth": depth + 1,
            **row(bounce.rays, [each[depth].seconds for each in passes]),
            "shadow_rays": shadow_rays[depth],
            "shadow_mrays_per_s": rate(shadow_rays[depth], [each[depth].shadow_seconds for each in passes]),
        }
        for depth, bounce in enumerate(first)
    ]
    return {"kinds": kinds, "bounces": bounces}
