"""Renders on worker processes of this machine: same bits as on one device, whatever happens to the workers."""

import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

pytest.importorskip("distributed", reason="Dask is in the extra 'cluster'")

import isonoise
from isonoise.distributed.cluster import Cluster
from isonoise.film.exr import read_reference
from isonoise.outcome import Outcome

pytestmark = pytest.mark.long

SIZE = (96, 64)
STRATEGIES = ("uniform", "pooled", "relative-median")
WAIT_S = 120.0


def render(strategy: str, cluster: Cluster | None = None) -> Outcome:
    return isonoise.render("cornell", spp=40, size=SIZE, strategy=strategy, seed=3, cluster=cluster)


@pytest.fixture(scope="module")
def on_one_device():
    return {strategy: render(strategy) for strategy in STRATEGIES}


def assert_same_bits(first: Outcome, second: Outcome) -> None:
    for name in ("rgb", "count", "mean", "variance"):
        np.testing.assert_array_equal(getattr(first.statistics, name), getattr(second.statistics, name))
    assert first.stated_error == second.stated_error


@pytest.mark.parametrize("workers", [1, 2, 4])
def test_the_number_of_workers_does_not_change_a_bit(workers, on_one_device):
    with Cluster.local(workers) as cluster:
        for strategy in STRATEGIES:
            assert_same_bits(on_one_device[strategy], render(strategy, cluster))


def processes_below(parent: int) -> list[int]:
    """Numbers of the worker processes that a process has started."""
    found = subprocess.run(["pgrep", "-P", str(parent), "-f", "spawn_main"], capture_output=True, text=True)
    return [int(line) for line in found.stdout.split()]


def start_render(folder, *options) -> subprocess.Popen:
    command = [sys.executable, "-m", "isonoise", "render", "cornell", "--size", "96x64", "--seed", "3"]
    command += ["-o", str(folder / "image.exr"), "--workers", "2", *options]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True)


def wait_until(condition) -> None:
    end_s = time.monotonic() + WAIT_S
    while not condition():
        assert time.monotonic() < end_s
        time.sleep(0.05)


def wait_for_samples(folder, process: subprocess.Popen) -> list[int]:
    """Wait until the render has written its first wave to the log; its worker processes."""
    log = folder / "log.csv"
    wait_until(lambda: process.poll() is not None or (log.exists() and len(log.read_text().splitlines()) > 1))
    assert process.poll() is None
    return processes_below(process.pid)


def ended(process: int) -> bool:
    try:
        with open(f"/proc/{process}/stat") as file:
            return file.read().rpartition(")")[2].split()[0] == "Z"
    except FileNotFoundError:
        return True


def test_ctrl_c_writes_the_image_and_ends_the_workers(tmp_path):
    process = start_render(tmp_path, "--time", "60", "--log", str(tmp_path / "log.csv"))
    workers = wait_for_samples(tmp_path, process)
    assert len(workers) == 2
    os.killpg(process.pid, signal.SIGINT)
    _, errors = process.communicate(timeout=WAIT_S)
    assert (process.returncode, errors) == (128 + signal.SIGINT, "")
    assert (tmp_path / "image.exr").exists()
    wait_until(lambda: all(map(ended, workers)))


def test_no_worker_outlives_a_killed_render(tmp_path):
    process = start_render(tmp_path, "--time", "60", "--log", str(tmp_path / "log.csv"))
    workers = wait_for_samples(tmp_path, process)
    process.kill()
    process.communicate(timeout=WAIT_S)
    wait_until(lambda: all(map(ended, workers)))


def test_killed_workers_are_replaced_and_the_bits_stay(tmp_path):
    """The last bits of the image depend on every sample of every pixel."""
    process = start_render(tmp_path, "--spp", "3000", "--log", str(tmp_path / "log.csv"), "--strategy", "uniform")
    for worker in wait_for_samples(tmp_path, process):
        os.kill(worker, signal.SIGKILL)
        time.sleep(0.5)
    _, errors = process.communicate(timeout=WAIT_S)
    assert process.returncode == 0
    lines = errors.splitlines()
    assert lines
    assert all("is lost" in line for line in lines)
    expected = isonoise.render("cornell", spp=3000, size=SIZE, strategy="uniform", seed=3)
    image, _ = read_reference(tmp_path / "image.exr")
    np.testing.assert_array_equal(image, expected.rgb)
