"""What a `Dealer` knows of its workers, and what it concludes from that: who can do how much, and until when."""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

TASK_S = 0.5
"""Time that a task is meant to take in the middle of a wave."""
STEADY_TASK_SHARE, TASK_SHARE = 1 / 2, 1 / 3
"""A task is at most this share of what is left for its worker, if its speed is steady and if not: as speeds change, not
all can be planned ahead."""
STEADY = 1.25
"""A speed is steady if that of the fastest of the last tasks is at most so many times that of the slowest."""
MIN_TASK_S = 0.05
"""No task is meant to be shorter than this, unless less is left. Each takes some milliseconds beside its samples."""
CLIENT_TASK_S = 0.005
"""What a task costs the client, which handles them one after the other."""
FIRST_WORKERS = 32
"""Workers that get a task while the speed of none is known."""
MAX_DELAY = 0.1
"""A worker gets no task that would end later than all others end, by more than this share of the wave's time."""
MEASURED_TASKS = 2
"""Tasks after which the speed of a worker is known. The first one also loads the scene and compiles its kernels."""
SPEED_TASKS = 4
"""The speed of a worker is that over so many of its last tasks."""


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
class DealtTask:
    """A task that is not yet reported: `samples` of a wave, dealt at `dealt_s`."""

    assignment: Assignment
    wave: int
    samples: int
    dealt_s: float
    expected_end_s: float = 0.0


@dataclass
class WorkerRecord:
    """What is known of a worker.

    Attributes
    ----------
    tasks : deque of DealtTask
        In the order in which it computes them.
    reported : int
        How many it has finished.
    last_report_s : float
        When the last one was reported.
    speed : float or None
        Samples per second, as the client sees them; None before the first finished task.
    tracing_speed : float
        Samples per second without the time for which the worker waits for the client.
    task_share : float
        Share of what is left for the worker that its next task may be.
    """

    tasks: deque[DealtTask] = field(default_factory=deque)
    reported: int = 0
    last_report_s: float = 0.0
    speed: float | None = None
    tracing_speed: float = 0.0
    task_share: float = TASK_SHARE
    _measured: deque[tuple[int, float, float]] = field(default_factory=lambda: deque(maxlen=SPEED_TASKS))

    def measure(self, samples: int, seconds: float, worker_seconds: float) -> None:
        """Note a finished task: the time from its begin to its result, and the time that the worker took."""
        if self.reported < MEASURED_TASKS:  # the first one says little of the next ones
            self._measured.clear()
        self._measured.append((samples, max(seconds, 1e-6), max(min(worker_seconds, seconds), 1e-6)))
        self.reported += 1
        total_samples, total_s, total_worker_s = map(sum, zip(*self._measured, strict=True))
        self.speed, self.tracing_speed = total_samples / total_s, total_samples / total_worker_s
        rates = [samples / seconds for samples, seconds, _ in self._measured]
        is_steady = len(rates) == SPEED_TASKS and max(rates) <= STEADY * min(rates)
        self.task_share = STEADY_TASK_SHARE if is_steady else TASK_SHARE

    @property
    def planned_speed(self) -> float | None:
        """The speed; None while it says little."""
        return self.speed if self.reported >= MEASURED_TASKS else None


