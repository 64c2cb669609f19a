"""`DevicePool`: the order of tasks, devices that fail or are slow, the end of its threads."""

import gc
import os
import signal
import subprocess
import sys
import threading
import time
import weakref
from types import SimpleNamespace

import numpy as np
import pytest

from isonoise.distributed.device_pool import DevicePool
from isonoise.distributed.task import Task, TaskResult
from isonoise.distributed.worker_pool import Finished, Lost
from isonoise.errors import DeviceError

WAIT_S = 20.0


def fake_device(label: str, driver: str = "a driver") -> SimpleNamespace:
    selected = SimpleNamespace(label=label, whole_name=f"device {label}")
    return SimpleNamespace(selected=selected, name=f"device {label}", program_key=lambda source, options: driver)


def task(number: int) -> Task:
    return Task(number, np.arange(2, dtype=np.uint32), np.array([1, 3], np.uint32), {"count": np.zeros((1, 2))}, 0)


class FakeTracer:
    """Counts samples; `act` is called with each task and with its `should_continue`."""

    def __init__(self, act=lambda task, should_continue: None):
        self.act = act

    def trace(self, task: Task, should_continue) -> TaskResult:
        self.act(task, should_continue)
        return TaskResult(task.number, {"count": task.state["count"] + task.allocation}, None, 0.0)


def make_pool(*acts) -> DevicePool:
    tracers = {f"{number}": FakeTracer(act) for number, act in enumerate(acts)}
    return DevicePool([fake_device(label) for label in tracers], lambda device, _: tracers.pop(device.selected.label))


def nothing(task, should_continue) -> None:
    pass


def until_stopped(task, should_continue) -> None:
    end_s = time.monotonic() + WAIT_S
    while should_continue():
        assert time.monotonic() < end_s
        time.sleep(0.001)


def wait_for(pool: DevicePool, count: int) -> list[Finished | Lost]:
    events = []
    while len(events) < count:
        new = pool.wait(WAIT_S)
        assert new
        events += new
    return events


def submit(pool: DevicePool, numbers: dict[int, str]) -> None:
    for number, worker in numbers.items():
        pool.submit(worker, task(number))


def test_tasks_are_computed_in_order_and_reported_once():
    pool = make_pool(nothing, nothing)
    assert [(worker.name, worker.device) for worker in pool.workers()] == [("0", "device 0"), ("1", "device 1")]
    submit(pool, {number: str(number % 3 % 2) for number in range(30)})
    events = wait_for(pool, 30)
    for worker in "01":
        assert [event.result.number for event in events if event.worker == worker] == [
            number for number in range(30) if str(number % 3 % 2) == worker
        ]
    assert all(event.result.state["count"].tolist() == [[1, 3]] for event in events)
    assert pool.wait(0.01) == []
    pool.close()


def test_a_slow_device_holds_no_other_up():
    pool = make_pool(until_stopped, nothing)
    submit(pool, {0: "0", 1: "1", 2: "1"})
    assert [event.worker for event in wait_for(pool, 2)] == ["1", "1"]
    pool.stop()
    submit(pool, {3: "0"})  # what is submitted later is not stopped
    assert [event.result.number for event in wait_for(pool, 1)] == [0]
    assert pool.wait(0.02) == []
    pool.close()


@pytest.mark.parametrize(
    ("failure", "reason"),
    [(DeviceError("the device was lost"), "the device was lost"), (MemoryError(), "not enough memory for device 0")],
)
def test_a_device_that_fails_is_left_out(failure, reason):
    def fail_at_second(task, should_continue):
        if task.number == 1:
            raise failure

    pool = make_pool(fail_at_second, nothing)
    submit(pool, {0: "0", 1: "0", 2: "0", 3: "1"})
    with pytest.warns(UserWarning, match=f"device 0 is left out from now on: .*{reason}"):
        events = wait_for(pool, 4)
    lost = [event for event in events if isinstance(event, Lost)]
    assert [(event.worker, event.task) for event in lost] == [("0", 1), ("0", 2)]
    assert all(reason in event.reason for event in lost)
    assert [worker.name for worker in pool.workers()] == ["1"]
    submit(pool, {4: "0", 5: "1"})  # it may fail while a task is on its way
    events = wait_for(pool, 2)
    assert sorted((type(event).__name__, event.worker) for event in events) == [("Finished", "1"), ("Lost", "0")]
    pool.close()


