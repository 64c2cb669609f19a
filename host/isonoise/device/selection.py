"""Selects an OpenCL device by number, name or type, or as the environment variable PYOPENCL_CTX says.

Used by `device.opencl` and `isonoise devices`.
"""

import os
import re

from isonoise.device.drivers import driver_advice, list_devices, load_pyopencl
from isonoise.device.pocl_cache import pocl_folder
from isonoise.errors import DeviceError

PYOPENCL_VARIABLE = "PYOPENCL_CTX"
"""Environment variable by which PyOpenCL selects a device; used where the caller selects none."""

_TYPES = {"gpu": "GPU", "cpu": "CPU", "accelerator": "ACCELERATOR"}
"""Word for a type of devices -> its name in `pyopencl.device_type`."""


def select_device(choice: str | int | None = None):
    """The OpenCL device that `choice` selects; None: that of PYOPENCL_VARIABLE if set, else the default.

    Parameters
    ----------
    choice : number of `list_devices`; type `gpu`, `cpu` or `accelerator`; a part of the name of device or platform; or
        PLATFORM:DEVICE in PyOpenCL's order, each a number or a part of a name. Of several devices the first of
        `list_devices` is taken. A single number in PYOPENCL_VARIABLE is that of a platform, as in PyOpenCL.

    Raises
    ------
    DeviceError
        With the list of devices, if there is none that matches.
    """
    devices = list_devices()
    if not devices:
        folder = pocl_folder()
        raise DeviceError(f"no OpenCL device found; {(folder and folder.problem) or driver_advice()}")
    variable = os.environ.get(PYOPENCL_VARIABLE, "").strip()
    if choice is not None:
        text = str(choice).strip()
        found = _find(text, devices)
    elif variable:
        text = f"{PYOPENCL_VARIABLE}={variable}"
        found = _find(f"{variable}:" if _is_number(variable) else variable, devices)
    else:
        return devices[0]
    if found is None:
        names = "\n".join(
            f"  {n}: {each.name.strip()} ({each.platform.name.strip()})" for n, each in enumerate(devices)
        )
        raise DeviceError(
            f"no OpenCL device matches '{text}'; choose a number, a type or a part of a name from:\n{names}"
        )
    return found


def pyopencl_number(device) -> str:
    """PLATFORM:DEVICE, the numbers by which PyOpenCL selects the device."""
    platforms = load_pyopencl().get_platforms()
    return f"{platforms.index(device.platform)}:{device.platform.get_devices().index(device)}"


def _find(text: str, devices: list):
    """The first of the devices that the text selects; None if there is none."""
    if _is_number(text):
        return devices[int(text)] if int(text) < len(devices) else None
    kind = _TYPES.get(text.lower())
    matches = [
        *(device for device in devices if kind and device.type & getattr(load_pyopencl().device_type, kind)),
        *(_of_platform(*text.split(":"), devices) if text.count(":") == 1 else ()),
        *(device for device in devices if text and text.lower() in f"{device.platform.name} {device.name}".lower()),
    ]
    return matches[0] if matches else None


def _of_platform(platform: str, number: str, devices: list) -> list:
    """The devices that PLATFORM:DEVICE selects. An empty platform is the first one, an empty device any of it."""
    found = _matching(platform or "0", load_pyopencl().get_platforms())
    wanted = [device for each in found for device in _matching(number, each.get_devices())]
    return [device for device in devices if device in wanted]


def _matching(choice: str, named: list) -> list:
    """The platform or device with this number, else those with this part of a name."""
    if _is_number(choice) and int(choice) < len(named):
        return [named[int(choice)]]
    return [each for each in named if choice.lower() in each.name.lower()]


def _is_number(text: str) -> bool:
    return re.fullmatch("[0-9]{1,9}", text) is not None