class Plan:
    """What is known at a moment: speeds, when each worker ends its tasks, and when the wave would end at best.

    A worker that has not been measured is taken to be as fast as the others are on average.
    """

    def __init__(
        self,
        ready: Sequence[str],
        workers: dict[str, WorkerRecord],
        now: float,
        wave_samples: int,
        waiting_samples: int,
    ):
        self.now, self._workers = now, workers
        self.waiting_samples = waiting_samples
        speeds = {name: workers[name].planned_speed for name in ready}
        self.measured = [name for name, speed in speeds.items() if speed is not None]
        self._used = {*self.measured, *(name for name in ready if workers[name].tasks)}
        mean = sum(speeds[name] for name in self.measured) / max(len(self.measured), 1)
        self.speeds = {name: mean if speed is None else speed for name, speed in speeds.items()}
        self._tracing_speeds = {name: workers[name].tracing_speed for name in self.measured}
        self.names_by_speed = sorted(ready, key=lambda name: -self.speeds[name])
        self._busy_until = {name: _expected_end(worker, now) for name, worker in workers.items()}
        self._first_ends: dict[int, float] = {}
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
            self._stop_sharing(name)

    def _stop_sharing(self, name: str) -> None:
        self._sharing.remove(name)
        self._total_speed -= self.speeds[name]
        self._busy_samples -= self.speeds[name] * (self._busy_until[name] - self.now)

    def task_samples(self, name: str) -> float:
        """Samples for the next task of a worker.

        The worker's part of the wave lasts until all could end together. Its task is a share of that, or all if little
        is left; more if the client cannot keep all workers busy.
        """
        part = max(self._wave_end() - self._busy_until[name], 0.0) * self.speeds[name]
        useful = self._useful_seconds() * self._tracing_speeds[name]
        if part < useful:
            is_idle = self._busy_until[name] <= self.now
            return is_idle * (useful if self.waiting_samples > 1.5 * useful else self.waiting_samples)
        least = max(MIN_TASK_S * self.speeds[name], useful)
        most = self._max_task_s * self.speeds[name]
        share = self._workers[name].task_share
        return min(max(share * part, least), most) if part >= 1.5 * least else part

    def is_useful(self, name: str) -> bool:
        """Whether the client can keep a worker busy that has not been measured, beside those that are used already."""
        most = self._useful_seconds() / CLIENT_TASK_S if self.measured else FIRST_WORKERS
        return name in self._used or len(self._used) < most

    def _useful_seconds(self) -> float:
        """The time of a task below which more tasks for more workers cost the client more time than they save.

        With k workers the rest of a wave takes W / k + k c, W the time of one worker and c `CLIENT_TASK_S`. That is
        least for k = sqrt(W / c), with tasks of sqrt(W c).
        """
        one_worker_s = self._remaining_samples() / (sum(self._tracing_speeds.values()) / len(self.measured))
        return math.sqrt(one_worker_s * CLIENT_TASK_S)

    def max_samples(self, name: str, shard_samples: int) -> float:
        """Samples that a worker can trace before it would be too late: see `MAX_DELAY`.

        They are enough for the shard if no other worker would end it earlier.
        """
        limit = (self._wave_end() + self._tolerance_s - self._busy_until[name]) * self.speeds[name]
        if shard_samples <= limit:
            return limit
        end = self._busy_until[name] + shard_samples / self.speeds[name]
        return shard_samples if end <= self._first_end(shard_samples) + self._tolerance_s else 0.0

    def _first_end(self, samples: int) -> float:
        """When the first worker could be done with so many samples."""
        if samples not in self._first_ends:
            self._first_ends[samples] = min(
                self._busy_until[name] + samples / self.speeds[name] for name in self.measured
            )
        return self._first_ends[samples]

    def add(self, name: str, dealt: DealtTask) -> None:
        """A worker has got a task."""
        self._used.add(name)
        self.waiting_samples = max(0, self.waiting_samples - dealt.samples)  # a copy was not waiting
        if self.measured:
            self._busy_until[name] += dealt.samples / self.speeds[name]
            self._first_ends.clear()
            if name in self._sharing:
                self._busy_samples += dealt.samples
                if self._busy_until[name] > self._wave_end() + self._tolerance_s and len(self._sharing) > 1:
                    self._stop_sharing(name)
        dealt.expected_end_s = self._busy_until[name]

    def _wave_end(self) -> float:
        """When the wave ends if all workers end at the same time."""
        return self.now + self._remaining_samples() / self._total_speed

    def _remaining_samples(self) -> float:
        return self.waiting_samples + max(self._busy_samples, 0.0)  # where differences of numbers are rounded


def _expected_end(worker: WorkerRecord, now: float) -> float:
    """When a worker ends its tasks; sets that of each. One that is overdue by d seconds is taken to need d more."""
    end, slowdown, speed = now, 1.0, worker.planned_speed
    for index, dealt in enumerate(worker.tasks):
        begin = max(dealt.dealt_s, worker.last_report_s) if index == 0 else end
        seconds = 0.0 if speed is None else slowdown * dealt.samples / speed
        end = begin + seconds
        if index == 0 and end < now:
            end = now + (now - end)
            slowdown = (end - begin) / seconds if seconds else 1.0
        dealt.expected_end_s = end
    return end
