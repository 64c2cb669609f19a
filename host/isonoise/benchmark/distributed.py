"""Measures what a distributed render costs on this machine, and predicts renders with more workers and larger images.

`python -m isonoise.benchmark.distributed` prints the tables of host/docs/distributed.md.
"""

import argparse
import itertools
import math
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from statistics import median

import numpy as np

from isonoise.benchmark.wave_costs import measure_wave_costs
from isonoise.device.opencl import Device
from isonoise.distributed.cluster import Cluster
from isonoise.distributed.distributed_wavefront import DistributedWavefront
from isonoise.distributed.packing import pack_result, pack_task, unpack_result, unpack_task
from isonoise.distributed.shards import Shards
from isonoise.distributed.simulation import Costs, SimulatedWave, SimulatedWorker, Simulation
from isonoise.distributed.task import Task, TaskResult
from isonoise.distributed.worker_pool import Lost, Worker, WorkerPool
from isonoise.integrator.reduction_state import state_planes
from isonoise.scene import compile_scene, load_description
from isonoise.scene.compiled_scene import CompiledScene
from isonoise.statistics import BASIC_NEEDS, Needs
from isonoise.tables import Table, columns, markdown_table

SEED = 1
REPEAT = 5
"""Times that everything is measured; the median counts."""
WORKERS = (4, 16, 64, 256, 1024)
"""Numbers of workers that are predicted."""
CLIENTS = 8
"""Clients of the last prediction."""
FIRST_SAMPLES, MORE_SAMPLES = 1, 32
"""Samples per pixel of the first of two tasks, and how many more the other one has."""
MAX_BUSY_SAMPLES = 2**16
"""Samples per pixel of the tasks that keep workers busy; they are stopped."""
IMAGES = (512, 512), (1080, 1920), (4320, 7680)
"""Height and width of the images that are predicted."""


@dataclass(frozen=True)
class Measurement:
    """What one worker of this machine costs.

    Attributes
    ----------
    samples_per_s : float
        Speed of the worker.
    costs : Costs
        Of its tasks, uncompressed as on this machine, without those of a wave.
    compression : float
        Compressed size / size, of tasks and results together.
    client_compression_s, worker_compression_s : float
        Time that compression adds for a pixel.
    """

    samples_per_s: float
    costs: Costs
    compression: float
    client_compression_s: float
    worker_compression_s: float

    def over_network(self, bytes_per_s: float) -> Costs:
        """The costs with compression and links of this bandwidth."""
        return replace(
            self.costs,
            compression=self.compression,
            client_pixel_s=self.costs.client_pixel_s + self.client_compression_s,
            worker_pixel_s=self.costs.worker_pixel_s + self.worker_compression_s,
            link_bytes_per_s=bytes_per_s,
            client_bytes_per_s=bytes_per_s,
        )


class FirstWorkers:
    """The first `number` workers of a pool, as a pool of their own."""

    def __init__(self, pool: WorkerPool, number: int):
        self._pool, self.number = pool, number
        self.submit, self.wait, self.stop, self.close = pool.submit, pool.wait, pool.stop, pool.close

    def workers(self) -> list[Worker]:
        """Those of them that are ready."""
        return sorted(self._pool.workers(), key=lambda worker: worker.name)[: self.number]


class TimedRender:
    """A render on some of the workers of a pool."""

    def __init__(self, pool: WorkerPool, scene: CompiledScene, needs: Needs):
        self.pool, self.needs = FirstWorkers(pool, 1), needs
        self.shape = scene.height, scene.width
        self._wavefront = DistributedWavefront(Device(), scene, needs, self.pool)

    def time_waves(self, workers: int, samples: int, waves: int) -> list[float]:
        """Seconds of uniform waves on so many workers, after one that measures their speeds."""
        self.pool.number = workers
        seconds = []
        for _ in range(1 + waves):
            remaining = np.full(self.shape, samples, np.uint32)
            start = time.perf_counter()
            self._wavefront.trace(remaining)
            seconds.append(time.perf_counter() - start)
        return seconds[1:]

    def client_seconds(self) -> tuple[float, float]:
        """CPU time of this process, all its threads together, for a task and for a pixel of a task."""
        self.pool.number = 1
        one_pixel = np.zeros(self.shape, np.uint32)
        one_pixel[0, 0] = 1
        task_s = _cpu_seconds(lambda: self._wavefront.trace(one_pixel.copy()))
        tasks = self._tasks()
        image_s = _cpu_seconds(lambda: self._wavefront.trace(np.ones(self.shape, np.uint32)))
        tasks = (self._tasks() - tasks) / REPEAT
        return task_s, max(image_s - tasks * task_s, 0.0) / one_pixel.size

    def _tasks(self) -> int:
        return sum(report.tasks for report in self._wavefront.worker_reports())


