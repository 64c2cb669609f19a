"""`isonoise devices`: lists the OpenCL devices, the default one and why, and what would be faster."""

import argparse
import os

import pyopencl as cl

from isonoise.command_output import print_json
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
    listed = [_facts(number, device, device == default) for number, device in enumerate(devices)]
    is_chosen = os.environ.get(PYOPENCL_VARIABLE, "").strip()
    reason = f"selected by {PYOPENCL_VARIABLE}" if is_chosen else default_reason(devices)
    advice = faster_driver(devices) or None
    if options.json:
        print_json({"devices": listed, "default": devices.index(default), "reason": reason, "faster": advice})
        return EXIT_DONE
    for facts in listed:
        _print_device(facts)
    print(f"default: device {devices.index(default)}, {reason}")
    if advice:
        print(f"faster: {advice}")
    return EXIT_DONE


def _facts(number: int, device: cl.Device, is_default: bool) -> dict[str, object]:
    """The fields of a device of --json."""
    return {
        "number": number,
        "name": device.name.strip(),
        "is_default": is_default,
        "platform": device.platform.name.strip(),
        "version": device.version.strip(),
        "driver_version": device.driver_version.strip(),
        "pyopencl_ctx": pyopencl_number(device),
        "compiler_target": compiler_target(device) or None,
        "unused_instructions": unused_instructions(device) or None,
        "known_fault": known_fault(device) or None,
        "compute_units": device.max_compute_units,
        "memory_bytes": device.global_mem_size,
        "largest_buffer_bytes": device.max_mem_alloc_size,
        "max_parts": max_parts(device),
        "pool_size": default_pool_size(device),
        "pool_size_source": _source(tuned_pool_size(device)),
        "form": choose_form(device).name,
        "form_source": f"from {FORM_VARIABLE}" if os.environ.get(FORM_VARIABLE) else _source(tuned_form(device)),
    }


def _print_device(facts: dict) -> None:
    print(f"{facts['number']}: {facts['name']}{' (default)' if facts['is_default'] else ''}")
    driver = f"{facts['platform']}, {facts['version']}, driver {facts['driver_version']}"
    print(f"   platform {driver}; {PYOPENCL_VARIABLE}={facts['pyopencl_ctx']}")
    if facts["compiler_target"]:
        unused = facts["unused_instructions"]
        lacks = f", which lacks the {unused} of this one" if unused else ""
        print(f"   compiles for the CPU {facts['compiler_target']}{lacks}")
    if facts["known_fault"]:
        print(f"   warning: {facts['known_fault']}")
    memory, largest_buffer = (f"{facts[name] / 2**30:.1f} GiB" for name in ("memory_bytes", "largest_buffer_bytes"))
    print(f"   {facts['compute_units']} compute units, {memory} memory, {largest_buffer} in one buffer")
    if (parts := facts["max_parts"]) > 1:
        print(f"   --device {facts['number']}/2 renders on its halves; it can be split into up to {parts} devices")
    print(f"   {facts['pool_size']:,} paths in flight, {facts['pool_size_source']}")
    print(f"   device form {facts['form']}, {facts['form_source']}")


def _source(tuned: object) -> str:
    return "the default" if tuned is None else "found by `isonoise bench --tune`"
