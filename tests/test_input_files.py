"""Files that commands read besides scenes: only regular ones, of any content. A wrong one is exit code 2 and a message.

Scenes are tested in test_malformed.py and test_scene_files.py.
"""

import os
import signal
import sys
from pathlib import Path

import numpy as np
import pytest
from small_scene import lamp_over_floor

from isonoise import input_files
from isonoise.cli import main
from isonoise.comparison.planning import make_plan
from isonoise.comparison.request import Request, SceneRequest, StrategyRequest
from isonoise.device import program_cache, tuned
from isonoise.errors import SceneError, UserError
from isonoise.film.exr import read_exr, read_reference, write_exr
from isonoise.renderer import Renderer
from isonoise.scene import load_description
from isonoise.strategies import make_strategy

MAX_SECONDS = 20
DEEP = b"[" * 100_000
IMAGE = np.zeros((2, 3, 3), np.float32)
TINY = ("cornell", "--size", "4x3", "--spp", "1")
READERS = {
    "info": ("info", "file.exr"),
    "info of a scene": ("info", "file"),
    "reference": ("render", *TINY, "-o", "out.exr", "--reference", "file"),
    "resume": ("render", *TINY, "-o", "out.exr", "--resume", "file"),
    "against": ("bench", *TINY, "--against", "file"),
    "plan": ("compare", *TINY, "--strategies", "uniform", "-o", "."),
    "reference of a comparison": ("compare", *TINY, "--strategies", "uniform", "--reference", "file", "-o", "new"),
}
"""What reads a file -> the command. In the current folder all of the names are the same file."""


@pytest.fixture(autouse=True)
def in_time(in_tmp_path):
    """Waiting for a pipe, or reading a device to its end, fails the test."""
    if not hasattr(signal, "SIGALRM"):
        yield
        return

    def fail(*_):
        raise TimeoutError

    previous = signal.signal(signal.SIGALRM, fail)
    signal.alarm(MAX_SECONDS)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, previous)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes on this system")
@pytest.mark.parametrize("kind", ["pipe", "device"])
@pytest.mark.parametrize("reader", READERS)
def test_pipes_and_devices_are_refused(reader, kind, capsys):
    for name in ("file", "file.exr", "plan.json"):
        if kind == "pipe":
            os.mkfifo(name)
        else:
            os.symlink("/dev/zero", name)
    assert main(list(READERS[reader])) == 2
    assert "not a regular file" in capsys.readouterr().err
    with pytest.raises(UserError, match="oracle: cannot read 'file': it is not a regular file"):
        _ = make_strategy("oracle:file=file")._variance


@pytest.mark.parametrize("content", [b"", DEEP, b'{"a":' * 100_000, b"1" * 100_000, b"\xff\xfe", b"nan"])
@pytest.mark.parametrize("reader", READERS)
def test_foreign_content_is_refused(reader, content, capsys):
    """Also brackets that are nested too deeply for Python, and a number that is too long for it."""
    for name in ("file", "file.exr", "plan.json"):
        Path(name).write_bytes(content)
    assert main(list(READERS[reader])) == 2
    printed = capsys.readouterr()
    assert printed.err.startswith(("isonoise: ", "usage: "))
    assert "Traceback" not in printed.err
    assert not Path("out.exr").exists()


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="no /proc on this system")
def test_no_more_is_read_than_the_size():
    """Files of /proc have size 0. Some have no end."""
    assert input_files.read_regular_file("/proc/self/status") == b""
    Path("file").write_bytes(b"abc")
    assert input_files.read_regular_file("file") == b"abc"


def test_errors_of_opening_say_the_reason():
    for name, reason in (("missing", "No such file"), (".", "Is a directory"), ("a\0b", "null")):
        with pytest.raises(OSError, match=reason) as error:
            input_files.read_regular_file(name)
        assert reason in error.value.strerror


@pytest.mark.filterwarnings("ignore:.*is damaged")
def test_damaged_caches_count_as_missing(monkeypatch):
    monkeypatch.setenv(program_cache.FOLDER_VARIABLE, os.getcwd())
    monkeypatch.setattr(tuned, "driver_identity", lambda device: ("driver",))
    for value in (b"[" * 100_000, b"1" * 100_000, b"\xff", b"[]", b"3", b"{}"):
        program_cache.store(tuned._key(None, "pool_size"), value)
        assert tuned.load_tuned(None, "pool_size") is None
    if hasattr(os, "mkfifo"):
        os.remove(tuned._key(None, "pool_size"))
        os.mkfifo(tuned._key(None, "pool_size"))
        assert tuned.load_tuned(None, "pool_size") is None


def test_a_pipe_as_a_lock_names_no_process():
    from isonoise.film import lock_file

    if hasattr(os, "mkfifo"):
        os.mkfifo("pipe")
        assert lock_file._read_process(Path("pipe")) is None
    Path("deep").write_bytes(DEEP)
    assert lock_file._read_process(Path("deep")) is None


