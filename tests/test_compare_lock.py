"""The lock of a comparison's folder: one process at a time, whatever happened to the others."""

import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from compare_command import compare, options

from isonoise.comparison.folder_lock import LOCK_FILE, lock_folder
from isonoise.errors import UserError
from isonoise.film import lock_file

pytestmark = pytest.mark.usefixtures("in_tmp_path")

HOLD = """
import sys
from pathlib import Path
from isonoise.comparison.folder_lock import lock_folder
from isonoise.film import lock_file
if sys.argv[1] == "without flock":
    lock_file.fcntl = None
with lock_folder(Path("out")):
    print("locked", flush=True)
    sys.stdin.read()
"""


@pytest.fixture(params=["flock", "without flock"])
def way(request, monkeypatch):
    if request.param == "without flock":
        monkeypatch.setattr(lock_file, "fcntl", None)
    elif lock_file.fcntl is None:
        pytest.skip("there is no flock")
    return request.param


@pytest.fixture
def holder(way):
    """A process that has locked `out`."""
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen([sys.executable, "-c", HOLD, way], **pipes) as process:
        assert process.stdout.readline() == "locked\n"
        yield process
        process.kill()


def test_a_second_process_is_told_who_is_first(holder, capsys):
    Path("out/plan.json").write_text("{}")
    assert compare(*options("out")) == 2
    err = capsys.readouterr().err
    assert f"in use by process {holder.pid} on " in err
    assert "another folder with -o" in err
    holder.communicate()  # ends its input
    assert not Path("out", LOCK_FILE).exists()
    with lock_folder(Path("out")):
        pass
    assert os.listdir("out") == ["plan.json"]


@pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals")
def test_a_killed_process_is_no_obstacle(holder):
    holder.send_signal(signal.SIGKILL)
    holder.wait()
    assert Path("out", LOCK_FILE).exists()
    with lock_folder(Path("out")) as lock:
        lock.check()
        with pytest.raises(UserError, match=f"process {os.getpid()} on"), lock_folder(Path("out")):
            pass
    assert os.listdir("out") == []


@pytest.mark.parametrize(
    ("change", "is_obstacle"),
    [
        ({"start_ticks": "1"}, False),  # the id is now another process's
        ({"host": "another"}, True),
        ({"pid": -1}, True),
        ({"pid": "1"}, True),
        (None, True),  # it may be about to be written
    ],
)
@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="Linux")
def test_locks_of_unknown_processes(change, is_obstacle, monkeypatch):
    """Without flock a file is an obstacle unless its process is known to have ended."""
    monkeypatch.setattr(lock_file, "fcntl", None)
    with lock_folder(Path("out")):
        content = json.loads(Path("out", LOCK_FILE).read_text())
        Path("keep").mkdir()
        Path("keep", LOCK_FILE).write_text("" if change is None else json.dumps(content | change))
    if is_obstacle:
        with pytest.raises(UserError, match="If that process has ended, delete"), lock_folder(Path("keep")):
            pass
        assert Path("keep", LOCK_FILE).exists()
    else:
        with lock_folder(Path("keep")):
            pass


def test_a_folder_that_was_removed_or_replaced_is_a_message(way):
    with lock_folder(Path("out")) as lock:
        shutil.rmtree("out")
        with pytest.raises(UserError, match="was removed"):
            lock.check()
        with lock_folder(Path("out")) as other:
            other.check()
            with pytest.raises(UserError, match="was removed"):
                lock.check()
            Path("out/file").touch()
        assert os.listdir("out") == ["file"]


def test_bad_input_leaves_no_folder(capsys):
    assert compare(*options("new/out", ("no such strategy",))) == 2
    assert not Path("new").exists()
    Path("out").mkdir()
    assert compare(*options("out", ("no such strategy",))) == 2
    assert os.listdir("out") == []