class _OneWorker:
    """Sends tasks to one worker, one at a time, while others are kept busy as in a render."""

    def __init__(self, pool: WorkerPool, needs: Needs):
        self._pool, self._needs = pool, needs
        self._name, *self._others = (worker.name for worker in pool.workers())
        self._next_number = 2**20  # no task of a `Dealer` has these
        self._submitted: set[int] = set()  # and not yet reported

    def empty_state(self, pixels: int) -> dict[str, np.ndarray]:
        """The state of pixels without samples."""
        return {
            name: np.zeros((planes, pixels), np.uint32 if name in ("count", "rejected") else np.float32)
            for name, planes in state_planes(self._needs).items()
        }

    def trace(self, pixels: np.ndarray, samples: int, state: dict[str, np.ndarray]) -> tuple[Task, TaskResult, float]:
        """Trace so many samples of each pixel; return task, result, and the seconds for which this process waited."""
        start, start_cpu = time.perf_counter(), time.process_time()
        task = self._submit(self._name, pixels, samples, state)
        result = self._wait(task.number)
        busy_s = time.process_time() - start_cpu
        return task, result, time.perf_counter() - start - busy_s

    def begin_others(self, pixels: np.ndarray) -> None:
        """Let the other workers trace until `stop_others`."""
        for name in self._others:
            self._submit(name, pixels, MAX_BUSY_SAMPLES, self.empty_state(len(pixels)))

    def stop_others(self) -> None:
        """Let them stop, and wait until they have."""
        self._pool.stop()
        while self._submitted:
            self._wait(next(iter(self._submitted)))

    def _submit(self, worker: str, pixels: np.ndarray, samples: int, state: dict[str, np.ndarray]) -> Task:
        self._next_number += 1
        task = Task(self._next_number, pixels, np.full(len(pixels), samples, np.uint32), state, SEED)
        self._pool.submit(worker, task)
        self._submitted.add(task.number)
        return task

    def _wait(self, number: int) -> TaskResult:
        """Wait for the result of a task; results of others are dropped."""
        result = None
        while number in self._submitted:
            for event in self._pool.wait(1.0):
                if isinstance(event, Lost):
                    raise RuntimeError(event.reason)
                self._submitted.discard(event.result.number)  # a late result of the render has another number
                result = event.result if event.result.number == number else result
        return result


class _Packed:
    """Bytes of a task and its result, and the time that client and worker take to pack and unpack them."""

    def __init__(self, task: Task, result: TaskResult, compress: bool):
        task_data, result_data = pack_task(task, compress), pack_result(result, compress)
        self.task_bytes, self.result_bytes = len(task_data), len(result_data)
        self.client_s = _cpu_seconds(lambda: pack_task(task, compress))
        self.client_s += _cpu_seconds(lambda: unpack_result(result_data))
        self.worker_s = _cpu_seconds(lambda: unpack_task(task_data))
        self.worker_s += _cpu_seconds(lambda: pack_result(result, compress))


def _cpu_seconds(function: Callable[[], object]) -> float:
    """CPU time of a call, the median of some."""
    times = []
    for _ in range(REPEAT):
        start = time.process_time()
        function()
        times.append(time.process_time() - start)
    return median(times)


