"""`isonoise devices`: lists the OpenCL devices and the default one."""

import argparse

from isonoise.commands import EXIT_DONE
from isonoise.device.drivers import driver_advice, list_devices
from isonoise.device.pool_size import default_pool_size, tuned_pool_size
from isonoise.errors import DeviceError


def run(options: argparse.Namespace) -> int:
    """Run the command; return the exit code. Raises DeviceError, with advice, if there is no device."""
    devices = list_devices()
    if not devices:
        raise DeviceError(f"no OpenCL device found; {driver_advice()}")
    for number, device in enumerate(devices):
        print(f"{number}: {device.name.strip()}{' (default)' if number == 0 else ''}")
        print(f"   platform {device.platform.name.strip()}, {device.version.strip()}, driver {device.driver_version}")
        memory, largest_buffer = (
            f"{size / 2**30:.1f} GiB" for size in (device.global_mem_size, device.max_mem_alloc_size)
        )
        print(f"   {device.max_compute_units} compute units, {memory} memory, {largest_buffer} in one buffer")
        source = "found by `isonoise bench --tune`" if tuned_pool_size(device) else "the default"
        print(f"   {default_pool_size(device):,} paths in flight, {source}")
    return EXIT_DONE
