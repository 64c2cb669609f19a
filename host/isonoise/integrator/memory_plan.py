"""The memory that a render takes, computed before it is allocated. `Wavefront` fits its pool to it; `info` shows it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property

from isonoise.device.opencl import Device
from isonoise.device.pool_size import MIN_POOL_SIZE, SAMPLES_PER_PATH
from isonoise.errors import DeviceError
from isonoise.integrator.accumulator import summary_bytes
from isonoise.integrator.error_stage import error_scratch_bytes
from isonoise.integrator.image_scratch import scratch_bytes
from isonoise.integrator.kernel_table import path_bytes
from isonoise.integrator.reduction_state import state_planes
from isonoise.layers import first_values, mean_components
from isonoise.statistics import Needs
from isonoise.strips import LARGE_IMAGE_PIXELS

PLANE_PADDING = 80
"""Elements by which a plane of path state is longer than the pool. Without it the members of a path would be a power of
two apart and compete for the same few cache sets."""

PROCESS_BYTES = 400 * 2**20
"""What Python, the libraries, the compiler of a driver and arrays of strips take: 351 MiB at most were measured."""

MAX_TASK_PIXELS = 2**20
"""Most pixels of a task of a distributed wave."""

ALLOCATION_BYTES = 32
"""Bytes a pixel of the temporary arrays with which the built-in strategies compute an allocation map in float32."""

LAYER_SCRATCH_BYTES = 48
"""Bytes a pixel of the temporary arrays with which a layer is made: float64 sums, means and weights."""


def path_buffers(features: Mapping[str, bool], pool_size: int, path_block_size: int) -> dict[str, int]:
    """Buffers of the paths in flight: name -> bytes."""
    planes = {name: size * (pool_size + PLANE_PADDING) for name, size in path_bytes(features).items()}
    return {**planes, "path_block_alive": 4 * -(-pool_size // path_block_size), "total_alive": 8}


def sample_buffers(pool_size: int, pixels: int) -> dict[str, int]:
    """Buffers of the samples of a slice: name -> bytes. A slice has at most as many pixels as samples."""
    samples = SAMPLES_PER_PATH * pool_size
    per_sample = {"samples": 12, "sample_pixel": 4, "sample_index": 4}
    return {**{name: size * samples for name, size in per_sample.items()}, "pixel_offset": 4 * min(pixels, samples)}


@dataclass(frozen=True)
class MemoryPlan:
    """What a render takes with one size of the pool.

    Parameters
    ----------
    scene, bvh : int
        Bytes of the scene's tables on the device, and of its BVH.
    features, needs
        Of the kernels and of the strategy.
    shape : (height, width)
        Of the image.
    pool_size, path_block_size : int
        Paths in flight, and how many of them the compaction moves at a time.
    compute_units : int
        Of the device.
    is_adaptive : bool
        Whether the strategy plans adaptive waves.
    has_image : bool
        Whether the statistics of the image are there, or only those of a task with at most `MAX_TASK_PIXELS` pixels.
    """

    scene: int
    bvh: int
    features: Mapping[str, bool]
    needs: Needs
    shape: tuple[int, int]
    pool_size: int
    path_block_size: int
    compute_units: int
    is_adaptive: bool = True
    has_image: bool = True

    @property
    def pixels(self) -> int:
        return self.shape[0] * self.shape[1]

    @cached_property
    def buffers(self) -> dict[str, int]:
        """Name -> bytes of the buffers whose sizes depend on image and pool."""
        state_pixels = self.pixels if self.has_image else min(self.pixels, MAX_TASK_PIXELS)
        buffers = {
            **path_buffers(self.features, self.pool_size, self.path_block_size),
            **sample_buffers(self.pool_size, self.pixels),
            **{name: 4 * planes * state_pixels for name, planes in state_planes(self.needs).items()},
        }
        if not self.has_image:
            return buffers
        return {
            **buffers,
            **scratch_bytes(self.shape, self.needs),
            "summary": summary_bytes(self.needs),
            "error_scratch": error_scratch_bytes(self.shape, self.compute_units),
        }

    @property
    def paths(self) -> int:
        return sum(path_buffers(self.features, self.pool_size, self.path_block_size).values())

    @property
    def samples(self) -> int:
        return sum(sample_buffers(self.pool_size, self.pixels).values())

    @property
    def statistics(self) -> int:
        return sum(self.buffers.values()) - self.paths - self.samples

    @property
    def device(self) -> int:
        """Bytes of all buffers."""
        return self.scene + self.bvh + sum(self.buffers.values())

    @cached_property
    def host(self) -> int:
        """Bytes of the largest arrays of the image that the host has at a time, estimated."""
        if not self.has_image:
            return 0
        return max(host for host, _ in self._phases().values())

    @cached_property
    def shared(self) -> int:
        """Bytes of the process at a time, where buffers and host arrays are in the same memory.

        Large images give the scratch buffers back where they are not needed, so it may be less than the sum. The counts
        of rejected samples take none: hardly any are written.
        """
        if not self.has_image:
            return PROCESS_BYTES + self.device
        scratch = sum(scratch_bytes(self.shape, self.needs).values())
        image = max(host + scratch * has for host, has in self._phases().values())
        return PROCESS_BYTES + self.device - self.buffers["rejected"] - scratch + image

    def _phases(self) -> dict[str, tuple[int, bool]]:
        """Phase of a wave -> bytes of host arrays, and whether the scratch buffers are there."""
        needs, is_large = self.needs, self.pixels >= LARGE_IMAGE_PIXELS
        read = 4 + 8 + 4 + 4 * needs.nets + 8 * (needs.neighbours is not None)  # count, mean, variance, ...
        read += 8 * needs.median + 8 * (needs.power is not None) + 12 * needs.half + 20 * needs.uniform
        kept = 16 * self.is_adaptive + 24 * needs.uniform  # sums over the uniform waves
        image, allocation, error = read + 12, 4, 4
        layers = 4 * (mean_components(needs.layers) + first_values(needs.layers))
        layers += LAYER_SCRATCH_BYTES * bool(layers)
        phases = {
            "trace": (allocation + kept + (0 if is_large else image), not is_large),
            "statistics": (read + kept + (0 if is_large else image), True),
            "output": (image + error + layers + kept, not is_large),
        }
        if self.is_adaptive:
            phases["allocate"] = (read + kept + ALLOCATION_BYTES, not is_large)
        return {name: (size * self.pixels, has_scratch) for name, (size, has_scratch) in phases.items()}

    def rows(self) -> list[tuple[str, int]]:
        """What takes memory, and bytes."""
        return [
            ("scene", self.scene),
            ("BVH", self.bvh),
            ("paths", self.paths),
            ("samples", self.samples),
            ("statistics", self.statistics),
            ("host arrays", self.host),
            ("process", PROCESS_BYTES),
        ]


def fit_pool(
    plan: Callable[[int], MemoryPlan], pool_size: int, device: Device, memory: int | None = None
) -> MemoryPlan:
    """The plan with the largest pool, `pool_size` halved again and again, that fits the device and `memory` bytes.

    Raises DeviceError, with the numbers, if none fits.
    """
    while excess := _excess(fitting := plan(pool_size), device, memory):
        if pool_size <= MIN_POOL_SIZE:
            raise DeviceError(excess)
        pool_size = max(pool_size // 2, MIN_POOL_SIZE)
    return fitting


def check_memory(plan: MemoryPlan, device: Device, memory: int | None = None) -> None:
    """Raise DeviceError, with the numbers, if the plan does not fit the device and `memory` bytes."""
    if excess := _excess(plan, device, memory):
        raise DeviceError(excess)


def _excess(plan: MemoryPlan, device: Device, memory: int | None) -> str | None:
    """What is too large, as a message; None if all fits."""
    total = plan.shared if device.shares_memory else plan.device
    limits = [(f"{device.name} has {format_bytes(device.global_memory)}", device.global_memory)]
    if memory is not None:
        limits.append((f"the limit (--memory) is {format_bytes(memory)}", memory))
    height, width = plan.shape
    advice = "render a smaller image"
    for text, limit in limits:
        if total > limit:
            parts = ", ".join(f"{name} {format_bytes(size)}" for name, size in plan.rows() if size >= 0.01 * total)
            return (
                f"{width}x{height} pixels and a pool of {plan.pool_size:,} paths need {format_bytes(total)} of memory "
                f"({parts}), but {text}; {advice}, choose another strategy or sampler, or raise the limit"
            )
    name, size = max(plan.buffers.items(), key=lambda item: item[1])
    if size > device.max_buffer_size:
        return (
            f"the buffer '{name}' of {width}x{height} pixels needs {format_bytes(size)}, but {device.name} gives at "
            f"most {format_bytes(device.max_buffer_size)} for one buffer; {advice}, or choose another device with "
            "--device"
        )
    return None


def format_bytes(size: int) -> str:
    """Bytes as text: '3.92 GiB', '47.6 MiB', '0.5 KiB'."""
    for unit, bits in (("GiB", 30), ("MiB", 20)):
        if size >= 2**bits:
            return f"{size / 2**bits:.3g} {unit}"
    return f"{size / 2**10:.3g} KiB"
