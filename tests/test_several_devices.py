"""Renders on several devices of one process: they have the bits of one device."""

import ctypes.util
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyopencl
import pytest
from small_scene import assert_same_bits, lamp_over_floor

from isonoise.cli import main
from isonoise.device.opencl import Device
from isonoise.device.selection import max_parts, select_device, select_devices
from isonoise.distributed.shard_tracer import ShardTracer
from isonoise.errors import DeviceError
from isonoise.renderer import Renderer

WHEEL_FOLDER = Path(pyopencl.__file__).parent.parent / "pocl_binary_distribution"
STRATEGIES = ["uniform", *(pytest.param(name, marks=pytest.mark.long) for name in ("pooled", "relative-median"))]


@pytest.fixture
def halves():
    """Skips the test if the default device cannot be split."""
    if max_parts(select_device(0).device) < 2:
        pytest.skip("the default device cannot be split")
    return "0/2"


def small_renderer(device: str, strategy: str = "uniform") -> Renderer:
    return Renderer(lamp_over_floor(width=45, height=37), device=device, strategy=strategy, seed=5)


def rendered(renderer: Renderer, waves: int = 4) -> Renderer:
    for _ in range(waves):
        renderer.step()
    return renderer


@pytest.mark.parametrize("strategy", STRATEGIES)
def test_halves_of_a_device_have_its_bits(halves, strategy):
    one = rendered(small_renderer("0", strategy))
    with rendered(small_renderer(halves, strategy)) as both:
        reports = both.worker_reports()
        assert [report.name for report in reports] == ["0/2:1", "0/2:2"]
        assert sum(report.samples for report in reports) == both.samples == one.samples
        assert both.devices == one.devices  # no warning if the render goes on with the other
        assert_same_bits(one.statistics(), both.statistics())


def fail_on(monkeypatch, numbers: dict[int, int]) -> None:
    """Let parts fail: part -> at which of its tasks. Every part gets a first task, but may be too slow for a second."""
    trace, tasks = ShardTracer.trace, []

    def failing(self, task, should_continue):
        tasks.append(part := self.device.selected.part)
        if tasks.count(part) == numbers.get(part):
            raise DeviceError(f"part {part} was lost")
        return trace(self, task, should_continue)

    monkeypatch.setattr(ShardTracer, "trace", failing)


def test_a_part_that_fails_loses_no_samples(halves, monkeypatch):
    one = rendered(small_renderer("0"))
    fail_on(monkeypatch, {1: 1})
    with small_renderer(halves) as both:
        with pytest.warns(UserWarning, match="device 0/2:2 is left out from now on: part 1 was lost"):
            rendered(both)
        assert_same_bits(one.statistics(), both.statistics())
        assert [report.is_ready for report in both.worker_reports()] == [True, False]


@pytest.mark.filterwarnings("ignore:device")
def test_what_was_rendered_is_written_if_all_devices_fail(halves, monkeypatch, tmp_path, capsys):
    fail_on(monkeypatch, {0: 3, 1: 1})
    image = tmp_path / "image.exr"
    options = ["--size", "45x37", "--spp", "64", "--strategy", "uniform", "--device", halves]
    assert main(["render", "cornell", "-o", str(image), *options]) == 2
    assert "part 0 was lost\npart 1 was lost" in capsys.readouterr().err
    assert image.exists()


SPIN = """__kernel void spin(__global float* x, uint count) {
    float y = get_global_id(0);
    for (uint i = 0; i < count; i++)
        y = y * 0.999f + 0.5f;
    x[get_global_id(0)] = y;
}"""


def thread_times_ns() -> dict[str, int]:
    """Time that each thread of this process has run."""
    tasks = Path("/proc/self/task").iterdir()
    return {task.name: int((task / "schedstat").read_text().split()[0]) for task in tasks}


def busy_threads(device: Device) -> set[str]:
    """Threads that run a kernel on the device."""
    kernel, buffer = device.build(SPIN, ())["spin"], device.buffer(4 * 2**16, "a test")

    def spin(count: int) -> None:
        device.launch(kernel, 2**16, (buffer, np.uint32(count)))
        device.finish()

    spin(1)  # compiles
    before = thread_times_ns()
    spin(1500)
    spent = {name: time_ns - before.get(name, 0) for name, time_ns in thread_times_ns().items()}
    return {name for name, time_ns in spent.items() if time_ns > 0.25 * max(spent.values())}


@pytest.mark.skipif(not Path("/proc/self/schedstat").exists(), reason="needs the times of threads")
def test_parts_of_a_cpu_run_on_cores_of_their_own():
    whole = Device(0)
    if not whole.is_pocl or max_parts(whole.device) < 2:
        pytest.skip("needs PoCL on several cores")
    parts = [Device(each) for each in select_devices(f"0/{whole.compute_units}")[:2]]
    threads = [busy_threads(part) for part in parts]
    assert [len(each) for each in threads] == [part.compute_units for part in parts] == [1, 1]
    assert threads[0].isdisjoint(threads[1])


TWO_DRIVERS = """
import json
from isonoise.device.selection import select_devices
from test_several_devices import rendered, small_renderer

one, several = rendered(small_renderer("0")).statistics(), rendered(small_renderer("0/2,1"))
print(json.dumps({
    "drivers": [each.device.driver_version for each in select_devices("0/2,1")],
    "tasks": [report.tasks for report in several.worker_reports()],
    "same counts": (one.count == several.statistics().count).all().item(),
    "means": [each.rgb.mean(axis=(0, 1)).tolist() for each in (one, several.statistics())],
}))
several.close()
"""


@pytest.mark.long
def test_two_drivers_in_one_process(tmp_path):
    """PoCL of the system and of pip compute a part of the tasks each. The last bits may differ."""
    library = ctypes.util.find_library("pocl")
    if library is None or not WHEEL_FOLDER.is_dir():
        pytest.skip("needs PoCL of the system (apt install pocl-opencl-icd) and of pip (pocl-binary-distribution)")
    (tmp_path / "system.icd").write_text(f"{library}\n")
    environment = os.environ | {"OCL_ICD_VENDORS": str(tmp_path), "PYTHONPATH": os.path.dirname(__file__)}
    done = subprocess.run([sys.executable, "-c", TWO_DRIVERS], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    assert len(set(found["drivers"])) == 2
    assert len(found["tasks"]) == 3
    assert sum(found["tasks"]) > 3
    assert found["same counts"]
    np.testing.assert_allclose(*found["means"], rtol=1e-5)
