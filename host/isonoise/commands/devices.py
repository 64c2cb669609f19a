"""`isonoise devices`: lists the OpenCL devices, the default one and why, and what would be faster."""

import argparse
import os

from isonoise.commands import EXIT_DONE
from isonoise.device.driver_advice import default_reason, faster_driver, known_fault, unused_instructions
from isonoise.device.drivers import compiler_target, driver_advice, list_devices
from isonoise.device.form import FORM_VARIABLE, choose_form, tuned_form
from isonoise.device.pool_size import default_pool_size, tuned_pool_size
from isonoise.errors import DeviceError


def run(options: argparse.Namespace) -> int:
    """Run the command; return the exit code. Raises DeviceError, with advice, if there is no device."""
    devices = list_devices()
    if not devices:
        raise DeviceError(f"no OpenCL device found; {driver_advice()}")
    for number, device in enumerate(devices):
        print(f"{number}: {device.name.strip()}{' (default)' if number == 0 else ''}")
        _print_driver(device)
        memory, largest_buffer = (
            f"{size / 2**30:.1f} GiB" for size in (device.global_mem_size, device.max_mem_alloc_size)
        )
        print(f"   {device.max_compute_units} compute units, {memory} memory, {largest_buffer} in one buffer")
        print(f"   {default_pool_size(device):,} paths in flight, {_source(tuned_pool_size(device))}")
        print(f"   device form {choose_form(device).name}, {_form_source(device)}")
    print(f"default: device 0, {default_reason(devices)}")
    if advice := faster_driver(devices):
        print(f"faster: {advice}")
    return EXIT_DONE


def _source(tuned: object) -> str:
    return "the default" if tuned is None else "found by `isonoise bench --tune`"


def _form_source(device) -> str:
    return f"from {FORM_VARIABLE}" if os.environ.get(FORM_VARIABLE) else _source(tuned_form(device))


def _print_driver(device) -> None:
    names = device.platform.name, device.version, f"driver {device.driver_version}"
    print(f"   platform {', '.join(name.strip() for name in names)}")
    if target := compiler_target(device):
        unused = unused_instructions(device)
        print(f"   compiles for the CPU {target}{f', which lacks the {unused} of this one' if unused else ''}")
    if fault := known_fault(device):
        print(f"   warning: {fault}")
