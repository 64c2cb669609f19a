"""The ends of a render: errors, signals, failing files and streams. What has been rendered is always written."""

import json
import operator
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from isonoise.cli import main
from isonoise.errors import DeviceError, UserError
from isonoise.film.exr import read_exr, read_reference
from isonoise.film.files import PathLock
from isonoise.film.log import LogWriter
from isonoise.film.output import ImageFiles
from isonoise.integrator.accumulator import Accumulator
from isonoise.loop import Periodic
from isonoise.statistics import Statistics

pytestmark = pytest.mark.usefixtures("in_tmp_path")

SMALL = ("render", "cornell", "--size", "16x12", "--spp", "64")
SAMPLES = 3 * 16 * 12
"""Of the three waves before `Ends` ends the render."""
STRATEGY = """
import os, resource, signal
import numpy as np
from isonoise import Strategy, Wave

class Ends(Strategy):
    '''One sample per pixel and wave; the fourth wave ends in an unusual way.'''

    def __init__(self, way: int = 0):
        self.way, self.waves_so_far = way, 1

    def waves(self):
        yield Wave("uniform", 1)
        while True:
            yield Wave("adaptive", 1)

    def allocate(self, statistics, samples):
        self.waves_so_far += 1
        if self.waves_so_far == 4:
            if self.way == 0:
                raise ValueError("a bug")
            if self.way == 1:
                raise MemoryError
            if self.way == 2:
                raise SystemExit(0)
            if self.way == 3:
                return np.ones(samples)
            if self.way == 5:
                resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))
            if self.way == 4:
                os.mkdir("b.exr")
            if self.way > 100:
                signal.raise_signal(self.way - 100)
        return np.ones(statistics.shape, np.uint32)
"""


@pytest.fixture(autouse=True)
def _strategy(tmp_path_factory, monkeypatch):
    folder = tmp_path_factory.mktemp("strategy")
    (folder / "ends_of_renders.py").write_text(STRATEGY)
    monkeypatch.syspath_prepend(folder)


def render(*options, way=None):
    strategy = () if way is None else ("--strategy", f"ends_of_renders:Ends:way={way}")
    return main([*SMALL, *strategy, *options])


def samples(path):
    return int(read_exr(path)[0]["samples"].sum())


@pytest.mark.parametrize(
    ("way", "code", "message"),
    [
        (0, 70, "error (ValueError) in "),
        (1, 2, "not enough memory"),
        (2, 70, "error (SystemExit) in "),
        (3, 2, "returned an allocation map"),
    ],
)
def test_an_error_keeps_image_and_log(way, code, message, capsys):
    assert render("-o", "a.exr", "-o", "a.png", "--log", "a.csv", "--json", way=way) == code
    out, err = capsys.readouterr()
    assert message in err.splitlines()[-1]
    assert ("Traceback" in err) == (code == 70)
    assert json.loads(out)["stopped_by"] == read_exr("a.exr")[1]["isonoise.stopped_by"] == "failed"
    assert samples("a.exr") == SAMPLES
    assert len(Path("a.csv").read_text().splitlines()) == 4
    assert sorted(os.listdir()) == ["a.csv", "a.exr", "a.png"]


def test_a_lost_device_keeps_the_image_of_the_last_wave(monkeypatch, capsys):
    read = Accumulator.statistics
    calls = []

    def fail_later(self, *arguments, **options):
        calls.append(None)
        if len(calls) > 3:
            raise DeviceError("the device is lost")
        return read(self, *arguments, **options)

    monkeypatch.setattr(Accumulator, "statistics", fail_later)
    assert render("-o", "a.exr", "--strategy", "uniform") == 2
    assert "the device is lost" in capsys.readouterr().err
    assert 0 < samples("a.exr") < 64 * 16 * 12


@pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, getattr(signal, "SIGHUP", None)])
def test_a_signal_keeps_the_image(number, capsys):
    previous = signal.signal(number, signal.SIG_DFL)  # it may be ignored, under nohup or in the background
    try:
        assert render("-o", "a.exr", "--log", "a.csv", way=100 + number) == 128 + number
    finally:
        assert signal.signal(number, previous) == signal.SIG_DFL
    assert capsys.readouterr().err == ""
    assert samples("a.exr") >= SAMPLES
    assert sorted(os.listdir()) == ["a.csv", "a.exr"]


@pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals")
def test_an_interrupt_that_a_library_swallows_is_not_lost(monkeypatch, capsys):
    def swallow(*_):
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt:
            raise_number.append(None)

    raise_number = []
    previous = signal.signal(signal.SIGINT, signal.default_int_handler)
    monkeypatch.setattr("isonoise.scene.load_compiled.build_scene_bvh", swallow)
    try:
        assert render("-o", "a.exr") == 130
    finally:
        signal.signal(signal.SIGINT, previous)
    assert raise_number
    assert capsys.readouterr() == ("", "isonoise: interrupted\n")
    assert os.listdir() == []


@pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals")
def test_an_interrupt_before_the_first_sample_changes_no_file(monkeypatch, capsys):
    Path("a.exr").write_text("old")
    previous = signal.signal(signal.SIGINT, signal.default_int_handler)
    monkeypatch.setattr("isonoise.commands.render.print_settings", lambda *_: None)
    monkeypatch.setattr(
        "isonoise.commands.render.RenderProgressBar.__enter__", lambda bar: signal.raise_signal(signal.SIGINT) or bar
    )
    monkeypatch.setattr("isonoise.commands.render.RenderProgressBar.__exit__", lambda *_: None)
    monkeypatch.setattr("isonoise.commands.render.RenderProgressBar.update", lambda *_: None, raising=False)
    try:
        assert render("-o", "a.exr") == 130
    finally:
        signal.signal(signal.SIGINT, previous)
    assert "no image is written" in capsys.readouterr().err
    assert Path("a.exr").read_text() == "old"


def statistics(unsampled: int) -> Statistics:
    count = np.full((4, 5), 2, np.uint32)
    count.ravel()[:unsampled] = 0
    plane = np.ones((4, 5))
    return Statistics(count, np.zeros((4, 5), np.uint32), np.ones((4, 5, 3), np.float32), plane, plane, None)


def test_an_image_without_all_pixels_replaces_none():
    Path("a.exr").write_text("old")
    images = ImageFiles(["a.exr", "b.exr"])
    for _ in range(2):  # a process that is killed later leaves no file that the next one does not replace
        assert images.write(statistics(3), 0.1, {}, has_ended=False) == [(None, None), ("b.exr", None)]
        assert Path("a.exr").read_text() == "old"
        assert sorted(os.listdir()) == ["a.exr", "b.exr"]
    written = images.write(statistics(3), 0.1, {})
    assert [image.path for image in written] == ["a.partial.exr", "b.exr"]
    assert (read_exr("a.partial.exr")[0]["samples"] == 0).sum() == 3
    written = images.write(statistics(0), 0.1, {})
    assert [image.path for image in written] == ["a.exr", "b.exr"]


def test_rejected_samples_and_few_samples_are_no_missing_pixels():
    Path("a.exr").write_text("old")
    sampled = statistics(3)
    sampled.rejected[sampled.count == 0] = 1
    assert ImageFiles(["a.exr"]).write(sampled, 0.1, {})[0].path == "a.exr"
    Path("a.exr").write_text("old")
    assert main([*SMALL[:-1], "0.5", "-o", "a.exr"]) == 0
    assert (read_exr("a.exr")[0]["samples"] == 0).sum() == 16 * 12 / 2


def test_a_file_that_cannot_be_written_loses_no_other(capsys):
    Path("b.rescued.exr").write_text("old")
    assert render("-o", "a.exr", "-o", "b.exr", "-o", "c.png", "--json", way=4) == 2
    out, err = capsys.readouterr()
    place = str(Path("b.rescued-2.exr").absolute())
    assert f"cannot write 'b.exr': it is a folder; give a file name; it is in '{place}' instead" in err
    assert samples("a.exr") == samples("b.rescued-2.exr") == 64 * 16 * 12
    assert json.loads(out)["output"] == ["a.exr", place, "c.png"]
    assert Path("b.rescued.exr").read_text() == "old"


