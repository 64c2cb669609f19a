"""Selection of a device: by number, name, type, and by PyOpenCL's environment variable."""

from types import SimpleNamespace

import pyopencl
import pytest

from isonoise.cli import main
from isonoise.device import drivers
from isonoise.device.selection import PYOPENCL_VARIABLE, pyopencl_number, select_device
from isonoise.errors import DeviceError

KIND = pyopencl.device_type


@pytest.fixture(autouse=True)
def platforms(monkeypatch):
    """Three platforms in PyOpenCL's order; in isonoise's order the devices are 1080, 3090, Zen, Xeon, FPGA."""
    monkeypatch.delenv(PYOPENCL_VARIABLE, raising=False)
    found = []
    for name, version, devices in (
        ("Intel(R) OpenCL", "2026", [("Xeon: two sockets", KIND.CPU), ("Arria FPGA", KIND.ACCELERATOR)]),
        ("NVIDIA CUDA", "550", [("GeForce 1080", KIND.GPU), ("GeForce 3090", KIND.GPU)]),
        ("Portable Computing Language", "7.1", [("pthread-znver4-AMD Zen", KIND.CPU)]),
    ):
        driver = SimpleNamespace(name=name, vendor="", devices=[])
        driver.get_devices = lambda driver=driver: driver.devices
        for device, kind in devices:
            driver.devices.append(
                SimpleNamespace(name=device, type=kind, platform=driver, vendor="", driver_version=version)
            )
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
    assert select_device(choice).name == expected
    monkeypatch.setenv(PYOPENCL_VARIABLE, "0:0")  # without effect where a device is selected
    assert select_device(choice).name == ("Xeon: two sockets" if choice is None else expected)


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
    assert select_device().name == expected
    assert select_device(1).name == "GeForce 3090"
    if value:
        monkeypatch.setenv(PYOPENCL_VARIABLE, pyopencl_number(select_device()))
        assert select_device().name == expected


@pytest.mark.parametrize(
    "choice", ["5", "99", "-1", "radeon", "", "0:2", "3:0", "intel:3090", "0:0:0", "1:0,1", "²", "²:0", "9" * 5000]
)
def test_choices_that_match_nothing_list_the_devices(choice, monkeypatch):
    with pytest.raises(DeviceError, match=f"matches '{choice}'") as caught:
        select_device(choice)
    assert "  1: GeForce 3090 (NVIDIA CUDA)" in str(caught.value)
    if choice:
        monkeypatch.setenv(PYOPENCL_VARIABLE, choice)
        with pytest.raises(DeviceError, match=f"matches '{PYOPENCL_VARIABLE}={choice}'"):
            select_device()


def test_the_command_names_the_variable(monkeypatch, capsys):
    monkeypatch.undo()  # the devices of this machine
    monkeypatch.setenv(PYOPENCL_VARIABLE, pyopencl_number(select_device(0)))
    assert main(["devices"]) == 0
    out = capsys.readouterr().out
    assert "default: device 0, selected by PYOPENCL_CTX" in out
    assert f"PYOPENCL_CTX={pyopencl_number(select_device(0))}" in out
    monkeypatch.setenv(PYOPENCL_VARIABLE, "no such device")
    assert main(["render", "cornell", "-o", "/dev/null.exr"]) == 2
    assert "PYOPENCL_CTX=no such device" in capsys.readouterr().err
