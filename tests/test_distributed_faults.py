"""Distributed renders whose processes are killed, slowed down or stopped: the bits of a render on one device, always.

Nothing is lost: every layer of the image, the state in the checkpoint, and the counts of samples are equal.
"""

import os
import random
import signal
import subprocess
from contextlib import suppress
from dataclasses import replace

import pytest

pytest.importorskip("distributed", reason="no Dask")
pytest.importorskip("psutil", reason="no psutil")

from cluster_processes import (
    ClusterProcesses,
    Render,
    alive,
    family,
    listening_addresses,
    slowed_down,
    wait_until,
)
from killed_renders import Files, Job

pytestmark = [pytest.mark.long, pytest.mark.skipif(os.name != "posix", reason="POSIX signals")]

STRATEGIES = ("uniform", "pooled", "relative-median")
SPP = 1500
SIZE = 96, 64
KILLS = 20
"""Per strategy, of workers that had tasks."""
KILLS_OF_A_RENDER = 7
"""Then it goes on to its end."""


@pytest.fixture(scope="module")
def environment(tmp_path_factory) -> dict[str, str]:
    """Of all processes: a program cache that only these tests use."""
    return {"ISONOISE_PROGRAM_CACHE": str(tmp_path_factory.mktemp("programs"))}


@pytest.fixture(scope="module")
def unbroken(tmp_path_factory, environment):
    """Files of the render on one device, by strategy."""
    files: dict[str, Files] = {}

    def render(strategy: str) -> Files:
        if strategy not in files:
            job = make_job(tmp_path_factory.mktemp("unbroken"), strategy, environment)
            job.run()
            files[strategy] = Files.read(job)
        return files[strategy]

    return render


@pytest.fixture
def cluster(tmp_path, environment):
    started = ClusterProcesses(tmp_path, environment)
    yield started
    started.close()


def make_job(folder, strategy: str, environment, *more: str) -> Job:
    path = folder / f"render-{len(list(folder.glob('render-*')))}"
    path.mkdir()
    return Job(path, strategy=strategy, spp=SPP, size=SIZE, more=more, interval_s=0.5, environment=environment)


def check(job: Job, unbroken: Files) -> None:
    """Every bit of the one-device render, and every planned sample."""
    files = Files.read(job)
    rows, expected = ([row[:-1] for row in each.rows[1:]] for each in (files, unbroken))  # the last column: workers
    replace(files, rows=rows).assert_equal(replace(unbroken, rows=expected))
    planned = SPP * SIZE[0] * SIZE[1]
    assert int(files.channels["samples"].sum(dtype="int64")) == files.kept_samples == planned
    assert int(files.header["isonoise.samples"]) == planned
    assert sorted(path.name for path in job.folder.iterdir()) == sorted(job.NAMES)


@pytest.mark.parametrize("strategy", STRATEGIES)
def test_killed_workers(strategy, cluster, unbroken, environment, tmp_path):
    """Workers are killed at random moments; a nanny starts one of them again, another one joins for the other."""
    rng = random.Random(f"workers {strategy}")
    one = unbroken(strategy)
    cluster.start_worker(has_nanny=True)
    cluster.start_worker()
    lost, kills = 0, 0
    while lost < KILLS:
        job = make_job(tmp_path, strategy, environment, "--dask", cluster.address)
        render = Render.start(job)
        render.wait_for_wave()
        for _ in range(KILLS_OF_A_RENDER):
            if not render.is_running:
                break
            cluster.kill_oldest_worker()
            kills += 1
            wait_until(lambda: len(cluster.worker_ids()) == 2, "the worker is replaced")
            with suppress(subprocess.TimeoutExpired):
                render.process.wait(rng.uniform(0.5, 3))
        result, _ = render.end()
        lost += sum(worker["lost"] > 0 and not worker["is_ready"] for worker in result["workers"])
        check(job, one)
    print(f"{strategy}: {kills} kills, {lost} of workers that had tasks")


@pytest.mark.parametrize("strategy", STRATEGIES)
def test_a_worker_joins(strategy, cluster, unbroken, environment, tmp_path):
    job = make_job(tmp_path, strategy, environment, "--dask", cluster.address)
    one = unbroken(strategy)
    cluster.start_worker()
    render = Render.start(job)
    render.wait_for_wave()
    cluster.start_worker()
    result, _ = render.end()
    assert len(result["workers"]) == 2
    assert all(worker["samples"] > 0 for worker in result["workers"])
    check(job, one)


