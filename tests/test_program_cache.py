"""Compiled programs between processes: what is kept is used, and nothing that lies in the folder can do harm."""

import os
import stat
import threading

import numpy as np
import pytest
from small_scene import lamp_over_floor

from isonoise.device import opencl, program_cache
from isonoise.device.opencl import Device
from isonoise.errors import DeviceError
from isonoise.renderer import Renderer

pytestmark = pytest.mark.filterwarnings("ignore:Pre-build attribute access")

SOURCE = """__kernel void roots(__global float* values, uint count)
{
    const uint i = get_global_id(0);
    if (i < count) values[i] = sqrt(i + OFFSET);
}
"""
OPTIONS = ("-cl-std=CL1.2", "-DOFFSET=0.3f")
COUNT = 1000


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty cache, and a process that has built nothing yet."""
    monkeypatch.setenv(program_cache.FOLDER_VARIABLE, str(tmp_path / "made" / "when needed"))
    return begin_anew(monkeypatch, tmp_path / "made" / "when needed")


@pytest.fixture(autouse=True)
def keeps_nothing_by_itself(monkeypatch):
    """The device's driver is taken for one that needs the cache: PoCL doesn't, but it can be asked for binaries."""
    monkeypatch.setattr(Device, "is_pocl", False)


def begin_anew(monkeypatch, folder):
    monkeypatch.setattr(opencl, "_programs", {})
    monkeypatch.setattr(opencl, "_programs_to_store", {})
    return folder


@pytest.fixture
def compiled(monkeypatch):
    """The source texts that are compiled from now on."""
    texts = []
    built = Device._build_program

    def note(self, program, options):
        if program.get_info(opencl._opencl().program_info.SOURCE):
            texts.append(options)
        return built(self, program, options)

    monkeypatch.setattr(Device, "_build_program", note)
    return texts


def roots(options=OPTIONS) -> bytes:
    device = Device()
    values = device.buffer(np.zeros(COUNT, np.float32), "values")
    device.launch(device.build(SOURCE, options)["roots"], COUNT, (values, np.uint32(COUNT)))
    return device.read(values, np.float32, COUNT).tobytes()


def later_process(monkeypatch, folder) -> bytes:
    opencl._store_programs()
    begin_anew(monkeypatch, folder)
    return roots()


def test_a_program_that_was_kept_gives_the_same_bits(folder, compiled, monkeypatch):
    first = roots()
    assert later_process(monkeypatch, folder) == first
    assert len(compiled) == 1
    assert len(list(folder.iterdir())) == 1


@pytest.mark.parametrize("harm", ["empty", "cut off", "one bit", "foreign", "no program", "a folder"])
def test_a_broken_file_is_as_good_as_none_and_is_replaced(folder, compiled, monkeypatch, harm):
    first = roots()
    opencl._store_programs()
    (file,) = folder.iterdir()
    whole = file.read_bytes()
    flipped = bytearray(whole)
    flipped[len(whole) // 2] ^= 1
    contents = {"empty": b"", "cut off": whole[:-1], "one bit": bytes(flipped), "foreign": b"\x7fELF" + whole}
    if harm == "no program":  # the file is sound, but the driver does not know what to do with it
        program_cache.store(file.name, b"something else")
    elif harm == "a folder":
        file.unlink()
        file.mkdir()
    else:
        file.write_bytes(contents[harm])
    begin_anew(monkeypatch, folder)
    assert roots() == first
    assert len(compiled) == 2
    if harm != "a folder":
        assert later_process(monkeypatch, folder) == first
        assert len(compiled) == 2


@pytest.mark.parametrize("obstacle", ["a file", "read-only"])
def test_without_a_folder_to_write_to_all_works(tmp_path, compiled, monkeypatch, obstacle):
    place = tmp_path / "cache"
    if obstacle == "a file":
        place.touch()
    else:
        place.mkdir(mode=stat.S_IRUSR | stat.S_IXUSR)
        if os.access(place, os.W_OK):
            pytest.skip("this user may write everywhere")
    monkeypatch.setenv(program_cache.FOLDER_VARIABLE, str(place / "programs"))
    begin_anew(monkeypatch, place)
    assert roots() == later_process(monkeypatch, place)
    assert len(compiled) == 2


def test_off_keeps_nothing(monkeypatch, tmp_path, compiled):
    monkeypatch.setenv(program_cache.FOLDER_VARIABLE, "off")
    monkeypatch.chdir(tmp_path)
    begin_anew(monkeypatch, tmp_path)
    assert roots() == later_process(monkeypatch, tmp_path)
    assert len(compiled) == 2
    assert not list(tmp_path.iterdir())


def test_pocl_keeps_its_programs_by_itself(folder, compiled, monkeypatch):
    monkeypatch.setattr(Device, "is_pocl", True)
    first = roots()
    assert not opencl._programs_to_store  # asked for at the process's end, its binaries take as long as the first image
    program_cache.store(program_cache.program_key(SOURCE, OPTIONS, Device()._cache_identity), b"is not looked for")
    assert later_process(monkeypatch, folder) == first
    assert len(compiled) == 2


def test_a_render_starts_the_compiler_three_times(folder, compiled):
    """For the pixels, for what shapes change, and for what materials change."""
    Renderer(lamp_over_floor())
    assert len(compiled) == 3


def test_the_usual_folder_is_the_users(monkeypatch, tmp_path):
    monkeypatch.delenv(program_cache.FOLDER_VARIABLE)
    monkeypatch.setattr(program_cache.sys, "platform", "linux")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert program_cache.cache_folder() == tmp_path / "isonoise" / "programs"
    monkeypatch.setattr(program_cache.sys, "platform", "win32")
    monkeypatch.setenv("LOCALAPPDATA", str(tmp_path / "local"))
    assert program_cache.cache_folder() == tmp_path / "local" / "isonoise" / "programs"


def test_every_part_of_the_key_counts():
    keys = [
        program_cache.program_key(*parts)
        for parts in [
            ("a", ("b", "c"), ("d", "e")),
            ("a ", ("b", "c"), ("d", "e")),
            ("a", ("c", "b"), ("d", "e")),
            ("a", ("bc",), ("d", "e")),
            ("a", ("b",), ("c", "d", "e")),
            ("a", ("b", "c"), ("d", "e2")),
            ("a", ("b", "c"), ("de",)),
        ]
    ]
    assert len(set(keys)) == len(keys)


def test_other_options_are_another_program(folder, compiled, monkeypatch):
    first = roots()
    opencl._store_programs()
    begin_anew(monkeypatch, folder)
    assert roots((OPTIONS[0], "-DOFFSET=0.4f")) != first
    assert len(compiled) == 2


def test_the_size_is_bounded_and_the_oldest_go(folder, monkeypatch):
    monkeypatch.setattr(program_cache, "MAX_SIZE_BYTES", 3500)
    for age, name in enumerate(["now", "yesterday", "last week"]):
        program_cache.store(name, bytes(1000))
        os.utime(folder / name, (1e9 - age, 1e9 - age))
    assert program_cache.load("last week")  # and with that it is the newest
    program_cache.store("new", bytes(1000))
    assert sorted(file.name for file in folder.iterdir()) == ["last week", "new", "now"]


def test_readers_see_whole_files_while_others_write(folder):
    binaries = [bytes([fill]) * 300_000 for fill in range(2)]
    program_cache.store("key", binaries[0])
    writers = [
        threading.Thread(target=lambda mine=mine: [program_cache.store("key", mine) for _ in range(50)])
        for mine in binaries
    ]
    for writer in writers:
        writer.start()
    while any(writer.is_alive() for writer in writers):
        assert program_cache.load("key") in binaries
    assert [file.name for file in folder.iterdir()] == ["key"]  # and no temporary file is left


def test_a_driver_without_binaries_is_no_error(folder, compiled, monkeypatch):
    roots()
    (kept,) = opencl._programs_to_store.values()

    class Silent:
        def get_info(self, what):
            raise opencl._opencl().RuntimeError("clGetProgramInfo failed: INVALID_VALUE")

    monkeypatch.setattr(opencl, "_programs_to_store", {"a": Silent(), "b": kept})
    opencl._store_programs()
    assert [file.name for file in folder.iterdir()] == ["b"]


def test_what_does_not_compile_is_an_error_and_is_not_kept(folder):
    with pytest.raises(DeviceError, match="refused"):
        Device().build("__kernel void wrong( {}", OPTIONS)
    assert not opencl._programs_to_store