@pytest.mark.skipif(sys.platform == "win32", reason="file size limits are POSIX")
def test_a_full_disk_everywhere():
    options = ("--strategy", "ends_of_renders:Ends:way=5", "-o", "a.exr", "-o", "b.exr", "--log", "a.csv")
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, "-m", "isonoise", *SMALL, *options]
    done = subprocess.run(command, capture_output=True, text=True, env=environment)
    assert done.returncode == 2
    for name in ("a.exr", "b.exr", "a.csv"):
        assert f"cannot write '{name}'" in done.stderr
    assert done.stderr.count("nor could it be written anywhere else") == 3
    assert os.listdir() == ["a.csv"]
    assert Path("a.csv").read_text().endswith("\n")


def test_an_incomplete_log_is_written_elsewhere(capsys, monkeypatch):
    write = LogWriter.write

    def fail_later(self, row):
        if row.wave == 2:
            raise UserError("cannot write 'a.csv': No space left on device")
        write(self, row)

    monkeypatch.setattr(LogWriter, "write", fail_later)
    assert render("-o", "a.exr", "--log", "a.csv", way=3) == 2
    assert "No space left on device; the log is incomplete, the image is complete; it is in" in capsys.readouterr().err
    assert len(Path("a.csv").read_text().splitlines()) == 2
    assert len(Path("a.rescued.csv").read_text().splitlines()) == 4


def failing_streams():
    read_end, write_end = os.pipe()
    os.close(read_end)
    yield "Broken pipe", os.fdopen(write_end, "w")
    yield "it is closed", None
    if os.path.exists("/dev/full"):
        yield "No space left on device", os.fdopen(os.open("/dev/full", os.O_WRONLY), "w")


@pytest.mark.skipif(sys.platform == "win32", reason="POSIX pipes")
def test_standard_output_that_fails_loses_no_image(capsys, monkeypatch):
    for (message, stream), option in zip(failing_streams(), [(), ("--json",), ()], strict=False):
        with monkeypatch.context() as patch:
            patch.setattr(sys, "stdout", stream)
            assert render("-o", "a.exr", "--strategy", "uniform", *option) == 2
        assert capsys.readouterr().err == f"isonoise: cannot write to standard output: {message}\n"
        assert read_reference("a.exr")[0].shape == (12, 16, 3)
        os.unlink("a.exr")


def test_a_log_is_written_by_one_process(capsys):
    lock = PathLock(Path("a.csv"))
    assert render("-o", "a.exr", "--log", "a.csv") == 2
    assert "it is being written by process" in capsys.readouterr().err
    lock.release()
    assert render("-o", "a.exr", "--log", "a.csv", "--strategy", "uniform") == 0
    assert sorted(os.listdir()) == ["a.csv", "a.exr"]


def test_images_are_saved_during_the_render(monkeypatch):
    """They are valid, and saving does not change the samples."""
    saved = []
    write = ImageFiles.write

    def write_and_read(self, *arguments, **options):
        written = write(self, *arguments, **options)
        channels, header = read_exr(written[0].path)
        saved.append((int(channels["samples"].sum()), header["isonoise.stopped_by"]))
        return written

    monkeypatch.setattr(ImageFiles, "write", write_and_read)
    monkeypatch.setattr("isonoise.commands.render.Periodic", lambda _, action: Periodic(0.01, action))
    options = ("--spp", "1000", "--strategy", "uniform")
    assert render(*options, "-o", "a.exr", "--save-every", "0.1") == 0
    assert len(saved) >= 3
    assert [number for number, _ in saved] == sorted(number for number, _ in saved)
    assert {reason for _, reason in saved[:-1]} == {"unfinished"}
    assert saved[-1] == (1000 * 16 * 12, "spp")
    assert render(*options, "-o", "b.exr") == 0
    for name, plane in read_exr("a.exr")[0].items():
        assert plane.tobytes() == read_exr("b.exr")[0][name].tobytes()
    assert sorted(os.listdir()) == ["a.exr", "b.exr"]


def test_an_internal_error_has_its_own_exit_code(monkeypatch, capsys):
    monkeypatch.setattr("isonoise.commands.info.run", operator.itemgetter(0))  # in no file that is not isonoise's
    assert main(["info", "cornell"]) == 70
    err = capsys.readouterr().err
    assert "TypeError: " in err
    assert err.splitlines()[-1] == "isonoise: internal error (TypeError); please report it with the lines above"
