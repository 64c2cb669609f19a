"""Decides which worker gets which shards of a wave, by the speeds measured so far.

`DistributedWavefront` asks it during a render, the simulation in `simulation.py` on a virtual clock. It does nothing
but arithmetic: the caller gives the time in seconds, of any clock that does not go back.
"""

import math
from bisect import bisect_right
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from operator import itemgetter

import numpy as np

TASK_S = 0.5
"""Time that a task is meant to take in the middle of a wave."""
MAX_TASK_SHARE = 1 / 3
"""A task is at most this share of what is left for its worker: as speeds change, not all can be planned ahead."""
MIN_TASK_S = 0.05
"""No task is meant to be shorter than this, unless less is left. Each takes some milliseconds beside its samples."""
CLIENT_TASK_S = 0.005
"""What a task costs the client, which handles them one after the other."""
MAX_TASKS = 2
"""Tasks of a worker at a time: it computes one, the other is on its way or waits."""
MEASURED_TASKS = 2
"""Tasks after which the speed of a worker is known. The first one also loads the scene and compiles its kernels."""
FIRST_WORKERS = 32
"""Workers that get a task while the speed of none is known."""
FIRST_TASK_SHARE = 1 / 32
"""Tasks of a worker of unknown speed, as a share of an equal part of the wave."""
FIRST_TASK_SAMPLES = 4096
"""They have at least this many samples."""
MAX_DELAY = 0.1
"""A worker gets no task that would end later than all others end, by more than this share of the wave's time."""
SPEED_TASKS = 4
"""The speed of a worker is that over so many of its last tasks."""
SPEED_EXPIRES_S = 60.0
"""A worker without tasks for this time is measured again: it may have become faster."""


@dataclass(frozen=True)
class Assignment:
    """A task for a worker.

    Attributes
    ----------
    number : int
        Of the task, unique in a render.
    worker : str
        Its name.
    shards : tuple of int
        What to trace, each shard with all its samples of the wave.
    """

    number: int
    worker: str
    shards: tuple[int, ...]


@dataclass
class _Dealt:
    """A task that is not yet reported: `samples` of a wave, dealt at `dealt_s`."""

    assignment: Assignment
    wave: int
    samples: int
    dealt_s: float
    expected_end_s: float = 0.0


