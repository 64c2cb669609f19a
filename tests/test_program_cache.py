"""The program cache: stored programs are used, and damaged or foreign files do no harm."""

import contextlib
import os
import stat
import threading
import warnings

import numpy as np
import pytest
from small_scene import lamp_over_floor

from isonoise.device import drivers, opencl, program_cache
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
    """An empty cache folder, and no programs in this process."""
    monkeypatch.setenv(program_cache.FOLDER_VARIABLE, str(tmp_path / "made" / "when needed"))
    return forget_programs(monkeypatch, tmp_path / "made" / "when needed")


@pytest.fixture(autouse=True)
def driver_without_cache(monkeypatch):
    """Treat PoCL as a driver without a cache of its own."""
    monkeypatch.setattr(Device, "is_pocl", False)


def forget_programs(monkeypatch, folder):
    monkeypatch.setattr(opencl, "_programs", {})
    monkeypatch.setattr(opencl, "_programs_to_store", {})
    return folder


@pytest.fixture
def compiled(monkeypatch):
    """Options of the programs that are compiled from source."""
    compilations = []
    original = Device._build_program

    def build(self, program, options):
        if program.get_info(drivers.load_pyopencl().program_info.SOURCE):
            compilations.append(options)
        return original(self, program, options)

    monkeypatch.setattr(Device, "_build_program", build)
    return compilations


def roots(options=OPTIONS) -> bytes:
    device = Device()
    values = device.buffer(np.zeros(COUNT, np.float32), "values")
    device.launch(device.build(SOURCE, options)["roots"], COUNT, (values, np.uint32(COUNT)))
    return device.read(values, np.float32, COUNT).tobytes()


def roots_in_new_process(monkeypatch, folder) -> bytes:
    opencl.store_programs()
    forget_programs(monkeypatch, folder)
    return roots()


def test_a_cached_program_gives_the_same_bits(folder, compiled, monkeypatch):
    first = roots()
    assert roots_in_new_process(monkeypatch, folder) == first
    assert len(compiled) == 1
    assert len(list(folder.iterdir())) == 1


