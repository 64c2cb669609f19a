"""Another place for a file that cannot be written where it should be, so that nothing rendered is lost."""

import os
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple


class WrittenFile(NamedTuple):
    """What became of a file.

    Attributes
    ----------
    path : str or None
        Where it is; None if it could not be written anywhere.
    failure : Exception or None
        Why it is not at the path that was asked for.
    """

    path: str | None
    failure: Exception | None = None

    def message(self) -> str:
        """The failure, and where the file is instead."""
        return f"{str(self.failure) or type(self.failure).__name__}; {self.place()}"

    def place(self) -> str:
        """Where the file is, as a clause."""
        return f"it is in '{self.path}' instead" if self.path else "nor could it be written anywhere else"


def write_with_fallback(path: str | os.PathLike, write: Callable[[str | os.PathLike], None]) -> WrittenFile:
    """Call `write(path)`, and `write_elsewhere` if it raises an exception."""
    try:
        write(path)
        return WrittenFile(os.fspath(path))
    except Exception as error:
        return write_elsewhere(path, write, error)


def write_elsewhere(
    path: str | os.PathLike, write: Callable[[str | os.PathLike], None], failure: Exception
) -> WrittenFile:
    """Call `write` with other paths than `path` until it succeeds; `failure` is why.

    These are a new name in the same folder, the current folder, and a new folder among the system's temporary files.
    No existing file is replaced there.
    """
    for other in _other_paths(Path(path)):
        try:
            write(other)
            return WrittenFile(str(other), failure)
        except Exception:
            continue
    return WrittenFile(None, failure)


def _other_paths(path: Path) -> Iterator[Path]:
    for folder in dict.fromkeys((path.parent.absolute(), Path.cwd())):
        yield unused_path(folder / path.name, "rescued")
    try:
        folder = Path(tempfile.mkdtemp(prefix="isonoise-"))
    except OSError:
        return
    yield folder / path.name
    folder.rmdir()  # not used


def unused_path(path: Path, label: str) -> Path:
    """A path at which there is no file: `path` with `.LABEL`, and a number if needed, before its extension."""
    number, other = 1, path.with_name(f"{path.stem}.{label}{path.suffix}")
    while os.path.lexists(other):
        number += 1
        other = path.with_name(f"{path.stem}.{label}-{number}{path.suffix}")
    return other
