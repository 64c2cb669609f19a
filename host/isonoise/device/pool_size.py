"""How many paths are in flight on a device: a default, or the size that `isonoise bench --tune` found to be faster."""

from isonoise.device.drivers import is_cpu, parent_of
from isonoise.device.tuned import load_tuned, store_tuned

_NAME = "pool_size"

SAMPLES_PER_PATH = 16
"""Samples of a slice for each path of the pool. When a path ends, that of a further sample takes its place; the pool
runs empty only at the end of a slice."""
MIN_POOL_SIZE, MAX_POOL_SIZE = 2**10, 2**25
"""Accepted range of a stored size, of which the upper end holds for every pool. Kernels index the three floats of a
sample with signed 32-bit numbers, which compilers gather twice as fast: 3 * 16 * 2^25 is below 2^31."""
MAX_UNTUNED_CPU_POOL_SIZE = 2**20
MIN_UNTUNED_GPU_POOL_SIZE, MAX_UNTUNED_GPU_POOL_SIZE = 2**18, 2**24
BYTES_PER_PATH = 504
"""Most memory for each path of the pool, with every feature: 184 bytes of path state and of a bounce
(`kernel_table.path_bytes`), and 16 samples of 20 bytes."""
MEMORY_SHARE = 1 / 8
"""Most of a GPU's memory that an untuned pool takes: the display and other programs use it too."""


def default_pool_size(device) -> int:
    """Paths in flight on an OpenCL device, unless the caller chooses: the tuned size if there is one."""
    return tuned_pool_size(device) or untuned_pool_size(device)


def untuned_pool_size(device) -> int:
    """Paths in flight on a device that was never tuned.

    On a CPU large enough that launches, some 0.2 ms each, are few, and that no core waits long for the last one of a
    launch: on two cores 1.08 times as fast as a quarter of it, 1.15 to 1.5 times beside other programs.

    On a GPU the largest power of two that its memory allows, up to 16 Mi. This is an estimate, which no measurement on
    a GPU confirms yet. A bounce costs eight launches and a wait, about 0.1 ms if a launch takes 10 us. A GPU that
    traces 10^9 rays per second traces 1 Mi paths for a bounce in 1 ms, so a tenth of the time is lost; of 8 Mi paths,
    an eightieth. The last bounces of a slice, with few paths, lose less as well.
    """
    if is_cpu(device):
        return min(2**18 << (device.max_compute_units.bit_length() - 1), MAX_UNTUNED_CPU_POOL_SIZE)
    samples = device.max_mem_alloc_size // (12 * SAMPLES_PER_PATH)  # one buffer has the colours of all samples
    fitting = int(min(MEMORY_SHARE * device.global_mem_size // BYTES_PER_PATH, samples))
    largest_power = 1 << max(fitting.bit_length() - 1, 0)
    return min(max(largest_power, MIN_UNTUNED_GPU_POOL_SIZE), MAX_UNTUNED_GPU_POOL_SIZE)


def tuned_pool_size(device) -> int | None:
    """The stored size, of a part of a device its share of it; None if there is none or it is invalid."""
    size = load_tuned(device, _NAME)
    is_number = isinstance(size, int) and not isinstance(size, bool)
    if not is_number or not MIN_POOL_SIZE <= size <= MAX_POOL_SIZE:
        return None
    return max(size * device.max_compute_units // parent_of(device).max_compute_units, MIN_POOL_SIZE)


def store_tuned_pool_size(device, size: int) -> bool:
    """Store the device's pool size; return whether that succeeded."""
    store_tuned(device, _NAME, None if size == untuned_pool_size(device) else size)
    return default_pool_size(device) == size
