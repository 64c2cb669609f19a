"""Tasks, their results and scenes as bytes, which `dask_pool` and `dask_worker` exchange.

A message is a head, which is JSON, and the planes one after the other. A plane in which all pixels have the same value
is sent as one number. Others are sent as they are, or compressed: the four bytes of the values are sorted into four
byte planes, of which those shrink that hold signs, exponents or high bytes of counts.
"""

import json
import pickle
import struct
import zlib
from collections.abc import Mapping

import numpy as np

from isonoise.distributed.task import Task, TaskResult
from isonoise.scene.compiled_scene import CompiledScene

_MAGIC = b"iso1"
_HEAD = struct.Struct("<4sII")  # magic, bytes of the JSON, Adler-32 of all that follows this or _UNCHECKED
_UNCHECKED = 0
"""Messages that stay on a machine have no checksum: to compute it takes as long as to send them."""
_TYPES = {"<f4": np.float32, "<u4": np.uint32}
_CONSTANT, _PLAIN, _COMPRESSED = range(3)
_MAX_PIXELS = 2**28
_MAX_PLANES = 2**10
_LEVEL = 1  # of zlib
_MIN_SAVING = 0.9
"""A byte plane stays compressed if it shrinks to at most this share."""
_TEST_BYTES = 2**12
"""Bytes of a byte plane that are compressed to see whether that is worth it."""
_DAMAGE = (
    *(ValueError, LookupError, TypeError, OverflowError, AttributeError),
    *(RecursionError, MemoryError, struct.error, zlib.error),
)
"""What damaged bytes raise."""


class PackingError(ValueError):
    """The bytes are damaged, or those of something else."""


def pack_task(task: Task, compress: bool) -> bytes:
    """A task as bytes; `compress` saves bytes and takes time."""
    arrays = {"pixels": task.pixels[None], "allocation": task.allocation[None]}
    arrays |= {f"state/{name}": array for name, array in task.state.items()}
    return _pack({"number": task.number, "seed": task.seed}, arrays, compress)


def unpack_task(data: bytes) -> Task:
    """The task that `pack_task` has packed. Raises PackingError if the bytes are damaged."""
    values, arrays = _unpack(data)
    try:
        pixels, allocation = arrays.pop("pixels"), arrays.pop("allocation")
        return Task(int(values["number"]), pixels[0], allocation[0], _state(arrays), int(values["seed"]))
    except (LookupError, TypeError, ValueError, OverflowError) as error:
        raise PackingError(f"this is no task: {error}") from error


def pack_result(result: TaskResult, compress: bool) -> bytes:
    """The result of a task as bytes."""
    arrays = {f"state/{name}": array for name, array in result.state.items()}
    if result.remaining is not None:
        arrays["remaining"] = result.remaining[None]
    values = {"number": result.number, "seconds": result.seconds}
    return _pack(values, arrays, compress)


def unpack_result(data: bytes) -> TaskResult:
    """The result that `pack_result` has packed. Raises PackingError if the bytes are damaged."""
    values, arrays = _unpack(data)
    try:
        remaining = arrays.pop("remaining", (None,))[0]
        return TaskResult(int(values["number"]), _state(arrays), remaining, float(values["seconds"]))
    except (LookupError, TypeError, ValueError, OverflowError) as error:
        raise PackingError(f"this is no result of a task: {error}") from error


def pack_scene(scene: CompiledScene, compress: bool) -> bytes:
    """A scene as bytes, for workers that need no file of it."""
    data = pickle.dumps(scene, protocol=5)
    return zlib.compress(data, _LEVEL) if compress else data


def unpack_scene(data: bytes, is_compressed: bool) -> CompiledScene:
    """The scene that `pack_scene` has packed. Like Dask itself it runs code that the bytes name."""
    return pickle.loads(zlib.decompress(data) if is_compressed else data)


