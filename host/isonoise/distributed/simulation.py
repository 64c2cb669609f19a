"""Predicts how long the waves of a distributed render take: an event-driven simulation around the real `Dealer`.

Used by tests and for the figures of host/docs/distributed.md, with costs that were measured.
"""

import heapq
import itertools
import math
from collections import defaultdict, deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from isonoise.distributed.dealer import Dealer

POLL_S = 0.1
"""The client looks after workers that do not answer at least this often."""


@dataclass(frozen=True)
class SimulatedWorker:
    """A worker.

    Attributes
    ----------
    samples_per_s : float
        While it computes.
    changes : tuple of (float, float)
        Times in seconds, ascending, from which it has another speed. Speed 0: it does not answer any more.
    joins_s, vanishes_s : float
        From when until when it exists.
    """

    samples_per_s: float
    changes: tuple[tuple[float, float], ...] = ()
    joins_s: float = 0.0
    vanishes_s: float = math.inf

    def seconds(self, samples: float, now: float) -> float:
        """Time for some samples from `now` on."""
        speeds = [(0.0, self.samples_per_s), *self.changes, (math.inf, 0.0)]
        begin = now
        for (_, speed), (end, _) in itertools.pairwise(speeds):
            if end > now:
                if speed > 0 and samples <= speed * (end - now):
                    return now - begin + samples / speed
                samples -= speed * (end - now) if speed else 0.0
                now = end
        return math.inf


@dataclass(frozen=True)
class Costs:
    """What a task and a wave cost beside the samples. All are 0 unless given.

    Attributes
    ----------
    pixel_bytes, result_bytes : float
        Of a pixel on its way to a worker and back, before compression.
    compression : float
        Compressed size / size.
    latency_s : float
        Time of a message from client to worker or back, without its bytes.
    link_bytes_per_s, client_bytes_per_s : float
        Bandwidth of the link of each worker and of the client, in each direction.
    worker_task_s, worker_pixel_s : float
        Time of the worker for a task and for each of its pixels: unpack, set the state, read it, pack.
    client_task_s, client_pixel_s : float
        Time of the client for a task and for each of its pixels, half of it before the task and half after: gather,
        pack, unpack, scatter.
    client_wave_s, client_wave_pixel_s : float
        Time of the client for a wave and for each pixel of the image: statistics, error, allocation map.
    cores : float or None
        Of the one machine that all workers and the client run on, one core each while they are busy; None: each has
        a machine of its own.
    """

    pixel_bytes: float = 0.0
    result_bytes: float = 0.0
    compression: float = 1.0
    latency_s: float = 0.0
    link_bytes_per_s: float = math.inf
    client_bytes_per_s: float = math.inf
    worker_task_s: float = 0.0
    worker_pixel_s: float = 0.0
    client_task_s: float = 0.0
    client_pixel_s: float = 0.0
    client_wave_s: float = 0.0
    client_wave_pixel_s: float = 0.0
    cores: float | None = None


@dataclass(frozen=True)
class SimulatedWave:
    """A wave that is over.

    Attributes
    ----------
    seconds : float
        From its begin to the end of the statistics after it.
    ideal_s : float
        Time in which the workers, all busy, trace the samples. `efficiency` is its share of `seconds`.
    client_s : float
        Time that the client is busy. `client_share` is its share of `seconds`.
    sent_bytes, received_bytes : int
        By the client.
    tasks, dropped : int
        Tasks dealt, and those of them whose result was not used.
    ends_s : dict of str to float
        When each worker ended its last task that was used, from the begin of the wave.
    """

    seconds: float
    ideal_s: float
    client_s: float
    sent_bytes: int
    received_bytes: int
    tasks: int
    dropped: int
    ends_s: dict[str, float]

    @property
    def efficiency(self) -> float:
        """Share of the wave that the workers spend on samples, if none joins, vanishes or changes its speed."""
        return self.ideal_s / self.seconds

    @property
    def client_share(self) -> float:
        """Share of the wave that the client is busy."""
        return self.client_s / self.seconds


class _Task(NamedTuple):
    number: int
    worker: str
    pixels: int
    samples: int


