"""Selection of devices: by number, name, type, in parts, and by PyOpenCL's environment variable."""

from types import SimpleNamespace

import pyopencl
import pytest

from isonoise.cli import main
from isonoise.device import drivers
from isonoise.device.drivers import parent_of
from isonoise.device.opencl import Device
from isonoise.device.selection import PYOPENCL_VARIABLE, max_parts, pyopencl_number, select_device, select_devices
from isonoise.errors import DeviceError

KIND = pyopencl.device_type
SPLIT = pyopencl.device_partition_property


class FakeDevice(SimpleNamespace):
    """A device of PyOpenCL, as far as the selection looks at it."""

    __hash__ = object.__hash__

    def create_sub_devices(self, properties: list[int]) -> list["FakeDevice"]:
        kind, *counts = properties
        if kind == SPLIT.EQUALLY:
            counts = [counts[0]] * (self.max_compute_units // counts[0])
        else:
            assert counts.pop() == 0  # the end of the list
        return [FakeDevice(**vars(self) | {"max_compute_units": count}) for count in counts]


@pytest.fixture(autouse=True)
def platforms(monkeypatch):
    """Four platforms in PyOpenCL's order; isonoise's is 1080, 3090, Zen, Xeon, FPGA, llvmpipe, and 3090 by Mesa."""
    monkeypatch.delenv(PYOPENCL_VARIABLE, raising=False)
    found = []
    for name, version, devices in (
        ("Intel(R) OpenCL", "2026", [("Xeon: two sockets", KIND.CPU, [4230]), ("Arria FPGA", KIND.ACCELERATOR, [0])]),
        ("NVIDIA CUDA", "550", [("GeForce 1080", KIND.GPU, []), ("GeForce 3090", KIND.GPU, [])]),
        ("Portable Computing Language", "7.1", [("pthread-znver4-AMD Zen", KIND.CPU, [4230, 4231])]),
        ("rusticl", "22.3", [("llvmpipe", KIND.CPU, []), ("GeForce 3090", KIND.GPU, [])]),
    ):
        driver = SimpleNamespace(name=name, vendor="", devices=[])
        driver.get_devices = lambda driver=driver: driver.devices
        for device, kind, splits in devices:
            own = {"name": device, "type": kind, "partition_properties": splits}
            shared = {"vendor": "", "driver_version": version, "max_compute_units": 7, "partition_max_sub_devices": 7}
            driver.devices.append(FakeDevice(platform=driver, **own, **shared))
        found.append(driver)
    monkeypatch.setattr(drivers.load_pyopencl(), "get_platforms", lambda: found)


@pytest.mark.parametrize(
    ("choice", "expected"),
    [
        (None, "GeForce 1080"),
        (1, "GeForce 3090"),
        ("1", "GeForce 3090"),
        (" 4 ", "Arria FPGA"),
        ("gpu", "GeForce 1080"),
        ("GPU", "GeForce 1080"),
        ("cpu", "pthread-znver4-AMD Zen"),
        ("accelerator", "Arria FPGA"),
        ("geforce 3", "GeForce 3090"),
        ("intel", "Xeon: two sockets"),
        ("portable", "pthread-znver4-AMD Zen"),
        ("0:0", "Xeon: two sockets"),
        ("0:1", "Arria FPGA"),
        ("nvidia:1", "GeForce 3090"),
        ("NVIDIA:3090", "GeForce 3090"),
        ("2:", "pthread-znver4-AMD Zen"),
        (":1", "Arria FPGA"),
        ("xeon: two", "Xeon: two sockets"),
    ],
)
def test_devices_by_number_name_and_type(choice, expected, monkeypatch):
    assert select_device(choice).device.name == expected
    monkeypatch.setenv(PYOPENCL_VARIABLE, "0:0")  # without effect where a device is selected
    assert select_device(choice).device.name == ("Xeon: two sockets" if choice is None else expected)


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        ("", "GeForce 1080"),
        ("0", "Xeon: two sockets"),
        ("1", "GeForce 1080"),
        ("1:1", "GeForce 3090"),
        ("2", "pthread-znver4-AMD Zen"),
        ("cpu", "pthread-znver4-AMD Zen"),
        ("intel:fpga", "Arria FPGA"),
    ],
)
def test_pyopencls_variable_keeps_its_meaning(value, expected, monkeypatch):
    monkeypatch.setenv(PYOPENCL_VARIABLE, value)
    assert select_device().device.name == expected
    assert select_device(1).device.name == "GeForce 3090"
    if value:
        monkeypatch.setenv(PYOPENCL_VARIABLE, pyopencl_number(select_device().device))
        assert select_device().device.name == expected


