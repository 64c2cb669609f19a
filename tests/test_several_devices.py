"""Renders on several devices of one process: they have the bits of one device."""

import ctypes.util
import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyopencl
import pytest
from small_scene import lamp_over_floor

from isonoise.device.opencl import Device
from isonoise.device.selection import SelectedDevice, max_parts, select_device, select_devices
from isonoise.distributed.device_pool import DevicePool
from isonoise.distributed.shard_tracer import ShardTracer
from isonoise.distributed.task import Task
from isonoise.integrator.reduction_state import state_planes
from isonoise.integrator.wavefront import Wavefront
from isonoise.scene import compile_scene, load
from isonoise.scene.accel.build import build_scene_bvh
from isonoise.statistics import Needs

WHEEL_FOLDER = Path(pyopencl.__file__).parent.parent / "pocl_binary_distribution"
SEED, TASKS, WAVES = 5, 7, 3


def small_scene():
    return compile_scene(load(lamp_over_floor(width=31, height=17)))


def allocations(pixels: int) -> list[np.ndarray]:
    """Samples per pixel of each wave; adaptive ones leave pixels out."""
    random = np.random.default_rng(1)
    return [random.integers(wave == 0, 40, pixels).astype(np.uint32) for wave in range(WAVES)]


def state_of_one_device(needs: Needs) -> dict[str, np.ndarray]:
    scene = small_scene()
    wavefront = Wavefront(Device(0), scene, build_scene_bvh(scene), needs, SEED)
    for allocation in allocations(scene.width * scene.height):
        wavefront.trace(allocation.copy())
    return wavefront.accumulator.reduction.read()


def state_of_devices(devices: Sequence[SelectedDevice], needs: Needs) -> dict[str, np.ndarray]:
    """Of the same samples, in tasks of random pixels that the devices compute in turn."""
    scene = small_scene()
    pixels = scene.width * scene.height
    state = {
        name: np.zeros((planes, pixels), np.uint32 if name in ("count", "rejected") else np.float32)
        for name, planes in state_planes(needs).items()
    }
    pool = DevicePool(
        [Device(each) for each in devices], lambda device, progress: ShardTracer(device, scene, needs, SEED)
    )
    workers, number = [worker.name for worker in pool.workers()], 0
    for wave, allocation in enumerate(allocations(pixels)):
        tasks = {}
        for shard in np.array_split(np.random.default_rng(wave).permutation(pixels), TASKS):
            shard = shard[allocation[shard] > 0].astype(np.uint32)
            shard_state = {name: np.ascontiguousarray(planes[:, shard]) for name, planes in state.items()}
            tasks[number] = Task(number, shard, allocation[shard], shard_state)
            pool.submit(workers[number % len(workers)], tasks[number])
            number += 1
        while tasks:
            for event in pool.wait(60.0):
                assert event.result.remaining is None
                task = tasks.pop(event.result.number)
                for name, planes in event.result.state.items():
                    state[name][:, task.pixels] = planes
    pool.close()
    return state


def assert_same_state(one: dict[str, np.ndarray], other: dict[str, np.ndarray]) -> None:
    assert list(one) == list(other)
    for name, planes in one.items():
        assert planes.tobytes() == other[name].tobytes(), name


@pytest.mark.parametrize("needs", [Needs(), pytest.param(Needs(median=True, nets=True), marks=pytest.mark.long)])
def test_halves_of_a_device_have_its_bits(needs):
    if max_parts(select_device(0).device) < 2:
        pytest.skip("the default device cannot be split")
    expected = state_of_one_device(needs)
    assert_same_state(expected, state_of_devices(select_devices("0/2"), needs))


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
from isonoise.distributed.device_pool import DevicePool
from isonoise.statistics import Needs
from test_several_devices import state_of_devices, state_of_one_device

devices = select_devices("0,1")
states = state_of_one_device(Needs()), state_of_devices(devices, Needs())
print(json.dumps({
    "drivers": [each.device.driver_version for each in devices],
    "same counts": all((states[0][name] == states[1][name]).all() for name in ("count", "rejected")),
    "sums": [state["sums"][:5].sum(axis=1, dtype=float).tolist() for state in states],
}))
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
    assert found["same counts"]
    np.testing.assert_allclose(*found["sums"], rtol=1e-5)
