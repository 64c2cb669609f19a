"""Selects OpenCL devices by number, name or type, or as the environment variable PYOPENCL_CTX says, and splits them.

Used by `device.opencl`, `isonoise devices`, and renders on several devices.
"""

import functools
import os
import re
from typing import NamedTuple

from isonoise.device.drivers import driver_advice, is_cpu, is_mesa, list_devices, load_pyopencl
from isonoise.device.pocl_cache import pocl_folder
from isonoise.errors import DeviceError

PYOPENCL_VARIABLE = "PYOPENCL_CTX"
"""Environment variable by which PyOpenCL selects a device; used where the caller selects none."""

_TYPES = {"gpu": "GPU", "cpu": "CPU", "accelerator": "ACCELERATOR"}
"""Word for a type of devices -> its name in `pyopencl.device_type`."""


_ALL = "all"
_PART_OF = re.compile(r"(?P<device>.+)/(?P<parts>[0-9]{1,9})")


class SelectedDevice(NamedTuple):
    """A device of `list_devices`, or a part of one."""

    device: object
    """PyOpenCL's; of a part, its sub-device."""
    number: int
    """In `list_devices`; of a part, that of the device that was split."""
    part: int = 0
    parts: int = 1

    @property
    def label(self) -> str:
        """Short and unique: its number, and the part."""
        return f"{self.number}/{self.parts}:{self.part + 1}" if self.parts > 1 else str(self.number)

    @property
    def name(self) -> str:
        """Name of the device and of its platform."""
        return self._name(f", part {self.part + 1} of {self.parts}" if self.parts > 1 else "")

    @property
    def kind(self) -> str:
        """The name without the number of the part: the same for devices that are equally fast."""
        return self._name(f", one of {self.parts} parts" if self.parts > 1 else "")

    @property
    def whole_name(self) -> str:
        """The name without the part: that of the device that was split."""
        return self._name("")

    def _name(self, part: str) -> str:
        return f"{self.device.name.strip()}{part} ({self.device.platform.name.strip()})"


def select_device(choice: str | int | None = None) -> SelectedDevice:
    """The OpenCL device that `choice` selects; None: that of PYOPENCL_VARIABLE if set, else the default.

    Parameters
    ----------
    choice : number of `list_devices`; type `gpu`, `cpu` or `accelerator`; a part of the name of device or platform; or
        PLATFORM:DEVICE in PyOpenCL's order, each a number or a part of a name. Of several devices the first of
        `list_devices` is taken. A single number in PYOPENCL_VARIABLE is that of a platform, as in PyOpenCL.

    Raises
    ------
    DeviceError
        With the list of devices, if there is none that matches, or if `choice` selects several.
    """
    selected = select_devices(choice)
    if len(selected) > 1:
        raise DeviceError(
            f"'{str(choice).strip()}' selects {len(selected)} devices, but only `isonoise render` uses more than one; "
            f"choose one of:\n{_listed(list_devices())}"
        )
    return selected[0]


def select_devices(choice: str | int | SelectedDevice | None = None) -> list[SelectedDevice]:
    """The OpenCL devices that `choice` selects, at least one.

    Parameters
    ----------
    choice : as for `select_device`; a SelectedDevice: itself; DEVICE/N: the device as N devices, each with an equal
        share of its compute units; `all`: every device, the CPU with its preferred driver alone; or several of these,
        separated by commas.

    Raises
    ------
    DeviceError
        If nothing matches, a device is selected twice, or cannot be split.
    """
    if isinstance(choice, SelectedDevice):
        return [choice]
    devices = list_devices()
    if not devices:
        folder = pocl_folder()
        raise DeviceError(f"no OpenCL device found; {(folder and folder.problem) or driver_advice()}")
    if choice is None:
        default = _default_device(devices)
        return [SelectedDevice(default, devices.index(default))]
    text = str(choice).strip()
    found = _select(text, devices)
    if found is None:  # a comma may be part of a name
        items = [item.strip() for item in text.split(",")]
        found = [device for item in items for device in _select(item, devices) or _refuse(item, devices)]
    wholes = [each.number for each in found if each.part == 0]
    for number in wholes:
        if wholes.count(number) > 1:
            raise DeviceError(f"'{text}' selects device {number} more than once: {devices[number].name.strip()}")
    return found


