"""`DaskPool` with workers in this process: results, losses, joins, stops, errors. Nothing is rendered."""

import gc
import sys
import threading
import time
import warnings
import weakref
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

distributed = pytest.importorskip("distributed", reason="Dask is in the extra 'cluster'")

from isonoise.cli import main  # noqa: E402
from isonoise.distributed import cluster as clusters  # noqa: E402
from isonoise.distributed.dask_pool import DaskPool  # noqa: E402
from isonoise.distributed.dask_worker import DeviceChoice, TracerSettings  # noqa: E402
from isonoise.distributed.task import Task, TaskResult  # noqa: E402
from isonoise.distributed.worker_pool import Finished, Lost  # noqa: E402
from isonoise.errors import DeviceError, UserError  # noqa: E402
from isonoise.statistics import BASIC_NEEDS  # noqa: E402

WAIT_S = 20.0
PIXELS = 50
released = threading.Event()
"""Tasks from number 1000 on end when it is set."""
tracers = weakref.WeakSet()
"""Those that workers have."""


class FakeTracer:
    """Counts samples. What it does depends on the task's number."""

    def __init__(self, device: DeviceChoice):
        tracers.add(self)
        self.device = SimpleNamespace(selected=SimpleNamespace(whole_name=f"device {device.number}"))

    def trace(self, task: Task, should_continue) -> TaskResult:
        if task.number >= 3000:
            raise DeviceError("the device is lost")
        if task.number >= 2000:
            return TaskResult(task.number, {"count": task.state["count"]}, None, 0.0)  # lacks an array
        end_s = time.monotonic() + WAIT_S
        while task.number >= 1000 and not released.is_set():
            if not should_continue():
                return TaskResult(task.number, task.state, task.allocation, 0.0)
            assert time.monotonic() < end_s
            time.sleep(0.002)
        return TaskResult(task.number, task.state | {"count": task.state["count"] + task.allocation}, None, 0.0)


@dataclass(frozen=True)
class FakeSettings(TracerSettings):
    is_refused: bool = False

    def make_tracer(self, device, scene):
        if self.is_refused:
            raise DeviceError(f"no device for {scene}")
        return FakeTracer(device)


def task(number: int) -> Task:
    counts = np.random.default_rng(number).integers(0, 9, (1, PIXELS), np.uint32)
    state = {"count": counts, "sums": np.zeros((2, PIXELS), np.float32)}
    return Task(number, np.arange(PIXELS, dtype=np.uint32), np.full(PIXELS, 2, np.uint32), state, 0)


def make_local(workers: int):
    return distributed.LocalCluster(
        n_workers=workers,
        threads_per_worker=1,
        processes=False,
        protocol="tcp",
        dashboard_address=None,
        scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},
    )


@pytest.fixture(scope="module")
def local():
    with clusters._quiet_logs(), make_local(2) as cluster:
        yield cluster


@pytest.fixture
def make_pool(local):
    """Function that makes a pool on the two workers of `local`, and waits for both."""
    released.clear()
    local.scale(2)
    pools = []

    def make(is_refused: bool = False, direct: bool | None = None) -> DaskPool:
        client = distributed.Client(local, set_as_default=False, direct_to_workers=direct)
        settings = FakeSettings(BASIC_NEEDS, 0, is_refused=is_refused)
        pool = DaskPool(client, lambda name: DeviceChoice(None, int(name)), "the scene", settings)
        pools.append((client, pool))
        if not is_refused:
            wait_for_workers(pool, 2)
        return pool

    yield make
    released.set()
    for client, pool in pools:
        pool.close()
        client.close()


def wait_for_workers(pool: DaskPool, count: int) -> list[str]:
    end_s = time.monotonic() + WAIT_S
    while len(pool.workers()) != count:
        assert time.monotonic() < end_s
        pool.wait(0.01)
    return [worker.name for worker in pool.workers()]


def wait_for(pool: DaskPool, count: int) -> list[Finished | Lost]:
    events, end_s = [], time.monotonic() + WAIT_S
    while len(events) < count:
        assert time.monotonic() < end_s
        events += pool.wait(0.5)
    return events


@pytest.mark.parametrize("direct", [None, False])
def test_every_task_is_reported_once_with_its_result(direct, make_pool):
    """Data go to the workers, or through the scheduler where this machine does not reach the workers."""
    pool = make_pool(direct=direct)
    assert sorted(worker.device for worker in pool.workers()) == ["device 0", "device 1"]
    names = [worker.name for worker in pool.workers()]
    for number in range(20):
        pool.submit(names[number % 2], task(number))
    events = wait_for(pool, 20)
    for worker in names:
        numbers = sorted(event.result.number for event in events if event.worker == worker)
        assert numbers == [number for number in range(20) if names[number % 2] == worker]
    for event in events:
        np.testing.assert_array_equal(event.result.state["count"], task(event.result.number).state["count"] + 2)
    assert pool.wait(0.05) == []


def test_a_stop_ends_tasks_until_the_next_one(make_pool):
    pool = make_pool()
    names = [worker.name for worker in pool.workers()]
    for number, name in enumerate(names * 2):
        pool.submit(name, task(1000 + number))
    assert pool.wait(0.05) == []
    pool.stop()
    for event in wait_for(pool, 4):
        np.testing.assert_array_equal(event.result.remaining, 2)
    pool.submit(names[0], task(1010))
    assert pool.wait(0.1) == []
    released.set()
    (event,) = wait_for(pool, 1)
    assert event.result.remaining is None