@dataclass
class _Worker:
    tasks: deque[_Dealt] = field(default_factory=deque)  # in the order in which it computes them
    measured: deque[tuple[int, float]] = field(default_factory=lambda: deque(maxlen=SPEED_TASKS))  # samples, seconds
    reported: int = 0  # tasks
    last_report_s: float = 0.0

    def speed(self) -> float | None:
        """Samples per second; None if nothing has been measured."""
        seconds = sum(seconds for _, seconds in self.measured)
        return sum(samples for samples, _ in self.measured) / seconds if self.measured else None

    def planned_speed(self) -> float | None:
        """Samples per second; None while unknown."""
        return self.speed() if self.reported >= MEASURED_TASKS else None


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
        self._workers: dict[str, _Worker] = {}
        self._dealt: dict[int, _Dealt] = {}  # by number
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
        speeds = {name: worker.speed() for name, worker in self._workers.items()}
        return {name: speed for name, speed in speeds.items() if speed is not None}

    def finished(self, number: int, now: float, remaining: int = 0) -> bool:
        """A task is finished. Returns whether its result is to be used.

        It is not if another copy of the task was first or if the task is of an earlier wave. `remaining`: samples that
        the worker has not traced, because it was asked to stop.
        """
        dealt = self._dealt.pop(number)
        worker = self._workers[dealt.assignment.worker]
        worker.tasks.remove(dealt)
        if remaining < dealt.samples:
            if worker.reported == 1:
                worker.measured.clear()
            seconds = now - max(dealt.dealt_s, worker.last_report_s)
            worker.measured.append((dealt.samples - remaining, max(seconds, 1e-6)))
            worker.reported += 1
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
        for name in workers:
            worker = self._workers.setdefault(name, _Worker())
            if worker.reported and not worker.tasks and now - worker.last_report_s > SPEED_EXPIRES_S:
                self._workers[name] = _Worker()
        for name in self._workers.keys() - set(workers):
            if not self._workers[name].tasks:
                del self._workers[name]  # it comes back as a new one
        if self.is_done:
            return []
        plan = _Plan(workers, self._workers, now, self._wave_samples, self._waiting_samples)
        assignments = []
        for places in range(MAX_TASKS):  # idle workers first, and of these the fastest
            for name in plan.names_by_speed:
                if len(self._workers[name].tasks) == places and self._waiting:
                    assignments += self._deal_to(name, plan)
        if not self._waiting:
            assignments += self._deal_copies(plan)
        return assignments

    def _deal_to(self, name: str, plan: "_Plan") -> list[Assignment]:
        """The next task of a worker, or none."""
        smallest, largest = self._waiting[0][0], self._waiting[-1][0]
        worker = self._workers[name]
        if worker.planned_speed() is None:
            if worker.reported + len(worker.tasks) >= MEASURED_TASKS or not plan.is_useful(name):
                return []
            part = self._wave_samples / len(plan.speeds)
            budget = max(FIRST_TASK_SHARE * part, FIRST_TASK_SAMPLES)
            limit = max(2 * budget, smallest)
        else:
            budget, limit = plan.task_samples(name), plan.max_samples(name, smallest)
            if largest > 2 * budget and largest <= plan.max_samples(name, largest):
                budget = limit = largest  # what takes long begins first
        if smallest > limit:
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

    def _assign(self, name: str, shards: tuple[int, ...], plan: "_Plan") -> Assignment:
        assignment = Assignment(self._next_number, name, shards)
        samples = sum(self._samples[shard] for shard in shards)
        dealt = _Dealt(assignment, self._wave, samples, plan.now)
        self._next_number += 1
        self._dealt[assignment.number] = dealt
        self._workers[name].tasks.append(dealt)
        plan.add(name, dealt)
        return assignment

    def _put_back(self, shards) -> None:
        self._waiting = sorted([*self._waiting, *((self._samples[shard], shard) for shard in shards)])
        self._waiting_samples = sum(samples for samples, _ in self._waiting)

    def _copies(self, shard: int) -> list[_Dealt]:
        """Tasks of this wave that hold the shard. Copies of a task hold the same ones."""
        return [
            dealt for dealt in self._dealt.values() if dealt.wave == self._wave and dealt.assignment.shards[0] == shard
        ]

    def _deal_copies(self, plan: "_Plan") -> list[Assignment]:
        """Copies of the tasks that end last, for idle workers that are sure to be faster."""
        idle = [name for name in plan.names_by_speed if not self._workers[name].tasks and name in plan.measured]
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


