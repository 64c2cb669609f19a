"""Reading files: regular ones only, whole."""

from pathlib import Path
from typing import BinaryIO

from isonoise.errors import SceneError
from isonoise.scene.parse.elements import path_exists


def open_regular_file(path: Path) -> BinaryIO:
    """The file, open for reading. Raises OSError, or SceneError where it is a pipe or device, which may have no end."""
    if path_exists(path) and not (path.is_file() or path.is_dir()):
        raise SceneError(f"{path}: is not a regular file")
    return path.open("rb")


def read_bytes(path: Path) -> bytes:
    """A whole file."""
    try:
        with open_regular_file(path) as file:
            return file.read()
    except OSError as error:
        raise SceneError(f"{path}: cannot be read ({error.strerror})") from None
