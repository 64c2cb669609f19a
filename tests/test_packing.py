"""Tasks and results as bytes: what is packed comes back, and damaged bytes are refused."""

import contextlib
import json
import zlib

import numpy as np
import pytest

from isonoise.distributed import packing
from isonoise.distributed.packing import PackingError
from isonoise.distributed.task import Task, TaskResult


def make_state(pixels: int, seed: int = 0) -> dict[str, np.ndarray]:
    """As after some samples: counts, sums that differ, a plane of zeros and one of NaN."""
    rng = np.random.default_rng(seed)
    sums = rng.gamma(2.0, size=(4, pixels)).astype(np.float32)
    sums[1], sums[3] = 0, np.nan
    return {
        "count": rng.integers(1, 500, (1, pixels), np.uint32),
        "rejected": np.zeros((1, pixels), np.uint32),
        "sums": sums,
    }


def make_task(pixels: int) -> Task:
    numbers = np.random.default_rng(1).permutation(2 * pixels)[:pixels].astype(np.uint32)
    return Task(7, numbers, np.full(pixels, 3, np.uint32), make_state(pixels), 2**64 - 1)


def assert_same_arrays(first, second) -> None:
    assert first.keys() == second.keys()
    for name, array in first.items():
        assert array.dtype == second[name].dtype
        np.testing.assert_array_equal(array, second[name])


@pytest.mark.parametrize("compress", [False, True])
@pytest.mark.parametrize("pixels", [1, 2, 1000, 20000])
def test_tasks_and_results_come_back(pixels, compress):
    task = make_task(pixels)
    back = packing.unpack_task(packing.pack_task(task, compress))
    assert (back.number, back.seed) == (7, 2**64 - 1)
    np.testing.assert_array_equal(task.pixels, back.pixels)
    np.testing.assert_array_equal(task.allocation, back.allocation)
    assert_same_arrays(task.state, back.state)
    for remaining in (None, task.allocation):
        result = TaskResult(8, task.state, remaining, 0.5)
        again = packing.unpack_result(packing.pack_result(result, compress))
        assert (again.number, again.seconds) == (8, 0.5)
        assert_same_arrays(task.state, again.state)
        assert (again.remaining is None) == (remaining is None)


def test_constant_planes_take_no_room_and_compression_saves_bytes():
    task = make_task(20000)
    plain, compressed = (len(packing.pack_task(task, compress)) for compress in (False, True))
    assert plain < 4 * 20000 * 4 + 2000  # pixels, count, two planes of sums
    assert compressed < 0.8 * plain


def damaged(data: bytes, rng) -> bytes:
    """The bytes with a bit flipped, or eight of them replaced."""
    changed = bytearray(data)
    if rng.integers(2):
        changed[rng.integers(len(data))] ^= 1 << rng.integers(8)
    else:
        begin = rng.integers(len(data) - 8)
        changed[begin : begin + 8] = rng.bytes(8)
    return bytes(changed)


def test_damaged_bytes_are_refused():
    """Those for a network, which have a checksum."""
    data, rng = packing.pack_task(make_task(300), True), np.random.default_rng(2)
    for _ in range(300):
        with pytest.raises(PackingError):
            packing.unpack_task(damaged(data, rng))


def test_damaged_bytes_without_checksum_raise_no_other_error():
    data, rng = packing.pack_task(make_task(3), False), np.random.default_rng(3)
    for _ in range(300):
        with contextlib.suppress(PackingError):
            packing.unpack_task(damaged(data, rng))


@pytest.mark.parametrize("compress", [False, True])
def test_bytes_of_another_length_are_refused(compress):
    data = packing.pack_task(make_task(300), compress)
    for length in range(0, len(data), 37):
        with pytest.raises(PackingError):
            packing.unpack_task(data[:length])
    with pytest.raises(PackingError):
        packing.unpack_task(data + b"\0")


def sealed(description: dict, content: bytes) -> bytes:
    """A message with a valid checksum."""
    text = json.dumps(description).encode()
    return packing._HEAD.pack(packing._MAGIC, len(text), zlib.adler32(text + content)) + text + content


BOMB = zlib.compress(bytes(10**6), 9)


@pytest.mark.parametrize(
    ("changes", "content"),
    [
        ({"pixels": -1}, b""),
        ({"pixels": 2**40}, b""),
        ({"pixels": "3"}, b""),
        ({"arrays": [["pixels", "<u4", [[1]]]]}, bytes(8)),  # cut off
        ({"arrays": [["pixels", "<u4", [[1]]]]}, bytes(16)),  # too long
        ({"arrays": [["pixels", "<f8", [[0, 1]]]]}, b""),
        ({"arrays": [["pixels", "<u4", [[9]]]]}, b""),
        ({"arrays": [["pixels", "<u4", [[0, 2**40]]]]}, b""),
        ({"arrays": [["pixels", "<u4", [[0, 1]] * 5000]]}, b""),
        ({"arrays": [["pixels", "<u4", [[2, len(BOMB), 3, 3, 3]]]]}, BOMB + bytes(9)),
        ({"arrays": [["else", "<u4", [[0, 1]]]]}, b""),
        ({"arrays": 3}, b""),
        ({"arrays": [["pixels", "<u4", [[0, 1]]], ["allocation", "<u4", [[0, 1]]]], "number": None}, b""),
    ],
)
def test_wrong_messages_are_refused(changes, content):
    with pytest.raises(PackingError):
        packing.unpack_task(sealed({"number": 1, "seed": 0, "pixels": 3, "arrays": []} | changes, content))


def test_a_task_is_no_result():
    with pytest.raises(PackingError):
        packing.unpack_result(packing.pack_task(make_task(3), False))
