"""OpenCL drivers and their devices: lists devices in the order of preference, reads version strings.

Used by `device.opencl`, `device.selection`, the benchmarks and `isonoise devices`.
"""

import functools
import os
import platform
import re
from enum import IntEnum

from isonoise.device.failures import note_driver_use, refuse_after_fork
from isonoise.device.pocl_cache import pocl_environment
from isonoise.errors import DeviceError
from isonoise.signals import deferred, raise_if_received

_POCL_TARGET = re.compile(r"HSTR: \w+-(?:\w+-\w+-linux-\w+|\w+-apple-[\w.]+|\w+-\w+-windows-\w+)-(?P<cpu>.+)")
"""In CL_DEVICE_VERSION: kind of device, target triple, CPU."""
_POCL_VERSION = re.compile(r"(?P<major>\d+)\.(?P<minor>\d+)(?P<prerelease>[-.]?(?:rc|pre|beta|dev))?")
_FAST_POCL = (3, 1, 1)
"""First version of PoCL that is preferred on all CPUs; see `pocl_version`."""


class Rank(IntEnum):
    """Kinds of devices, the most preferred first.

    Time on the CPU per sample (host/docs/devices.md#choice-of-a-device): on a Zen 4, PoCL 3.1 and 7.1 were faster than
    Intel's driver, and that was faster than PoCL 3.0. On an Intel Xeon, PoCL 3.0 was as fast as 3.1, and both were
    faster than Intel's driver.
    """

    GPU = 0
    NEW_POCL = 1
    OLD_POCL_ON_INTEL = 2
    OTHER = 3
    OLD_POCL = 4
    MESA = 5


@functools.cache
def load_pyopencl():
    """The module pyopencl."""
    # pyopencl's own cache would duplicate the drivers' caches and fail in a read-only home
    os.environ.setdefault("PYOPENCL_NO_CACHE", "1")
    try:
        with deferred():  # an exception of a signal would abort the process, or be lost, in compiled code
            import pyopencl
    except ImportError as error:
        raise DeviceError(f"pyopencl cannot be loaded ({error}); install it with: pip install pyopencl") from error
    raise_if_received()
    return pyopencl


def driver_advice() -> str:
    """Which OpenCL driver to install on this system."""
    if platform.system() == "Linux" and platform.machine() in ("x86_64", "AMD64"):
        return "install PoCL for the CPU with: pip install pocl-binary-distribution; or the driver of your GPU's vendor"
    if platform.system() == "Linux":
        return "install PoCL from your distribution (package pocl-opencl-icd), or the driver of your GPU's vendor"
    if platform.system() == "Darwin":
        return "macOS includes OpenCL; reinstall pyopencl's wheel: pip install --force-reinstall pyopencl"
    return "install the driver of your GPU's vendor, or Intel's OpenCL runtime for the CPU"


def list_devices() -> list:
    """All OpenCL devices in the order of `preference`; the first is the default. Empty if there is none."""
    cl = load_pyopencl()
    refuse_after_fork()
    note_driver_use()
    try:
        with pocl_environment():
            devices = [device for each in cl.get_platforms() for device in each.get_devices()]
    except cl.Error:
        return []
    return sorted(devices, key=preference)


def preference(device) -> tuple[int, ...]:
    """A sort key, smallest for the most preferred device: its rank, and for PoCL on a CPU the newest version first."""
    rank, version = rank_of(device), pocl_version(device)
    return (rank, 0, 0, 0) if version is None or rank == Rank.GPU else (rank, *(-part for part in version))


def rank_of(device) -> Rank:
    """The kind of a device and its driver."""
    if is_mesa(device):
        return Rank.MESA
    if device.type & load_pyopencl().device_type.GPU:
        return Rank.GPU
    version = pocl_version(device)
    if version is None:
        return Rank.OTHER
    if version >= _FAST_POCL:
        return Rank.NEW_POCL
    return Rank.OLD_POCL_ON_INTEL if "intel" in device.vendor.lower() else Rank.OLD_POCL


def is_pocl(device) -> bool:
    return "portable computing language" in device.platform.name.lower()


def is_mesa(device) -> bool:
    """Whether the driver is Mesa's: rusticl or Clover, on a GPU or, by llvmpipe, on the CPU."""
    driver = device.platform
    return driver.name.strip().lower() in ("rusticl", "clover") or "mesa" in driver.vendor.lower()


def pocl_version(device) -> tuple[int, int, int] | None:
    """Major and minor version, and 0 for a prerelease such as 3.0-rc2, else 1. None for other drivers than PoCL."""
    match = _POCL_VERSION.match(device.driver_version.strip()) if is_pocl(device) else None
    return match and (int(match["major"]), int(match["minor"]), int(match["prerelease"] is None))


def parent_of(device):
    """The device of `list_devices` that a sub-device is a part of; the device itself, if it is whole."""
    try:
        return device.parent_device or device
    except load_pyopencl().Error:  # OpenCL 1.1
        return device


def is_cpu(device) -> bool:
    return bool(device.type & load_pyopencl().device_type.CPU)


ROUNDING_OPTION = "-cl-fp32-correctly-rounded-divide-sqrt"
"""Else a GPU's division may be off by 2.5 units in the last place, and its square root by 3."""
GPU_OPTIONS = ("-DNO_BUILTINS=1",)
"""Compiler builtins (kernels/util/vec.h) replace slow calls of CPU drivers; on GPUs OpenCL's functions are native."""


def build_options(device) -> tuple[str, ...]:
    """Options of all programs on a device, beside those of a program. CPUs round correctly without one."""
    if is_cpu(device):
        return ()
    rounds_correctly = load_pyopencl().device_fp_config.CORRECTLY_ROUNDED_DIVIDE_SQRT & device.single_fp_config
    return (*GPU_OPTIONS, ROUNDING_OPTION) if rounds_correctly else GPU_OPTIONS


def driver_identity(device) -> tuple[str, ...]:
    """Names and versions that identify a device and its driver."""
    driver = device.platform
    return driver.name, driver.version, device.name, device.version, device.driver_version


def driver_fields(device) -> dict[str, str | None]:
    """Names and versions of a device and its driver, and its compiler's target, as in all JSON reports."""
    return {
        "name": device.name.strip(),
        "platform": device.platform.name.strip(),
        "opencl_version": device.version.strip(),
        "driver_version": device.driver_version.strip(),
        "compiler_target": compiler_target(device),
    }


def describe_driver(device) -> str:
    """The driver's version, and its compiler's target if that is known."""
    target = compiler_target(device)
    return f"driver {device.driver_version.strip()}" + (f", code for {target}" if target else "")


def compiler_target(device) -> str | None:
    """The CPU that PoCL's compiler emits code for, in LLVM's words such as `znver4`; None if unknown."""
    match = _POCL_TARGET.search(device.version)
    return match["cpu"].strip() if match else None
