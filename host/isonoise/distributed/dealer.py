"""Decides which worker gets which shards of a wave, by the speeds measured so far.

`DistributedWavefront` asks it during a render, the simulation in `simulation.py` on a virtual clock. It does nothing
but arithmetic: the caller gives the time in seconds, of any clock that does not go back.
"""

import math
from bisect import bisect_right
from collections.abc import Iterable, Sequence
from operator import itemgetter

import numpy as np

from isonoise.distributed.plan import (
    CLIENT_TASK_S,
    MEASURED_TASKS,
    MIN_TASK_S,
    Assignment,
    DealtTask,
    Plan,
    WorkerRecord,
)

MAX_TASKS = 2
"""Tasks of a worker at a time: it computes one, the other is on its way or waits."""
FIRST_TASK_SHARE = 1 / 32
"""Tasks of a worker of unknown speed, as a share of an equal part of the wave."""
FIRST_TASK_SAMPLES = 4096
"""They have at least this many samples."""
SPEED_EXPIRES_S = 60.0
"""A worker without tasks for this time is measured again: it may have become faster."""


class Dealer:
    """Deals the shards of waves to workers.

    Tasks get shorter towards the end of a wave (guided self-scheduling; Polychronopoulos and Kuck 1987, "Guided
    Self-Scheduling: A Practical Scheduling Scheme for Parallel Supercomputers"), and are in proportion to the worker's
    speed. Once all shards are dealt, an idle worker gets a copy of a task whose worker has become slow or does not
    answer (backup tasks; Dean and Ghemawat 2004, "MapReduce"). Both copies have the same result.

    Parameters
    ----------
    shard_pixels : (shards,) int array
        Pixels of every shard.
    max_pixels : int
        Pixels of a task at most, unless one shard has more.
    """

    def __init__(self, shard_pixels: np.ndarray, max_pixels: int = 2**20):
        self._shard_pixels = [int(pixels) for pixels in shard_pixels]
        self._max_pixels = max_pixels
        self._workers: dict[str, WorkerRecord] = {}
        self._dealt: dict[int, DealtTask] = {}  # by number
        self._next_number = 0
        self._wave = 0
        self.begin_wave(np.zeros(len(self._shard_pixels), np.int64))

    def begin_wave(self, samples: np.ndarray) -> None:
        """Deal `samples`, (shards,) int64, from now on.

        Results of tasks of the last wave are no longer used. Their workers stay busy until they are reported.
        """
        self._wave += 1
        self._samples = [int(number) for number in samples]
        self._wave_samples = sum(self._samples)
        self._left = {shard for shard, number in enumerate(self._samples) if number}  # without a result
        self._waiting: list[tuple[int, int]] = []  # (samples, shard) that are to be dealt, in ascending order
        self._waiting_samples = 0
        self._next_copies_s = -math.inf
        self._put_back(self._left)

    @property
    def is_done(self) -> bool:
        """Whether every shard with samples has a result."""
        return not self._left

    @property
    def is_idle(self) -> bool:
        """Whether no result of this wave is on its way. After a stop, not all shards have one."""
        return not any(dealt.wave == self._wave for dealt in self._dealt.values())

    @property
    def speeds(self) -> dict[str, float]:
        """Samples per second of the workers that have finished a task, host work and transfers included."""
        return {name: worker.speed for name, worker in self._workers.items() if worker.speed is not None}

    def finished(self, number: int, now: float, remaining: int = 0, worker_seconds: float = math.inf) -> bool:
        """A task is finished. Returns whether its result is to be used.

        It is not if another copy of the task was first or if the task is of an earlier wave. `remaining`: samples that
        the worker has not traced, because it was asked to stop. `worker_seconds`: time that the worker took.
        """
        dealt = self._dealt.pop(number)
        worker = self._workers[dealt.assignment.worker]
        worker.tasks.remove(dealt)
        if remaining < dealt.samples:
            seconds = now - max(dealt.dealt_s, worker.last_report_s)
            worker.measure(dealt.samples - remaining, seconds, worker_seconds)
        worker.last_report_s = now
        is_first = dealt.wave == self._wave and dealt.assignment.shards[0] in self._left
        if is_first:
            self._left.difference_update(dealt.assignment.shards)
        return is_first

    def lost(self, number: int, now: float) -> None:
        """A task has no result: its worker is gone or has failed. Its shards are dealt again."""
        dealt = self._dealt.pop(number)
        worker = self._workers[dealt.assignment.worker]
        worker.tasks.remove(dealt)
        worker.last_report_s = now
        shards = dealt.assignment.shards
        if dealt.wave == self._wave and shards[0] in self._left and not self._copies(shards[0]):
            self._put_back(shards)

    def deal(self, workers: Sequence[str], now: float) -> list[Assignment]:
        """Return new tasks for these workers, all that are ready now. They are to be submitted at once, in this order.

        Call it when tasks have been reported and, because it notices workers that do not answer, several times per
        second.
        """
        if self.is_done or (not self._waiting and now < self._next_copies_s):
            return []
        self._update_workers(workers, now)
        plan = Plan(workers, self._workers, now, self._wave_samples, self._waiting_samples)
        assignments = []
        for places in range(MAX_TASKS):  # idle workers first, and of these the fastest
            for name in plan.names_by_speed:
                if len(self._workers[name].tasks) == places and self._waiting:
                    assignments += self._deal_to(name, plan)
        if not self._waiting:
            assignments += self._deal_copies(plan)
            self._next_copies_s = now + MIN_TASK_S
        return assignments

    def _update_workers(self, ready: Sequence[str], now: float) -> None:
        """Forget idle workers that are not ready any more, or whose speed is old; they come back as new ones."""
        names = set(ready)
        for name, worker in list(self._workers.items()):
            is_old = worker.reported > 0 and now - worker.last_report_s > SPEED_EXPIRES_S
            if not worker.tasks and (is_old or name not in names):
                del self._workers[name]
        for name in ready:
            if name not in self._workers:
                self._workers[name] = WorkerRecord()

    def _deal_to(self, name: str, plan: Plan) -> list[Assignment]:
        """The next task of a worker, or none."""
        smallest, largest = self._waiting[0][0], self._waiting[-1][0]
        worker = self._workers[name]
        if worker.planned_speed is None:
            if worker.reported + len(worker.tasks) >= MEASURED_TASKS or not plan.is_useful(name):
                return []
            part = self._wave_samples / len(plan.speeds)
            budget = max(FIRST_TASK_SHARE * part, FIRST_TASK_SAMPLES)
            limit = max(2 * budget, smallest)
        else:
            budget, limit = plan.task_samples(name), plan.max_samples(name, smallest)
            limit = max(limit, budget)
            if largest > 2 * budget > 0 and largest <= plan.max_samples(name, largest):
                budget = limit = largest  # what takes long begins first
        if budget <= 0 or smallest > limit:
            return []
        return [self._assign(name, self._take(budget, limit), plan)]

    def _take(self, budget: float, limit: float) -> tuple[int, ...]:
        """Take shards with about `budget` samples, the largest first; at least one, and at most `limit` samples."""
        taken, pixels = [], 0
        while self._waiting:
            index = bisect_right(self._waiting, min(2 * budget, limit), key=itemgetter(0)) - 1
            if index < 0 and taken:
                break
            samples, shard = self._waiting[max(index, 0)]
            pixels += self._shard_pixels[shard]
            if taken and pixels > self._max_pixels:
                break
            del self._waiting[max(index, 0)]
            taken.append(shard)
            budget, limit = budget - samples, limit - samples
        self._waiting_samples -= sum(self._samples[shard] for shard in taken)
        return tuple(taken)

    def _assign(self, name: str, shards: tuple[int, ...], plan: Plan) -> Assignment:
        assignment = Assignment(self._next_number, name, shards)
        samples = sum(self._samples[shard] for shard in shards)
        dealt = DealtTask(assignment, self._wave, samples, plan.now)
        self._next_number += 1
        self._dealt[assignment.number] = dealt
        self._workers[name].tasks.append(dealt)
        plan.add(name, dealt)
        return assignment

    def _put_back(self, shards: Iterable[int]) -> None:
        self._waiting = sorted([*self._waiting, *((self._samples[shard], shard) for shard in shards)])
        self._waiting_samples = sum(samples for samples, _ in self._waiting)

    def _copies(self, shard: int) -> list[DealtTask]:
        """Tasks of this wave that hold the shard. Copies of a task hold the same ones."""
        return [
            dealt for dealt in self._dealt.values() if dealt.wave == self._wave and dealt.assignment.shards[0] == shard
        ]

    def _deal_copies(self, plan: Plan) -> list[Assignment]:
        """Copies of the tasks that end last, for idle workers that are sure to be faster."""
        records = self._workers
        idle = [name for name in plan.names_by_speed if records[name].planned_speed and not records[name].tasks]
        if not idle:
            return []
        ends: dict[tuple[int, ...], float] = {}
        for dealt in self._dealt.values():
            shards = dealt.assignment.shards
            if dealt.wave == self._wave and shards[0] in self._left:
                ends[shards] = min(ends.get(shards, np.inf), dealt.expected_end_s)
        assignments = []
        for shards, end in sorted(ends.items(), key=lambda item: -item[1]):
            if not idle:
                break
            seconds = sum(self._samples[shard] for shard in shards) / plan.speeds[idle[0]]
            if end - plan.now > 1.25 * seconds + MIN_TASK_S + CLIENT_TASK_S * len(self._dealt):
                assignments.append(self._assign(idle.pop(0), shards, plan))
        return assignments
