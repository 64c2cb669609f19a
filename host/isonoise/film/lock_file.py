"""Lock files that name their process, for files and folders that one process at a time may write.

`files.PathLock` and `comparison.folder_lock` use them. A lock file is locked with flock, which the kernel releases when
the process ends. Where flock does not work, as on some network file systems, the existing file is the lock: it counts
until its process has ended.
"""

import contextlib
import json
import os
import platform
import tempfile
import time
from pathlib import Path

from isonoise.errors import UserError
from isonoise.input_files import read_json

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None

_FLAGS = os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0)


class LockFile:
    """Holds the lock `path` until `release`, or until the process ends.

    Parameters
    ----------
    path : Path
        The lock file. It is created, and removed by `release`.
    before, after : str
        The message if another process holds the lock: `before`, the process, `after`.

    Raises
    ------
    UserError
        If another process holds the lock.
    OSError
        If the file cannot be created or written.
    """

    def __init__(self, path: Path, before: str, after: str):
        self._path, self._before, self._after = path, before, after
        self._with_flock = _flock_works(path.parent)
        self._descriptor: int | None = self._open_with_flock() if self._with_flock else self._create()
        try:
            os.ftruncate(self._descriptor, 0)
            os.write(self._descriptor, json.dumps(_this_process()).encode())
        except OSError:
            self.release()
            raise

    def is_intact(self) -> bool:
        """Whether the file is still there and has not been replaced."""
        return is_same_file(self._path, self._descriptor)

    def release(self) -> None:
        if self._descriptor is None:
            return
        is_own = self.is_intact()
        if not self._with_flock:
            os.close(self._descriptor)  # Windows removes no open file
        with contextlib.suppress(OSError):
            if is_own:
                self._path.unlink()
        if self._with_flock:
            os.close(self._descriptor)  # ends the lock
        self._descriptor = None

    def _open_with_flock(self) -> int:
        while True:
            descriptor = os.open(self._path, _FLAGS, 0o666)
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                os.close(descriptor)
                raise UserError(self._in_use()) from None
            if is_same_file(self._path, descriptor):
                return descriptor
            os.close(descriptor)  # its process removed it after it was opened here

    def _create(self) -> int:
        for _ in range(2):
            try:
                return os.open(self._path, _FLAGS | os.O_EXCL, 0o666)
            except FileExistsError:
                if not _has_ended(_read_process(self._path)):
                    break
                self._path.unlink(missing_ok=True)
        raise UserError(f"{self._in_use()}. If that process has ended, delete '{self._path}'")

    def _in_use(self) -> str:
        process = _read_process(self._path)
        name = "process {pid} on {host}, which began at {time}".format(**process) if process else "another process"
        return f"{self._before} {name}{self._after}"


def is_same_file(path: Path, descriptor: int) -> bool:
    """Whether the open file is the one at `path`."""
    try:
        return os.path.samestat(os.stat(path), os.fstat(descriptor))
    except OSError:
        return False


def _flock_works(folder: Path) -> bool:
    if fcntl is None:
        return False
    with tempfile.TemporaryFile(dir=folder) as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            return False
    return True


def _this_process() -> dict:
    return {
        "pid": os.getpid(),
        "host": platform.node(),
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
    if process is None or process["host"] != platform.node() or os.name == "nt":  # its os.kill ends processes
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
