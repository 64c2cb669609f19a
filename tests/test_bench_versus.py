"""`isonoise bench --versus`: two processes take turns; each uses the isonoise of its own folder."""

import json
import shutil
import sys
from pathlib import Path

import pytest
from bench_command import CHECKOUT, documented_fields, json_fields, run_isonoise

from isonoise.benchmark import versus
from isonoise.benchmark.report_text import versus_text

COMMAND = ("bench", "cornell", "--size", "12x10", "--spp", "4", "--repeat", "2")

pytestmark = pytest.mark.usefixtures("in_tmp_path")


@pytest.fixture
def other_checkout(tmp_path):
    """A copy of this checkout, in another folder."""
    folder = tmp_path / "other"
    for name in ("host/isonoise", "kernels", "scenes"):
        shutil.copytree(CHECKOUT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(CHECKOUT / "pyproject.toml", folder)
    return folder


def edit(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


def test_two_checkouts_are_compared(other_checkout, capsys):
    """The other side is that in its folder, where images are twice as bright."""
    edit(other_checkout / "host/isonoise/__init__.py", '__version__ = "', '__version__ = "99.')
    image = "self._waves.statistics.read_rgb()"
    edit(other_checkout / "host/isonoise/renderer.py", f"return {image}", f"return 2 * {image}")
    assert run_isonoise(*COMMAND, "--versus", str(other_checkout), "--json", "v.json", "--threshold", "0.001") == 0
    result = json.loads(Path("v.json").read_text())
    assert json_fields(result) == documented_fields()[1]
    assert result["other"]["checkout"] == str(other_checkout)
    assert result["other"]["isonoise_version"].startswith("99.")
    assert result["other"]["commit"] is None
    assert {key: result["device"][key] for key in result["other"]["device"]} == result["other"]["device"]
    (scene,) = result["scenes"]
    assert scene["samples"] == 480
    assert scene["image_mean_ratio"] == pytest.approx(0.5, rel=1e-6)
    for name in ("speedup", "cpu_speedup"):
        assert 0 < scene[name]["min"] <= scene[name]["median"] <= scene[name]["max"]
    assert versus_text(result, 0.001, []) in capsys.readouterr().out


def test_a_checkout_that_fails_is_a_message(other_checkout, capsys, tmp_path, monkeypatch):
    """Its kernels are those in its folder, too."""
    monkeypatch.setenv("TMPDIR", str(tmp_path))  # the compiler's log is saved there
    edit(other_checkout / "kernels/stages/reduce.cl", "__kernel", "#error broken\n__kernel")
    assert run_isonoise(*COMMAND, "--versus", str(other_checkout)) == 2
    out, err = capsys.readouterr()
    assert "other' cannot render cornell: DeviceError" in err
    assert "Traceback" not in err
    assert out == ""


def test_another_device_is_selected_by_its_name(capsys):
    assert run_isonoise(*COMMAND, "--versus", "device:no such device") == 2
    assert "no OpenCL device matches 'no such device'" in capsys.readouterr().err


class FakeProcess:
    """A side whose runs take the seconds in `runs`, in order; it records the order of all requests."""

    runs: dict[str, list[float]]
    order: list[str]
    version = "1"

    def __init__(self, subject, name, source, scene, samples, settings):
        self.label = subject.label

    def __enter__(self):
        return self

    def __exit__(self, *exception):
        pass

    def request(self, line):
        if line == "mean":
            return {"mean": 0.0}
        self.order.append(self.label)
        seconds = self.runs[self.label].pop(0)
        return {"seconds": seconds, "cpu_seconds": 2 * seconds}


@pytest.mark.parametrize(
    ("mine", "theirs", "threshold", "median", "code"),
    [
        # a machine that is busy for a while slows down both sides of a pair
        ([1.0, 4.0, 1.0, 4.0], [1.0, 4.0, 1.0, 4.0], (), 1.0, 0),
        ([1.0, 2.0, 1.0, 2.0], [0.5, 1.0, 0.5, 1.0], (), 0.5, 1),
        ([1.0, 2.0, 1.0, 2.0], [0.5, 1.0, 0.5, 1.0], ("--threshold", "0.4"), 0.5, 0),
        # one pair in which this side was not slower
        ([1.0, 1.0, 1.0, 1.0], [0.5, 0.5, 0.5, 1.0], (), 0.5, 0),
        ([0.5, 0.5, 0.5, 0.5], [1.0, 1.0, 1.0, 1.0], (), 2.0, 0),
    ],
)
def test_ratios_are_those_of_pairs(monkeypatch, capsys, mine, theirs, threshold, median, code):
    monkeypatch.setattr(versus, "WorkerProcess", FakeProcess)
    FakeProcess.runs, FakeProcess.order = {"this side": list(mine), "'device:0'": list(theirs)}, []
    command = ("bench", "cornell", "--size", "12x10", "--spp", "4", "--repeat", "4", "--versus", "device:0")
    assert run_isonoise(*command, "--json", "v.json", *threshold) == code
    assert FakeProcess.order == ["this side", "'device:0'"] * 4
    (scene,) = json.loads(Path("v.json").read_text())["scenes"]
    assert scene["speedup"]["median"] == scene["cpu_speedup"]["median"] == median
    assert scene["samples_per_s"]["max"] == 480 / min(mine)
    assert scene["image_mean_ratio"] is None
    out, err = capsys.readouterr()
    assert (f"slower than 'device:0': cornell samples/s {median:.3f}" in err) == bool(code)
    assert ("slower\n" in out.splitlines()[-1] + "\n") == bool(code)


def test_a_process_that_dies_is_a_message(monkeypatch, tmp_path, capsys):
    script = tmp_path / "dies.py"
    script.write_text("import sys\nsys.stdin.readline()\nsys.exit(7)\n")
    monkeypatch.setattr(versus.versus_worker, "__file__", str(script))
    assert run_isonoise(*COMMAND, "--versus", "device:0") == 2
    assert "this side cannot render cornell: its process ended with exit code 7" in capsys.readouterr().err


def test_the_worker_ends_with_its_input():
    subject = versus.this_subject(None)
    scene = versus.load_scene("cornell", versus.Settings(size=(4, 3)))
    with versus.WorkerProcess(subject, "cornell", "cornell", scene, 12, versus.Settings()) as side:
        assert side.request("run")["seconds"] > 0
        process = side._process
    assert process.returncode == 0
    assert sys.modules["isonoise"].__version__ == side.version
