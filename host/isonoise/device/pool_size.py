"""How many paths are in flight on a device: the usual number, or the one that a measurement found to be faster.

What was found is kept beside the compiled programs, for one device with its driver; `isonoise bench --tune` measures.
"""

import json

from isonoise.device import program_cache
from isonoise.device.opencl import driver_identity, is_cpu

MOST_USUAL = 2**20
LEAST, MOST = 2**10, 2**26
"""Bounds for what is read from a file."""


def untuned_pool_size(device) -> int:
    """Paths in flight where nothing else was found. `device`: of OpenCL, here and below.

    Enough that launches, which take some 0.2 ms each on a CPU, are few, and that no core waits long for the last one
    of a launch: on two cores 1.08 times as fast as a quarter of it, 1.15 to 1.5 times beside other programs. A GPU
    has tens of thousands of lanes to fill.
    """
    if not is_cpu(device):
        return MOST_USUAL
    return min(2**18 << (device.max_compute_units.bit_length() - 1), MOST_USUAL)


def tuned_pool_size(device) -> int | None:
    """What `store_tuned_pool_size` kept for the device; None if there is nothing, or nothing sound."""
    content = program_cache.load(_key(device))
    try:
        size = json.loads(content or b"{}")["pool_size"]
    except (ValueError, LookupError, TypeError):
        return None
    return size if isinstance(size, int) and LEAST <= size <= MOST else None


def default_pool_size(device) -> int:
    """Paths in flight on the device, unless it is said how many."""
    return tuned_pool_size(device) or untuned_pool_size(device)


def store_tuned_pool_size(device, size: int) -> bool:
    """From now on this is the device's pool size. Returns whether it could be kept."""
    if size == untuned_pool_size(device):
        program_cache.forget(_key(device))
    else:
        program_cache.store(_key(device), json.dumps({"pool_size": size}).encode())
    return default_pool_size(device) == size


def _key(device) -> str:
    return program_cache.program_key("pool size", (), driver_identity(device))
