"""A Dask cluster whose processes can be killed or slowed down, and renders on it. For test_distributed_faults.py."""

import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import psutil
from killed_renders import Job

DEADLINE_S = 240
"""For every wait; a busy machine needs a tenth of it."""
LOOPBACK = "127.0.0.1"


def wait_until(condition: Callable[[], object], what: str, seconds: float = DEADLINE_S) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, f"waited in vain until {what}"
        time.sleep(0.02)


def family(process: subprocess.Popen) -> list[psutil.Process]:
    """A process and all that it has started, directly or not."""
    with suppress(psutil.NoSuchProcess):
        parent = psutil.Process(process.pid)
        return [parent, *parent.children(recursive=True)]
    return []


def alive(processes: list[psutil.Process]) -> list[psutil.Process]:
    """Those that still run."""
    found = []
    for process in processes:
        with suppress(psutil.NoSuchProcess):
            if process.is_running() and process.status() != psutil.STATUS_ZOMBIE:
                found.append(process)
    return found


def listening_addresses(processes: list[psutil.Process]) -> set[str]:
    """IP addresses at which they accept connections."""
    found = set()
    for process in processes:
        with suppress(psutil.NoSuchProcess):
            connections = process.net_connections("inet")
            found |= {each.laddr.ip for each in connections if each.status == psutil.CONN_LISTEN}
    return found


class ClusterProcesses:
    """A scheduler and workers on this machine, each a process of its own. Ended by `close`."""

    def __init__(self, folder: Path, environment: dict[str, str]):
        self._folder, self._environment = folder, os.environ | environment
        self._processes: list[subprocess.Popen] = []
        with socket.socket() as free:
            free.bind((LOOPBACK, 0))
            self.address = f"tcp://{LOOPBACK}:{free.getsockname()[1]}"
        self.scheduler = self._start("scheduler", "--host", self.address)
        self._workers: list[subprocess.Popen] = []
        self._nannies: list[subprocess.Popen] = []

    def start_worker(self, has_nanny: bool = False) -> None:
        """Start a worker, which a nanny starts again if it dies."""
        limits = ("--nworkers", "1", "--nthreads", "1", "--memory-limit", "0", "--death-timeout", "60")
        nanny = "--nanny" if has_nanny else "--no-nanny"
        process = self._start("worker", self.address, "--host", LOOPBACK, nanny, *limits)
        (self._nannies if has_nanny else self._workers).append(process)

    def worker_ids(self) -> list[int]:
        """Processes that trace, or will do so when they have started."""
        found = [process.pid for process in self._workers if process.poll() is None]
        for nanny in self._nannies:
            for child in alive(family(nanny)[1:]):
                with suppress(psutil.NoSuchProcess):
                    if "spawn_main" in " ".join(child.cmdline()):
                        found.append(child.pid)
        return found

    def kill_oldest_worker(self) -> None:
        """Kill the worker that most likely traces. A nanny starts it again; another joins for one without a nanny."""
        oldest = min(map(psutil.Process, self.worker_ids()), key=psutil.Process.create_time)
        oldest.kill()
        for process in self._workers:
            if process.pid == oldest.pid:
                process.wait(DEADLINE_S)
                self.start_worker()
                break

    def processes(self) -> list[psutil.Process]:
        return [member for process in self._processes for member in family(process)]

    def close(self) -> None:
        """Kill what still runs."""
        members = self.processes()
        for process in members:
            with suppress(psutil.NoSuchProcess):
                process.kill()
        for process in self._processes:
            process.wait(DEADLINE_S)

    def _start(self, tool: str, *options: str) -> subprocess.Popen:
        log = open(self._folder / f"{tool}-{len(self._processes)}.log", "w")  # noqa: SIM115
        process = subprocess.Popen(
            [sys.executable, "-m", "dask", tool, *options, "--dashboard-address", f"{LOOPBACK}:0"],
            stdout=log,
            stderr=log,
            env=self._environment,
        )
        log.close()
        self._processes.append(process)
        return process


@contextmanager
def slowed_down(pid: int, factor: float) -> Iterator[None]:
    """A process that runs a share 1 / `factor` of the time."""
    ended = threading.Event()

    def stop_and_continue() -> None:
        period_s = 0.1
        while not ended.is_set():
            os.kill(pid, signal.SIGSTOP)
            ended.wait(period_s * (1 - 1 / factor))
            os.kill(pid, signal.SIGCONT)
            ended.wait(period_s / factor)

    thread = threading.Thread(target=stop_and_continue)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


@dataclass
class Render:
    """A render of a job that runs in a process of its own."""

    job: Job
    process: subprocess.Popen

    @classmethod
    def start(cls, job: Job) -> "Render":
        """Start it and return at once."""
        command = [sys.executable, "-m", "isonoise", *job.arguments, "--json"]
        pipe = subprocess.PIPE
        process = subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True, env=os.environ | job.environment)
        return cls(job, process)

    def wait_for_wave(self, number: int = 1) -> None:
        """Wait until this many waves are in the log, or the render has ended."""
        log = self.job.folder / "a.csv"
        header = 1
        wait_until(
            lambda: (
                (log.exists() and len(log.read_text().splitlines()) >= number + header)
                or self.process.poll() is not None
            ),
            "a wave has ended",
        )

    @property
    def is_running(self) -> bool:
        return self.process.poll() is None

    def end(self, code: int = 0) -> tuple[dict, str]:
        """Wait for the end; returns what --json and standard error say."""
        out, err = self.process.communicate(timeout=DEADLINE_S)
        assert self.process.returncode == code, (self.process.returncode, err)
        assert "Traceback" not in err, err
        return json.loads(out or "{}"), err
