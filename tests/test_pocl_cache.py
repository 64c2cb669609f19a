"""PoCL's folder in each process: filled from the program cache, whose damaged files do no harm."""

import ctypes.util
import os
import random
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from isonoise.device import pocl_cache, program_cache
from isonoise.device.pocl_cache import FOLDER_VARIABLE, PoclFolder
from isonoise.film.exr import read_exr

pytestmark = pytest.mark.skipif(pocl_cache.fcntl is None, reason="PoCL uses its own folder on this system")


@pytest.fixture(autouse=True)
def folders(tmp_path, monkeypatch):
    """Folders of PoCL and of the program cache for this test."""
    places = SimpleNamespace(pocl=tmp_path / "pocl", programs=tmp_path / "programs")
    monkeypatch.setenv(FOLDER_VARIABLE, str(places.pocl))
    monkeypatch.setenv(program_cache.FOLDER_VARIABLE, str(places.programs))
    return places


def compile_kernels(folder: PoclFolder, key: str, program: str, kernels=("a", "b")) -> None:
    """Write what PoCL writes when it builds a program and launches its kernels."""
    with folder.program(key):
        place = folder.path / "kcache" / "AB" / program
        place.mkdir(parents=True, exist_ok=True)
        (place / "program.bc").write_bytes(program.encode())
    for kernel in kernels:
        (place / kernel).mkdir(exist_ok=True)
        (place / kernel / f"{kernel}.so").write_bytes(2 * kernel.encode())


def restored_files(key: str) -> dict[str, bytes]:
    """What PoCL finds in a new process that builds the program."""
    folder = PoclFolder()
    with folder.program(key):
        files = {path.name: path.read_bytes() for path in folder.path.rglob("*") if path.is_file()}
    folder.close()
    return files


KERNELS = {"program.bc": b"one", "a.so": b"aa", "b.so": b"bb"}


def test_kernels_are_restored_in_the_next_process(folders):
    folder = PoclFolder()
    assert folder.path.parent == folders.pocl
    assert folder.path.stat().st_mode & 0o777 == 0o700
    compile_kernels(folder, "first", "one")
    compile_kernels(folder, "second", "two", ())
    folder.close()
    assert not list(folders.pocl.iterdir())
    assert restored_files("first") == KERNELS
    assert restored_files("second") == {"program.bc": b"two"}
    assert restored_files("third") == {}


def test_a_program_in_use_is_not_restored_once_more():
    """Another device of the process builds it: the driver has loaded its kernels, and their files must not change."""
    folder = PoclFolder()
    compile_kernels(folder, "key", "one")
    folder.store()
    kernel = folder.path / "kcache" / "AB" / "one" / "a" / "a.so"
    kernel.write_bytes(b"in use")
    with folder.program("key"):
        assert kernel.read_bytes() == b"in use"
    folder.close()


def test_only_new_kernels_are_stored(folders, monkeypatch):
    folder = PoclFolder()
    compile_kernels(folder, "key", "one")
    folder.store()
    stored = []
    store = program_cache.store
    monkeypatch.setattr(program_cache, "store", lambda *program: stored.append(program[0]) or store(*program))
    folder.close()
    again = PoclFolder()
    with again.program("key"):
        pass
    again.store()
    assert not stored
    (again.path / "kcache" / "AB" / "one" / "c.so").write_bytes(b"a kernel for another grid")
    again.close()
    assert stored == ["key"]
    assert restored_files("key") == KERNELS | {"c.so": b"a kernel for another grid"}


def test_kernels_of_another_version_of_pocl_are_replaced():
    """It builds the program in a folder with another name."""
    for program in ("one", "two"):
        folder = PoclFolder()
        compile_kernels(folder, "key", program)
        folder.close()
    assert restored_files("key") == KERNELS | {"program.bc": b"two"}


@pytest.mark.parametrize("content", [b"", b"{", b"not JSON\n", b"7\n", b"[1]\n", b"[[1, 2, 3]]\n"])
def test_a_valid_file_of_something_else_is_ignored(content):
    program_cache.store("key", content)
    assert restored_files("key") == {}


def test_a_full_disk_leaves_no_part_of_a_program(monkeypatch):
    folder = PoclFolder()
    compile_kernels(folder, "key", "one")
    folder.close()

    def open_until_full(path, mode):
        if path.endswith("b.so"):
            raise OSError(28, "No space left on device")
        return open(path, mode)

    monkeypatch.setattr(pocl_cache, "open", open_until_full, raising=False)
    assert restored_files("key") == {}