class _Clock:
    """Virtual time: timers, and work on cores that busy workers and client share equally."""

    def __init__(self, cores: float | None):
        self.now = 0.0
        self._cores = cores or math.inf
        self._done = 0.0  # seconds of work on each busy core so far
        self._timers: list[tuple[float, int, Callable]] = []
        self._jobs: list[tuple[float, int, Callable]] = []
        self._order = itertools.count()

    def after(self, seconds: float, action: Callable) -> None:
        heapq.heappush(self._timers, (self.now + seconds, next(self._order), action))

    def work(self, seconds: float, action: Callable) -> None:
        heapq.heappush(self._jobs, (self._done + seconds, next(self._order), action))

    def step(self) -> None:
        """Go on to the next event."""
        rate = min(1.0, self._cores / len(self._jobs)) if self._jobs else 1.0
        job_end = self.now + (self._jobs[0][0] - self._done) / rate if self._jobs else math.inf
        timer_end = self._timers[0][0] if self._timers else math.inf
        if job_end <= timer_end:
            self.now, self._done = job_end, self._jobs[0][0]
            heapq.heappop(self._jobs)[2]()
        else:
            self._done += (timer_end - self.now) * rate
            self.now = timer_end
            heapq.heappop(self._timers)[2]()


class _Links:
    """The links of client and workers, in one direction. A message occupies that of the client, then the worker's."""

    def __init__(self, clock: _Clock, costs: Costs):
        self._clock, self._costs = clock, costs
        self._client_free_s = 0.0
        self._worker_free_s: defaultdict[str, float] = defaultdict(float)
        self.bytes = 0.0

    def send(self, worker: str, size_bytes: float, action: Callable) -> None:
        """Call `action` when the message has arrived."""
        costs = self._costs
        begin = max(self._clock.now, self._client_free_s)
        self._client_free_s = begin + size_bytes / costs.client_bytes_per_s
        begin = max(begin, self._worker_free_s[worker])
        end = begin + size_bytes / min(costs.client_bytes_per_s, costs.link_bytes_per_s)
        self._worker_free_s[worker] = end
        self.bytes += size_bytes
        self._clock.after(end + costs.latency_s - self._clock.now, action)