def max_parts(device) -> int:
    """Most parts that the device can be split into; 1: its driver cannot split it."""
    return min(device.max_compute_units, device.partition_max_sub_devices) if _partition_kinds(device) else 1


def _default_device(devices: list):
    variable = os.environ.get(PYOPENCL_VARIABLE, "").strip()
    if not variable:
        return devices[0]
    found = _find(f"{variable}:" if _is_number(variable) else variable, devices)
    return _refuse(f"{PYOPENCL_VARIABLE}={variable}", devices) if found is None else found


def _refuse(text: str, devices: list):
    raise DeviceError(
        f"no OpenCL device matches '{text}'; choose a number, a type or a part of a name from:\n{_listed(devices)}"
    )


def _listed(devices: list) -> str:
    return "\n".join(f"  {number}: {SelectedDevice(each, number).name}" for number, each in enumerate(devices))


def _select(text: str, devices: list) -> list[SelectedDevice] | None:
    """What an item of a list of devices selects; None if nothing matches."""
    if text.lower() == _ALL:
        return _all_devices(devices)
    found = _find(text, devices)
    if found is not None:
        return [SelectedDevice(found, devices.index(found))]
    split = _PART_OF.fullmatch(text)
    found = split and _find(split["device"].strip(), devices)
    if found is None:
        return None
    number, parts = devices.index(found), int(split["parts"])
    return [SelectedDevice(each, number, part, parts) for part, each in enumerate(_split(found, number, parts))]


def _all_devices(devices: list) -> list[SelectedDevice]:
    """Every device once, by its preferred driver. Mesa's drivers are left out where there are others.

    There is one CPU. Drivers of different vendors give a GPU the same name.
    """
    known = [device for device in devices if not is_mesa(device)] or devices
    platforms: dict[str, object] = {}  # of GPUs, by name
    selected: list[SelectedDevice] = []
    for device in known:
        if is_cpu(device):
            is_new = not any(is_cpu(each.device) for each in selected)
        else:
            is_new = platforms.setdefault(device.name, device.platform) == device.platform
        if is_new:
            selected.append(SelectedDevice(device, devices.index(device)))
    return selected


@functools.cache  # each call of the driver makes new sub-devices, for which programs would be built once more
def _split(device, number: int, parts: int) -> list:
    """Sub-devices with equal shares of the compute units; their numbers differ by 1 where they cannot be equal."""
    if parts == 1:
        return [device]
    name, units = f"device {number}, {device.name.strip()},", device.max_compute_units
    kinds, possible = load_pyopencl().device_partition_property, _partition_kinds(device)
    if not possible:
        raise DeviceError(f"{name} cannot be split: its driver does not support it")
    if not 1 <= parts <= max_parts(device):
        raise DeviceError(f"{name} cannot be split into {parts} parts: it has {units} compute units")
    if units % parts == 0 and kinds.EQUALLY in possible:
        return device.create_sub_devices([kinds.EQUALLY, units // parts])
    if kinds.BY_COUNTS in possible:
        counts = [units // parts + (part < units % parts) for part in range(parts)]
        return device.create_sub_devices([kinds.BY_COUNTS, *counts, kinds.BY_COUNTS_LIST_END])
    raise DeviceError(f"{name} cannot be split into {parts} parts: its driver makes parts of equal size only")


def _partition_kinds(device) -> set[int]:
    """The ways in which the driver can split the device, of those that are used here."""
    cl = load_pyopencl()
    try:
        possible = set(device.partition_properties)
    except cl.Error:  # OpenCL 1.1
        return set()
    return possible & {cl.device_partition_property.EQUALLY, cl.device_partition_property.BY_COUNTS}


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
