"""What the coordinator knows of workers, whether they are devices of this machine or processes of a cluster."""

from dataclasses import dataclass
from typing import Protocol

from isonoise.distributed.task import Task, TaskResult


@dataclass(frozen=True)
class Worker:
    """A worker that is ready for tasks.

    Attributes
    ----------
    name : str
        Unique in the pool: the address of a process, or the number of a device.
    device : str
        Name of its OpenCL device, or of the one that it has a part of, and of the platform.
    """

    name: str
    device: str


@dataclass(frozen=True)
class Finished:
    """A worker has finished a task."""

    worker: str
    result: TaskResult


@dataclass(frozen=True)
class Lost:
    """A task has no result, and some worker has to compute it again: its worker is gone or has failed."""

    worker: str
    task: int
    reason: str


class WorkerPool(Protocol):
    """Workers that have the scene. `DevicePool` and `DaskPool` are such pools."""

    def workers(self) -> list[Worker]:
        """Those that are ready now. They may change at any time."""

    def submit(self, worker: str, task: Task) -> None:
        """Send a task to a worker, which computes its tasks one after the other. Returns at once."""

    def wait(self, timeout_s: float) -> list[Finished | Lost]:
        """What has happened since the last call; waits until something has. Empty after `timeout_s` seconds.

        Every submitted task is reported exactly once. Raises DeviceError if no worker can ever finish a task: the
        connection to the cluster is lost, or the last device has failed.
        """

    def stop(self) -> None:
        """Ask the workers to end their tasks early if they can, and report them as finished, until the next task."""

    def close(self) -> None:
        """Free the devices, or tell the cluster to forget the scene. Submitted tasks are dropped."""
