"""The command line: exit codes, messages, files, and no leftovers after a failure."""

import csv
import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from isonoise.cli import main
from isonoise.film.exr import read_exr, read_reference, write_exr
from isonoise.film.log import columns

SMALL = ("render", "cornell", "--size", "16x12")

pytestmark = pytest.mark.usefixtures("in_tmp_path")


def isonoise(*arguments):
    """Run a command in this process; return its exit code."""
    try:
        return main(list(arguments))
    except SystemExit as exit_:  # raised by argparse
        return exit_.code


def start(*arguments, **options):
    """Start the command in a subprocess."""
    command = [sys.executable, "-m", "isonoise", *arguments]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **options)


def rows(path):
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


def test_a_render_with_image_preview_and_log(capsys):
    options = ("--spp", "16", "--seed", "7", "--strategy", "relative-median", "--log", "a.csv")
    assert isonoise(*SMALL, *options, "-o", "a.exr", "-o", "a.png") == 0
    out, err = capsys.readouterr()
    assert err == ""
    for word in (
        "cornell, 16x12",
        "relative-median",
        "seed 7",
        "set-up",
        "samples",
        "% (stated, quantile 0.99)",
        "a.exr",
        "a.png",
    ):
        assert word in out
    channels, header = read_exr("a.exr")
    assert set(channels) == {"R", "G", "B", "samples", "error", "M_x"}
    assert channels["samples"].shape == (12, 16)
    total = int(channels["samples"].sum()) + int(header["isonoise.rejected"])
    assert total == 16 * 16 * 12
    assert {name: header[f"isonoise.{name}"] for name in ("scene", "seed", "stopped_by")} == {
        "scene": "cornell",
        "seed": "7",
        "stopped_by": "spp",
    }
    assert float(header["isonoise.floor"]) > 0
    log = rows("a.csv")
    assert list(log[0]) == list(columns(true_errors=False))
    assert int(log[-1]["samples"]) == total
    assert [int(row["wave"]) for row in log] == list(range(1, len(log) + 1))
    assert float(log[-1]["elapsed_s"]) <= float(header["isonoise.time_s"])
    assert sorted(os.listdir()) == ["a.csv", "a.exr", "a.png"]


def test_json_is_one_object_and_equals_the_header(capsys):
    assert isonoise(*SMALL, "--spp", "8", "-o", "a.exr", "--json") == 0
    out, err = capsys.readouterr()
    assert err == ""
    outcome = json.loads(out, parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))
    channels, header = read_exr("a.exr")
    assert outcome["samples"] == int(channels["samples"].sum()) == int(header["isonoise.samples"])
    assert outcome["output"] == ["a.exr"]
    assert outcome["stopped_by"] == "spp"
    assert outcome["last_wave"]["samples"] == outcome["samples"]
    assert outcome["setup_s"]["load"] >= 0
    assert outcome["workers"] == []  # one device
    assert outcome["client_share"] is None
    assert outcome["time_s"] == float(header["isonoise.time_s"])


def test_without_a_limit_the_scenes_sample_count_is_used(capsys):
    assert isonoise("render", "cornell", "--size", "4x4", "-o", "a.exr", "--json") == 0
    assert json.loads(capsys.readouterr().out)["spp"] == 256  # cornell's sample_count


def test_true_errors_with_a_reference(capsys):
    assert isonoise(*SMALL, "--spp", "64", "--seed", "1", "-o", "ref.exr") == 0
    assert (
        isonoise(*SMALL, "--spp", "64", "--seed", "1", "-o", "a.exr", "--reference", "ref.exr", "--log", "a.csv") == 0
    )
    assert "true    p50 0 %, p95 0 %, p99 0 %; relMSE 0, image mean ratio 1.0000" in capsys.readouterr().out
    log = rows("a.csv")
    assert list(log[0]) == list(columns(true_errors=True))
    assert float(log[0]["true_p99"]) > 0
    assert float(log[-1]["true_p99"]) == 0  # the same samples as the reference


@pytest.mark.parametrize(("limit", "code", "reason"), [("1e-9", 1, "spp"), ("1e11%", 0, "error")])
def test_the_exit_code_says_whether_the_error_was_reached(limit, code, reason, capsys):
    assert isonoise(*SMALL, "--error", limit, "--spp", "32", "-o", "a.exr", "--json") == code
    assert json.loads(capsys.readouterr().out)["stopped_by"] == reason
    assert os.listdir() == ["a.exr"]


@pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_render_with_a_valid_image(number):
    options = ("--time", "100", "-o", "a.exr", "--log", "a.csv", "--json")
    # a test run in the background may ignore Ctrl-C, and subprocesses inherit that
    process = start("render", "cornell", *options, preexec_fn=lambda: signal.signal(number, signal.SIG_DFL))
    deadline = time.monotonic() + 60
    while not os.path.exists("a.csv"):
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.05)
    process.send_signal(number)
    out, err = process.communicate(timeout=20)
    assert (process.returncode, err) == (128 + number, "")
    outcome = json.loads(out)
    assert outcome["stopped_by"] == "interrupted"
    channels, _ = read_exr("a.exr")
    assert int(channels["samples"].sum()) == outcome["samples"] > 0
    assert sorted(os.listdir()) == ["a.csv", "a.exr"]


LIMITS = ("--spp", "--time", "--error")


@pytest.mark.parametrize(
    ("option", "value", "message"),
    [
        ("--spp", "0", "more than 0"),
        ("--spp", "-4", "more than 0"),
        ("--spp", "many", "not a number"),
        ("--time", "nan", "not a finite number"),
        ("--time", "inf", "not a finite number"),
        ("--error", "0", "more than 0"),
        ("--error", "%", "not a number"),
        ("--error", "-2%", "more than 0"),
        ("--error", "5", "would be 500 %; write 5% or 0.05"),
        ("--fov", "180", "less than 180"),
        ("--fov", "wide", "not a number"),
        ("--look-at", "1,2", "not a point"),
        ("--look-at", "0,0,0:1,2,3:4,5,6", "more than two points"),
        ("--look-at", "0,0,1e999", "not a finite number"),
        ("--look-at", "1,1,1:1,1,1", "two different points"),
        ("--up", "w", "not a point"),
        ("--up", "0,0,0", "no direction"),
        ("--camera", "side", "there is no camera 'side'; the scene has: 0 'sensor'"),
        ("--env", "no.hdr", "cannot be read"),
        ("--quantile", "1", "between 0 and 1"),
        ("--quantile", "0", "between 0 and 1"),
        ("--seed", "-1", "from 0"),
        ("--seed", "1.5", "not a whole number"),
        ("--seed", str(2**64), "from 0"),
        ("--size", "0x0", "no pixels"),
        ("--size", "640", "WIDTHxHEIGHT"),
        ("--size", "100000x100000", "more than"),
        ("--size", "-2x3", "WIDTHxHEIGHT"),
        ("--max-depth", "0", "from 1 to 2147483647, or -1"),
        ("--max-depth", "-2", "or -1"),
        ("--max-depth", "99999999999", "from 1 to 2147483647, or -1"),
        ("--max-depth", "1" + "0" * 5000, "not a whole number"),
        ("--seed", "1" + "0" * 5000, "not a whole number"),
        ("--size", "1" + "0" * 5000 + "x1", "WIDTHxHEIGHT"),
        *((limit, value, "from 1e-30 to 1e+30") for limit in LIMITS for value in ("1e308", "1e-300")),
        ("-D", "name", "name=value"),
        ("-D", "=1", "name=value"),
        ("--strategy", "relative-medan", "relative-median"),
        ("--strategy", "relative-median:kapa=3", "kappa"),
        ("--device", "no such device", "no such device"),
        ("--reference", "nothing.exr", "No such file"),
        ("--log", "no/log.csv", "no folder"),
        ("-o", "a.exr", "the same file as"),
        ("-o", "./a.exr", "the same file as"),
        ("-o", "no/b.exr", "no folder"),
        ("-o", "b.jpg", "use .exr"),
        ("--log", "a.exr", "the same file as"),
    ],
)
def test_bad_option_values_are_reported(option, value, message, capsys):
    assert (
        isonoise(*SMALL, "--spp", "1", "-o", "a.exr", f"{option}={value}" if option[1] == "-" else option + value) == 2
    )
    out, err = capsys.readouterr()
    assert message in err
    assert "Traceback" not in err + out
    assert os.listdir() == []


def test_points_and_axes_may_begin_with_a_minus():
    from isonoise.cli import make_parser

    options = make_parser().parse_args(
        ["render", "a.glb", "-o", "a.png", "--look-at", "-1,0,-2:-.5,1e-3,0", "--up", "-z", "-D", "a=-1"]
    )
    assert options.look_at == ((-1, 0, -2), (-0.5, 1e-3, 0))
    assert options.up == (0, 0, -1)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "no such file"),
        (b"", "scene.xml"),
        (b"<scene version='3.0.0'><shape type='sphere'>", "scene.xml"),
        (b"<scene version='3.0.0'><shape type='sphre'/></scene>", "sphere"),
        (b"<!DOCTYPE s [<!ENTITY a 'b'><!ENTITY c '&a;&a;'>]><scene version='3.0.0'>&c;</scene>", "scene.xml"),
    ],
)
def test_bad_scenes_are_reported(content, message, capsys, tmp_path):
    if content is not None:
        (tmp_path / "scene.xml").write_bytes(content)
    for command in (("render", "scene.xml", "-o", "a.exr"), ("info", "scene.xml")):
        assert isonoise(*command) == 2
        err = capsys.readouterr().err
        assert err.startswith("isonoise: ")
        assert message in err
        assert "Traceback" not in err
    assert not os.path.exists("a.exr")