@pytest.mark.parametrize(
    "choice", ["7", "99", "-1", "radeon", "", "0:2", "4:0", "intel:3090", "0:0:0", "²", "²:0", "9" * 5000]
)
def test_choices_that_match_nothing_list_the_devices(choice, monkeypatch):
    with pytest.raises(DeviceError, match=f"matches '{choice}'") as caught:
        select_device(choice)
    assert "  1: GeForce 3090 (NVIDIA CUDA)" in str(caught.value)
    if choice:
        monkeypatch.setenv(PYOPENCL_VARIABLE, choice)
        with pytest.raises(DeviceError, match=f"matches '{PYOPENCL_VARIABLE}={choice}'"):
            select_device()


@pytest.mark.parametrize(
    ("choice", "labels"),
    [
        (None, ["0"]),
        ("1", ["1"]),
        ("1,0", ["1", "0"]),
        (" cpu , geforce 3", ["2", "1"]),
        ("2,3", ["2", "3"]),  # two drivers of one CPU, if that is asked for
        ("xeon: two, gpu", ["3", "0"]),
        ("all", ["0", "1", "2", "4"]),
        ("ALL", ["0", "1", "2", "4"]),
        ("2/1", ["2"]),
        ("zen/2", ["2/2:1", "2/2:2"]),
        ("2/3,0", ["2/3:1", "2/3:2", "2/3:3", "0"]),
        ("Xeon: two sockets/7", [f"3/7:{part}" for part in range(1, 8)]),
    ],
)
def test_several_devices(choice, labels):
    assert [each.label for each in select_devices(choice)] == labels
    if len(labels) > 1:
        with pytest.raises(DeviceError, match=r"selects \d devices, but only `isonoise render` uses more than one"):
            select_device(choice)


@pytest.mark.parametrize(
    ("choice", "message"),
    [
        ("0,0", "selects device 0 more than once: GeForce 1080"),
        ("gpu,1,0", "selects device 0 more than once"),
        ("2,2/2", "selects device 2 more than once: pthread-znver4"),
        ("all,cpu", "selects device 2 more than once"),
        ("0,radeon", "matches 'radeon'"),
        ("0,", "matches ''"),
        ("0/2", "GeForce 1080, cannot be split: its driver does not support it"),
        ("4/2", "Arria FPGA, cannot be split: its driver"),
        ("2/8", "cannot be split into 8 parts: it has 7 compute units"),
        ("2/0", "cannot be split into 0 parts"),
        ("3/2", "cannot be split into 2 parts: its driver makes parts of equal size only"),
        ("all/2", "matches 'all/2'"),
    ],
)
def test_lists_of_devices_that_are_refused(choice, message):
    with pytest.raises(DeviceError, match=message):
        select_devices(choice)


@pytest.mark.parametrize(("parts", "units"), [(1, [7]), (2, [4, 3]), (3, [3, 2, 2]), (7, [1] * 7)])
def test_parts_have_equal_shares(parts, units):
    assert [each.device.max_compute_units for each in select_devices(f"2/{parts}")] == units


def test_all_of_mesa_where_there_is_nothing_else(monkeypatch):
    mesa = pyopencl.get_platforms()[3:]
    monkeypatch.setattr(drivers.load_pyopencl(), "get_platforms", lambda: mesa)
    assert [each.name for each in select_devices("all")] == ["llvmpipe (rusticl)", "GeForce 3090 (rusticl)"]


def test_halves_of_a_device(monkeypatch):
    monkeypatch.undo()  # the devices of this machine
    whole = select_device(0)
    if max_parts(whole.device) < 2:
        pytest.skip("the default device cannot be split")
    halves = [Device(each) for each in select_devices("0/2")]
    assert [each.selected for each in halves] == select_devices("0/2")
    assert sum(each.compute_units for each in halves) == whole.device.max_compute_units
    assert all(parent_of(each.device) == whole.device for each in halves)
    assert [", part 1 of 2 (" in halves[0].name, ", part 2 of 2 (" in halves[1].name] == [True, True]
    # what is compiled for the device serves its parts
    assert len({each.program_key("text", ()) for each in [Device(0), *halves]}) == 1


def test_the_command_names_the_variable(monkeypatch, capsys):
    monkeypatch.undo()  # the devices of this machine
    monkeypatch.setenv(PYOPENCL_VARIABLE, pyopencl_number(select_device(0).device))
    assert main(["devices"]) == 0
    out = capsys.readouterr().out
    assert "default: device 0, selected by PYOPENCL_CTX" in out
    assert f"PYOPENCL_CTX={pyopencl_number(select_device(0).device)}" in out
    monkeypatch.setenv(PYOPENCL_VARIABLE, "no such device")
    assert main(["render", "cornell", "-o", "/dev/null.exr"]) == 2
    assert "PYOPENCL_CTX=no such device" in capsys.readouterr().err
