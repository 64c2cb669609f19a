"""`DistributedWavefront` and `ShardTracer`: any shards, workers and faults give the bits of one device."""

import functools
from dataclasses import replace

import numpy as np
import pytest
from small_scene import assert_same_bits, lamp_over_floor

from isonoise import Renderer
from isonoise.device.opencl import Device
from isonoise.device.selection import select_device
from isonoise.distributed import distributed_wavefront, set_up
from isonoise.distributed.shard_tracer import ShardTracer
from isonoise.distributed.shards import Shards
from isonoise.distributed.task import Task
from isonoise.distributed.worker_pool import Finished, Lost, Worker
from isonoise.errors import DeviceError
from isonoise.integrator.reduction_state import state_planes

SEED, SIZE = 7, (45, 37)
WAVES = 5
STRATEGIES = ("uniform", "pooled", "relative-median")


def zero_state(needs, pixels: int) -> dict[str, np.ndarray]:
    return {
        name: np.zeros((planes, pixels), np.uint32 if name in ("count", "rejected") else np.float32)
        for name, planes in state_planes(needs).items()
    }


def test_a_task_is_a_pure_function():
    """The state of pixels in any order, in several tasks, is that of the whole image."""
    renderer = Renderer(lamp_over_floor(), size=SIZE, seed=SEED, strategy="relative-median")
    for _ in range(3):
        renderer.step()
    expected = renderer._wavefront.reduction.read()
    counts = (expected["count"] + expected["rejected"])[0]
    needs = renderer.strategy.needs.with_sampler(renderer.scene.sampler)
    tracer = ShardTracer(Device(), renderer.scene, needs)
    order = np.random.default_rng(1).permutation(len(counts)).astype(np.uint32)
    for number, pixels in enumerate((order[:1], order[1:700], order[700:])):
        first = counts[pixels] // 3
        begun = tracer.trace(Task(0, pixels, first, zero_state(needs, len(pixels)), SEED))
        result = tracer.trace(Task(number, pixels, counts[pixels] - first, begun.state, SEED))
        assert result.number == number
        assert result.remaining is None
        assert result.state.keys() == expected.keys()
        for name, planes in expected.items():
            assert result.state[name].tobytes() == planes[:, pixels].tobytes(), name
    stopped = tracer.trace(Task(9, order, counts[order], zero_state(needs, len(order)), SEED), lambda: False)
    assert np.array_equal(stopped.remaining, counts[order])


@pytest.mark.parametrize("shape", [(16, 24), (37, 45), (1, 20), (1, 1)])
def test_the_state_of_any_pixels_is_gathered_and_scattered(shape):
    shards = Shards(shape)
    planes = np.arange(3 * shape[0] * shape[1], dtype=np.float32).reshape(3, -1)
    for chosen in ([0], range(0, shards.number, 3), range(shards.number)):
        pixels = shards.pixels(chosen)  # rows of blocks are taken as a whole
        for some in (pixels, pixels[:8], pixels[1:], pixels[::3], pixels[:0]):
            runs, written = distributed_wavefront._find_runs(some, planes.shape[1]), np.zeros_like(planes)
            rows, expected = runs.gather(planes), np.zeros_like(planes)
            assert np.array_equal(rows, planes[:, some])
            runs.scatter(rows, written)
            expected[:, some] = rows
            assert np.array_equal(written, expected)


class FaultyPool:
    """Workers that share a tracer, answer in a random order, come and go, and lose or damage a share of the tasks."""

    def __init__(self, devices, make_tracer, on_compile, faults: float, workers: int, seed: int):
        self.random, self.faults = np.random.default_rng(seed), faults
        self.tracer = make_tracer(devices[0], on_compile)
        self.names = [f"worker {number}" for number in range(workers)]
        self.pending: list[tuple[str, Task]] = []
        self.is_stopped = self.is_closed = False
        self.lost = 0

    def workers(self) -> list[Worker]:
        self.is_stopped = False
        return [Worker(name, "a device") for name in self.names if self.random.random() < 0.8]

    def submit(self, worker: str, task: Task) -> None:
        assert len(np.unique(task.pixels)) == len(task.pixels)
        assert task.allocation.all()
        self.pending.append((worker, task))

    def wait(self, timeout_s: float) -> list[Finished | Lost]:
        events = []
        while self.pending and self.random.random() < 0.7:
            worker, task = self.pending.pop(self.random.integers(len(self.pending)))
            fault = self.random.random() / self.faults if self.faults else 1.0
            if fault < 0.5:
                self.lost += 1
                events.append(Lost(worker, task.number, "it is gone"))
                continue
            result = self.tracer.trace(task, lambda: not self.is_stopped)
            if fault < 1:
                self.lost += 1
                counts = result.state["count"].copy()
                counts[0, -1] += 1
                result = replace(result, state=result.state | {"count": counts})
            events.append(Finished(worker, result))
        return events

    def stop(self) -> None:
        self.is_stopped = True

    def close(self) -> None:
        self.is_closed = True