def measure(render: TimedRender, workers: int) -> Measurement:
    """Measure the first of so many workers, while the others trace as well: on one machine they share its memory."""
    render.pool.number = workers
    worker, shards = _OneWorker(render.pool, render.needs), Shards(render.shape)
    one_pixel = shards.pixels([0])[:1]
    pixels = shards.pixels(range(max(shards.number // 4, 1)))
    n = len(pixels)
    _, first, _ = worker.trace(pixels, 16, worker.empty_state(n))
    _, first_of_one, _ = worker.trace(one_pixel, 16, worker.empty_state(1))
    few, many, tiny = [], [], []
    worker.begin_others(pixels)
    for _ in range(REPEAT):
        few.append(worker.trace(pixels, FIRST_SAMPLES, first.state))
        many.append(worker.trace(pixels, FIRST_SAMPLES + MORE_SAMPLES, first.state))
        tiny.append(worker.trace(one_pixel, 1, first_of_one.state))
    worker.stop_others()
    few_s, many_s, tiny_s = (median(wait for _, _, wait in tasks) for tasks in (few, many, tiny))
    speed = MORE_SAMPLES * n / (many_s - few_s)
    task_s = median(result.seconds for _, result, _ in tiny)
    client_task_s, client_pixel_s = render.client_seconds()
    plain, compressed = (_Packed(*few[0][:2], compress) for compress in (False, True))
    costs = Costs(
        pixel_bytes=plain.task_bytes / n,
        result_bytes=plain.result_bytes / n,
        latency_s=max(tiny_s - task_s, 0.0) / 2,
        worker_task_s=task_s,
        worker_pixel_s=max(few_s - tiny_s - FIRST_SAMPLES * n / speed, 0.0) / n,
        client_task_s=client_task_s,
        client_pixel_s=client_pixel_s,
    )
    return Measurement(
        speed,
        costs,
        compression=(compressed.task_bytes + compressed.result_bytes) / (plain.task_bytes + plain.result_bytes),
        client_compression_s=(compressed.client_s - plain.client_s) / n,
        worker_compression_s=(compressed.worker_s - plain.worker_s) / n,
    )


def wait_for_workers(pool: WorkerPool, number: int) -> None:
    """Wait until so many workers of a pool are ready."""
    while len(pool.workers()) < number:
        time.sleep(0.1)


def simulate_waves(
    shape: tuple[int, int], samples: int, workers: int, samples_per_s: float, costs: Costs, waves: int = 1
) -> list[SimulatedWave]:
    """What `TimedRender.time_waves` would measure with such workers and costs."""
    shards = Shards(shape)
    simulation = Simulation(shards.sizes, [SimulatedWorker(samples_per_s)] * workers, costs)
    return [simulation.wave(samples * shards.sizes) for _ in range(1 + waves)][1:]


def measure_and_simulate(render: TimedRender, workers: int, samples: int, waves: int) -> tuple[float, float]:
    """Median seconds of waves on so many workers of this machine, measured and simulated.

    The speed of a worker is measured before and after the waves while as many workers trace: it is that of its share of
    the cores, and it changes from minute to minute.
    """
    before = measure(render, workers)
    seconds = median(render.time_waves(workers, samples, waves))
    speed = (before.samples_per_s + measure(render, workers).samples_per_s) / 2
    simulated = simulate_waves(render.shape, samples, workers, speed, before.costs, waves)
    return seconds, median(wave.seconds for wave in simulated)


def _print_measurement(measured: Measurement) -> None:
    costs = measured.costs
    rows = [
        ("speed of a worker", f"{measured.samples_per_s / 1e6:.2f} M samples/s"),
        ("a pixel on its way to a worker, and back", f"{costs.pixel_bytes:.0f} B, {costs.result_bytes:.0f} B"),
        ("compressed to", f"{100 * measured.compression:.0f} %"),
        ("latency of a message", _milliseconds(costs.latency_s)),
        ("worker, for a task", _milliseconds(costs.worker_task_s)),
        ("worker, for a pixel of a task", _nanoseconds(costs.worker_pixel_s)),
        ("client, for a task", _milliseconds(costs.client_task_s)),
        ("client, for a pixel of a task", _nanoseconds(costs.client_pixel_s)),
        ("compression, for a pixel, of the client", _nanoseconds(measured.client_compression_s)),
        ("compression, for a pixel, of the worker", _nanoseconds(measured.worker_compression_s)),
        ("statistics, errors and map, for a pixel of the image", _nanoseconds(costs.client_wave_pixel_s)),
    ]
    _print_table(("what", "measured"), rows)


def _milliseconds(seconds: float) -> str:
    return f"{1e3 * seconds:.1f} ms"


def _nanoseconds(seconds: float) -> str:
    return f"{1e9 * seconds:.0f} ns"


def _print_table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    print(markdown_table(Table(columns(*heads), rows)), end="\n\n")


def _print_check(render: TimedRender, alone: Measurement, cores: int) -> None:
    """Measured and simulated waves on the workers of this machine."""
    rows = []
    for workers, samples in itertools.product((1, 2, 4), (16, 64)):
        seconds, simulated = measure_and_simulate(render, workers, samples, REPEAT)
        ideal_s = samples * math.prod(render.shape) / (min(workers, cores) * alone.samples_per_s)
        times = f"{seconds:.3f}", f"{simulated:.3f}", f"{ideal_s / seconds:.2f}"
        rows.append((str(workers), str(samples), *times))
    _print_table(("workers", "spp", "measured [s]", "simulated [s]", "measured efficiency"), rows)


def _print_predictions(speed: float, costs: Costs) -> None:
    """Waves with many workers, each on a machine of its own."""
    rows = []
    for (height, width), samples in itertools.product(IMAGES, (16, 256, 4096)):
        waves = [simulate_waves((height, width), samples, workers, speed, costs)[0] for workers in WORKERS]
        size_mb = (waves[0].sent_bytes + waves[0].received_bytes) / 1e6
        efficiencies = (f"{wave.efficiency:.2f}" for wave in waves)
        rows.append((f"{width}x{height}", str(samples), f"{size_mb:.0f}", f"{waves[0].client_s:.2f}", *efficiencies))
    _print_table(("image", "spp", "MB", "client [s]", *map(str, WORKERS)), rows)


def _print_changes(measured: Measurement, speed: float, bytes_per_s: float) -> None:
    """The largest image on the most workers, with one change after the other."""
    compressed = measured.over_network(bytes_per_s)
    plain = replace(measured.costs, link_bytes_per_s=bytes_per_s, client_bytes_per_s=bytes_per_s)
    # Workers keep the state: they get an allocation, and return count, mean and variance. The client's time for a pixel
    # is taken to be in proportion to the bytes.
    share = (8 + 12) / (plain.pixel_bytes + plain.result_bytes)
    cached = replace(plain, pixel_bytes=8, result_bytes=12, client_pixel_s=share * plain.client_pixel_s)
    tiles = replace(cached, client_wave_pixel_s=0.0)
    clients = replace(
        tiles,
        client_task_s=tiles.client_task_s / CLIENTS,
        client_pixel_s=tiles.client_pixel_s / CLIENTS,
        client_bytes_per_s=tiles.client_bytes_per_s * CLIENTS,
    )
    rows = []
    for change, costs in (
        ("none", compressed),
        ("no compression", plain),
        ("workers keep the state", cached),
        ("workers compute statistics and map", tiles),
        (f"{CLIENTS} clients", clients),
    ):
        waves = [simulate_waves(IMAGES[-1], samples, WORKERS[-1], speed, costs)[0] for samples in (256, 4096)]
        rows.append((change, *(f"{wave.seconds:.1f} s, {wave.efficiency:.2f}" for wave in waves)))
    _print_table(("change", "256 spp", "4096 spp"), rows)


def main() -> None:
    """Measure, compare with the simulation, predict."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scene", default="cornell")
    parser.add_argument("--size", type=int, default=512, help="width and height of the image that is measured")
    parser.add_argument("--bandwidth", type=float, default=10.0, help="of each link of a cluster, in Gbit/s")
    parser.add_argument("--speedup", type=float, default=16.0, help="speed of a worker of a cluster / one core here")
    options = parser.parse_args()
    size = options.size, options.size
    scene = compile_scene(load_description(options.scene, size=size), size=size)
    needs, cores = BASIC_NEEDS.with_sampler(scene.sampler), len(os.sched_getaffinity(0))
    wave = measure_wave_costs(options.scene, REPEAT, size=size)
    wave_pixel_s = wave["total_share"]["median"] * wave["wave_s"]["median"] / (size[0] * size[1])
    with Cluster.local(4) as cluster:
        pool = cluster.pool(scene, needs)
        wait_for_workers(pool, 4)
        render = TimedRender(pool, scene, needs)
        measured = measure(render, 1)
        measured = replace(measured, costs=replace(measured.costs, client_wave_pixel_s=wave_pixel_s))
        _print_measurement(measured)
        _print_check(render, measured, cores)
    speed, bytes_per_s = options.speedup * measured.samples_per_s, options.bandwidth * 1e9 / 8
    _print_predictions(speed, measured.over_network(bytes_per_s))
    _print_changes(measured, speed, bytes_per_s)


if __name__ == "__main__":
    main()