class Simulation:
    """A render on some workers, wave by wave.

    Parameters
    ----------
    shard_pixels : (shards,) int array
        Pixels of every shard.
    workers : sequence of SimulatedWorker
        Their names are "0", "1", ...
    costs : Costs
        Of tasks and waves.
    dealer : Dealer or None
        None: a new one.
    """

    def __init__(
        self,
        shard_pixels: np.ndarray,
        workers: Sequence[SimulatedWorker],
        costs: Costs | None = None,
        dealer: Dealer | None = None,
    ):
        self._shard_pixels = np.asarray(shard_pixels)
        self._costs = costs or Costs()
        self.dealer = dealer or Dealer(self._shard_pixels)
        self.clock = _Clock(self._costs.cores)
        self._sent, self._received = _Links(self.clock, self._costs), _Links(self.clock, self._costs)
        self._workers = {str(index): worker for index, worker in enumerate(workers)}
        self._submitted: dict[str, list[_Task]] = {name: [] for name in self._workers}  # and not yet reported
        self._arrived: dict[str, deque[_Task]] = {name: deque() for name in self._workers}  # in the worker's queue
        self._inbox: list[tuple[_Task, bool]] = []  # tasks reported, and whether they are lost
        self._worker_seconds: dict[int, float] = {}  # by the number of the task
        self._wake: Callable | None = None  # of the client, if it waits
        for name, worker in self._workers.items():
            if worker.vanishes_s < math.inf:
                self.clock.after(worker.vanishes_s, partial(self._vanish, name))

    def wave(self, samples: np.ndarray) -> SimulatedWave:
        """Trace a wave of `samples` for each shard, (shards,) int."""
        samples = np.asarray(samples)
        begin, self._client_s = self.clock.now, 0.0
        sent, received = self._sent.bytes, self._received.bytes
        self._tasks, self._dropped, self._ends, self._is_over = 0, 0, {}, False
        self._resume(self._client(samples))
        while not self._is_over:
            self.clock.step()
        return SimulatedWave(
            seconds=self.clock.now - begin,
            ideal_s=int(samples.sum()) / self._total_speed(begin),
            client_s=self._client_s,
            sent_bytes=round(self._sent.bytes - sent),
            received_bytes=round(self._received.bytes - received),
            tasks=self._tasks,
            dropped=self._dropped,
            ends_s={name: end - begin for name, end in self._ends.items()},
        )

    def _total_speed(self, now: float) -> float:
        """Samples per second of all workers that exist, as far as there are cores for them."""
        speeds = [
            worker.samples_per_s for worker in self._workers.values() if worker.joins_s <= now < worker.vanishes_s
        ]
        return sum(speeds) * min(1.0, (self._costs.cores or math.inf) / len(speeds))

    def _client(self, samples: np.ndarray) -> Iterator[float | None]:
        """The client during a wave. Yields the seconds that it computes, or None to wait until tasks are reported."""
        costs = self._costs
        self.dealer.begin_wave(samples)
        while not self.dealer.is_done:
            reported, self._inbox = self._inbox, []
            for task, is_lost in reported:
                if is_lost:
                    self.dealer.lost(task.number, self.clock.now)
                else:
                    yield self._client_seconds(task)
                    is_used = self.dealer.finished(
                        task.number, self.clock.now, worker_seconds=self._worker_seconds.pop(task.number)
                    )
                    self._dropped += not is_used
                    self._ends |= {task.worker: self.clock.now} if is_used else {}
            for assignment in self.dealer.deal(self._ready(), self.clock.now):
                shards = list(assignment.shards)
                pixels = int(self._shard_pixels[shards].sum())
                task = _Task(assignment.number, assignment.worker, pixels, int(samples[shards].sum()))
                yield self._client_seconds(task)
                self._submit(task)
            if not self._inbox and not self.dealer.is_done:
                yield None
        yield costs.client_wave_s + costs.client_wave_pixel_s * int(self._shard_pixels.sum())
        self._is_over = True

    def _client_seconds(self, task: _Task) -> float:
        """Time of the client for a task, before it or after it."""
        return (self._costs.client_task_s + self._costs.client_pixel_s * task.pixels) / 2

    def _resume(self, client: Iterator[float | None]) -> None:
        self._wake = None
        for seconds in client:
            if seconds is None:
                self._wake = partial(self._resume, client)
                self.clock.after(POLL_S, partial(self._poll, self._wake))
                return
            if seconds > 0:
                self._client_s += seconds
                self.clock.work(seconds, partial(self._resume, client))
                return

    def _poll(self, wake: Callable) -> None:
        """Wake the client if it still waits as it did."""
        if self._wake is wake:
            wake()

    def _report(self, task: _Task, is_lost: bool = False) -> None:
        self._inbox.append((task, is_lost))
        if self._wake is not None:
            self._wake()

    def _ready(self) -> list[str]:
        now = self.clock.now
        return [name for name, worker in self._workers.items() if worker.joins_s <= now < worker.vanishes_s]

    def _submit(self, task: _Task) -> None:
        """Send a task to its worker."""
        self._tasks += 1
        if self.clock.now >= self._workers[task.worker].vanishes_s:
            self._report(task, is_lost=True)
            return
        self._submitted[task.worker].append(task)
        size_bytes = self._costs.pixel_bytes * self._costs.compression * task.pixels
        self._sent.send(task.worker, size_bytes, partial(self._arrive, task))

    def _arrive(self, task: _Task) -> None:
        self._arrived[task.worker].append(task)
        if len(self._arrived[task.worker]) == 1:
            self._compute(task)

    def _compute(self, task: _Task) -> None:
        """A worker begins a task."""
        seconds = self._costs.worker_task_s + self._costs.worker_pixel_s * task.pixels
        seconds += self._workers[task.worker].seconds(task.samples, self.clock.now)
        self._worker_seconds[task.number] = -self.clock.now
        if seconds < math.inf:
            self.clock.work(seconds, partial(self._end, task))

    def _end(self, task: _Task) -> None:
        """A worker has ended a task: it sends the result and begins the next one."""
        arrived = self._arrived[task.worker]
        if task not in arrived:
            return  # the worker has vanished
        arrived.popleft()
        self._worker_seconds[task.number] += self.clock.now
        size_bytes = self._costs.result_bytes * self._costs.compression * task.pixels
        self._received.send(task.worker, size_bytes, partial(self._receive, task))
        if arrived:
            self._compute(arrived[0])

    def _receive(self, task: _Task) -> None:
        if task in self._submitted[task.worker]:
            self._submitted[task.worker].remove(task)
            self._report(task)

    def _vanish(self, name: str) -> None:
        self._arrived[name].clear()
        submitted, self._submitted[name] = self._submitted[name], []
        for task in submitted:
            self._report(task, is_lost=True)
