"""Errors of drivers as messages for the user: compilers, lost devices, forked processes."""

import os
import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from isonoise.device import failures
from isonoise.device.drivers import load_pyopencl
from isonoise.device.opencl import Device
from isonoise.errors import DeviceError

SOURCE = (
    '#line 1 "stages/shade.cl"\n__kernel void a(__global float* x) {\n#line 41 "util/vec.h"\n    x[0] = nothing;\n}\n'
)


@pytest.fixture(scope="module")
def device():
    return Device()


def driver_error(code: int):
    cl = load_pyopencl()
    return cl.RuntimeError(cl._cl._ErrorRecord(msg="text of the driver", code=code, routine="clFinish"))


def test_a_build_error_names_file_line_options_and_log(device, tmp_path, monkeypatch):
    monkeypatch.setattr(failures, "log_folders", [str(tmp_path)])
    with pytest.raises(DeviceError) as caught:
        device.build(SOURCE, ("-cl-std=CL1.2", "-DFEATURE_A=1", "-DFEATURE_B=0"))
    message = str(caught.value)
    assert "util/vec.h:41: use of undeclared identifier 'nothing'" in message
    assert "-cl-std=CL1.2 -DFEATURE_A=1\n" in message
    log = Path(re.search(r"are in (.+)", message)[1])
    assert list(tmp_path.iterdir()) == [log]  # and pyopencl has left no file
    content = log.read_text()
    assert "undeclared" in content
    assert "-cl-std=CL1.2 -DFEATURE_A=1 -DFEATURE_B=0" in content
    assert content.endswith(SOURCE + "\n")


def test_a_build_log_that_cannot_be_saved_is_in_the_message(tmp_path, monkeypatch):
    monkeypatch.setattr(failures.tempfile, "mkstemp", lambda **_: (_ for _ in ()).throw(OSError("disk full")))
    message = str(failures.build_failure("a GPU", "", ["-DX=1"], driver_error(-11), "the disk is full"))
    assert "text of the driver" in message
    assert "refused a kernel: the disk is full" in message


def test_a_build_log_for_which_there_is_no_space_leaves_no_file(tmp_path, monkeypatch):
    def refuse(number, *_, **__):
        os.close(number)
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(failures, "log_folders", [str(tmp_path)])
    monkeypatch.setattr(failures, "open", refuse, raising=False)
    assert "text of the driver" in str(failures.build_failure("a GPU", "", [], driver_error(-11)))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("log", "place"),
    [
        ("error: stages/a.cl:7:2: no", "stages/a.cl:7: no"),
        ("stages/b.cl:1:2: warning: odd\nutil/vec.h:8:1: error: no\n", "util/vec.h:8: no"),
        ("stages/a.cl(3): error: no", "stages/a.cl:3: no"),
        ("/tmp/a.cl:3:1: error: no", "refused a kernel"),
        ("killed", "refused a kernel"),
    ],
)
def test_places_in_compiler_logs(log, place, tmp_path, monkeypatch):
    monkeypatch.setattr(failures, "log_folders", [str(tmp_path)])
    assert place in str(failures.build_failure("a GPU", "", [], Exception(log)))


@pytest.mark.parametrize(
    ("code", "status", "advice"),
    [
        (-2, "DEVICE_NOT_AVAILABLE", "the device was lost"),
        (-5, "OUT_OF_RESOURCES", "the device was lost"),
        (-36, "INVALID_COMMAND_QUEUE", "the device was lost"),
        (-4, "MEM_OBJECT_ALLOCATION_FAILURE", "memory is exhausted"),
        (-6, "OUT_OF_HOST_MEMORY", "memory is exhausted"),
        (-9999, "error -9999", "update the driver"),
    ],
)
def test_a_failure_says_what_the_device_was_doing(code, status, advice, device, monkeypatch):
    class Failing:
        """A module pyopencl whose functions all fail."""

        def __getattr__(self, name):
            if name.startswith(("enqueue", "release")):
                raise driver_error(code)
            return getattr(load_pyopencl(), name)

    buffer = device.buffer(64, "a buffer")
    monkeypatch.setattr(device, "_cl", Failing())
    actions = [
        ("reading a buffer", lambda: device.read(buffer, np.float32, 4)),
        ("reading a buffer", lambda: device.begin_read(buffer, np.float32, 4)),
        ("reading a buffer", lambda: device.mapped(buffer, np.float32, 4).__enter__()),
        ("reading a buffer", lambda: device._unmap(SimpleNamespace(base=Failing()))),
        ("writing a buffer", lambda: device.write(buffer, np.zeros(4, np.float32))),
    ]
    for action, act in actions:
        with pytest.raises(DeviceError, match=f"failed while {action}") as caught:
            act()
        assert f"clFinish: {status}" in str(caught.value)
        assert advice in str(caught.value)
        assert device.name in str(caught.value)


def test_failures_of_the_queue_and_of_launches(device, monkeypatch):
    class Failing:
        def finish(self):
            raise driver_error(-36)

        flush = finish

    def kernel(*_):
        raise driver_error(-5)

    kernel.function_name = "shade"
    with pytest.raises(DeviceError, match="launching `shade`"):
        device.launch(kernel, 64, ())
    monkeypatch.setattr(device, "queue", Failing())
    for method in (device.finish, device.flush):
        with pytest.raises(DeviceError, match="the device was lost"):
            method()


FORK = """
import os, sys
from isonoise.device.opencl import Device
from isonoise.errors import DeviceError

device = Device()
buffer = device.buffer(64, "a buffer")
child = os.fork()
if child == 0:
    uses = (Device, device.finish, device.flush, lambda: device.read(buffer, "f4", 4), lambda: device.build("", ()))
    for use in uses:
        try:
            use()
        except DeviceError as error:
            assert "spawn" in str(error)
        else:
            sys.exit("not refused")
    sys.exit(7)  # runs the functions registered for the exit, which must not wait for the device
print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), device.read(buffer, "f4", 4).sum())
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
def test_a_forked_process_refuses_the_device():
    done = subprocess.run([sys.executable, "-c", FORK], capture_output=True, text=True, timeout=60)
    assert done.stdout.split() == ["7", "0.0"], done.stderr