def test_the_last_device_that_fails_ends_the_render():
    def fail(task, should_continue):
        raise DeviceError(f"failed at task {task.number}")

    pool = make_pool(fail, fail)
    submit(pool, {7: "0"})
    with pytest.warns(UserWarning, match="failed at task 7"):
        wait_for(pool, 1)
    submit(pool, {8: "1"})
    assert [event.reason for event in wait_for(pool, 1)] == ["failed at task 8"]  # no sample is lost in silence
    with pytest.raises(DeviceError, match="failed at task 7\nfailed at task 8"):
        pool.wait(WAIT_S)
    pool.close()


def test_a_fault_of_the_program_is_raised():
    def divide(task, should_continue):
        return 1 / 0

    pool = make_pool(divide, nothing)
    submit(pool, {0: "0"})
    with pytest.raises(ZeroDivisionError):
        pool.wait(WAIT_S)
    pool.close()


@pytest.mark.parametrize("abandon", [False, True])
def test_the_end_of_a_pool_frees_its_devices(abandon):
    is_running, computed = threading.Event(), []

    def act(task, should_continue):
        computed.append(task.number)
        is_running.set()
        until_stopped(task, should_continue)

    tracer = FakeTracer(act)
    freed, tracers = weakref.ref(tracer), [tracer]
    del tracer
    before = threading.active_count()
    pool = DevicePool([fake_device("0")], lambda device, _: tracers.pop())
    submit(pool, {0: "0", 1: "0"})
    assert is_running.wait(WAIT_S)
    if abandon:
        del pool
        gc.collect()
    else:
        pool.close()
        pool.close()
    assert freed() is None
    assert computed == [0]  # the other task was dropped
    assert threading.active_count() == before


def test_devices_that_share_programs_follow_the_first():
    made, compiled = [], []

    def make(device, on_compile):
        on_compile(device.name, 0, 1)
        made.append((device.selected.label, threading.current_thread() is threading.main_thread()))
        return FakeTracer()

    devices = [fake_device("0", "x"), fake_device("1", "x"), fake_device("2", "y"), fake_device("3", "x")]
    pool = DevicePool(devices, make, lambda *progress: compiled.append(progress))
    assert made[:2] == [("0", True), ("2", True)]
    assert sorted(made[2:]) == [("1", False), ("3", False)]
    assert compiled == [("device 0", 0, 1), ("device 2", 0, 1)]
    assert [worker.name for worker in pool.workers()] == ["0", "1", "2", "3"]
    pool.close()


@pytest.mark.parametrize("label", ["0", "1"])
def test_a_device_that_cannot_be_set_up_is_an_error(label):
    def make(device, on_compile):
        if device.selected.label == label:
            raise DeviceError(f"{device.name} is too small")
        return FakeTracer()

    before = threading.active_count()
    with pytest.raises(DeviceError, match=f"device {label} is too small"):
        DevicePool([fake_device("0"), fake_device("1")], make)
    assert threading.active_count() == before


BUSY_POOL = """
import sys, time
from test_device_pool import make_pool, submit, until_stopped
from isonoise.signals import handle_signals

def ends_after_a_while(task, should_continue):
    until_stopped(task, should_continue)
    time.sleep(0.1)
    print("ended", flush=True)

with handle_signals():
    pool = make_pool(ends_after_a_while)
    submit(pool, {0: "0", 1: "0"})
    print("busy", flush=True)
    if sys.argv[1] == "wait":
        pool.wait(20)
"""


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
@pytest.mark.parametrize("end", ["wait", pytest.param("exit", marks=pytest.mark.long)])
def test_the_process_ends_while_a_device_is_busy(end):
    """By its own end, and by Ctrl-C while it waits: the running task ends early, and no other begins."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([os.path.dirname(__file__), *sys.path])}
    process = subprocess.Popen(
        [sys.executable, "-c", BUSY_POOL, end], env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    assert process.stdout.readline() == b"busy\n"
    if end == "wait":
        process.send_signal(signal.SIGINT)
    out, error = process.communicate(timeout=WAIT_S)
    assert out == b"ended\n"
    assert (b"KeyboardInterrupt" in error) == (end == "wait"), error
    assert b"Fatal" not in error
