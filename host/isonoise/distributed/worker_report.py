"""What the workers of a render have done: counted by `DistributedWavefront`, shown by `isonoise render`."""

from collections.abc import Collection
from dataclasses import dataclass

from isonoise.distributed.worker_pool import Worker


@dataclass(frozen=True)
class WorkerReport:
    """What a worker has done so far.

    Attributes
    ----------
    name, device : str
        As of `Worker`.
    is_ready : bool
        Whether it is there and takes tasks.
    samples : int
        Samples of its finished tasks.
    seconds : float
        Time that it took for them.
    tasks, lost : int
        Finished tasks, and tasks that it was given and has not finished, so that others had to compute them.
    """

    name: str
    device: str
    is_ready: bool
    samples: int
    seconds: float
    tasks: int
    lost: int

    @property
    def samples_per_s(self) -> float | None:
        """Its speed; None before its first finished task."""
        return self.samples / self.seconds if self.seconds > 0 else None


class WorkerTally:
    """Counts the tasks of workers, which may come and go."""

    def __init__(self):
        self._counts: dict[str, _Counts] = {}
        self._ready: set[str] = set()
        self._active: set[str] = set()  # since the last call of `count_active`

    def update(self, ready: Collection[Worker]) -> None:
        """Note the workers that are there now; before they are given tasks."""
        self._ready = {worker.name for worker in ready}
        for worker in ready:
            self._counts.setdefault(worker.name, _Counts(worker.device))

    def finished(self, worker: str, samples: int, seconds: float) -> None:
        """Count a finished task of the worker with this name."""
        counts = self._counts[worker]
        counts.samples += samples
        counts.seconds += seconds
        counts.tasks += 1
        if samples:
            self._active.add(worker)

    def lost(self, worker: str) -> None:
        """Count a lost task."""
        self._counts[worker].lost += 1

    def count_active(self) -> int:
        """How many workers have traced samples since the last call."""
        number = len(self._active)
        self._active.clear()
        return number

    def reports(self) -> list[WorkerReport]:
        """A report for every worker that has been there, in the order in which they came."""
        return [
            WorkerReport(name, is_ready=name in self._ready, **vars(counts)) for name, counts in self._counts.items()
        ]


@dataclass
class _Counts:
    device: str
    samples: int = 0
    seconds: float = 0.0
    tasks: int = 0
    lost: int = 0
