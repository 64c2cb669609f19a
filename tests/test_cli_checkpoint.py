"""Checkpoints and merging on the command line: options, limits, the log, refusals, failing writes."""

import csv
import os
import time
from pathlib import Path

import numpy as np
import pytest

from isonoise.cli import main
from isonoise.device.opencl import Device
from isonoise.errors import DeviceError
from isonoise.film.exr import read_exr
from isonoise.scene.builtin import find_scene
from isonoise.state import checkpoint_writer
from isonoise.state.checkpoint import read_checkpoint

SMALL = ("render", "cornell", "--size", "16x12")
PIXELS = 16 * 12

pytestmark = pytest.mark.usefixtures("in_tmp_path")


def isonoise(*arguments) -> int:
    """Run a command in this process; return its exit code."""
    return main([str(argument) for argument in arguments])


def rows(path: str) -> list[dict]:
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


def channels(path: str) -> dict[str, np.ndarray]:
    return read_exr(path)[0]


def test_options_and_limits_come_from_the_checkpoint(capsys):
    settings = ("--seed", 9, "--strategy", "pooled:warmup=8", "--max-depth", 6)
    assert isonoise(*SMALL, *settings, "--spp", 20, "-o", "a.exr", "--checkpoint", "c.npz", "--log", "a.csv") == 0
    before = rows("a.csv")
    assert isonoise("render", "cornell", "-o", "same.exr", "--resume", "c.npz", "--log", "same.csv") == 0
    assert rows("same.csv") == before  # although there was no new wave
    assert all(
        np.array_equal(a, b) for a, b in zip(*(channels(f).values() for f in ("a.exr", "same.exr")), strict=True)
    )
    capsys.readouterr()
    assert isonoise("render", "cornell", "-o", "b.exr", "--resume", "c.npz", "--spp", 32, "--log", "a.csv") == 0
    assert "warmup=8" in (out := capsys.readouterr().out)
    assert "seed 9" in out
    assert "state     c.npz" in out
    assert int(channels("b.exr")["samples"].sum()) == 32 * PIXELS
    after = rows("a.csv")
    assert after[: len(before)] == before
    assert len(after) > len(before)
    assert read_checkpoint("c.npz").values["renderer"]["samples"] == 32 * PIXELS


def test_only_what_belongs_together_is_continued(capsys):
    assert isonoise(*SMALL, "--spp", 1, "-o", "a.exr", "--checkpoint", "c.npz") == 0
    content = Path("c.npz").read_bytes()
    for options, message in [
        (("--checkpoint", "c.npz"), "c.npz exists"),
        (("--resume", "c.npz", "--seed", 1), "the seed was 0 and is now 1"),
        (("--resume", "c.npz", "--size", "8x8"), "the image size was 16x12 and is now 8x8"),
        (("--resume", "missing.npz"), "cannot read 'missing.npz'"),
        (("--resume", "a.exr"), "it is not a checkpoint"),
        (("--resume", "c.npz", "--checkpoint", "b.exr"), "same file"),
        (("--resume", "c.npz", "--reference", "a.exr"), "another --reference"),
    ]:
        assert isonoise("render", "cornell", "-o", "b.exr", *options) == 2, options
        assert message in capsys.readouterr().err
    text = find_scene("cornell").read_text()
    Path("other.xml").write_text(text.replace('"0.74, 0.72, 0.69"', '"0.74, 0.72, 0.6"'))
    assert isonoise("render", "other.xml", "-o", "b.exr", "--resume", "c.npz") == 2
    assert "the scene 'cornell' differs from 'other.xml'" in capsys.readouterr().err
    assert Path("c.npz").read_bytes() == content
    assert not os.path.exists("b.exr")


def test_one_file_for_both_options_begins_or_continues():
    both = ("--checkpoint", "c.npz", "--resume", "c.npz")
    assert isonoise(*SMALL, *both, "--spp", 1, "-o", "a.exr") == 0
    assert isonoise(*SMALL, *both, "--spp", 3, "-o", "a.exr") == 0
    assert int(channels("a.exr")["samples"].sum()) == 3 * PIXELS
    assert sorted(os.listdir()) == ["a.exr", "c.npz"]


