"""Lock of a comparison's folder: one process at a time writes into it; called by `isonoise compare`.

The file `.lock` holds the process's id, host and start. It is locked with flock, which the kernel releases when the
process ends. Where flock does not work, as on some network file systems, the file itself is the lock: it counts until
its process has ended.
"""

import contextlib
import json
import os
import socket
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from isonoise.errors import UserError
from isonoise.input_files import read_json

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None

LOCK_FILE = ".lock"
_FLAGS = os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0)


class FolderLock:
    """The lock of a folder, held by this process; `lock_folder` makes it."""

    def __init__(self, directory: Path, descriptor: int):
        self.directory = directory
        self._descriptor = descriptor

    def check(self) -> None:
        """Raise UserError if the folder was removed or replaced since it was locked."""
        if not _is_same_file(self._descriptor, self.directory / LOCK_FILE):
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
            path = directory.resolve() / LOCK_FILE
            stack.callback(_remove_empty, [folder for folder in path.parents if not folder.exists()])
            path.parent.mkdir(parents=True, exist_ok=True)
            with_flock = _flock_works(path.parent)
            descriptor = _open_with_flock(path) if with_flock else _create(path)
            stack.callback(_release, path, descriptor, with_flock)
            os.ftruncate(descriptor, 0)
            os.write(descriptor, json.dumps(_this_process()).encode())
        except (OSError, ValueError, RuntimeError) as error:  # ValueError: null byte; RuntimeError: cyclic links
            reason = getattr(error, "strerror", None) or error
            raise UserError(f"cannot write into '{directory}': {reason}") from error
        yield FolderLock(path.parent, descriptor)


def _flock_works(folder: Path) -> bool:
    if fcntl is None:
        return False
    with tempfile.TemporaryFile(dir=folder) as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            return False
    return True


def _open_with_flock(path: Path) -> int:
    """Descriptor of the file, locked. Raises UserError if another process has locked it."""
    while True:
        descriptor = os.open(path, _FLAGS)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(descriptor)
            raise UserError(_in_use(path)) from None
        if _is_same_file(descriptor, path):
            return descriptor
        os.close(descriptor)  # its process removed it after it was opened here


def _create(path: Path) -> int:
    """Descriptor of the file, which must not exist yet or be of a process that has ended; else raises UserError."""
    for _ in range(2):
        try:
            return os.open(path, _FLAGS | os.O_EXCL)
        except FileExistsError:
            if not _has_ended(_read_process(path)):
                break
            path.unlink(missing_ok=True)
    raise UserError(f"{_in_use(path)}. If that process has ended, delete '{path}'")


def _release(path: Path, descriptor: int, with_flock: bool) -> None:
    is_own = _is_same_file(descriptor, path)
    if not with_flock:
        os.close(descriptor)  # Windows removes no open file
    with contextlib.suppress(OSError):
        if is_own:
            path.unlink()
    if with_flock:
        os.close(descriptor)  # ends the lock


def _is_same_file(descriptor: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(descriptor), os.stat(path))
    except OSError:
        return False


def _remove_empty(folders: list[Path]) -> None:
    """Remove the folders, the innermost first, until one is not empty."""
    with contextlib.suppress(OSError):
        for folder in folders:
            folder.rmdir()


def _in_use(path: Path) -> str:
    process = _read_process(path)
    name = "process {pid} on {host}, which began at {time}".format(**process) if process else "another process"
    return f"'{path.parent}' is in use by {name}: wait for it or end it, or choose another folder with -o"


def _this_process() -> dict:
    return {
        "pid": os.getpid(),
        "host": socket.gethostname(),
        "time": time.strftime("%Y-%m-%d %H:%M:%S"),
        "start_ticks": _start_ticks(os.getpid()),
    }


def _read_process(path: Path) -> dict | None:
    """What `_this_process` returned to the process that wrote the file; None if the file is damaged."""
    try:
        process = read_json(path)
        is_complete = process.keys() == _this_process().keys() and 0 < process["pid"] < 2**31
        return process if is_complete else None
    except (OSError, ValueError, TypeError, AttributeError):
        return None


def _has_ended(process: dict | None) -> bool:
    """False if it is unknown: for a process on another host, or an unreadable file."""
    if process is None or process["host"] != socket.gethostname() or os.name == "nt":  # its os.kill ends processes
        return False
    try:
        os.kill(process["pid"], 0)
    except ProcessLookupError:
        return True
    except OSError:  # it is another user's
        pass
    return process["start_ticks"] != _start_ticks(process["pid"])  # another process may have got its id


def _start_ticks(pid: int) -> str | None:
    """When the process began, in clock ticks since the machine started; None without Linux's /proc."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[19]
    except OSError:
        return None
