"""`isonoise devices`: which OpenCL devices there are, and which one a render takes by default."""

import argparse

from isonoise.commands import EXIT_DONE
from isonoise.device.opencl import driver_advice, list_devices
from isonoise.device.pool_size import default_pool_size, tuned_pool_size
from isonoise.errors import DeviceError


def run(options: argparse.Namespace) -> int:
    """List the devices with the numbers that --device takes. Raises DeviceError, with what to install, without any."""
    devices = list_devices()
    if not devices:
        raise DeviceError(f"no OpenCL device found; {driver_advice()}")
    for number, device in enumerate(devices):
        print(f"{number}: {device.name.strip()}{' (default)' if number == 0 else ''}")
        print(f"   platform {device.platform.name.strip()}, {device.version.strip()}, driver {device.driver_version}")
        memory, largest = (size / 2**30 for size in (device.global_mem_size, device.max_mem_alloc_size))
        print(f"   {device.max_compute_units} compute units, {memory:.1f} GiB memory, {largest:.1f} GiB in one buffer")
        how = "found by `isonoise bench --tune`" if tuned_pool_size(device) else "as usual"
        print(f"   {default_pool_size(device):,} paths in flight, {how}")
    return EXIT_DONE
