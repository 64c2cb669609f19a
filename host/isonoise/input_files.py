"""Opens and reads input files of any kind: regular files only, because pipes and devices may have no end.

Called by all readers. Errors are OSError and ValueError: the callers name the file and its purpose.
"""

import errno
import json
import os
import stat
from typing import BinaryIO


def open_regular_file(path: str | os.PathLike) -> BinaryIO:
    """Open a file for reading without waiting.

    Raises OSError if it cannot be opened or is a pipe, a device or a socket, and for an invalid name.
    """
    try:
        _check_mode(os.stat(path).st_mode, path)  # before opening: to open a device may start something
        return open(path, "rb", opener=_open_without_waiting)
    except ValueError as error:  # a null byte
        raise OSError(errno.EINVAL, str(error)) from None


def _open_without_waiting(path: str | os.PathLike, flags: int) -> int:
    descriptor = os.open(path, flags | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_NOCTTY", 0))
    try:
        _check_mode(os.fstat(descriptor).st_mode, path)  # it may have been replaced meanwhile
    except OSError:
        os.close(descriptor)
        raise
    return descriptor


def _check_mode(mode: int, path: str | os.PathLike) -> None:
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):  # of a folder, `open` says what is wrong
        raise OSError(errno.EINVAL, "it is not a regular file", os.fspath(path))


def size_bytes(file: BinaryIO) -> int:
    """The size of an open file. No more should be read: some files of /proc are regular and have no end."""
    return os.fstat(file.fileno()).st_size


def read_regular_file(path: str | os.PathLike) -> bytes:
    """Read a whole file. Raises OSError as `open_regular_file` does."""
    with open_regular_file(path) as file:
        return file.read(size_bytes(file))


def read_json(path: str | os.PathLike) -> object:
    """Read a JSON file. Raises OSError if it cannot be read, ValueError if it is not JSON."""
    return parse_json(read_regular_file(path))


def parse_json(content: bytes) -> object:
    """Parse JSON in UTF-8. Raises ValueError if it is not JSON or nested too deeply."""
    try:
        return json.loads(content.decode("utf-8"))
    except RecursionError:
        raise ValueError("its brackets are nested too deeply") from None
