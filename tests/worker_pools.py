"""A pool of workers without threads or processes, for tests of distributed renders."""

import itertools
from collections import deque
from collections.abc import Callable

from isonoise.device.opencl import Device
from isonoise.distributed.shard_tracer import ShardTracer
from isonoise.distributed.task import Task
from isonoise.distributed.worker_pool import Finished, Lost, Worker

STOPPED_AFTER = 3
"""Calls of `should_continue` that return True in a task that is asked to end early."""


class InlinePool:
    """A `WorkerPool` whose workers share a tracer. Every second call of `wait` computes the oldest task.

    Parameters
    ----------
    names : names of the workers; the list may change during the render
    tracer : computes the tasks
    on_task : called with the worker and the task before a task is computed; the task is lost if it returns True
    """

    def __init__(self, names: list[str], tracer: ShardTracer, on_task: Callable[[str, Task], bool | None]):
        self.names, self._tracer, self._on_task = names, tracer, on_task
        self._tasks: deque[tuple[str, Task]] = deque()
        self._is_due = False
        self._to_stop = 0  # tasks that end early
        self.is_closed = False

    def workers(self) -> list[Worker]:
        return [Worker(name, "a device") for name in self.names]

    def submit(self, worker: str, task: Task) -> None:
        self._tasks.append((worker, task))

    def wait(self, timeout_s: float) -> list[Finished | Lost]:
        self._is_due = not self._is_due
        if self._is_due or not self._tasks:
            return []
        worker, task = self._tasks.popleft()
        left = itertools.repeat(True, STOPPED_AFTER) if self._to_stop else itertools.repeat(True)
        self._to_stop = max(self._to_stop - 1, 0)
        if self._on_task(worker, task):
            return [Lost(worker, task.number, "lost by the test")]
        return [Finished(worker, self._tracer.trace(task, lambda: next(left, False)))]

    def stop(self) -> None:
        self._to_stop = len(self._tasks)

    def close(self) -> None:
        self.is_closed = True


class InlineCluster:
    """Stands for a `Cluster` in `Renderer(cluster=...)`.

    Parameters
    ----------
    workers : how many
    on_task : as for `InlinePool`

    Attributes
    ----------
    pools : list of InlinePool
        One for each render.
    """

    name = "inline"

    def __init__(
        self,
        workers: int = 2,
        on_task: Callable[[str, Task], bool | None] = lambda worker, task: None,
    ):
        self.names = [f"worker {number}" for number in range(workers)]
        self._on_task = on_task
        self.pools: list[InlinePool] = []

    def pool(self, scene, needs, pool_size, memory, *_) -> InlinePool:
        tracer = ShardTracer(Device(), scene, needs, pool_size, memory)
        self.pools.append(InlinePool(self.names, tracer, self._on_task))
        return self.pools[-1]