def test_a_reference_of_another_size_is_reported(capsys):
    write_exr("ref.exr", {"": np.ones((5, 6, 3), np.float32)}, {})
    assert isonoise(*SMALL, "-o", "a.exr", "--reference", "ref.exr") == 2
    assert "is 6x5 and the image 16x12" in capsys.readouterr().err
    assert os.listdir() == ["ref.exr"]


def test_inputs_are_never_overwritten(capsys, tmp_path):
    write_exr("ref.exr", {"": np.ones((12, 16, 3), np.float32)}, {})
    before = (tmp_path / "ref.exr").read_bytes()
    assert isonoise(*SMALL, "-o", "ref.exr", "--reference", "ref.exr") == 2
    assert "the same file as --reference" in capsys.readouterr().err
    (tmp_path / "scene.xml").write_text("<scene version='3.0.0'/>")
    assert isonoise("render", "scene.xml", "-o", "a.exr", "--log", "scene.xml") == 2
    assert "the same file as the scene" in capsys.readouterr().err
    assert (tmp_path / "ref.exr").read_bytes() == before
    assert (tmp_path / "scene.xml").read_text() == "<scene version='3.0.0'/>"


def test_a_failed_render_keeps_an_existing_image(tmp_path):
    (tmp_path / "a.exr").write_bytes(b"old")
    assert isonoise("render", "no such scene", "-o", "a.exr") == 2
    assert (tmp_path / "a.exr").read_bytes() == b"old"


def test_a_failed_log_does_not_lose_the_image(capsys, monkeypatch):
    from isonoise.errors import UserError
    from isonoise.film.log import LogWriter

    def fail(self, row):
        raise UserError("cannot write 'a.csv': No space left on device")

    monkeypatch.setattr(LogWriter, "write", fail)
    assert isonoise(*SMALL, "--spp", "4", "-o", "a.exr", "--log", "a.csv") == 2
    assert "No space left on device; the log is incomplete, the image is complete" in capsys.readouterr().err
    assert read_reference("a.exr")[0].shape == (12, 16, 3)


def test_help_lists_strategies_and_every_column(capsys):
    assert isonoise("render", "--help") == 0
    out = capsys.readouterr().out
    for word in (
        "(default: pooled)",
        "pooled:rule=sqrt",
        "window=5",
        "kappa=8",
        "uniform",
        *columns(true_errors=True),
    ):
        assert word in out


def test_help_and_version_import_nothing_heavy():
    code = (
        "import sys; from isonoise.cli import main\n"
        "try: main([sys.argv[1]])\n"
        "except SystemExit: pass\n"
        "print(sorted({'numpy', 'pyopencl', 'rich', 'PIL', 'OpenEXR', 'trimesh'} & set(sys.modules)))"
    )
    for option in ("--help", "--version"):
        out = subprocess.run([sys.executable, "-c", code, option], capture_output=True, text=True).stdout
        assert out.splitlines()[-1] == "[]"


def test_a_missing_command_is_reported(capsys):
    assert isonoise() == 2
    assert "COMMAND" in capsys.readouterr().err


def test_devices_shows_the_default(capsys):
    assert isonoise("devices") == 0
    first, *rest = capsys.readouterr().out.splitlines()
    assert first.startswith("0: ")
    assert first.endswith(" (default)")
    assert not any(line.endswith("(default)") for line in rest)


def test_without_a_driver_the_message_says_what_to_install(tmp_path):
    environment = os.environ | {"OCL_ICD_VENDORS": str(tmp_path / "none")}
    for command in (("devices",), ("render", "cornell", "-o", "a.exr")):
        process = start(*command, env=environment)
        out, err = process.communicate(timeout=60)
        if process.returncode == 0:
            pytest.skip("this OpenCL loader ignores OCL_ICD_VENDORS")
        assert (process.returncode, out) == (2, "")
        assert err.startswith("isonoise: no OpenCL device found; ")
        assert "install" in err
    assert os.listdir() == []


@pytest.mark.skipif(sys.platform == "win32", reason="POSIX pipes")
def test_a_closed_pipe_is_no_error():
    process = start("info", "cornell")
    process.stdout.close()
    assert process.stderr.read() == ""
    assert process.wait(timeout=60) == 0


def test_a_read_only_home(tmp_path):
    """Drivers cache compiled kernels under HOME; PoCL offers no device if it cannot."""
    no_folder = tmp_path / "file"
    no_folder.touch()
    gone = ("POCL_CACHE_DIR", "XDG_CACHE_HOME")
    environment = {name: value for name, value in os.environ.items() if name not in gone}
    environment |= {"HOME": str(no_folder), "TMPDIR": str(tmp_path)}
    process = start("devices", env=environment)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 0, err
    assert "(default)" in out
