"""Atomic files and locks: permissions, temporary files of other processes, places for files that cannot be written."""

import os
import random
import stat
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import pytest

from isonoise.errors import UserError
from isonoise.film.fallback import unused_path, write_with_fallback
from isonoise.film.files import PathLock, check_writable, remove_temporary_files, write_atomically

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="POSIX permissions and locks")

KILLED = (
    "import os, sys; from isonoise.film.files import *; write_atomically('a.exr', lambda path: os.kill(os.getpid(), 9))"
)
WAITING = "import sys; from isonoise.film.files import *; write_atomically('a.exr', lambda path: sys.stdin.read())"


def write(text: str):
    return lambda path: Path(path).write_text(text)


@pytest.mark.parametrize("mode", [0o600, 0o640, 0o664, 0o755])
def test_an_overwritten_file_keeps_its_mode(tmp_path, mode):
    path = tmp_path / "a.exr"
    path.touch()
    path.chmod(mode)
    modes = []
    write_atomically(path, lambda temporary: modes.append(temporary.stat().st_mode & 0o777))
    assert stat.S_IMODE(path.stat().st_mode) == mode
    assert not modes[0] & ~(mode | 0o600)  # nobody else can read it while it is written, either


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only root gives files away")
def test_an_overwritten_file_keeps_its_owner(tmp_path):
    path = tmp_path / "a.exr"
    path.touch()
    os.chown(path, 12345, 23456)
    write_atomically(path, write("new"))
    assert (path.stat().st_uid, path.stat().st_gid) == (12345, 23456)
    assert path.read_text() == "new"


def test_a_hard_link_keeps_the_old_content(tmp_path):
    path, link = tmp_path / "a.exr", tmp_path / "backup.exr"
    path.write_text("old")
    os.link(path, link)
    write_atomically(path, write("new"))
    assert (path.read_text(), link.read_text()) == ("new", "old")


def test_temporary_files_of_killed_processes_are_removed(tmp_path):
    subprocess.run([sys.executable, "-c", KILLED], cwd=tmp_path)
    assert len(list(tmp_path.glob(".*.tmp.exr"))) == 1
    others = [".a.exr.lock", ".0123456789ab.tmp.exr.bak", "0123456789ab.tmp", ".0123456789AB.tmp", ".notes.tmp"]
    for name in others:
        (tmp_path / name).touch()
    (tmp_path / ".0123456789ab.tmp").mkdir()
    check_writable(tmp_path / "b.exr")
    assert sorted(os.listdir(tmp_path)) == sorted([*others, ".0123456789ab.tmp"])


@pytest.mark.long
def test_processes_that_write_do_not_disturb_each_other(tmp_path):
    """Four processes write and look for abandoned files at once; one after the other is killed and started again."""
    code = """
        import sys, time
        from isonoise.film.files import *
        from isonoise.errors import UserError
        while True:
            check_writable("a.exr")
            write_atomically("a.exr", lambda path: path.write_text("x" * 100_000))
            try:
                PathLock(Path(sys.argv[1])).release()
            except UserError as error:
                assert "it is being written by" in str(error)
            time.sleep(0.002)
        """

    def begin(number):
        command = [sys.executable, "-c", textwrap.dedent(code), str(tmp_path / f"{number % 2}.csv")]
        return subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.PIPE, text=True)

    processes = [begin(number) for number in range(4)]
    pauses = random.Random(1)
    for number in range(200):
        time.sleep(pauses.uniform(0, 0.3))
        process = processes[number % 4]
        assert process.poll() is None, process.communicate()[1]
        process.kill()
        process.communicate()
        processes[number % 4] = begin(number)
        if (tmp_path / "a.exr").exists():
            assert (tmp_path / "a.exr").read_text() == "x" * 100_000
    for process in processes:
        assert process.poll() is None, process.communicate()[1]
        process.kill()
        process.communicate()
    check_writable(tmp_path / "b.exr")
    for number in range(2):  # a lock that a process has left does not count
        PathLock(tmp_path / f"{number}.csv").release()
    assert os.listdir(tmp_path) == ["a.exr"]


def test_temporary_files_of_running_processes_stay(tmp_path):
    process = subprocess.Popen([sys.executable, "-c", WAITING], cwd=tmp_path, stdin=subprocess.PIPE)
    while not list(tmp_path.glob(".*.tmp.exr")):
        assert process.poll() is None
        time.sleep(0.01)
    check_writable(tmp_path / "a.exr")
    remove_temporary_files(tmp_path)
    process.communicate()
    assert process.returncode == 0
    assert os.listdir(tmp_path) == ["a.exr"]


def test_a_file_is_reserved_for_one_process(tmp_path):
    path = tmp_path / "a.csv"
    lock = PathLock(path)
    with pytest.raises(UserError, match=f"being written by process {os.getpid()} "):
        PathLock(path)
    other = PathLock(tmp_path / "b.csv")
    lock.release()
    PathLock(path).release()
    other.release()
    assert os.listdir(tmp_path) == []


def test_the_reservation_of_a_killed_process_is_void(tmp_path):
    code = "import os; from isonoise.film.files import *; lock = PathLock(Path('a.csv')); os.kill(os.getpid(), 9)"
    subprocess.run([sys.executable, "-c", code], cwd=tmp_path)
    assert len(os.listdir(tmp_path)) == 1
    PathLock(tmp_path / "a.csv").release()
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), MemoryError(), ZeroDivisionError("bug")])
def test_another_place_is_found(tmp_path, monkeypatch, error):
    """Writing fails in one folder, then in two, then everywhere."""
    monkeypatch.setenv("TMPDIR", str(tmp_path / "temporary"))
    monkeypatch.setattr("tempfile.tempdir", None)
    for name in ("wanted", "current", "temporary"):
        (tmp_path / name).mkdir()
    monkeypatch.chdir(tmp_path / "current")
    full: list[Path] = []

    def write_unless_full(path):
        if any(folder in Path(path).absolute().parents for folder in full):
            raise error
        write_atomically(path, write("image"))

    path = tmp_path / "wanted" / "a.exr"
    places = []
    for folder in ("wanted", "current", "temporary"):
        written = write_with_fallback(path, write_unless_full)
        places.append(written.path)
        assert Path(written.path).read_text() == "image"
        assert (written.failure is None) == (folder == "wanted")
        full.append(tmp_path / folder)
    assert Path(places[1]).parent == tmp_path / "current"
    assert Path(places[2]).parent.parent == tmp_path / "temporary"
    lost = write_with_fallback(path, write_unless_full)
    assert lost.path is None
    assert "nor could it be written anywhere else" in lost.message()


def test_another_place_is_a_new_file(tmp_path):
    path = tmp_path / "a.exr"
    path.mkdir()  # has become a folder since it was checked
    for name in ("a.rescued.exr", "a.rescued-2.exr"):
        assert unused_path(path, "rescued").name == name
        written = write_with_fallback(path, lambda place: write_atomically(place, write("image")))
        assert written.path == str(tmp_path / name)
        assert written.message().endswith(f"it is in '{tmp_path / name}' instead")
