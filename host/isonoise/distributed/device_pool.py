"""A pool of OpenCL devices of this machine: a thread and a tracer for each. Used by `DistributedWavefront`.

Drivers release Python's lock while they wait for a device, so one process keeps several devices busy. Signals are
handled in the main thread alone, which waits for events of the devices.
"""

import atexit
import threading
import warnings
import weakref
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from queue import Empty, SimpleQueue
from typing import Protocol

from isonoise.device.opencl import Device
from isonoise.device.precompile import OnCompile
from isonoise.distributed.task import Task, TaskResult
from isonoise.distributed.worker_pool import Finished, Lost, Worker
from isonoise.errors import DeviceError


class Tracer(Protocol):
    """What computes the tasks of a device, such as `ShardTracer`."""

    def trace(self, task: Task, should_continue: Callable[[], bool]) -> TaskResult:
        """Trace the samples of a task. Once `should_continue` returns False no new path starts."""


MakeTracer = Callable[[Device, OnCompile], Tracer]


def _no_progress(name: str, done: int, total: int) -> None:
    """An `OnCompile` that does nothing."""


class DevicePool:
    """A `WorkerPool` of devices. Workers have the number of their device as name, such as `0` or, of a half, `0/2:1`.

    A device that fails with DeviceError or MemoryError gets no more tasks, with a warning.

    Parameters
    ----------
    devices : one or more, each used by nothing else until `close`
    make_tracer : called once for each, partly in several threads at a time
    on_compile : passed to `make_tracer` where programs may have to be compiled; called in the calling thread

    Raises
    ------
    DeviceError
        If a tracer cannot be made.
    """

    def __init__(self, devices: Sequence[Device], make_tracer: MakeTracer, on_compile: OnCompile = _no_progress):
        self._events: SimpleQueue[Finished | Lost | BaseException] = SimpleQueue()
        self._is_left_out: set[str] = set()  # with a warning
        tracers = _make_tracers(devices, make_tracer, on_compile)
        self._threads = {
            device.selected.label: _DeviceThread(device, tracer, self._events)
            for device, tracer in zip(devices, tracers, strict=True)
        }
        # At exit before what the driver needs is gone: functions that were registered earlier run later.
        self._end = weakref.finalize(self, _end_threads, list(self._threads.values()))
        self._end.atexit = False
        atexit.register(self._end)

    def workers(self) -> list[Worker]:
        """The devices that have not failed."""
        return [thread.worker for thread in self._threads.values() if thread.failure is None]

    def submit(self, worker: str, task: Task) -> None:
        """Give a task to a device, which computes its tasks one after the other."""
        self._threads[worker].submit(task)

    def wait(self, timeout_s: float) -> list[Finished | Lost]:
        """What has happened since the last call, as of `WorkerPool`."""
        events = []
        try:
            events.append(self._events.get(timeout=timeout_s if self.workers() else 0))
            while True:
                events.append(self._events.get_nowait())
        except Empty:
            pass
        for event in events:
            if isinstance(event, BaseException):  # a fault of the program
                raise event
        self._warn_of_failures()
        if not events and not self.workers():
            raise DeviceError("\n".join(thread.failure for thread in self._threads.values()))
        return events

    def _warn_of_failures(self) -> None:
        """Warn of the devices that have failed since the last call, unless none is left."""
        for label, thread in self._threads.items():
            if thread.failure is not None and label not in self._is_left_out and self.workers():
                self._is_left_out.add(label)
                warnings.warn(f"device {label} is left out from now on: {thread.failure}", stacklevel=3)

    def stop(self) -> None:
        """Let the tasks that have been submitted end early; later ones are computed as usual."""
        for thread in self._threads.values():
            thread.stop()

    def close(self) -> None:
        """Drop the tasks, wait for the paths in flight, and free what the tracers have allocated."""
        self._end()
        atexit.unregister(self._end)


def _make_tracers(devices: Sequence[Device], make_tracer: MakeTracer, on_compile: OnCompile) -> list[Tracer]:
    """A tracer for each device. Devices that share compiled programs follow the first of them, all at a time."""
    keys = [device.program_key("", ()) for device in devices]
    firsts = [keys.index(key) for key in dict.fromkeys(keys)]
    tracers = {number: make_tracer(devices[number], on_compile) for number in firsts}
    others = [number for number in range(len(devices)) if number not in tracers]
    if others:
        with ThreadPoolExecutor(len(others)) as executor:
            made = executor.map(lambda number: make_tracer(devices[number], _no_progress), others)
            tracers.update(zip(others, made, strict=True))
    return [tracers[number] for number in range(len(devices))]


def _end_threads(threads: "Sequence[_DeviceThread]") -> None:
    for thread in threads:
        thread.close()
    for thread in threads:
        thread.join()


class _DeviceThread:
    """Computes the tasks of a device in the order in which they are submitted, in a thread of its own.

    Attributes
    ----------
    worker : Worker
    failure : str or None
        Why the device computes no more tasks.
    """

    def __init__(self, device: Device, tracer: Tracer, events: SimpleQueue):
        self.worker = Worker(device.selected.label, device.selected.whole_name)
        self.failure: str | None = None
        self._tracer: Tracer | None = tracer
        self._events = events
        self._tasks: SimpleQueue[tuple[int, Task] | None] = SimpleQueue()
        self._submitted = 0
        self._stop_before = 0  # of the submitted tasks those before this one end early
        self._is_closed = False
        # a daemon: the interpreter waits for other threads before it runs what `atexit` has registered
        self._thread = threading.Thread(target=self._run, name=f"device {self.worker.name}", daemon=True)
        self._thread.start()

    def submit(self, task: Task) -> None:
        self._tasks.put((self._submitted, task))
        self._submitted += 1

    def stop(self) -> None:
        self._stop_before = self._submitted

    def close(self) -> None:
        self._is_closed = True
        self.stop()
        self._tasks.put(None)

    def join(self) -> None:
        if self._thread is not threading.current_thread():  # which may collect an abandoned pool
            self._thread.join()

    def _run(self) -> None:
        try:
            while (submitted := self._tasks.get()) is not None and not self._is_closed:
                self._events.put(self._compute(*submitted))
        except BaseException as error:
            self._events.put(error)
        finally:
            self._tracer = None

    def _compute(self, number: int, task: Task) -> Finished | Lost:
        if self.failure is None:
            try:
                return Finished(self.worker.name, self._tracer.trace(task, lambda: number >= self._stop_before))
            except DeviceError as error:
                self.failure = str(error)
            except MemoryError:
                self.failure = f"there is not enough memory for {self.worker.device}"
            self._tracer = None
        return Lost(self.worker.name, task.number, self.failure)