@pytest.mark.parametrize("text", [b"spectral", b"isonoise.note", b"content"])
def test_images_with_names_that_are_not_utf8(text, capsys):
    """The name of a channel, the name of an attribute, the value of one."""
    write_exr("whole.exr", {"": IMAGE, "spectral": IMAGE[..., 0]}, {"isonoise.note": "content"})
    content = Path("whole.exr").read_bytes()
    assert text in content
    Path("a.exr").write_bytes(content.replace(text, b"\xff\xfe" + text[2:]))
    for read in (read_reference, read_exr):
        with pytest.raises(UserError, match=r"a\.exr"):
            read("a.exr")
    with pytest.raises(UserError, match=r"oracle: cannot read 'a\.exr'"):
        _ = make_strategy("oracle:file=a.exr")._variance
    assert main(["info", "a.exr"]) == 2
    assert "a.exr" in capsys.readouterr().err


@pytest.mark.skipif(sys.platform != "linux", reason="needs names of any bytes")
def test_files_may_have_names_that_are_not_utf8():
    name = os.fsdecode(b"a\xff.exr")
    os.mkdir(os.fsdecode(b"\xfe"))
    path = Path(os.fsdecode(b"\xfe"), name)
    write_exr(path, {"": IMAGE, "variance": IMAGE[..., 0]}, {"scene": name})
    channels, header = read_exr(path)
    assert header["scene"] == "a\\udcff.exr"  # what UTF-8 does not have is escaped
    assert set(channels) == {"R", "G", "B", "variance"}
    assert make_strategy(f"oracle:file={path}")._variance.shape == (2, 3)


@pytest.mark.skipif(sys.platform != "linux", reason="needs names of any bytes")
def test_comparisons_refuse_names_that_no_report_can_hold():
    scene = os.fsdecode(b"a\xff.xml")
    Path(scene).write_text('<scene version="3.0.0"><sensor type="perspective"/></scene>')
    for scenes, strategy in ((scene, "uniform"), ("cornell", "uniform:warmup=\udcff")):
        with pytest.raises(UserError, match="is not text in UTF-8"):
            make_plan(Request([SceneRequest(scenes)], [StrategyRequest(strategy)], seeds=[0], spp=1.0))


def test_mesh_attributes_have_to_be_finite_where_they_are_used():
    """A colour of 1e308 exceeds 32-bit floats."""
    from isonoise.scene import compile_scene

    numbers = b"".join(b"property double %c\n" % name for name in b"xyzrgb")
    head = b"ply\nformat ascii 1.0\nelement vertex 3\n" + numbers
    head += b"element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    Path("a.ply").write_bytes(head + b"0 0 0 1e308 0 0\n1 0 0 0 0 0\n0 1 0 0 0 0\n3 0 1 2\n")
    shape = {"type": "ply", "filename": "a.ply"}
    scene = {"type": "scene", "sensor": {"type": "perspective"}, "part": shape}
    compile_scene(load_description(scene))  # unused
    colour = {"type": "mesh_attribute", "name": "vertex_color"}
    for used in (
        {"bsdf": {"type": "diffuse", "reflectance": colour}},
        {"emitter": {"type": "area", "radiance": colour}},
    ):
        with pytest.raises(SceneError, match=r"part.*'vertex_color'.*no finite 32-bit number"):
            compile_scene(load_description(scene | {"part": shape | used}))


def test_numbers_of_the_library_are_limited():
    from isonoise.stops import Stops

    for name in ("spp", "time", "error"):
        for value in (1e308, 1e-300, float("inf"), float("nan"), 0, -1):
            with pytest.raises(UserError, match=f"{name} has to be a number from 1e-30 to 1e.30"):
                Stops(**{name: value})
    for size in ((0, 5), (5, -1), (2**40, 1), (2**15, 2**14)):
        with pytest.raises(UserError, match=r"size.* = .* is out of range"):
            Renderer(lamp_over_floor(), size=size)
    for depth in (2**31, 10**20, -2):
        with pytest.raises(UserError, match=r"max_depth = .* is out of range"):
            Renderer(lamp_over_floor(), max_depth=depth)


@pytest.mark.parametrize("name", ["pooled", "relative-median", "tsallis"])
@pytest.mark.parametrize("ratio", ["1e308", "4294967296", "inf"])
def test_a_ratio_beyond_any_pixel_plans_no_uniform_waves(name, ratio):
    """The adaptive waves are those of an infinite ratio, instead of one that no pixel can take."""
    waves = make_strategy(f"{name}:ratio={ratio}").waves()
    expected = make_strategy(f"{name}:ratio=inf").waves()
    assert [next(waves) for _ in range(20)] == [next(expected) for _ in range(20)]


def test_a_checkpoint_does_not_choose_code(capsys, monkeypatch):
    """A strategy of another module is imported only if the command line names it."""
    from isonoise.state.state import State

    settings = {"overrides": {}, "seed": 0, "strategy": "evil:Strategy:a=1", "layers": ()}
    loop = {"stops": {"quantile": 0.99, "confidence": 0.95, "spp": 1.0, "time": None, "error": None}}
    state = State(settings, {"loop": loop}, {})
    monkeypatch.setattr("isonoise.state.checkpoint.read_checkpoint", lambda path: state)
    Path("evil.py").write_text("raise SystemExit('imported')")
    assert main(["render", "cornell", "-o", "a.exr", "--resume", "c.npz"]) == 2
    assert "'evil:Strategy:a=1' is no part of isonoise" in capsys.readouterr().err
    assert "evil" not in sys.modules