def _state(arrays: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    names = [name.partition("/") for name in arrays]
    if any(group != "state" for group, _, _ in names):
        raise ValueError(f"it has the arrays {', '.join(arrays)}")
    return {name.removeprefix("state/"): array for name, array in arrays.items()}


def _pack(values: dict[str, object], arrays: Mapping[str, np.ndarray], compress: bool) -> bytes:
    """The bytes of some values, and of arrays with planes of one size."""
    parts: list[bytes | memoryview] = []
    table = []
    pixels = next(iter(arrays.values())).shape[1]
    for name, array in arrays.items():
        planes = [_pack_plane(plane, compress, parts) for plane in np.ascontiguousarray(array).view(np.uint32)]
        table.append([name, array.dtype.str, planes])
    description = json.dumps(values | {"pixels": pixels, "arrays": table}).encode()
    description += b" " * (-len(description) % 4)  # aligns the planes
    check = 1 if compress else _UNCHECKED
    for part in (description, *parts) if compress else ():
        check = zlib.adler32(part, check)
    return b"".join((_HEAD.pack(_MAGIC, len(description), check), description, *parts))


def _pack_plane(plane: np.ndarray, compress: bool, parts: list[bytes | memoryview]) -> list:
    """Add the bytes of a plane to `parts`; return its entry in the table: the kind, and what it takes to read it."""
    if len(plane) and plane[0] == plane[-1] and (plane == plane[0]).all():
        return [_CONSTANT, int(plane[0])]
    if not compress:
        parts.append(plane.view(np.uint8).data)
        return [_PLAIN]
    sizes = []
    for byte_plane in np.ascontiguousarray(plane.view(np.uint8).reshape(-1, 4).T):
        content = byte_plane.tobytes()
        if len(zlib.compress(content[:_TEST_BYTES], _LEVEL)) <= _MIN_SAVING * len(content[:_TEST_BYTES]):
            compressed = zlib.compress(content, _LEVEL)
            content = compressed if len(compressed) < len(content) else content
        parts.append(content)
        sizes.append(len(content))
    return [_COMPRESSED, *sizes]


def _unpack(data: bytes) -> tuple[dict, dict[str, np.ndarray]]:
    """The values and arrays that `_pack` has packed."""
    try:
        magic, description_bytes, check = _HEAD.unpack_from(data)
        body = memoryview(data)[_HEAD.size :]
        if magic != _MAGIC or (check != _UNCHECKED and zlib.adler32(body) != check):
            raise ValueError("the checksum differs")
        values = json.loads(bytes(body[:description_bytes]))
        pixels = values["pixels"]
        if not isinstance(pixels, int) or not 0 <= pixels < _MAX_PIXELS:
            raise ValueError(f"it has {pixels} pixels")
        reader = _Reader(body[description_bytes:])
        arrays = {name: _unpack_array(reader, dtype, planes, pixels) for name, dtype, planes in values["arrays"]}
        reader.check_end()
        return values, arrays
    except _DAMAGE as error:
        raise PackingError(f"the bytes are damaged: {error}") from error


class _Reader:
    """Reads the planes, one after the other."""

    def __init__(self, content: memoryview):
        self._content, self._next = content, 0

    def read(self, size_bytes: int) -> memoryview:
        begin, self._next = self._next, self._next + size_bytes
        if size_bytes < 0 or self._next > len(self._content):
            raise ValueError("it is cut off")
        return self._content[begin : self._next]

    def check_end(self) -> None:
        if self._next != len(self._content):
            raise ValueError("it is too long")


def _unpack_array(reader: _Reader, dtype: str, planes: list, pixels: int) -> np.ndarray:
    if len(planes) > _MAX_PLANES:
        raise ValueError(f"it has {len(planes)} planes")
    if planes == [[_PLAIN]] * len(planes):
        content = reader.read(4 * pixels * len(planes))
        return np.frombuffer(content, _TYPES[dtype]).reshape(len(planes), pixels)  # without a copy
    array = np.empty((len(planes), pixels), np.uint32)
    for plane, (kind, *rest) in zip(array, planes, strict=True):
        if kind == _CONSTANT:
            plane[:] = rest[0]
        elif kind == _PLAIN:
            plane[:] = np.frombuffer(reader.read(4 * pixels), np.uint32)
        elif kind == _COMPRESSED and len(rest) == 4:
            for byte_plane, size_bytes in zip(plane.view(np.uint8).reshape(-1, 4).T, rest, strict=True):
                content = reader.read(size_bytes)
                byte_plane[:] = np.frombuffer(_decompressed(content, pixels), np.uint8)
        else:
            raise ValueError(f"a plane is of kind {kind}")
    return array.view(_TYPES[dtype])


def _decompressed(content: memoryview, size_bytes: int) -> bytes | memoryview:
    """The content of a byte plane, which is compressed if it is shorter."""
    if len(content) == size_bytes:
        return content
    decompressor = zlib.decompressobj()
    plain = decompressor.decompress(content, size_bytes + 1)
    if len(plain) != size_bytes or not decompressor.eof:
        raise ValueError("a plane has another size")
    return plain
