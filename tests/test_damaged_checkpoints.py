"""Damaged, foreign and crafted checkpoints, logs and images are refused, or read with the content that was written."""

import contextlib
import copy
import json
import os
import pickle
import random
import resource
import time

import numpy as np
import pytest
from damaged_checkpoints import archive_bytes, content, damaged, file_bytes, merged_state, read_members, render_state
from fuzz_mutations import mutate_bytes

from isonoise.cli import main
from isonoise.errors import UserError
from isonoise.film.exr import read_header, read_reference, write_exr
from isonoise.film.log import LogWriter, row_from_values
from isonoise.state.checkpoint import read_checkpoint, write_checkpoint
from isonoise.state.describe import describe_checkpoint

MAX_SECONDS = 2.0
"""Processor time for one file."""


def is_refused(path, sound: list[tuple]) -> bool:
    """Whether the file is refused; else it has one of these contents. `info` must not fail otherwise, either."""
    start = time.process_time()
    with contextlib.suppress(UserError):
        describe_checkpoint(path)
    try:
        state = read_checkpoint(path)
    except UserError:
        return True
    finally:
        assert time.process_time() - start < MAX_SECONDS
    assert content(state) in sound
    return False


def read_damaged(first: int, number: int, folder) -> int:
    """Read files with the damage of these numbers; return how many were refused."""
    path, refused = folder / "damaged.npz", 0
    for make_state, seeds in (
        (render_state, range(first, first + number // 4 * 3)),
        (merged_state, range(first + number // 4 * 3, first + number)),
    ):
        sound, other = (file_bytes(make_state(seed), folder) for seed in (0, 1))
        expected = [content(make_state(seed)) for seed in (0, 1)]  # all but bytes without content are of the other
        for seed in seeds:
            path.write_bytes(damaged(sound, other, random.Random(seed)))
            refused += is_refused(path, expected)
    return refused


def test_damaged_checkpoints(tmp_path):
    assert read_damaged(0, 150, tmp_path) > 120  # the others are damaged in bytes without content, such as times


@pytest.mark.long
def test_many_damaged_checkpoints(tmp_path):
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    refused = read_damaged(1000, 4000, tmp_path)
    growth = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - peak
    print(f"{refused} of 4000 refused, the others read as written; peak memory grew by {growth} KiB")
    assert refused > 3200
    assert growth < 100 << 10


def crafted(members: dict[str, bytes], change) -> bytes:
    """A checkpoint whose description is changed; all checksums are valid."""
    description = json.loads(members["state.json"])
    result = change(description, members)
    text = result if isinstance(result, str) else json.dumps(description)
    return archive_bytes(members | {"state.json": text.encode()})


def set_value(*path_and_value):
    *path, name, value = path_and_value

    def change(description, members):
        part = description
        for key in path:
            part = part[key]
        if value is None:
            del part[name]
        else:
            part[name] = value

    return change


NAN, HUGE = float("nan"), 10**12
RENDERER, LOOP, PLANNER = ("values", "renderer"), ("values", "loop"), ("values", "renderer", "planner")
CRAFTED = {
    "format": set_value("format", 1),
    "no settings": set_value("settings", None),
    "list of values": set_value("values", []),
    "no array": set_value("arrays", "reduction/count", None),
    "type": set_value("arrays", "reduction/count", 0, "|O"),
    "shape": set_value("arrays", "reduction/count", 1, [HUGE, HUGE]),
    "negative shape": set_value("arrays", "reduction/count", 1, [-1, 7]),
    "size": set_value("settings", "size", [7, 6]),
    "huge size": set_value("settings", "size", [2**20, 2**20]),
    "size of nan": set_value("settings", "size", [NAN, 5]),
    "seed": set_value("settings", "seed", -1),
    "seed as text": set_value("settings", "seed", "0"),
    "strategy": set_value("settings", "strategy", None),
    "sampler": set_value("settings", "sampler", "halton"),
    "parts": set_value("settings", "scene_parts", {"faces": 1}),
    "overrides": set_value("settings", "overrides", []),
    "needs": set_value("settings", "needs", "chunk", "5"),
    "unknown needs": set_value("settings", "needs", "x", 1),
    "scale": set_value("settings", "radiance_scale", 0),
    "no renderer": set_value("values", "renderer", None),
    "samples": set_value(*RENDERER, "samples", 5),
    "samples of nan": set_value(*RENDERER, "samples", NAN),
    "samples as text": set_value(*RENDERER, "samples", "200"),
    "waves taken": set_value(*PLANNER, "waves_taken", HUGE),
    "all waves": lambda d, m: d["values"]["renderer"]["planner"].update(waves_taken=HUGE, wave_index=HUGE),
    "many waves": lambda d, m: d["values"]["renderer"]["planner"].update(
        waves_taken=2**32 - 1, wave_index=2**32 - 1, max_pixel_samples=2**32 - 1
    ),
    "pixel samples": set_value(*PLANNER, "max_pixel_samples", 3),
    "unfinished": set_value(*PLANNER, "unfinished_spp", NAN),
    "planned": set_value(*RENDERER, "wave", "planned", 5),
    "traced": set_value(*RENDERER, "wave", "traced", 10**6),
    "negative traced": set_value(*RENDERER, "wave", "traced", -1),
    "kind": set_value(*RENDERER, "wave", "kind", "other"),
    "seconds": set_value(*RENDERER, "wave", "seconds", NAN),
    "unknown wave": set_value(*RENDERER, "wave", "remaining", 1),
    "no rows": set_value(*LOOP, "rows", None),
    "row": set_value(*LOOP, "rows", 0, 5),
    "row of less": set_value(*LOOP, "rows", 0, "spp", None),
    "row of text": set_value(*LOOP, "rows", 1, "stated_p99", "inf"),
    "row of another wave": set_value(*LOOP, "rows", 1, "wave", 7),
    "row of true": set_value(*LOOP, "rows", 1, "true_p50", 0.5),
    "elapsed": set_value(*LOOP, "elapsed_s", NAN),
    "speed": set_value(*LOOP, "samples_per_s", 0),
    "error stop": set_value(*LOOP, "error_stop", "looks", None),
    "looks": set_value(*LOOP, "error_stop", "looks", -3),
    "limits": set_value(*LOOP, "stops", "spp", -1),
    "text": lambda d, m: "[" * 10**6,
    "constant": lambda d, m: "7",
    "digits": lambda d, m: '{"format": ' + "9" * 10**6 + "}",
}


@pytest.mark.parametrize("name", CRAFTED)
def test_crafted_checkpoints(name, tmp_path):
    path = tmp_path / "crafted.npz"
    path.write_bytes(crafted(read_members(file_bytes(render_state(), tmp_path)), CRAFTED[name]))
    with pytest.raises(UserError, match=r"crafted\.npz': (the checkpoint is damaged|it has format)"):
        read_checkpoint(path)
    with contextlib.suppress(UserError):
        describe_checkpoint(path)


def test_crafted_arrays(tmp_path):
    """Valid files whose arrays do not fit; each would be read beyond its end or count wrongly."""
    write_checkpoint(tmp_path / "a.npz", render_state())
    assert content(read_checkpoint(tmp_path / "a.npz")) == content(render_state())
    for name, array in {
        "wave/remaining": np.full((5, 7), 2**31, np.uint32),
        "reduction/count": np.full((1, 5, 7), 2**31, np.uint32),
        "reduction/sums": np.zeros((10, 5, 6), np.float32),
        "uniform/sums": np.zeros((3, 5, 7), np.float32),
        "energy_loss/uniform": np.zeros((2, 7, 5)),
    }.items():
        state = copy.deepcopy(render_state())
        state.arrays[name] = array
        write_checkpoint(tmp_path / "a.npz", state)
        with pytest.raises(UserError, match="the checkpoint is damaged"):
            read_checkpoint(tmp_path / "a.npz")


class _Payload:
    def __reduce__(self):
        return os.mkdir, ("unpickled",)


def foreign_files() -> dict[str, bytes]:
    object_array = b"\x93NUMPY\x01\x00" + (118).to_bytes(2, "little")
    object_array += f"{{'descr': '|O', 'fortran_order': False, 'shape': (1,)}}{'': <64}\n".encode()[:118]
    return {
        "empty": b"",
        "png": b"\x89PNG\r\n\x1a\n" + bytes(100),
        "json": b'{"format": 2}',
        "pickle": pickle.dumps(_Payload()),
        "other npz": archive_bytes({"a.npy": b"\x93NUMPY"}),
        "npz with pickle": archive_bytes({"state.json": b"{}", "a.npy": object_array + pickle.dumps([_Payload()])}),
        "bomb": archive_bytes({"state.json": b" " * 2**24}, compression=8),
    }


def test_foreign_files(tmp_path, monkeypatch, capsys):
    """On the command line, too, and where an image is expected. No device is opened and nothing is unpickled."""
    monkeypatch.chdir(tmp_path)
    paths = ["/dev/zero", "/dev/full", "folder", "pipe", "missing.npz"]
    os.mkdir("folder")
    os.mkfifo("pipe")
    for number, data in enumerate(foreign_files().values()):
        paths.append(f"foreign-{number}.npz")
        (tmp_path / paths[-1]).write_bytes(data)
    for path in paths:
        with pytest.raises(UserError):
            read_checkpoint(path)
        assert main(["render", "cornell", "-o", "a.exr", "--resume", path]) == 2
        assert main(["merge", path, "b.npz", "-o", "a.exr"]) == 2
        assert main(["info", path]) == 2
        with pytest.raises(UserError):
            read_reference(path)
    assert "Traceback" not in capsys.readouterr().err
    assert not os.path.exists("unpickled")
    assert not os.path.exists("a.exr")


def damage_logs_and_images(first: int, number: int, folder) -> None:
    """A damaged log is replaced by the rows of the checkpoint; a damaged image is refused or read."""
    image = folder / "a.exr"
    layers = {"": np.random.default_rng(0).random((5, 7, 3), np.float32), "samples": np.ones((5, 7), np.uint32)}
    write_exr(image, layers, {"isonoise.scene": "s"})
    sound = image.read_bytes()
    rows = [row_from_values(row) for row in render_state().values["loop"]["rows"]]
    for seed in range(first, first + number):
        rng = random.Random(seed)
        image.write_bytes(mutate_bytes(sound, rng) if seed % 2 else sound[: rng.randrange(len(sound))])
        for read in (read_header, read_reference):
            with contextlib.suppress(UserError):
                read(image)
        log = folder / "a.csv"
        log.write_bytes(rng.randbytes(rng.randrange(2000)))
        writer = LogWriter(log, False, rows[:1])
        writer.write(rows[1])
        writer.close()
        lines = log.read_text().splitlines()
        assert [line.split(",")[1] for line in lines] == ["wave", "1", "2"]


def test_damaged_logs_and_images(tmp_path):
    damage_logs_and_images(0, 20, tmp_path)


@pytest.mark.long
def test_many_damaged_logs_and_images(tmp_path):
    damage_logs_and_images(1000, 500, tmp_path)
