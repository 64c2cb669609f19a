"""Atomic output files: written under a temporary name in the same folder, then renamed. Locks against other processes.

A process locks its temporary files as long as it lives, so the next one removes those that a killed process has left.
"""

import contextlib
import os
import re
import secrets
import stat
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from isonoise.errors import UserError
from isonoise.film.lock_file import LockFile, is_same_file

try:
    import fcntl
except ImportError:  # Windows: nothing is locked, and temporary files of killed processes stay
    fcntl = None

_TEMPORARY_NAME = re.compile(r"\.[0-9a-f]{12}\.tmp(\.\w+)?")


def check_writable(path: str | os.PathLike) -> Path:
    """Check, before any work is done, that a file can be written at `path`.

    Creates a file in the same folder and removes it: permission bits do not show a read-only or full file system.
    Removes temporary files of killed processes from the folder.

    Returns
    -------
    Path
        The path with symbolic links resolved, so that a link's target is written and the link stays.

    Raises
    ------
    UserError
        If the folder is missing or read-only, or `path` exists and is not a writable file.
    """
    path = Path(path)
    try:
        target = path.resolve()
        if target.is_dir():
            raise UserError(f"cannot write '{path}': it is a folder; give a file name")
        if target.exists() and not target.is_file():
            raise UserError(f"cannot write '{path}': it is not a regular file")
        if not target.parent.is_dir():
            raise UserError(f"cannot write '{path}': there is no folder '{path.parent}'; create it first")
        if target.exists() and not os.access(target, os.W_OK):
            raise UserError(f"cannot write '{path}': the existing file is write-protected")
        _remove_abandoned(target.parent.glob(".*.tmp*"))
        with _temporary_file(target):
            pass
    except (OSError, ValueError, RuntimeError) as error:  # ValueError: null byte; RuntimeError: cyclic links
        raise UserError(f"cannot write '{path}': {_reason(error)}") from error
    return target


def check_no_input(outputs: Iterable[str | os.PathLike | None], inputs: Iterable[Path]) -> None:
    """Raise UserError if an output that is not None is a file of the scene, by any name."""
    identities = {identity for identity in map(_identity, inputs) if identity}
    for path in filter(None, outputs):
        if _identity(path) in identities:
            raise UserError(f"cannot write '{path}': the scene was read from this file; give another name")


def write_atomically(path: str | os.PathLike, write: Callable[[Path], None]) -> None:
    """Call `write(temporary)`, which fills the empty file `temporary`, then rename it to `path`.

    It is flushed to the disk before it is renamed. If `write` fails or is interrupted, the temporary file is removed
    and an existing file at `path` stays. Otherwise the new file takes the mode of the existing one, and its owner and
    group as far as the user may set them. Other names (hard links) of the existing file keep the old content.

    Raises
    ------
    UserError
        If the file cannot be written.
    """
    try:
        target = Path(path).resolve()
        with _temporary_file(target) as temporary:
            write(temporary)
            _copy_permissions(target, temporary)
            _flush_to_disk(temporary)
            os.replace(temporary, target)
            _flush_folder(target.parent)
    except OSError as error:
        raise UserError(f"cannot write '{path}': {_reason(error)}") from error


def remove_temporary_files(folder: Path) -> None:
    """Remove temporary files of killed processes below `folder`."""
    _remove_abandoned(folder.rglob(".*.tmp*"))


class PathLock(LockFile):
    """Reserves a file for this process, by a lock file `.NAME.lock` beside it, until `release` or the process ends.

    Raises
    ------
    UserError
        If another process has reserved the file; or the lock cannot be created.
    """

    def __init__(self, path: Path):
        lock = path.with_name(f".{path.name}.lock")
        try:
            super().__init__(lock, f"cannot write '{path}': it is being written by", "; give another name")
        except OSError as error:
            raise UserError(f"cannot write '{lock}': {_reason(error)}") from error


@contextmanager
def _temporary_file(target: Path) -> Iterator[Path]:
    """A new, locked file beside `target`. It is removed at the end unless it has been renamed."""
    mode = target.stat().st_mode & 0o666 | 0o600 if target.exists() else 0o666  # nobody else may read it meanwhile
    while True:
        temporary = target.with_name(f".{secrets.token_hex(6)}.tmp{target.suffix}")
        descriptor = os.open(temporary, os.O_RDWR | os.O_CREAT | os.O_EXCL, mode)
        if _lock(descriptor, wait=True) and is_same_file(temporary, descriptor):
            break
        os.close(descriptor)  # another process has taken it for an abandoned one before it was locked
    if fcntl is None:  # Windows renames no open file
        os.close(descriptor)
    try:
        yield temporary
    finally:
        temporary.unlink(missing_ok=True)
        if fcntl is not None:
            os.close(descriptor)


def _copy_permissions(source: Path, target: Path) -> None:
    """Give a file the mode of `source`, if that exists, and its owner and group as far as permitted."""
    try:
        wanted = source.stat()
    except FileNotFoundError:
        return
    if hasattr(os, "chown"):
        for owner, group in ((wanted.st_uid, -1), (-1, wanted.st_gid)):
            with contextlib.suppress(OSError):
                os.chown(target, owner, group)
    os.chmod(target, wanted.st_mode & 0o777)


def _flush_to_disk(path: Path) -> None:
    with open(path, "rb+") as file:
        os.fsync(file.fileno())


def _flush_folder(path: Path) -> None:
    """Let the new name survive a crash of the machine; not every system can do that."""
    with contextlib.suppress(OSError):
        descriptor = os.open(path, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def _remove_abandoned(paths: Iterable[Path]) -> None:
    """Remove those of the files that are this user's temporary files and that no process has locked."""
    for path in paths if fcntl else ():
        if not _TEMPORARY_NAME.fullmatch(path.name):
            continue
        with contextlib.suppress(OSError):
            status = path.lstat()
            if not stat.S_ISREG(status.st_mode) or status.st_uid != os.geteuid():
                continue
            descriptor = os.open(path, os.O_RDWR | os.O_NOFOLLOW)
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                path.unlink()
            finally:
                os.close(descriptor)


def _lock(descriptor: int, wait: bool = False) -> bool:
    """Lock an open file; False if another process has locked it and this one shall not wait."""
    if fcntl is not None:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        except BlockingIOError:
            return False
        except OSError:  # a file system without locks
            pass
    return True


def _identity(path: str | os.PathLike) -> tuple[int, int] | None:
    """Device and inode of a file, which all its names share; None if there is none."""
    with contextlib.suppress(OSError):
        status = os.stat(path)
        return status.st_dev, status.st_ino
    return None


def _reason(error: Exception) -> str:
    return getattr(error, "strerror", None) or str(error)
