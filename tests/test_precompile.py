"""Compilation in several processes."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest

from isonoise.device import precompile, program_cache
from isonoise.device.opencl import Device
from isonoise.device.precompile import FirstLaunch, Job

VALUE = np.uint32(0).tobytes().hex()


def job(number: int) -> Job:
    """A program that no other test builds."""
    text = (
        f"__kernel void add(__global uint* x, uint n) {{ if (get_global_id(0) < n) x[get_global_id(0)] += {number}u; }}"
    )
    return Job(text, ("-cl-std=CL1.2",), (FirstLaunch("add", 64, 64, (None, VALUE)),))


@pytest.fixture
def device():
    device = Device()
    if not device.is_pocl:
        pytest.skip("other drivers than PoCL compile on all cores, or keep nothing")
    return device


@pytest.fixture
def two_processes(monkeypatch, tmp_path):
    monkeypatch.setattr(precompile, "worker_limit", lambda: 2)
    monkeypatch.setenv(program_cache.FOLDER_VARIABLE, str(tmp_path / "programs"))


def forbid_processes(monkeypatch) -> None:
    def start(*_, **__):
        raise AssertionError("a process is started")

    monkeypatch.setattr(subprocess, "Popen", start)


@pytest.mark.usefixtures("two_processes")
def test_programs_are_compiled_once(device, monkeypatch):
    jobs = [job(1), job(2)]
    allocated, progress = device.allocated, []
    precompile.precompile(device, jobs, lambda *reported: progress.append(reported))
    assert device.allocated == allocated
    assert progress[0][1:] == (0, 2)
    assert [done for _, done, _ in progress] == sorted(done for _, done, _ in progress)
    forbid_processes(monkeypatch)
    precompile.precompile(device, jobs)
    with pytest.raises(AssertionError):  # a new program, and one with other launches
        precompile.precompile(device, [job(3), job(1)._replace(launches=(FirstLaunch("add", 128, 64, (None, VALUE)),))])


def test_workers_store_their_kernels(tmp_path):
    """All programs are compiled by the worker here: the calling process finds them in the program cache."""
    script = """
import sys
sys.path.insert(0, "tests")
from isonoise.device import precompile
from isonoise.device.opencl import Device
from test_precompile import job

precompile.worker_limit = lambda: 2
precompile._compile_unclaimed = lambda *arguments: None
device, jobs = Device(), [job(1), job(2)]
precompile.precompile(device, jobs)
for each in jobs:
    assert b"add.so" in precompile.program_cache.load(device.program_key(each.source, each.options))
"""
    folders = {"POCL_CACHE_DIR": str(tmp_path / "pocl"), program_cache.FOLDER_VARIABLE: str(tmp_path / "programs")}
    if not Device().is_pocl:
        pytest.skip("not PoCL")
    subprocess.run([sys.executable, "-c", script], env=os.environ | folders, check=True)
    assert not list((tmp_path / "pocl").iterdir())  # each process has deleted its own


@pytest.mark.usefixtures("two_processes")
@pytest.mark.parametrize("executable", ["/nonexistent", "/bin/false"])
def test_workers_that_fail_are_ignored(device, monkeypatch, executable):
    """The calling process compiles what no worker has begun with."""
    built = []
    monkeypatch.setattr(sys, "executable", executable)
    build = Device.build
    monkeypatch.setattr(Device, "build", lambda self, *text: built.append(text) or build(self, *text))
    precompile.precompile(device, [job(4), job(5)])
    assert len(built) == (2 if executable == "/bin/false" else 0)


@pytest.mark.parametrize(("processes", "folder"), [(1, "programs"), (2, "off")])
def test_one_process_where_more_would_not_help(device, monkeypatch, tmp_path, processes, folder):
    monkeypatch.setattr(precompile, "worker_limit", lambda: processes)
    monkeypatch.setenv(program_cache.FOLDER_VARIABLE, folder if folder == "off" else str(tmp_path / folder))
    forbid_processes(monkeypatch)
    precompile.precompile(device, [job(6), job(7)])


def test_jobs_survive_the_way_to_a_worker():
    assert Job(*json.loads(json.dumps(job(8)))).launches == [["add", 64, 64, [None, VALUE]]]
