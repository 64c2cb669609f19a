"""Opens and reads scene files: regular files only, because pipes and devices may have no end."""

from pathlib import Path
from typing import BinaryIO

from isonoise.errors import SceneError
from isonoise.scene.parse.elements import path_exists


def open_regular_file(path: Path) -> BinaryIO:
    """Open a file for reading. Raises OSError, or SceneError if it is a pipe or a device."""
    if path_exists(path) and not (path.is_file() or path.is_dir()):
        raise SceneError(f"{path}: is not a regular file")
    return path.open("rb")


def read_bytes(path: Path) -> bytes:
    """Read a whole file. Raises SceneError if it cannot be read."""
    try:
        with open_regular_file(path) as file:
            return file.read()
    except OSError as error:
        raise SceneError(f"{path}: cannot be read ({error.strerror})") from None