def begin_on_two_workers(strategy, cluster, environment, folder):
    """A render on two workers that has traced a wave; and its job."""
    job = make_job(folder, strategy, environment, "--dask", cluster.address)
    for _ in range(2):
        cluster.start_worker()
    render = Render.start(job)
    render.wait_for_wave()
    return job, render


@pytest.mark.parametrize("strategy", STRATEGIES)
def test_a_slow_worker(strategy, cluster, unbroken, environment, tmp_path):
    """A worker becomes ten times slower in the middle of a render."""
    job, render = begin_on_two_workers(strategy, cluster, environment, tmp_path)
    with slowed_down(cluster.worker_ids()[0], 10):
        render.end()
    check(job, unbroken(strategy))


@pytest.mark.parametrize("strategy", STRATEGIES)
def test_a_worker_that_hangs(strategy, cluster, unbroken, environment, tmp_path):
    """It stops in the middle of a render and never goes on. Others trace its part."""
    job, render = begin_on_two_workers(strategy, cluster, environment, tmp_path)
    os.kill(cluster.worker_ids()[0], signal.SIGSTOP)
    render.end()
    check(job, unbroken(strategy))


@pytest.mark.parametrize("strategy", STRATEGIES)
def test_a_killed_scheduler(strategy, unbroken, environment, tmp_path):
    """The render ends with a message and is continued on another cluster. The workers of the first one end."""
    one = unbroken(strategy)
    first = ClusterProcesses(tmp_path, environment)
    try:
        job = make_job(tmp_path, strategy, environment, "--dask", first.address)
        first.start_worker(has_nanny=True)
        first.start_worker()
        render = Render.start(job)
        render.wait_for_wave(2)
        workers = first.processes()[1:]
        first.scheduler.kill()
        _, err = render.end(code=2)
        assert "the connection to the Dask scheduler is lost" in err
        assert Files.read(job).kept_samples > 0
        wait_until(lambda: not alive(workers), "the workers end")
    finally:
        first.close()
    second = ClusterProcesses(tmp_path, environment)
    try:
        second.start_worker()
        job.more = ("--dask", second.address)
        Render.start(job).end()
    finally:
        second.close()
    check(job, one)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
@pytest.mark.parametrize("strategy", STRATEGIES)
def test_a_stopped_client_of_local_workers(strategy, number, unbroken, environment, tmp_path):
    """No process is left, and the same command continues the render. All listen on loopback alone."""
    one = unbroken(strategy)
    job = make_job(tmp_path, strategy, environment, "--workers", "2")
    render = Render.start(job)
    render.wait_for_wave(2)
    processes = family(render.process)
    assert len(processes) >= 3
    assert listening_addresses(processes) == {"127.0.0.1"}
    render.process.send_signal(number)
    render.end(code=-number if number == signal.SIGKILL else 128 + number)
    wait_until(lambda: not alive(processes), "the workers end", seconds=60)
    job.run()
    check(job, one)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
@pytest.mark.parametrize("strategy", STRATEGIES)
def test_a_stopped_client_of_a_cluster(strategy, number, cluster, unbroken, environment, tmp_path):
    """The cluster forgets the render, and the same command continues it."""
    from distributed import Client

    one = unbroken(strategy)
    for _ in range(2):
        cluster.start_worker()
    job = make_job(tmp_path, strategy, environment, "--dask", cluster.address)
    render = Render.start(job)
    render.wait_for_wave(2)
    assert listening_addresses([*family(render.process), *cluster.processes()]) == {"127.0.0.1"}
    render.process.send_signal(number)
    render.end(code=-number if number == signal.SIGKILL else 128 + number)
    with Client(cluster.address, set_as_default=False) as client:
        tasks = "the cluster forgets the render"
        wait_until(lambda: not client.run_on_scheduler(lambda dask_scheduler: len(dask_scheduler.tasks)), tasks)
        wait_until(lambda: not any(client.run(lambda dask_worker: len(dask_worker.state.actors)).values()), tasks)
    Render.start(job).end()
    check(job, one)
