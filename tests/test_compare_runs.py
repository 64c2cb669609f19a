"""Runs of `isonoise compare`: content of their files, resuming, Ctrl-C."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from compare_command import (
    HEIGHT,
    SIZE,
    STRATEGIES,
    WIDTH,
    assert_same_runs,
    compare,
    options,
    run_files,
    write_flat_reference,
)

import isonoise
from isonoise.comparison.recorder import RUN_COLUMNS, SNAPSHOTS, Recorder
from isonoise.film.exr import read_reference
from isonoise.film.log import LogRow
from isonoise.loop import Stops
from isonoise.luminance import luminance
from isonoise.strategies.measures import image_floor

pytestmark = pytest.mark.usefixtures("in_tmp_path", "no_compare_report")


def test_the_files_of_a_comparison(finished_comparison):
    whole = finished_comparison
    assert sorted(run_files(whole)) == [
        f"runs/cornell/{strategy}/{seed}.npz" for strategy in sorted(STRATEGIES) for seed in (0, 1)
    ]
    assert sorted(path.name for path in (whole / "references").iterdir()) == ["cornell.exr"]
    plan = json.loads((whole / "plan.json").read_text())
    assert [(scene["slug"], scene["name"], scene["reference"]) for scene in plan["scenes"]] == [
        ("cornell", "cornell", "references/cornell.exr")
    ]
    assert [(strategy["slug"], strategy["spec"]) for strategy in plan["strategies"]] == [(s, s) for s in STRATEGIES]
    assert plan["seeds"] == [0, 1]
    assert (plan["time"], plan["spp"]) == (None, 8.0)
    rgb, error = read_reference(whole / "references" / "cornell.exr")
    assert rgb.shape == error.shape == (HEIGHT, WIDTH, 3)


@pytest.mark.parametrize("strategy", STRATEGIES)
def test_a_run_equals_a_render_with_the_same_options(tmp_path, strategy):
    """64 samples per pixel, so that the snapshots are from several waves."""
    reference = write_flat_reference("a.exr")
    assert compare(*options("out", (strategy,), 1, 64), "--seed", 3, "--reference", "a.exr") == 0
    with np.load(f"out/runs/cornell/{strategy}/3.npz") as file:
        run = {name: file[name] for name in file.files}
    assert set(run) == {"rows", "snapshot_s", "snapshot_samples", "errors", "rgb", "count", "facts", "identity"}
    outcome = isonoise.render("cornell", spp=64, strategy=strategy, seed=3, size=(WIDTH, HEIGHT))

    rows = json.loads(str(run["rows"]))
    assert [row["samples"] for row in rows] == [row.samples for row in outcome.rows]
    assert all(list(row) == list(RUN_COLUMNS) for row in rows)
    device = [row["device_s"] for row in rows]
    assert device[0] > 0
    assert device == sorted(device)
    assert run["count"].dtype == np.uint32
    assert (run["count"] == outcome.statistics.count).all()

    samples = np.array([row["samples"] for row in rows])
    reached = [samples[samples >= 64 * WIDTH * HEIGHT / 2 ** (SNAPSHOTS - 1 - k)][0] for k in range(SNAPSHOTS)]
    assert run["snapshot_samples"].tolist() == reached
    assert len(set(reached)) > 2
    elapsed = {row["samples"]: row["elapsed_s"] for row in rows}
    assert run["snapshot_s"].tolist() == [elapsed[each] for each in reached]

    assert (run["errors"].dtype, run["errors"].shape) == (np.float16, (SNAPSHOTS, HEIGHT, WIDTH))
    r = luminance(reference)
    expected = (luminance(outcome.rgb) - r) / np.maximum(r, image_floor(r))
    np.testing.assert_allclose(run["errors"][-1], expected, rtol=2**-11, atol=2**-24)
    for k in range(SNAPSHOTS - 1):
        assert (run["errors"][k].tobytes() == run["errors"][k + 1].tobytes()) == (reached[k] == reached[k + 1])
    assert rows[-1]["true_p99"] == pytest.approx(np.quantile(np.abs(expected), 0.99), rel=1e-6)
    assert (run["rgb"] == outcome.rgb.astype(np.float16)).all()

    facts = json.loads(str(run["facts"]))
    assert (facts["scene"], facts["seed"], facts["samples"]) == ("cornell", 3, int(samples[-1]))
    assert facts["strategy"].startswith(f"{strategy}:warmup=") or "warmup=" in facts["strategy"]
    assert facts["setup_s"] > 0
    assert facts["elapsed_s"] >= rows[-1]["elapsed_s"]


def row_at(elapsed, samples):
    stated = {"stated_p50": 0.1, "stated_p95": 0.1, "stated_p99": 0.1}
    return LogRow(elapsed_s=elapsed, wave=1, kind="uniform", samples=samples, spp=1, **stated, true=None, rejected=0)


def test_snapshots_are_taken_by_time_if_time_is_the_budget():
    """8 s: snapshots are due at 0.25, 0.5, 1, 2, 4 s and at the end, which may be a little before 8 s."""
    recorder = Recorder(Stops(time=8.0), np.ones((2, 3, 3), np.float32))
    times = (0.1, 0.3, 0.9, 1.5, 3.9, 5.0, 7.99)
    for number, elapsed in enumerate(times):
        image = np.full((2, 3, 3), 1 + elapsed, np.float32)
        recorder.wave(row_at(elapsed, number), image, None)
    Path("run.npz").write_bytes(recorder.pack(row_at(times[-1], 6), image, np.ones((2, 3)), {}, {}))
    with np.load("run.npz") as run:
        assert run["snapshot_s"].tolist() == [0.3, 0.9, 1.5, 3.9, 5.0, 7.99]
        assert run["snapshot_samples"].tolist() == [1, 2, 3, 4, 5, 6]
        np.testing.assert_allclose(run["errors"][:, 0, 0], run["snapshot_s"], rtol=1e-3)


def test_errors_are_clipped_to_the_range_of_float16():
    reference = np.zeros((1, 4, 3), np.float32)
    image = np.array([0.0, 1.0, -1.0, 1e30], np.float32)[None, :, None] * np.ones(3, np.float32)
    recorder = Recorder(Stops(spp=1.0), reference)
    recorder.wave(row_at(1.0, 4), image, None)
    Path("run.npz").write_bytes(recorder.pack(row_at(1.0, 4), image, np.ones((1, 4)), {}, {}))
    with np.load("run.npz") as run:
        assert run["errors"][-1].tolist() == [[0, 65504, -65504, 65504]]
        assert run["rgb"].tolist() == [[[value] * 3 for value in (0, 1, -1, 65504)]]


def test_a_plan_that_grows_keeps_its_runs(capsys):
    write_flat_reference("a.exr")
    given = ("--reference", "a.exr")
    assert compare(*options("out", ("uniform",), 1), *given) == 0
    (first,) = run_files("out").values()
    before = first.stat().st_mtime_ns
    capsys.readouterr()
    assert compare(*options("out", STRATEGIES, 2), *given) == 0
    assert "added: relative-mean, seed 1" in capsys.readouterr().out
    assert len(run_files("out")) == 4
    assert first.stat().st_mtime_ns == before
    assert compare(*options("whole", STRATEGIES, 2), *given) == 0
    assert_same_runs("whole", "out")

    assert compare(*options("out", ("uniform",), 2), *given) == 2
    assert "'relative-mean' is missing" in capsys.readouterr().err
    assert compare(*options("out", STRATEGIES, 2, 9), *given) == 2
    assert "spp was 8.0 and is 9.0" in capsys.readouterr().err
    assert len(run_files("out")) == 4


def start(*arguments, **more):
    command = [sys.executable, "-m", "isonoise", "compare", "cornell", *map(str, arguments)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **more)


def wait_for(process, directory, pattern):
    deadline = time.monotonic() + 60
    while not any(Path(directory).glob(pattern)):
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.002)


@pytest.mark.long
@pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals")
def test_a_killed_comparison_resumes_to_the_same_bits():
    """It is killed twice: during the reference and during the runs."""
    arguments = options("killed", seeds=3, spp=256)
    Path("killed/references").mkdir(parents=True)
    Path("killed/references/.0123456789ab.tmp.npz").touch()  # left by a process that was killed while writing
    for pattern in ("references/cornell.partial.npz", "runs/*/*/[0-9]*.npz"):
        process = start(*arguments)
        wait_for(process, "killed", pattern)
        process.kill()
        process.communicate()
        assert len(run_files("killed")) < 6
    assert compare(*arguments) == 0
    assert compare(*options("whole", seeds=3, spp=256)) == 0
    assert len(run_files("whole")) == 6
    assert_same_runs("whole", "killed")
    assert sorted(os.listdir("killed/references")) == ["cornell.exr"]
    assert not list(Path("killed").rglob("*.tmp*"))


@pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals")
@pytest.mark.parametrize(
    "name", ["SIGINT", *(pytest.param(name, marks=pytest.mark.long) for name in ("SIGTERM", "SIGHUP"))]
)
def test_signals_keep_finished_runs(name):
    """The process writes the report from the finished runs."""
    number = getattr(signal, name)
    write_flat_reference("a.exr")
    arguments = (*SIZE, "--time", "0.3", "--strategies", "uniform", "--seeds", 50, "-o", "out", "--reference", "a.exr")
    # a test run in the background may have set signals to be ignored
    process = start(*arguments, preexec_fn=lambda: signal.signal(number, signal.SIG_DFL))
    wait_for(process, "out", "runs/cornell/uniform/1.npz")
    process.send_signal(number)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 128 + number, err
    assert "finished runs are kept" in err
    assert "Traceback" not in err
    assert 2 <= len(run_files("out")) < 50
    assert Path("out/report.html").exists()
    assert not list(Path("out").rglob("*.tmp*"))
    assert "seed 0" in out  # seed 1 may be interrupted between its file and its line
