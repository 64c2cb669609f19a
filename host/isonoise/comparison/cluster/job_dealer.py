"""Decides which worker of a cluster does which job next; called by `jobs`. Pure logic without times.

A job is a run, or a batch of a reference. Jobs come in groups: the runs of a scene and a seed go to one worker, one
after the other. Figures are ratios of strategies, paired over the seeds, so that a slow worker affects both sides of a
ratio. A worker for which no group is left helps one that has the same device, from the end of its group.
"""

from collections import deque
from collections.abc import Callable, Hashable, Iterable
from itertools import groupby
from typing import Generic, TypeVar

MAX_LOSSES = 5
"""Workers that a job may lose: one that ends its workers, by their memory for example, would end all of them."""

Job = TypeVar("Job", bound=Hashable)


class JobDealer(Generic[Job]):
    """Deals jobs to workers, one per worker at a time.

    Parameters
    ----------
    jobs : iterable
        In the wanted order.
    group : callable
        What consecutive jobs of a group have in common.

    Attributes
    ----------
    in_progress : dict
        Worker -> its job.
    """

    def __init__(self, jobs: Iterable[Job], group: Callable[[Job], object]):
        self._waiting = deque(deque(each) for _, each in groupby(jobs, key=group))  # no worker has begun these
        self._begun: dict[str, tuple[str, deque[Job]]] = {}  # worker -> its device, the rest of its group
        self._losses: dict[Job, int] = {}
        self.in_progress: dict[str, Job] = {}

    @property
    def is_done(self) -> bool:
        return not self.in_progress and not self._waiting and not any(rest for _, rest in self._begun.values())

    def next_job(self, worker: str, device: str) -> Job | None:
        """The job that the idle worker is to do now; None: nothing for it."""
        rest = self._begun[worker][1] if worker in self._begun else deque()
        if not rest and self._waiting:
            rest = self._waiting.popleft()
        self._begun[worker] = (device, rest)
        if rest:
            self.in_progress[worker] = rest.popleft()
        elif rest := self._longest_rest(device):
            self.in_progress[worker] = rest.pop()
        return self.in_progress.get(worker)

    def finished(self, worker: str) -> None:
        """The worker has done its job."""
        del self.in_progress[worker]

    def lost(self, worker: str) -> Job | None:
        """The worker is gone, and its job if it had one: others get what it has not done, before other jobs."""
        job = self.in_progress.pop(worker, None)
        rest = self._begun.pop(worker, ("", deque()))[1]
        if job is not None:
            self._losses[job] = self._losses.get(job, 0) + 1
            rest.appendleft(job)
        if rest:
            self._waiting.appendleft(rest)
        return job

    def has_failed(self, job: Job) -> bool:
        """Whether the job has lost so many workers that no other should try it."""
        return self._losses.get(job, 0) >= MAX_LOSSES

    def _longest_rest(self, device: str) -> deque[Job]:
        """The most jobs that a worker with the same device has before it."""
        rests = [rest for other, rest in self._begun.values() if other == device]
        return max(rests, key=len, default=deque())