def distributed_renderer(monkeypatch, strategy: str, *, shards=None, faults=0.0, workers=3, seed=1) -> Renderer:
    monkeypatch.setattr(set_up, "DevicePool", functools.partial(FaultyPool, faults=faults, workers=workers, seed=seed))
    monkeypatch.setattr(distributed_wavefront, "Shards", functools.partial(Shards, number=shards))
    monkeypatch.setattr("isonoise.renderer.select_devices", lambda choice: 2 * [select_device()])
    renderer = Renderer(lamp_over_floor(), size=SIZE, seed=SEED, strategy=strategy)
    monkeypatch.undo()
    return renderer


CASES = {"shards": 1, "workers": 1}, {"faults": 0.3}, {"shards": 30, "faults": 0.6, "workers": 9}


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("strategy", STRATEGIES)
def test_shards_workers_and_faults_do_not_change_the_image(monkeypatch, strategy, case):
    one_device = Renderer(lamp_over_floor(), size=SIZE, seed=SEED, strategy=strategy)
    with distributed_renderer(monkeypatch, strategy, **case) as renderer:
        pool = renderer._wavefront._pool
        for _ in range(WAVES):
            record = renderer.step()
            assert record.samples == record.planned
            one_device.step()
        assert_same_bits(renderer.statistics(), one_device.statistics())
        reports = renderer.worker_reports()
        assert sum(report.samples for report in reports) == renderer.samples
        assert sum(report.lost for report in reports) == pool.lost
        assert (pool.lost > 0) == ("faults" in case)
    assert pool.is_closed


def test_a_stopped_wave_goes_on_to_the_same_bits(monkeypatch):
    """Counts are exact after every stop: what remains of the wave and what is in the state are all its samples."""
    one_device = Renderer(lamp_over_floor(), size=SIZE, seed=SEED, strategy="pooled")
    with distributed_renderer(monkeypatch, "pooled", faults=0.2) as renderer:
        stops, random = 0, np.random.default_rng(3)
        for _ in range(WAVES):
            renderer.begin_wave()
            before, planned = renderer.samples, int(renderer._waves.wave.remaining.sum())
            while not renderer.continue_wave(lambda traced: random.random() < 0.2):
                stops += 1
                left = int(renderer._waves.wave.remaining.sum())
                assert renderer.samples - before == planned - left
                assert renderer.statistics().samples + int(renderer.statistics().rejected.sum()) == renderer.samples
            renderer.end_wave()
            one_device.step()
        assert stops > 3
        assert_same_bits(renderer.statistics(), one_device.statistics())


def test_an_exception_loses_no_samples(monkeypatch):
    """What was on its way is dropped: it remains to be traced, and later answers are ignored."""
    one_device = Renderer(lamp_over_floor(), size=SIZE, seed=SEED, strategy="uniform")
    with distributed_renderer(monkeypatch, "uniform") as renderer:
        pool = renderer._wavefront._pool

        def fail_while_tasks_are_pending(traced: int) -> bool:
            if traced and pool.pending:
                raise KeyboardInterrupt
            return True

        renderer.begin_wave()
        with pytest.raises(KeyboardInterrupt):
            renderer.continue_wave(fail_while_tasks_are_pending)
        assert 0 < renderer.samples < 2 * 16 * SIZE[0] * SIZE[1]
        assert renderer.continue_wave()
        renderer.end_wave()
        one_device.step()
        assert_same_bits(renderer.statistics(), one_device.statistics())


def test_a_worker_that_hangs_does_not_hold_up_a_stop(monkeypatch):
    """Its samples remain, and another worker traces them."""
    one_device = Renderer(lamp_over_floor(), size=SIZE, seed=SEED, strategy="uniform")
    one_device.step()
    with distributed_renderer(monkeypatch, "uniform") as renderer:
        monkeypatch.setattr(distributed_wavefront, "STOP_TIMEOUT_S", 0.05)
        pool = renderer._wavefront._pool
        renderer.begin_wave()
        answer = pool.wait
        monkeypatch.setattr(pool, "wait", lambda timeout_s: [])
        assert not renderer.continue_wave(lambda traced: False)
        assert renderer.samples == 0
        monkeypatch.setattr(pool, "wait", answer)
        while not renderer.continue_wave():
            pass
        renderer.end_wave()
        assert_same_bits(renderer.statistics(), one_device.statistics())


def test_memory_is_planned_for_the_client_and_each_device():
    with pytest.raises(DeviceError, match="of memory"):
        Renderer(lamp_over_floor(), size=SIZE, device="0/2", memory=2**20)