def test_merged_renders(capsys):
    for seed in (1, 2):
        options = ("--seed", seed, "--spp", 8, "--strategy", "uniform")
        assert isonoise(*SMALL, *options, "-o", f"{seed}.exr", "--checkpoint", f"{seed}.npz") == 0
    assert isonoise("merge", "1.npz", "2.npz", "-o", "m.exr", "-o", "m.png", "--checkpoint", "m.npz") == 0
    a, b, merged = (channels(f"{name}.exr") for name in ("1", "2", "m"))
    for name in "RGB":
        np.testing.assert_allclose(merged[name], (a[name].astype(float) + b[name]) / 2, rtol=1e-6, atol=0)
    assert (merged["samples"] == 16).all()
    capsys.readouterr()
    for options, message in [(("1.npz", "m.npz"), "the same seed, 1"), (("1.npz", "1.npz"), "named twice")]:
        assert isonoise("merge", *options, "-o", "n.exr") == 2
        assert message in capsys.readouterr().err
    assert isonoise("render", "cornell", "-o", "n.exr", "--resume", "m.npz") == 2
    assert "a merged render cannot be continued" in capsys.readouterr().err
    assert isonoise("info", "m.npz") == 0
    assert "3,072, 16 per pixel" in capsys.readouterr().out


def test_a_checkpoint_that_cannot_be_written_does_not_stop_the_render(capsys, monkeypatch):
    def fail(path, state):
        time.sleep(0.01)
        raise checkpoint_writer.UserError(f"cannot write '{path}': No space left on device")

    monkeypatch.setattr(checkpoint_writer, "write_checkpoint", fail)
    options = ("--spp", 2000, "--checkpoint", "c.npz", "--checkpoint-every", 0.1)
    assert isonoise(*SMALL, *options, "-o", "a.exr") == 2
    err = capsys.readouterr().err
    assert err.count("the render goes on without checkpoints") == 1
    assert "it is in" in err
    assert int(channels("a.exr")["samples"].sum()) == 2000 * PIXELS
    assert read_checkpoint("c.rescued.npz").values["renderer"]["samples"] == 2000 * PIXELS


def test_a_lost_device_leaves_the_last_checkpoint_and_the_last_image(capsys, monkeypatch):
    """Every read fails after the first checkpoint, from which the render then continues with the same bits."""
    options = ("--spp", 2000, "--strategy", "uniform")
    assert isonoise(*SMALL, *options, "-o", "unbroken.exr") == 0

    def failing(method):
        def wrapper(*arguments, **named):
            if os.path.exists("c.npz"):
                raise DeviceError("the device was lost: CL_DEVICE_NOT_AVAILABLE")
            return method(*arguments, **named)

        return wrapper

    with monkeypatch.context() as patch:
        for name in ("read", "mapped", "begin_read"):
            patch.setattr(Device, name, failing(getattr(Device, name)))
        checkpoints = ("--checkpoint", "c.npz", "--checkpoint-every", 0.1)
        assert isonoise(*SMALL, *options, *checkpoints, "-o", "a.exr") == 2
    err = capsys.readouterr().err
    assert "the device was lost" in err
    assert "an earlier one stays" in err
    assert 0 < read_checkpoint("c.npz").values["renderer"]["samples"] < 2000 * PIXELS
    assert 0 < channels("a.exr")["samples"].sum() < 2000 * PIXELS
    assert isonoise(*SMALL, "-o", "a.exr", "--resume", "c.npz") == 0
    unbroken = channels("unbroken.exr")
    assert all(np.array_equal(plane, unbroken[name]) for name, plane in channels("a.exr").items())


def test_a_continued_render_has_the_view_of_its_checkpoint():
    import damaged_checkpoints

    from isonoise.cli import make_parser
    from isonoise.commands.render_checkpoint import _complete
    from isonoise.scene.view import View, view_of

    state = damaged_checkpoints.render_state()
    options = make_parser().parse_args(["render", "s.xml", "-o", "a.exr", "--look-at", "4,5,6"])
    _complete(options, state)
    assert view_of(options) == View(fov=40.0, look_at=((4, 5, 6),))
