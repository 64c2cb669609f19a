"""What the workers of a Dask cluster run: `prepare` once a render, then `trace_task` for each of its tasks.

`dask_pool` submits these functions. The tracer that `prepare` returns stays on its worker, in Dask's own store, and
is freed with the future of the pool: when the render ends, or its process is gone.
"""

import threading
from dataclasses import dataclass

from isonoise.distributed.packing import pack_result, unpack_scene, unpack_task
from isonoise.statistics import Needs

_tracing = threading.Lock()
"""A process traces one task at a time, whatever the number of its threads: its device is busy with one."""
_stopped: dict[str, int] = {}
"""Number of a render -> tasks up to this number of stops end early."""


@dataclass(frozen=True)
class DeviceChoice:
    """One of the devices that `select_devices(choice)` returns: that of this number, modulo how many there are."""

    choice: str | None = None
    number: int = 0

    def select(self):
        """The device, a `SelectedDevice` of this process."""
        from isonoise.device.selection import select_devices

        devices = select_devices(self.choice)
        return devices[self.number % len(devices)]


@dataclass(frozen=True)
class TracerSettings:
    """What a `ShardTracer` depends on besides scene and device; its parameters."""

    needs: Needs
    seed: int
    pool_size: int | None = None
    memory: int | None = None

    def make_tracer(self, device: DeviceChoice, scene):
        """The tracer on a device of this process."""
        from isonoise.device.opencl import Device
        from isonoise.distributed.shard_tracer import ShardTracer

        return ShardTracer(Device(device.select()), scene, self.needs, self.seed, self.pool_size, self.memory)


class WorkerTracer:
    """A tracer of this process. A copy in another process, which Dask makes of a retiring worker's, is of no use."""

    def __init__(self, render: str, tracer=None):
        self.render, self.tracer = render, tracer

    def __reduce__(self):
        return WorkerTracer, (self.render,)


def prepare(
    scene: bytes, is_compressed: bool, render: str, settings: TracerSettings, device: DeviceChoice
) -> WorkerTracer:
    """Compile a scene for the device of this worker. `render` is a number of the render, unique in the cluster."""
    with _tracing:
        return WorkerTracer(render, settings.make_tracer(device, unpack_scene(scene, is_compressed)))


def device_name(tracer: WorkerTracer) -> str:
    """Name of the device that a prepared worker traces on."""
    return tracer.tracer.device.name


def trace_task(tracer: WorkerTracer, data: bytes, stops: int, compress: bool) -> bytes:
    """Compute a task that `pack_task` has packed; return its result, packed.

    `stops` counts how often the render was stopped before the task was submitted.
    """
    task = unpack_task(data)
    with _tracing:
        result = tracer.tracer.trace(task, lambda: _stopped.get(tracer.render, 0) <= stops)
    return pack_result(result, compress)


def stop(render: str, stops: int) -> None:
    """Let the tasks of a render that were submitted before its stop number `stops` end early."""
    _stopped[render] = max(stops, _stopped.get(render, 0))


def forget(render: str) -> None:
    """The render has ended."""
    _stopped.pop(render, None)
