"""The simulation of distributed renders against closed forms."""

import numpy as np
import pytest

from isonoise.distributed.simulation import Costs, SimulatedWorker, Simulation
from isonoise.scene import compile_scene, load_description
from isonoise.statistics import BASIC_NEEDS

SHARD_PIXELS = np.full(256, 1024)
PIXELS = SHARD_PIXELS.sum()
SPEED = 2e6
SAMPLES = 16 * SHARD_PIXELS
ONE_WORKER_S = SAMPLES.sum() / SPEED


def second_wave(workers, costs=None, samples=SAMPLES):
    """A wave of workers whose speeds are known."""
    simulation = Simulation(SHARD_PIXELS, workers, costs)
    simulation.wave(samples)
    return simulation.wave(samples)


@pytest.mark.parametrize("workers", [1, 2, 4, 8])
def test_without_overhead_workers_share_the_wave(workers):
    wave = second_wave([SimulatedWorker(SPEED)] * workers)
    assert wave.seconds == pytest.approx(ONE_WORKER_S / workers)
    assert wave.efficiency == pytest.approx(1)
    assert wave.client_share == 0


def test_unequal_workers_end_together_but_for_a_shard():
    """The last shard is 1/256 of the wave."""
    speeds = [SPEED, SPEED / 2, SPEED / 5]
    wave = second_wave([SimulatedWorker(speed) for speed in speeds])
    ideal = SAMPLES.sum() / sum(speeds)
    assert ideal <= wave.seconds <= ideal + SAMPLES[0] / min(speeds)
    assert wave.ideal_s == pytest.approx(ideal)


def test_what_a_task_costs_one_worker():
    """Messages and the client's work overlap with the worker's tasks, but for the first and the last one."""
    costs = Costs(
        pixel_bytes=92,
        result_bytes=84,
        compression=0.5,
        latency_s=0.003,
        worker_task_s=0.004,
        worker_pixel_s=1e-7,
        client_task_s=0.002,
        client_wave_s=0.01,
        client_wave_pixel_s=1e-8,
    )
    wave = second_wave([SimulatedWorker(SPEED)], costs)
    worker_s = ONE_WORKER_S + wave.tasks * costs.worker_task_s + PIXELS * costs.worker_pixel_s
    client_wave_s = costs.client_wave_s + PIXELS * costs.client_wave_pixel_s
    assert wave.seconds == pytest.approx(worker_s + 2 * costs.latency_s + costs.client_task_s + client_wave_s)
    assert (wave.sent_bytes, wave.received_bytes) == (PIXELS * 92 / 2, PIXELS * 84 / 2)
    assert wave.client_s == pytest.approx(wave.tasks * costs.client_task_s + client_wave_s)


def test_the_client_is_the_limit():
    """Fast workers wait for the client, which handles every pixel once before and once after its task."""
    costs = Costs(client_pixel_s=1e-6)
    wave = second_wave([SimulatedWorker(1e12)] * 4, costs)
    assert wave.client_s == pytest.approx(PIXELS * costs.client_pixel_s)
    assert wave.seconds == pytest.approx(wave.client_s, rel=1e-3)
    assert wave.client_share == pytest.approx(1, rel=1e-3)


def test_the_bandwidth_of_the_client_is_the_limit():
    """Results travel while tasks are sent. Some tasks are copied: the link makes workers slower than they were."""
    costs = Costs(pixel_bytes=92, result_bytes=84, compression=0.5, client_bytes_per_s=1e7)
    wave = second_wave([SimulatedWorker(1e12)] * 8, costs)
    assert 1 <= wave.sent_bytes / (PIXELS * 92 / 2) < 1.05
    sent_s, received_s = wave.sent_bytes / 1e7, wave.received_bytes / 1e7
    assert sent_s <= wave.seconds <= 1.001 * (sent_s + received_s)


def test_the_bandwidth_of_one_link_is_the_limit():
    costs = Costs(pixel_bytes=100, link_bytes_per_s=1e7)
    wave = second_wave([SimulatedWorker(1e12)], costs)
    assert wave.seconds == pytest.approx(PIXELS * 100 / 1e7, rel=1e-3)


@pytest.mark.parametrize(("workers", "cores"), [(4, 2), (4, 1), (2, 4), (3, 2)])
def test_workers_share_cores(workers, cores):
    wave = second_wave([SimulatedWorker(SPEED)] * workers, Costs(cores=cores))
    assert wave.ideal_s == pytest.approx(ONE_WORKER_S / min(workers, cores))
    assert wave.seconds == pytest.approx(wave.ideal_s, rel=0.01)


def test_the_client_takes_time_from_workers_on_its_machine():
    """Each second of the client costs a second of their cores. At the end of a wave not all cores are busy."""
    costs = Costs(cores=2, client_task_s=0.02)
    wave = second_wave([SimulatedWorker(SPEED)] * 4, costs)
    assert 1 <= wave.seconds / ((ONE_WORKER_S + wave.client_s) / 2) < 1.1


def test_a_worker_that_changes_its_speed():
    """100 samples per second until t = 2 s, then 10, from t = 4 s on 50."""
    worker = SimulatedWorker(100, changes=((2.0, 10), (4.0, 50)))
    assert worker.seconds(100, 0.0) == 1.0
    assert worker.seconds(210, 0.0) == 3.0
    assert worker.seconds(270, 0.0) == 5.0
    assert worker.seconds(50, 4.5) == 1.0
    assert SimulatedWorker(100, changes=((2.0, 0.0),)).seconds(150, 1.0) == np.inf


@pytest.mark.long
def test_prediction_for_four_workers():
    """Local worker processes, from what one costs while the others trace: within 10 %. Fails if the machine is busy."""
    pytest.importorskip("distributed")
    from isonoise.benchmark.distributed import TimedRender, measure_and_simulate, wait_for_workers
    from isonoise.distributed.cluster import Cluster

    size = 512, 512
    scene = compile_scene(load_description("cornell", size=size), size=size)
    needs = BASIC_NEEDS.with_sampler(scene.sampler)
    with Cluster.local(4) as cluster:
        pool = cluster.pool(scene, needs)
        wait_for_workers(pool, 4)
        measured, simulated = measure_and_simulate(TimedRender(pool, scene, needs), 4, samples=64, waves=7)
    assert simulated == pytest.approx(measured, rel=0.1)
