"""Opens and reads the files of a scene, records which they are, and checks that they are below the scene's folder."""

import io
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import BinaryIO

from isonoise import input_files
from isonoise.errors import SceneError

_MIN_DECOMPRESSED_BYTES, _MAX_COMPRESSION_RATIO = 1 << 20, 100
_recorded: ContextVar[dict[Path, None] | None] = ContextVar("recorded", default=None)


@contextmanager
def record_files() -> Iterator[dict[Path, None]]:
    """Collect the files that `load` and `compile_scene` read inside the `with` block.

    Yields a dict whose keys are their resolved paths, each once, in the order of reading. Threads that the block starts
    are recorded only if they run in a copy of its context.
    """
    files: dict[Path, None] = {}
    token = _recorded.set(files)
    try:
        yield files
    finally:
        _recorded.reset(token)


def note_files(paths: Iterable[Path]) -> None:
    """Record files that have been read before, for a scene that is used again."""
    files = _recorded.get()
    if files is not None:
        files.update(dict.fromkeys(paths))


def open_regular_file(path: Path) -> BinaryIO:
    """Open a file for reading and record it. Raises OSError, also if it is a pipe or a device."""
    file = input_files.open_regular_file(path)
    files = _recorded.get()
    if files is not None:
        files[Path(path).resolve()] = None
    return file


def read_bytes(path: Path) -> bytes:
    """Read a whole file. Raises SceneError if it cannot be read."""
    try:
        with open_regular_file(path) as file:
            return file.read(input_files.size_bytes(file))
    except OSError as error:
        raise SceneError(f"{path}: cannot be read ({error.strerror})") from None


def read_decompressed(path: Path) -> bytes:
    """Read a whole file, decompressed if its name ends in .gz. Raises SceneError if it cannot be read or is damaged."""
    data = read_bytes(path)
    if path.suffix.lower() != ".gz":
        return data
    import gzip
    import zlib

    limit = _MIN_DECOMPRESSED_BYTES + _MAX_COMPRESSION_RATIO * len(data)
    try:
        decompressed = gzip.GzipFile(fileobj=io.BytesIO(data)).read(limit + 1)
    except (OSError, EOFError, zlib.error) as error:
        raise SceneError(f"{path}: its compressed data is damaged ({error})") from None
    if len(decompressed) > limit:
        raise SceneError(f"{path}: it is more than {_MAX_COMPRESSION_RATIO} times as large when decompressed")
    return decompressed


def scene_folder(path: Path, allow_outside: bool) -> Path | None:
    """The folder below which the files of a scene have to be, resolved; None: they may be anywhere."""
    return None if allow_outside else path.parent.resolve()


def is_inside(path: Path, folder: Path | None) -> bool:
    """Whether a file, with symbolic links resolved, is in the folder or below it, or may be anywhere."""
    return folder is None or path.resolve().is_relative_to(folder)


def outside_message(path: Path, folder: Path) -> str:
    """The error for a file that is not in the scene's folder."""
    return (
        f"'{path}' is outside the scene's folder '{folder}'; move it there, or allow it with --allow-outside "
        "(in Python: allow_outside=True)"
    )
