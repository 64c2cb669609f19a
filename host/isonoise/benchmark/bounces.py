"""Rays by bounce: traces a run's samples pool by pool without regeneration, so that a launch has paths of one depth.

Called by `measure`.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from isonoise.benchmark.prepared_scene import PreparedScene
from isonoise.benchmark.spread import spread
from isonoise.device.drivers import list_devices
from isonoise.device.opencl import Device, Launch
from isonoise.integrator.wavefront import Wavefront

SHADOW_KERNELS = ("shadow", "shadow_transmittance")
BLOCK_TRIANGLES = 8
"""Triangles of a block. One operation tests all of them, so all count, also the empty places."""


@dataclass
class BounceTimes:
    """Rays and seconds of one depth in one pass over the samples; depth 1 are the camera rays."""

    rays: int = 0
    seconds: float = 0.0
    shadow_seconds: float = 0.0


@dataclass(frozen=True)
class RayTests:
    """Rays of one depth, and sums over the rays of the nodes and triangles that they were tested against."""

    rays: int = 0
    nodes: int = 0
    triangles: int = 0

    def __add__(self, other: "RayTests") -> "RayTests":
        return RayTests(self.rays + other.rays, self.nodes + other.nodes, self.triangles + other.triangles)


def split_allocation(allocation: np.ndarray, size: int) -> Iterator[np.ndarray]:
    """Allocation maps of `size` samples each (the last one may have fewer) that sum to `allocation`, in pixel order."""
    ends = np.cumsum(allocation.ravel(), dtype=np.int64)
    begins = ends - allocation.ravel()
    for begin in range(0, int(ends[-1]), size):
        part = np.minimum(ends, begin + size) - np.maximum(begins, begin)
        yield np.maximum(part, 0).astype(np.uint32).reshape(allocation.shape)


def _trace_by_bounce(
    prepared: PreparedScene, wavefront: Wavefront, on_bounce: Callable[[int, int], None] | None = None
) -> None:
    """Trace the samples of a run pool by pool; `on_bounce` gets the index of a bounce and its number of paths."""
    depth = 0

    def count_bounces(paths: int) -> None:
        nonlocal depth
        on_bounce(depth, paths)
        depth += 1

    wavefront.on_bounce = count_bounces if on_bounce else None
    for allocation in split_allocation(prepared.allocation, prepared.pool_size):
        depth = 0
        wavefront.trace(allocation)
    wavefront.on_bounce = None


def count_shadow_rays(prepared: PreparedScene) -> list[int]:
    """Shadow rays of every bounce: `shade` writes a direction of length 0 if there is none."""
    stages = prepared.wavefront.stages
    directions = stages.arguments.get("shadow_direction")
    if directions is None:
        return []
    counts: list[int] = []

    def on_bounce(depth: int, paths: int) -> None:
        offset = 3 * int(stages.arguments["plane_stride"])  # the plane of the lengths
        lengths = prepared.device.read(directions, np.float32, paths, offset=offset)
        counts.extend([0] * (depth + 1 - len(counts)))
        counts[depth] += int(np.count_nonzero(lengths))

    prepared.reset(profile=False)
    _trace_by_bounce(prepared, prepared.wavefront, on_bounce)
    return counts


def time_bounces(prepared: PreparedScene) -> list[BounceTimes]:
    """One pass over the samples of a run, in the same order, with the times of the stages that trace rays."""
    bounces: list[BounceTimes] = []
    depth = 0

    def on_launch(launch: Launch) -> None:
        nonlocal depth
        if launch.kernel == "generate":
            depth = 0
        elif launch.kernel == "intersect":
            depth += 1
            if depth > len(bounces):
                bounces.append(BounceTimes())
            bounces[depth - 1].rays += launch.items
            bounces[depth - 1].seconds += launch.seconds
        elif launch.kernel in SHADOW_KERNELS:
            bounces[depth - 1].shadow_seconds += launch.seconds

    prepared.reset(profile=True)
    prepared.device.on_launch = on_launch
    _trace_by_bounce(prepared, prepared.wavefront)
    prepared.device.on_launch = None
    return bounces


def count_tests(prepared: PreparedScene, rays: list[int]) -> list[RayTests]:
    """Intersection tests of every bounce of a run; `rays` are its numbers of rays, from `time_bounces`.

    Builds `intersect` once more with the feature COUNT_TESTS and traces the samples of the run again. With
    brute force nothing is counted: every ray is tested against all triangles.
    """
    if prepared.wavefront.brute_force:
        return [RayTests(number, 0, number * len(prepared.scene.faces)) for number in rays]
    device = Device(list_devices().index(prepared.device.device))  # its buffers are not part of the report
    feature_override = prepared.wavefront.features | {"COUNT_TESTS": True}
    wavefront = Wavefront(
        device, prepared.scene, prepared.bvh, pool_size=prepared.pool_size, feature_override=feature_override
    )
    sums = [RayTests()] * len(rays)

    def on_bounce(depth: int, paths: int) -> None:
        nodes, blocks = device.read(wavefront.stages.arguments["tests"], np.uint32, 2 * paths).reshape(-1, 2).T
        triangles = BLOCK_TRIANGLES * int(blocks.sum(dtype=np.int64))
        sums[depth] += RayTests(paths, int(nodes.sum(dtype=np.int64)), triangles)

    _trace_by_bounce(prepared, wavefront, on_bounce)
    return sums


def ray_rows(
    passes: list[list[BounceTimes]], shadow_rays: list[int], tests: list[RayTests]
) -> dict[str, list[dict[str, object]]]:
    """The JSON field `rays`: numbers and rates of rays by kind and by bounce.

    Parameters
    ----------
    passes : list of list of BounceTimes
        Repeats of `time_bounces`; they differ only in their times.
    shadow_rays : list of int
        From `count_shadow_rays`; empty without light sampling.
    tests : list of RayTests
        From `count_tests`. Those of shadow rays are not counted.
    """
    first = passes[0]
    shadow_rays = shadow_rays or [0] * len(first)
    shadow_seconds = [sum(bounce.shadow_seconds for bounce in each) for each in passes]
    kinds = [
        _kind_row("camera", passes, tests, slice(0, 1)),
        _kind_row("indirect", passes, tests, slice(1, None)),
        {
            "kind": "shadow",
            "rays": sum(shadow_rays),
            "mrays_per_s": _mrays_per_s(sum(shadow_rays), shadow_seconds),
            "node_tests_per_ray": None,
            "triangle_tests_per_ray": None,
        },
    ]
    bounces = [
        {
            "depth": depth + 1,
            "rays": bounce.rays,
            "mrays_per_s": _mrays_per_s(bounce.rays, [each[depth].seconds for each in passes]),
            "shadow_rays": shadow_rays[depth],
            "shadow_mrays_per_s": _mrays_per_s(shadow_rays[depth], [each[depth].shadow_seconds for each in passes]),
        }
        for depth, bounce in enumerate(first)
    ]
    return {"kinds": kinds, "bounces": bounces}


def _kind_row(name: str, passes: list[list[BounceTimes]], tests: list[RayTests], depths: slice) -> dict[str, object]:
    rays = sum(bounce.rays for bounce in passes[0][depths])
    counted = sum(tests[depths], RayTests())
    return {
        "kind": name,
        "rays": rays,
        "mrays_per_s": _mrays_per_s(rays, [sum(bounce.seconds for bounce in each[depths]) for each in passes]),
        "node_tests_per_ray": counted.nodes / counted.rays if counted.rays else None,
        "triangle_tests_per_ray": counted.triangles / counted.rays if counted.rays else None,
    }


def _mrays_per_s(rays: int, seconds: list[float]) -> dict[str, float] | None:
    """None without rays, or if they took no time by the device's clock."""
    return spread(1e-6 * rays / s for s in seconds) if rays and min(seconds) > 0 else None
