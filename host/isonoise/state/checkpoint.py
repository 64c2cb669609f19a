"""Checkpoint files: a `State` as an uncompressed .npz archive, without pickled objects.

An archive has a member `GROUP/NAME.npy` for every array of the state, and `state.json` with the rest and with type,
shape and CRC-32 of every array. The zip format has a CRC-32 of every member, which is checked when it is read. Other
programs read the arrays with `numpy.load`.
"""

import json
import math
import os
import struct
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from isonoise.errors import UserError
from isonoise.film.files import write_atomically
from isonoise.input_files import open_regular_file, size_bytes
from isonoise.state.consistency import check_consistency
from isonoise.state.state import State

FORMAT = 3
"""Version of the layout; a file of another one is refused."""
_JSON_NAME = "state.json"
_ARRAY_SUFFIX = ".npy"
_CHUNK_BYTES = 2**20
"""Checksum and copy of a chunk find it in the CPU's cache: whole arrays take 1.4 times as long."""
_MAX_JSON_BYTES = 2**28
_TYPES = ("<f4", "<f8", "<u4", "<i4", "<i8", "<u8", "|b1", "|u1", "|i1", "<u2", "<i2", "<f2")
_DAMAGE = (
    zipfile.BadZipFile, zlib.error, ValueError, KeyError, TypeError, EOFError, NotImplementedError, RuntimeError,
    struct.error, OverflowError,
)  # fmt: skip
"""What zipfile, json and numpy raise for a damaged file. UnicodeDecodeError is a ValueError, RecursionError a
RuntimeError."""


def write_checkpoint(path: str | os.PathLike, state: State) -> None:
    """Write a state atomically: the previous file stays until the new one is on the disk.

    Parameters
    ----------
    path : path
        The file.
    state : State
        Of `Renderer.state` or `RenderLoop.state`.

    Raises
    ------
    UserError
        If the file cannot be written.
    """

    def write(temporary: Path) -> None:
        with zipfile.ZipFile(temporary, "w", zipfile.ZIP_STORED) as archive:
            forms = {}
            for name, array in state.arrays.items():
                with archive.open(name + _ARRAY_SUFFIX, "w", force_zip64=True) as member:
                    contiguous = np.ascontiguousarray(array)
                    np.lib.format.write_array_header_1_0(member, np.lib.format.header_data_from_array_1_0(contiguous))
                    content = contiguous.reshape(-1).view(np.uint8).data
                    for begin in range(0, len(content), _CHUNK_BYTES):
                        member.write(content[begin : begin + _CHUNK_BYTES])
                forms[name] = array.dtype.str, array.shape, archive.getinfo(name + _ARRAY_SUFFIX).CRC
            parts = {"settings": state.settings, "values": state.values, "arrays": forms}
            archive.writestr(_JSON_NAME, json.dumps({"format": FORMAT} | parts))

    write_atomically(path, write)


def read_checkpoint(path: str | os.PathLike) -> State:
    """Read the state that `write_checkpoint` has written.

    Parameters
    ----------
    path : path
        The file.

    Returns
    -------
    State
        For `Renderer.restore`, or the parameter `state` of `RenderLoop`.

    Raises
    ------
    UserError
        If the file is missing, damaged, or not a checkpoint of this version of isonoise.
    """
    with _opened(path) as (archive, file_bytes):
        description = _read_description(archive, path)
        arrays = {name: _read_array(archive, name, *form, file_bytes) for name, form in description["arrays"].items()}
        state = State(dict(description["settings"]), dict(description["values"]), arrays)
        check_consistency(state)
        return state


def read_description(path: str | os.PathLike) -> dict[str, object]:
    """Read what a checkpoint holds besides arrays: `settings`, `values`, and `arrays`, name -> [type, shape, CRC-32].

    Raises UserError as `read_checkpoint` does; arrays are not checked.
    """
    with _opened(path) as (archive, _):
        return _read_description(archive, path)


@contextmanager
def _opened(path: str | os.PathLike) -> Iterator[tuple[zipfile.ZipFile, int]]:
    """The archive and the size of its file in bytes. Within the `with` block, damage raises UserError."""
    try:
        with open_regular_file(path) as file:
            if not zipfile.is_zipfile(file):
                raise UserError(f"cannot read '{path}': it is not a checkpoint, or it is cut off")
            with zipfile.ZipFile(file) as archive:
                yield archive, size_bytes(file)
    except _DAMAGE as error:
        raise UserError(f"cannot read '{path}': the checkpoint is damaged ({error})") from error
    except OSError as error:  # damaged offsets have EINVAL
        raise UserError(f"cannot read '{path}': {error.strerror or error}") from error


def _read_description(archive: zipfile.ZipFile, path: str | os.PathLike) -> dict[str, object]:
    if _JSON_NAME not in archive.namelist():
        raise UserError(f"cannot read '{path}': it is not a checkpoint of isonoise")
    if archive.getinfo(_JSON_NAME).file_size > _MAX_JSON_BYTES:
        raise ValueError(f"{_JSON_NAME} is too large")
    description = json.loads(_stored(archive, _JSON_NAME).read())
    if description["format"] != FORMAT:
        raise UserError(
            f"cannot read '{path}': it has format {description['format']}, and this version of isonoise reads "
            f"format {FORMAT}; use the version that wrote it"
        )
    for part in ("settings", "values", "arrays"):
        if not isinstance(description[part], Mapping):
            raise TypeError(f"'{part}' is no object")
    return description


def _read_array(
    archive: zipfile.ZipFile, name: str, dtype: str, shape: list[int], crc: int, file_bytes: int
) -> np.ndarray:
    """An array of the archive; ValueError or another of `_DAMAGE` if it is not as described."""
    if dtype not in _TYPES or not all(isinstance(side, int) and 0 <= side < 2**40 for side in shape):
        raise ValueError(f"'{name}' has type {dtype} and shape {shape}")
    size_bytes = math.prod(shape) * np.dtype(dtype).itemsize
    if size_bytes > file_bytes:
        raise ValueError(f"'{name}' is larger than the file")
    if crc != archive.getinfo(name + _ARRAY_SUFFIX).CRC:
        raise ValueError(f"'{name}' is that of another checkpoint")
    with _stored(archive, name + _ARRAY_SUFFIX) as member:
        version = np.lib.format.read_magic(member)
        header = np.lib.format.read_array_header_1_0(member) if version == (1, 0) else None
        if header != (tuple(shape), False, np.dtype(dtype)):
            raise ValueError(f"'{name}' has the header {header}")
        array = np.empty(shape, dtype)
        content = memoryview(array.reshape(-1).view(np.uint8)) if size_bytes else memoryview(b"")
        if (size_bytes and member.readinto(content) != size_bytes) or member.read(1):
            raise ValueError(f"'{name}' has another size")
        return array


def _stored(archive: zipfile.ZipFile, name: str):
    """The open member; it may not be compressed, because then its size is limited by that of the file."""
    info = archive.getinfo(name)
    if info.compress_type != zipfile.ZIP_STORED:
        raise ValueError(f"'{name}' is compressed")
    return archive.open(info)