class _Plan:
    """What is known at a moment: speeds, when each worker ends its tasks, and when the wave would end at best.

    A worker that has not been measured is taken to be as fast as the others are on average.
    """

    def __init__(
        self, ready: Sequence[str], workers: dict[str, _Worker], now: float, wave_samples: int, waiting_samples: int
    ):
        self.now = now
        self.waiting_samples = waiting_samples
        speeds = {name: workers[name].planned_speed() for name in ready}
        self._used = {name for name in ready if speeds[name] is not None or workers[name].tasks}
        self.measured = {name for name, speed in speeds.items() if speed is not None}
        mean = sum(speeds[name] for name in self.measured) / max(len(self.measured), 1)
        self.speeds = {name: mean if speed is None else speed for name, speed in speeds.items()}
        self.names_by_speed = sorted(ready, key=lambda name: -self.speeds[name])
        self._busy_until = {name: _expected_end(worker, now) for name, worker in workers.items()}
        self._max_task_s = max(TASK_S, len(ready) * CLIENT_TASK_S)
        if self.measured:
            self._find_sharing()
            self._tolerance_s = MAX_DELAY * wave_samples / self._total_speed

    def _find_sharing(self) -> None:
        """Find the workers that share what waits: without those that are busy for longer than the rest needs."""
        self._sharing = set(self.speeds)
        self._total_speed = sum(self.speeds.values())
        self._busy_samples = sum(speed * (self._busy_until[name] - self.now) for name, speed in self.speeds.items())
        for name in sorted(self.speeds, key=lambda name: -self._busy_until[name])[:-1]:
            if self._busy_until[name] <= self._wave_end():
                break
            self._sharing.remove(name)
            self._total_speed -= self.speeds[name]
            self._busy_samples -= self.speeds[name] * (self._busy_until[name] - self.now)

    def task_samples(self, name: str) -> float:
        """Samples for the next task of a worker.

        The worker's part of the wave lasts until all could end together. Its task is a share of that, or all if little
        is left.
        """
        part_s = self._wave_end() - self._busy_until[name]
        min_task_s = max(MIN_TASK_S, self._least_useful_seconds())
        if part_s >= 1.5 * min_task_s:
            part_s = min(max(MAX_TASK_SHARE * part_s, min_task_s), self._max_task_s)
        return max(part_s, 0.0) * self.speeds[name]

    def is_useful(self, name: str) -> bool:
        """Whether the client can keep a worker busy that has not been measured, beside those that are used already."""
        if not self.measured:
            workers = FIRST_WORKERS
        else:
            workers = self._remaining_samples() / self._total_speed * len(self._sharing) / self._least_useful_seconds()
        return name in self._used or len(self._used) < workers

    def max_samples(self, name: str, shard_samples: int) -> float:
        """Samples that a worker can trace before it would be too late: see `MAX_DELAY`.

        They are enough for the shard if no other worker would end it earlier.
        """
        limit = (self._wave_end() + self._tolerance_s - self._busy_until[name]) * self.speeds[name]
        if shard_samples <= limit:
            return limit
        first_end = min(self._busy_until[other] + shard_samples / self.speeds[other] for other in self.measured)
        end = self._busy_until[name] + shard_samples / self.speeds[name]
        return shard_samples if end <= first_end + self._tolerance_s else 0.0

    def add(self, name: str, dealt: _Dealt) -> None:
        """A worker has got a task."""
        self._used.add(name)
        self.waiting_samples = max(0, self.waiting_samples - dealt.samples)  # a copy was not waiting
        if self.measured:
            self._busy_until[name] += dealt.samples / self.speeds[name]
            if name in self._sharing:
                self._busy_samples += dealt.samples
            if self._busy_until[name] > self._wave_end() + self._tolerance_s:
                self._find_sharing()
        dealt.expected_end_s = self._busy_until[name]

    def _wave_end(self) -> float:
        """When the wave ends if all workers end at the same time, or as many of them as the client can keep busy."""
        return self.now + max(self._remaining_samples() / self._total_speed, self._least_useful_seconds())

    def _remaining_samples(self) -> float:
        return self.waiting_samples + max(self._busy_samples, 0.0)  # where differences of numbers are rounded

    def _least_useful_seconds(self) -> float:
        """The time of a task below which more tasks for more workers cost the client more time than they save.

        With k workers the rest of a wave takes W / k + k c, W the time of one worker and c `CLIENT_TASK_S`. That is
        least for k = sqrt(W / c), with tasks of sqrt(W c).
        """
        return math.sqrt(CLIENT_TASK_S * self._remaining_samples() * len(self._sharing) / self._total_speed)


def _expected_end(worker: _Worker, now: float) -> float:
    """When a worker ends its tasks; sets that of each. One that is overdue by d seconds is taken to need d more."""
    end, slowdown, speed = now, 1.0, worker.planned_speed()
    for index, dealt in enumerate(worker.tasks):
        begin = max(dealt.dealt_s, worker.last_report_s) if index == 0 else end
        seconds = 0.0 if speed is None else slowdown * dealt.samples / speed
        end = begin + seconds
        if index == 0 and end < now:
            end = now + (now - end)
            slowdown = (end - begin) / seconds if seconds else 1.0
        dealt.expected_end_s = end
    return end