@pytest.mark.parametrize("damage", ["empty", "cut off", "one bit", "foreign", "no program", "a folder"])
def test_a_damaged_file_is_replaced(folder, compiled, monkeypatch, damage):
    first = roots()
    opencl.store_programs()
    (file,) = folder.iterdir()
    whole = file.read_bytes()
    flipped = bytearray(whole)
    flipped[len(whole) // 2] ^= 1
    contents = {"empty": b"", "cut off": whole[:-1], "one bit": bytes(flipped), "foreign": b"\x7fELF" + whole}
    if damage == "no program":  # a valid file that the driver rejects
        program_cache.store(file.name, b"something else")
    elif damage == "a folder":
        file.unlink()
        file.mkdir()
    else:
        file.write_bytes(contents[damage])
    forget_programs(monkeypatch, folder)
    with contextlib.nullcontext() if damage == "no program" else pytest.warns(match="is damaged"):
        assert roots() == first
    assert len(compiled) == 2
    assert roots_in_new_process(monkeypatch, folder) == first
    assert len(compiled) == 2


@pytest.mark.parametrize("obstacle", ["a file", "read-only"])
def test_a_folder_that_cannot_be_written(tmp_path, compiled, monkeypatch, obstacle):
    place = tmp_path / "cache"
    if obstacle == "a file":
        place.touch()
    else:
        place.mkdir(mode=stat.S_IRUSR | stat.S_IXUSR)
        if os.access(place, os.W_OK):
            pytest.skip("this user may write everywhere")
    monkeypatch.setenv(program_cache.FOLDER_VARIABLE, str(place / "programs"))
    forget_programs(monkeypatch, place)
    assert roots() == roots_in_new_process(monkeypatch, place)
    assert len(compiled) == 2


def test_a_folder_that_cannot_be_read_is_reported_once(folder, monkeypatch):
    def refuse(path):
        raise PermissionError(13, "Permission denied", path)

    monkeypatch.setattr(program_cache, "read_regular_file", refuse)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("default")
        assert [program_cache.load(key) for key in ("a", "b")] == [None, None]
    assert [str(warning.message) for warning in caught] == [
        f"the program cache {folder} cannot be read (Permission denied); programs are compiled at each start"
    ]


def test_the_cache_can_be_off(monkeypatch, tmp_path, compiled):
    monkeypatch.setenv(program_cache.FOLDER_VARIABLE, "off")
    monkeypatch.chdir(tmp_path)
    forget_programs(monkeypatch, tmp_path)
    assert roots() == roots_in_new_process(monkeypatch, tmp_path)
    assert len(compiled) == 2
    assert not list(tmp_path.iterdir())


def test_binaries_of_pocl_are_not_cached(folder, compiled, monkeypatch):
    monkeypatch.setattr(Device, "is_pocl", True)
    first = roots()
    assert not opencl._programs_to_store  # its binaries take as long as compiling
    assert roots_in_new_process(monkeypatch, folder) == first
    assert len(compiled) == 2


def test_a_render_compiles_three_programs(folder, compiled):
    """Pixel stages, stages that depend on shapes, stages that depend on materials."""
    Renderer(lamp_over_floor())
    assert len(compiled) == 3


def test_the_default_folder_is_the_users(monkeypatch, tmp_path):
    monkeypatch.delenv(program_cache.FOLDER_VARIABLE)
    monkeypatch.setattr(program_cache.sys, "platform", "linux")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert program_cache.cache_folder() == tmp_path / "isonoise" / "programs"
    monkeypatch.setattr(program_cache.sys, "platform", "win32")
    monkeypatch.setenv("LOCALAPPDATA", str(tmp_path / "local"))
    assert program_cache.cache_folder() == tmp_path / "local" / "isonoise" / "programs"


def test_every_part_of_the_key_matters():
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
    opencl.store_programs()
    forget_programs(monkeypatch, folder)
    assert roots((OPTIONS[0], "-DOFFSET=0.4f")) != first
    assert len(compiled) == 2


def test_another_device_of_the_kind_gets_the_binary(folder, compiled, monkeypatch):
    """In the same process, before programs are stored: a program belongs to the context of one device."""
    kernels = [Device().build(SOURCE, OPTIONS)]
    monkeypatch.setattr(opencl, "_programs", {})
    kernels.append(Device().build(SOURCE, OPTIONS))
    assert [list(each) for each in kernels] == [["roots"], ["roots"]]
    assert len(compiled) == 1


def test_the_least_recently_used_files_are_removed(folder, monkeypatch):
    monkeypatch.setattr(program_cache, "MAX_SIZE_BYTES", 3500)
    for age, name in enumerate(["now", "yesterday", "last week"]):
        program_cache.store(name, bytes(1000))
        os.utime(folder / name, (1e9 - age, 1e9 - age))
    assert program_cache.load("last week")  # this makes it the newest
    program_cache.store("new", bytes(1000))
    assert sorted(file.name for file in folder.iterdir()) == ["last week", "new", "now"]


def test_concurrent_reads_and_writes(folder):
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
    (program,) = opencl._programs_to_store.values()

    class WithoutBinaries:
        def get_info(self, what):
            raise drivers.load_pyopencl().RuntimeError("clGetProgramInfo failed: INVALID_VALUE")

    monkeypatch.setattr(opencl, "_programs_to_store", {"a": WithoutBinaries(), "b": program})
    opencl.store_programs()
    assert [file.name for file in folder.iterdir()] == ["b"]


def test_a_compiler_error_is_reported_and_not_cached(folder):
    with pytest.raises(DeviceError, match="refused"):
        Device().build("__kernel void wrong( {}", OPTIONS)
    assert not opencl._programs_to_store
