"""Compiles programs in several processes at a time, for drivers that compile on one core and keep what they compile.

PoCL compiles one kernel at a time in a process, at its first launch. `precompile` starts worker processes, which store
their kernels in the program cache at their exit; the calling process takes part. Run as a module, this file is such a
worker: `python -m isonoise.device.precompile FOLDER`.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from isonoise.device import failures, program_cache
from isonoise.device.drivers import build_options, driver_identity, list_devices, parent_of
from isonoise.device.opencl import Device
from isonoise.device.pocl_cache import pocl_folder, store_pocl_kernels

_JOBS_FILE = "jobs.json"
_POLL_S = 0.05  # between looks at the worker processes
_BUFFER_BYTES = 2**16
"""Of the buffer that stands in for all buffers of a kernel; kernels without work access a few words at most."""


class FirstLaunch(NamedTuple):
    """A launch that makes the driver compile a kernel. The kernel must find nothing to do."""

    kernel: str
    global_size: int
    local_size: int
    arguments: tuple[str | None, ...]
    """The bytes of a value in hexadecimal digits, or None for a buffer."""


class Job(NamedTuple):
    """A program and the launches that compile its kernels."""

    source: str
    options: tuple[str, ...]
    launches: tuple[FirstLaunch, ...]
    name: str = ""  # for people


OnCompile = Callable[[str, int, int], None]
"""Called with the name of a program that is compiled now, how many are done, and how many there are."""


def precompile(device: Device, jobs: Sequence[Job], on_compile: OnCompile = lambda name, done, total: None) -> None:
    """Compile the programs that this device has not compiled before, on all cores.

    Does nothing where it would not help: with other drivers than PoCL, on one core, or if the program cache is off,
    which remembers what has been compiled. Errors of workers are ignored: the caller builds its programs anyway.
    """
    if not device.is_pocl or program_cache.cache_folder() is None:
        return
    fresh = {}
    for job in sorted(jobs, key=lambda job: -len(job.source)):  # the longest first, so that no core is idle at the end
        key = _key(device, job)
        program = device.program_key(job.source, (*job.options, *build_options(device.device)))
        are_kernels_cached = pocl_folder() is None or program_cache.has(program)
        if program_cache.load(key) is None or not are_kernels_cached:
            fresh[key] = job
    workers = min(len(fresh), worker_limit()) - 1
    if workers < 1:
        return
    own_folder = pocl_folder()
    try:
        with tempfile.TemporaryDirectory(prefix="compile-", dir=own_folder and own_folder.path) as folder:
            _compile_in_processes(device, list(fresh.values()), Path(folder), workers, on_compile)
    except OSError:  # no file or process can be made
        return
    store_pocl_kernels()
    for key in fresh:
        program_cache.store(key, b"compiled")


def _compile_in_processes(
    device: Device, jobs: Sequence[Job], folder: Path, workers: int, on_compile: OnCompile
) -> None:
    """Compile in this process and `workers` more, which find the jobs in the folder."""
    content = {"device": list_devices().index(parent_of(device.device)), "jobs": jobs}
    (folder / _JOBS_FILE).write_text(json.dumps(content), encoding="utf-8")
    command = [sys.executable, "-m", "isonoise.device.precompile", str(folder)]
    silent = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.DEVNULL)
    processes = []
    try:
        processes += [subprocess.Popen(command, **silent) for _ in range(workers)]
        _compile_unclaimed(device, jobs, folder, on_compile)
        while any(process.poll() is None for process in processes):
            last = next((job.name for number, job in enumerate(jobs) if not _done_file(folder, number).exists()), "")
            on_compile(last, _count_done(folder), len(jobs))
            time.sleep(_POLL_S)
    finally:
        for process in processes:
            if process.poll() is None:
                process.kill()
                process.wait()


def worker_limit() -> int:
    """Most processes that compile at a time: the cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _key(device: Device, job: Job) -> str:
    """Name in the program cache of the note that the job is done."""
    options = (*job.options, json.dumps(job.launches))
    return program_cache.program_key(job.source, options, driver_identity(device.device))


def _done_file(folder: Path, number: int) -> Path:
    return folder / f"{number}.done"


def _count_done(folder: Path) -> int:
    return sum(1 for _ in folder.glob("*.done"))


def _compile_unclaimed(device: Device, jobs: Sequence[Job], folder: Path, on_compile: OnCompile) -> None:
    """Compile, in turn, the programs that no other process has begun with."""
    for number, job in enumerate(jobs):
        try:
            (folder / f"{number}.claimed").touch(exist_ok=False)
        except FileExistsError:
            continue
        on_compile(job.name, _count_done(folder), len(jobs))
        kernels = device.build(job.source, job.options)
        buffer = device.buffer(_BUFFER_BYTES, "the compilation")
        for launch in job.launches:
            arguments = [buffer if value is None else bytes.fromhex(value) for value in launch.arguments]
            kernels[launch.kernel](device.queue, (launch.global_size,), (launch.local_size,), *arguments)
        device.finish()
        device.allocated -= buffer.size
        buffer.release()
        _done_file(folder, number).touch()


def _work(folder: Path) -> None:
    """Take part in the jobs of the folder. The calling process reports what cannot be compiled."""
    failures.log_folders[:] = [str(folder)]
    content = json.loads((folder / _JOBS_FILE).read_text(encoding="utf-8"))
    jobs = [
        Job(source, tuple(options), tuple(FirstLaunch(*launch) for launch in launches), name)
        for source, options, launches, name in content["jobs"]
    ]
    _compile_unclaimed(Device(content["device"]), jobs, folder, lambda name, done, total: None)


if __name__ == "__main__":
    _work(Path(sys.argv[1]))
