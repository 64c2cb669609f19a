"""`isonoise devices`: lists the OpenCL devices, the default one and why, and what would be faster."""

import argparse
import os

from isonoise.commands import EXIT_DONE
from isonoise.device.driver_advice import default_reason, faster_driver, known_fault, unused_instructions
from isonoise.device.drivers import compiler_target, list_devices
from isonoise.device.form import FORM_VARIABLE, choose_form, tuned_form
from isonoise.device.pool_size import default_pool_size, tuned_pool_size
from isonoise.device.selection import PYOPENCL_VARIABLE, max_parts, pyopencl_number, select_device


def run(options: argparse.Namespace) -> int:
    """Run the command; return the exit code. Raises DeviceError, with advice, if there is no device."""
    default = select_device().device
    devices = list_devices()
    for number, device in enumerate(devices):
        print(f"{number}: {device.name.strip()}{' (default)' if device == default else ''}")
        _print_driver(device)
        memory, largest_buffer = (
            f"{size / 2**30:.1f} GiB" for size in (device.global_mem_size, device.max_mem_alloc_size)
        )
        print(f"   {device.max_compute_units} compute units, {memory} memory, {largest_buffer} in one buffer")
        if (parts := max_parts(device)) > 1:
            print(f"   --device {number}/2 renders on its halves; it can be split into up to {parts} devices")
        print(f"   {default_pool_size(device):,} paths in flight, {_source(tuned_pool_size(device))}")
        print(f"   device form {choose_form(device).name}, {_form_source(device)}")
    chosen = f"selected by {PYOPENCL_VARIABLE}" if os.environ.get(PYOPENCL_VARIABLE, "").strip() else None
    print(f"default: device {devices.index(default)}, {chosen or default_reason(devices)}")
    if advice := faster_driver(devices):
        print(f"faster: {advice}")
    return EXIT_DONE


def _source(tuned: object) -> str:
    return "the default" if tuned is None else "found by `isonoise bench --tune`"


def _form_source(device) -> str:
    return f"from {FORM_VARIABLE}" if os.environ.get(FORM_VARIABLE) else _source(tuned_form(device))


def _print_driver(device) -> None:
    names = device.platform.name, device.version, f"driver {device.driver_version}"
    print(f"   platform {', '.join(name.strip() for name in names)}; {PYOPENCL_VARIABLE}={pyopencl_number(device)}")
    if target := compiler_target(device):
        unused = unused_instructions(device)
        print(f"   compiles for the CPU {target}{f', which lacks the {unused} of this one' if unused else ''}")
    if fault := known_fault(device):
        print(f"   warning: {fault}")
