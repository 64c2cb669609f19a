"""The lock of a comparison's folder: one process at a time writes into it; called by `isonoise compare`."""

import contextlib
from collections.abc import Iterator
from pathlib import Path

from isonoise.errors import UserError
from isonoise.film.lock_file import LockFile

LOCK_FILE = ".lock"


class FolderLock:
    """The lock of a folder, held by this process; `lock_folder` makes it."""

    def __init__(self, directory: Path, file: LockFile):
        self.directory, self._file = directory, file

    def check(self) -> None:
        """Raise UserError if the folder was removed or replaced since it was locked."""
        if not self._file.is_intact():
            raise UserError(
                f"'{self.directory}' or its file {LOCK_FILE} was removed while isonoise was writing into it"
            )


@contextlib.contextmanager
def lock_folder(directory: Path) -> Iterator[FolderLock]:
    """Create the folder if it is missing, and lock it for the `with` block.

    A folder that was created and is empty at the end is removed.

    Raises
    ------
    UserError
        Another process has locked the folder, or no file can be written into it.
    """
    with contextlib.ExitStack() as stack:
        try:
            folder = directory.resolve()
            stack.callback(_remove_empty, [path for path in (folder, *folder.parents) if not path.exists()])
            folder.mkdir(parents=True, exist_ok=True)
            remedy = ": wait for it or end it, or choose another folder with -o"
            file = LockFile(folder / LOCK_FILE, f"'{directory}' is in use by", remedy)
            stack.callback(file.release)
        except (OSError, ValueError, RuntimeError) as error:  # ValueError: null byte; RuntimeError: cyclic links
            reason = getattr(error, "strerror", None) or error
            raise UserError(f"cannot write into '{directory}': {reason}") from error
        yield FolderLock(folder, file)


def _remove_empty(folders: list[Path]) -> None:
    """Remove the folders, the innermost first, until one is not empty."""
    with contextlib.suppress(OSError):
        for folder in folders:
            folder.rmdir()