def test_nothing_is_stored_from_a_full_disk(monkeypatch, folders):
    folder = PoclFolder()
    compile_kernels(folder, "key", "one")
    monkeypatch.setattr(pocl_cache, "_free_bytes", lambda path: 1000)
    folder.close()
    assert not folders.programs.exists()


def test_folders_of_killed_processes_are_deleted(folders, monkeypatch):
    script = "import os, signal\nfrom isonoise.device.pocl_cache import PoclFolder\nfolder = PoclFolder()\n"
    subprocess.run([sys.executable, "-c", script + "os.kill(os.getpid(), signal.SIGKILL)"], check=False)
    (abandoned,) = folders.pocl.iterdir()
    (folders.pocl / "something else").mkdir()
    first = PoclFolder()
    second = PoclFolder()  # the first one is in use
    assert not abandoned.exists()
    assert first.path.is_dir()
    assert second.path.is_dir()
    first.close()
    second.close()
    assert [path.name for path in folders.pocl.iterdir()] == ["something else"]


@pytest.mark.parametrize("when", ["before it is opened", "before it is locked", "while it is locked"])
def test_a_new_folder_that_another_process_deletes_is_made_again(when, monkeypatch):
    made = []
    make, lock = pocl_cache.tempfile.mkdtemp, pocl_cache.fcntl.flock

    def make_folder(**options):
        made.append(make(**options))
        if when == "before it is opened" and len(made) == 1:
            os.rmdir(made[0])
        return made[-1]

    def lock_folder(*arguments):
        if len(made) == 1:
            os.rmdir(made[0])
            if when == "while it is locked":
                raise BlockingIOError
        lock(*arguments)

    monkeypatch.setattr(pocl_cache.tempfile, "mkdtemp", make_folder)
    if when != "before it is opened":
        monkeypatch.setattr(pocl_cache.fcntl, "flock", lock_folder)
    folder = PoclFolder()
    assert len(made) == 2
    assert folder.path.is_dir()
    folder.close()


def test_a_forked_process_does_not_delete_the_folder():
    folder = PoclFolder()
    child = os.fork()
    if child == 0:
        folder.close()
        os._exit(0)
    os.waitpid(child, 0)
    assert folder.path.is_dir()
    folder.close()


@pytest.mark.parametrize("obstacle", ["a file", "full", "not executable"])
def test_another_folder_is_used_where_the_first_cannot_be(obstacle, folders, tmp_path, monkeypatch):
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    monkeypatch.setattr(pocl_cache.tempfile, "tempdir", str(temporary))
    if obstacle == "a file":
        folders.pocl.touch()
    elif obstacle == "full":
        monkeypatch.setattr(pocl_cache, "_free_bytes", lambda path: 2**40 if temporary in path.parents else 2**10)
    else:
        check = pocl_cache._check_usable
        monkeypatch.setattr(
            pocl_cache, "_check_usable", lambda path: check(path if temporary in path.parents else tmp_path / "none")
        )
    with pytest.warns(match=f"{FOLDER_VARIABLE} cannot be used .{folders.pocl}"):
        folder = PoclFolder()
    assert folder.path.parent == temporary
    folder.close()
    assert not list(temporary.iterdir())


def test_without_any_folder_the_message_says_what_to_do(monkeypatch):
    monkeypatch.setattr(pocl_cache, "_free_bytes", lambda path: 0)
    folder = PoclFolder()
    assert folder.path is None
    assert "less than 16 MiB of free space" in folder.problem
    assert f"set {FOLDER_VARIABLE}" in folder.problem
    with folder.program("key"):
        pass
    folder.store()
    folder.close()
    monkeypatch.setattr(pocl_cache, "pocl_folder", lambda: folder)
    with pocl_cache.pocl_environment():
        assert not Path(os.environ[FOLDER_VARIABLE]).exists()


def test_the_environment_is_as_before_once_pocl_has_started(monkeypatch, folders):
    folder = PoclFolder()
    monkeypatch.setattr(pocl_cache, "pocl_folder", lambda: folder)
    for before in (str(folders.pocl), None):
        if before is None:
            monkeypatch.delenv(FOLDER_VARIABLE)
        with pocl_cache.pocl_environment():
            assert os.environ[FOLDER_VARIABLE] == str(folder.path)
        assert os.environ.get(FOLDER_VARIABLE) == before
    folder.close()


