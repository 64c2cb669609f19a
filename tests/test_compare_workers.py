"""`isonoise compare --workers`: the same figures as without, lost workers, Ctrl-C and resuming."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from compare_command import read_run, run_files, write_flat_reference

from isonoise.comparison.summary import summarise
from isonoise.film.exr import read_exr

psutil = pytest.importorskip("psutil", reason="needs the extra 'cluster'")
pytest.importorskip("distributed", reason="needs the extra 'cluster'")

pytestmark = [pytest.mark.long, pytest.mark.usefixtures("in_tmp_path")]

WIDTH, HEIGHT = 48, 32
SCENES = ("cornell", "penumbra")
OF_THE_WORKER = {"device", "parts", "worker"}
TIMES = {"elapsed_s", "device_s", "setup_s", "curves", "time_to_equal_error", "devices", "timing"}


def options(directory, spp, seeds=2, scenes=SCENES):
    strategies = ("--strategies", "uniform,pooled", "--seeds", seeds)
    return (*scenes, "--size", f"{WIDTH}x{HEIGHT}", "--spp", spp, *strategies, "-o", directory)


def long_runs(directory, spp):
    """Six runs against a reference that takes no time."""
    write_flat_reference("a.exr", (WIDTH, HEIGHT))
    return (*options(directory, spp, 3, SCENES[:1]), "--reference", "a.exr")


def start(*arguments):
    command = [sys.executable, "-m", "isonoise", "compare", *map(str, arguments)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def finish(process, code=0):
    out, err = process.communicate(timeout=300)
    assert process.returncode == code, err
    assert "Traceback" not in err
    return out, err


def worker_processes(process):
    """Those that render; Python's `multiprocessing` starts others, too."""
    found = psutil.Process(process.pid).children(recursive=True)
    return [each for each in found if any("spawn_main" in part for part in each.cmdline())]


def wait_for_runs(process, directory, count):
    deadline = time.monotonic() + 120
    while len(run_files(directory)) < count:
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.01)


def content_of(path):
    """What a run has in common with that of another device of the same kind."""
    content = read_run(path)
    facts = {name: value for name, value in content["facts"].items() if name not in OF_THE_WORKER}
    arrays = {name: content[name].tobytes() for name in ("errors", "count", "snapshot_samples")}
    return repr((content["rows"], facts)), arrays


def assert_same_bits(directory, other):
    files, others = run_files(directory), run_files(other)
    assert list(files) == list(others)
    for name, path in files.items():
        assert content_of(path) == content_of(others[name]), name
    for path in Path(directory).glob("references/*.exr"):
        channels, same = (read_exr(folder / "references" / path.name)[0] for folder in (Path(directory), Path(other)))
        assert all(plane.tobytes() == same[name].tobytes() for name, plane in channels.items())


def without_times(value):
    if isinstance(value, dict):
        return {name: without_times(each) for name, each in value.items() if name not in TIMES}
    return [without_times(each) for each in value] if isinstance(value, list) else value


def test_two_workers_give_the_same_figures():
    finish(start(*options("here", 64)))
    finish(start(*options("there", 64), "--workers", 2))
    assert_same_bits("here", "there")
    here, there = summarise("here"), summarise("there")
    assert without_times(here) == without_times(there)
    for scene in there["scenes"]:
        assert sum(row["runs"] for row in scene["timing"]) == 4
        assert all(row["worker"].startswith("tcp://127.0.0.1:") for row in scene["timing"])
    assert json.loads(Path("there/plan.json").read_text())["device"] == there["scenes"][0]["timing"][0]["device"]
    assert "tcp://127.0.0.1:" in Path("there/report.html").read_text()
    _, err = finish(start(*options("there", 64)), 2)
    assert "device was" in err


def test_a_killed_worker_costs_its_run_only():
    process = start(*long_runs("there", 2048), "--workers", 2)
    wait_for_runs(process, "there", 1)
    worker_processes(process)[0].kill()
    _, err = finish(process)
    assert "is rendered again: worker tcp://127.0.0.1:" in err
    assert len(run_files("there")) == 6
    finish(start(*long_runs("here", 2048)))
    assert_same_bits("here", "there")


@pytest.mark.skipif(os.name != "posix", reason="POSIX signals")
def test_ctrl_c_keeps_finished_runs_and_the_same_command_resumes():
    arguments = (*long_runs("there", 2048), "--workers", 2)
    process = start(*arguments)
    wait_for_runs(process, "there", 2)
    workers = worker_processes(process)
    process.send_signal(signal.SIGINT)
    _, err = finish(process, 128 + signal.SIGINT)
    assert "finished runs are kept" in err
    psutil.wait_procs(workers, timeout=10)
    assert not any(each.is_running() for each in workers)
    finished = {name: path.stat().st_mtime_ns for name, path in run_files("there").items()}
    assert 2 <= len(finished) < 6
    assert not list(Path("there").rglob("*.tmp*"))
    _, err = finish(start(*arguments))
    assert err == ""
    assert {name: path.stat().st_mtime_ns for name, path in run_files("there").items() if name in finished} == finished
    finish(start(*long_runs("here", 2048)))
    assert_same_bits("here", "there")