def test_tasks_of_a_lost_worker_are_reported_and_another_one_joins(make_pool, local):
    pool = make_pool()
    names = [worker.name for worker in pool.workers()]
    for number, name in enumerate(names * 2):
        pool.submit(name, task(1000 + number))
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        local.scale(1)
        events = wait_for(pool, 2)
    (lost,) = {event.worker for event in events}
    assert sorted(event.task for event in events) == sorted(
        1000 + k for k, name in enumerate(names * 2) if name == lost
    )
    assert [f"worker {lost} is lost" in str(each.message) for each in warned] == [True]
    released.set()
    assert all(isinstance(event, Finished) and event.worker != lost for event in wait_for(pool, 2))
    pool.submit(lost, task(5))  # it was chosen before its loss was known
    (event,) = wait_for(pool, 1)
    assert isinstance(event, Lost)
    local.scale(2)
    new = wait_for_workers(pool, 2)[-1]
    assert new not in names
    pool.submit(new, task(6))
    assert isinstance(wait_for(pool, 1)[0], Finished)


@pytest.mark.long
def test_closing_the_pool_frees_the_tracers(make_pool):
    tracers.clear()
    pool = make_pool()
    pool.submit(pool.workers()[0].name, task(1))
    wait_for(pool, 1)
    assert len(tracers) == 2
    pool.close()
    end_s = time.monotonic() + WAIT_S
    while tracers:
        assert time.monotonic() < end_s
        gc.collect()
        time.sleep(0.01)


def test_wrong_results_are_refused(make_pool):
    pool = make_pool()
    pool.submit(pool.workers()[0].name, task(2000))
    (event,) = wait_for(pool, 1)
    assert (event.task, "refused" in event.reason) == (2000, True)


@pytest.mark.long
def test_a_worker_that_fails_gets_nothing_more_and_the_last_one_ends_the_render(make_pool):
    pool = make_pool()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for left in (1, 0):
            name = pool.workers()[0].name
            for number in range(3):
                pool.submit(name, task(3000 + number))
                (event,) = wait_for(pool, 1)
                assert (event.worker, event.reason) == (name, "the device is lost")
            if left:
                assert name not in wait_for_workers(pool, 1)
    with pytest.raises(DeviceError, match=r"no worker can render: .*the device is lost"):
        wait_for(pool, 1)


def test_a_scene_that_no_worker_can_render_is_an_error(make_pool):
    with pytest.raises(DeviceError, match="no device for the scene"):
        make_pool(is_refused=True).wait_for_worker()


@pytest.mark.long
def test_after_an_interrupted_connection_workers_are_prepared_again(make_pool):
    pool = make_pool()
    pool._client.sync(pool._client.scheduler_comm.comm.close)
    events, end_s = [], time.monotonic() + WAIT_S
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        while not events or not isinstance(events[-1], Finished):
            assert time.monotonic() < end_s
            for worker in pool.workers()[:1]:
                pool.submit(worker.name, task(len(events)))
                events += wait_for(pool, 1)
            time.sleep(0.01)
        wait_for_workers(pool, 2)


@pytest.mark.long
@pytest.mark.filterwarnings("ignore:worker .* is lost")
def test_a_lost_scheduler_is_an_error():
    with clusters._quiet_logs(), make_local(1) as cluster:
        client = distributed.Client(cluster, set_as_default=False, timeout=0.2)
        pool = DaskPool(client, lambda name: DeviceChoice(), "the scene", FakeSettings(BASIC_NEEDS, 0))
        pool.submit(wait_for_workers(pool, 1)[0], task(1000))
        released.set()
        cluster.close()
        with pytest.raises(DeviceError, match=r"connection to the Dask scheduler is lost.*--resume"):
            wait_for(pool, 2)
        pool.close()
        client.close()


@pytest.mark.parametrize(
    ("address", "error", "message"),
    [
        ("tcp://127.0.0.1:1", DeviceError, "no Dask scheduler answers at"),
        ("nonsense", UserError, "port"),
        pytest.param("ftp://127.0.0.1:1", UserError, "scheme", marks=pytest.mark.long),
        pytest.param("tls://127.0.0.1:1", UserError, "distributed.comm.tls", marks=pytest.mark.long),
    ],
)
def test_wrong_addresses(address, error, message, monkeypatch):
    monkeypatch.setattr(clusters, "CONNECT_TIMEOUT_S", 0.2)
    with pytest.raises(error, match=message):
        clusters.Cluster.connect(address)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--workers", "0"), "0 must be 1 or more"),
        (("--workers", "2", "--dask", "tcp://127.0.0.1:1"), "not allowed with"),
    ],
)
def test_wrong_options(options, message, capsys):
    with pytest.raises(SystemExit):
        main(["render", "cornell", "-o", "image.exr", *options])
    assert message in capsys.readouterr().err


def test_without_dask_the_message_says_what_to_install(monkeypatch, tmp_path, capsys):
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert main(["render", "cornell", "-o", str(tmp_path / "image.exr"), "--workers", "2"]) == 2
    assert "pip install 'isonoise[cluster]'" in capsys.readouterr().err


def test_a_worker_is_no_scheduler(local):
    with pytest.raises(UserError, match="give the address of the scheduler"):
        clusters.Cluster.connect(local.workers[0].address)
