"""What the workers of a Dask cluster run for `dask_pool`: a `TracerActor` for each render.

An actor is an object that stays on its worker, and whose methods the client calls. Data go from the client to the
worker and back, and not through the scheduler. Dask frees the actor when the pool drops it, or its process is gone.
"""

import threading
from dataclasses import dataclass

from isonoise import __version__
from isonoise.distributed.packing import pack_result, unpack_scene, unpack_task
from isonoise.heap import keep_freed_memory
from isonoise.statistics import Needs

_tracing = threading.Lock()
"""A process compiles or traces one thing at a time: its device is busy with it."""


def other_version(version: str | None) -> str:
    """What is wrong with a process of the cluster that has this version of isonoise, or None."""
    has = f"has isonoise {version}" if version else "has no isonoise"
    return f"{has}, and this machine {__version__}; install the same version on all machines of the cluster"


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
    """What a `ShardTracer` depends on besides scene and device: its parameters."""

    needs: Needs
    pool_size: int | None = None
    memory: int | None = None

    def make_tracer(self, device: DeviceChoice, scene):
        """The tracer on a device of this process."""
        from isonoise.device.opencl import Device, store_programs
        from isonoise.device.pocl_cache import store_pocl_kernels
        from isonoise.distributed.shard_tracer import ShardTracer

        tracer = ShardTracer(Device(device.select()), scene, self.needs, self.pool_size, self.memory)
        store_programs()  # now, because Dask's processes end without the functions of `atexit`
        store_pocl_kernels()
        return tracer


class TracerActor:
    """A scene on the device of a worker. `scene` is what `pack_scene` has packed."""

    def __init__(self, scene: bytes, is_compressed: bool, settings: TracerSettings, device: DeviceChoice):
        keep_freed_memory()
        with _tracing:
            self._tracer = settings.make_tracer(device, unpack_scene(scene, is_compressed))
        self._stops = 0

    def device_name(self) -> str:
        """Name of the device, or of the one that it is a part of."""
        return self._tracer.device.selected.whole_name

    def trace(self, data: bytes, stops: int, compress: bool) -> bytes:
        """Compute a task that `pack_task` has packed; return its result, packed.

        `stops` counts how often the pool was stopped before it submitted the task.
        """
        task = unpack_task(data)
        with _tracing:
            result = self._tracer.trace(task, lambda: self._stops <= stops)
        return pack_result(result, compress)

    async def stop(self, stops: int) -> None:
        """Let tasks that were submitted before the stop of this number end early. Runs beside `trace`."""
        self._stops = max(self._stops, stops)