def test_an_unwritable_home_has_the_program_cache_elsewhere(tmp_path, monkeypatch):
    """Among temporary files, unless that name is taken by a file or another user."""
    monkeypatch.delenv(program_cache.FOLDER_VARIABLE)
    monkeypatch.setattr(program_cache.tempfile, "tempdir", str(tmp_path))
    (tmp_path / "home").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    monkeypatch.setattr(program_cache, "_user_cache_folder", lambda: tmp_path / "home")
    program_cache._writable_folder.cache_clear()
    folder = program_cache.cache_folder()
    assert folder.parent == tmp_path
    assert folder.stat().st_mode & 0o777 == 0o700
    program_cache._writable_folder.cache_clear()
    folder.rmdir()
    folder.touch()
    assert program_cache.cache_folder() is None
    program_cache._writable_folder.cache_clear()


RENDER = ["-m", "isonoise", "render", "cornell", "--size", "16x12", "--spp", "1", "--strategy", "uniform", "-o"]


@pytest.mark.long
@pytest.mark.parametrize("driver", ["default", "PoCL of the system"])
def test_renders_with_damaged_caches(driver, tmp_path):
    """Every file of the caches emptied, cut, with flipped bits, random, replaced by a folder, and removed."""
    library = ctypes.util.find_library("pocl")
    environment = os.environ | {"HOME": str(tmp_path / "home"), "TMPDIR": str(tmp_path / "tmp")}
    for variable in ("XDG_CACHE_HOME", FOLDER_VARIABLE, program_cache.FOLDER_VARIABLE):
        environment.pop(variable, None)
    if driver != "default":
        if library is None or os.environ.get("OCL_ICD_VENDORS"):
            pytest.skip("needs PoCL of the system and no other choice of drivers")
        environment["OCL_ICD_VENDORS"] = library
    for name in ("home", "tmp"):
        (tmp_path / name).mkdir()

    def render() -> tuple[dict[str, bytes], str]:
        output = str(tmp_path / "image.exr")
        done = subprocess.run([sys.executable, *RENDER, output], env=environment, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        assert not list((tmp_path / "tmp").iterdir())
        return {name: plane.tobytes() for name, plane in read_exr(output)[0].items()}, done.stderr

    expected, _ = render()
    shutil.copytree(tmp_path / "home", tmp_path / "whole")
    files = [path.relative_to(tmp_path / "whole") for path in (tmp_path / "whole").rglob("*") if path.is_file()]
    assert len(files) >= 3
    draw = random.Random(1)
    for file in files:
        for damage in ("emptied", "cut", "flipped", "random", "a folder", "removed"):
            shutil.rmtree(tmp_path / "home")
            shutil.copytree(tmp_path / "whole", tmp_path / "home")
            damage_file(tmp_path / "home" / file, damage, draw)
            image, message = render()
            assert image == expected, (file, damage)
            assert ("is damaged" in message) == (damage != "removed"), (file, damage)
            assert "is damaged" not in render()[1], (file, damage)


def damage_file(path: Path, damage: str, draw: random.Random) -> None:
    content = bytearray(path.read_bytes())
    if damage == "flipped":
        content[draw.randrange(len(content))] ^= 1 << draw.randrange(8)
    elif damage == "random":
        content = draw.randbytes(len(content))
    path.unlink()
    if damage == "a folder":
        path.mkdir()
    elif damage != "removed":
        path.write_bytes({"emptied": b"", "cut": content[: len(content) // 2]}.get(damage, content))


USE_A_KERNEL = """
import numpy as np
from isonoise.device import pocl_cache
from isonoise.device.opencl import Device
device = Device()
x = device.buffer(np.zeros(8, np.float32), "numbers")
device.launch(device.build("__kernel void five(__global float* x) { x[0] = 5.0f; }", ())["five"], 8, (x,))
print(device.is_pocl, device.read(x, np.float32, 1)[0], len(pocl_cache.pocl_folder()._stored))
"""


def test_a_kernel_is_compiled_in_the_first_process_only(folders):
    def use_a_kernel(stored: int) -> str:
        done = subprocess.run([sys.executable, "-c", USE_A_KERNEL], env=os.environ, capture_output=True, text=True)
        if done.stdout.startswith("False"):
            pytest.skip("not PoCL")
        assert done.stdout.split() == ["True", "5.0", str(stored)], done.stderr
        assert not list(folders.pocl.iterdir())
        return done.stderr

    use_a_kernel(0)
    use_a_kernel(1)
    (file,) = folders.programs.iterdir()
    content = file.read_bytes()
    file.write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
    assert "is damaged (wrong checksum)" in use_a_kernel(0)
