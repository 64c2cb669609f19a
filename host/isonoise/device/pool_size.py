"""How many paths are in flight on a device: a default, or the size that `isonoise bench --tune` found to be faster.

A tuned size is stored in the program cache, per device and driver.
"""

import json

from isonoise.device import program_cache
from isonoise.device.drivers import driver_identity, is_cpu

MAX_UNTUNED_POOL_SIZE = 2**20
MIN_POOL_SIZE, MAX_POOL_SIZE = 2**10, 2**26
"""Accepted range of a stored size."""


def default_pool_size(device) -> int:
    """Paths in flight on an OpenCL device, unless the caller chooses: the tuned size if there is one."""
    return tuned_pool_size(device) or untuned_pool_size(device)


def untuned_pool_size(device) -> int:
    """Paths in flight on a device that was never tuned.

    Large enough that launches, some 0.2 ms each on a CPU, are few, and that no core waits long for the last one of a
    launch: on two cores 1.08 times as fast as a quarter of it, 1.15 to 1.5 times beside other programs. A GPU has tens
    of thousands of lanes to fill.
    """
    if not is_cpu(device):
        return MAX_UNTUNED_POOL_SIZE
    return min(2**18 << (device.max_compute_units.bit_length() - 1), MAX_UNTUNED_POOL_SIZE)


def tuned_pool_size(device) -> int | None:
    """The stored size; None if there is none or it is invalid."""
    content = program_cache.load(_key(device))
    try:
        size = json.loads(content or b"{}")["pool_size"]
    except (ValueError, LookupError, TypeError):
        return None
    return size if isinstance(size, int) and MIN_POOL_SIZE <= size <= MAX_POOL_SIZE else None


def store_tuned_pool_size(device, size: int) -> bool:
    """Store the device's pool size; return whether that succeeded."""
    if size == untuned_pool_size(device):
        program_cache.remove(_key(device))
    else:
        program_cache.store(_key(device), json.dumps({"pool_size": size}).encode())
    return default_pool_size(device) == size


def _key(device) -> str:
    return program_cache.program_key("pool size", (), driver_identity(device))
