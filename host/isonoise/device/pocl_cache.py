"""Gives PoCL a cache folder of its own in each process, filled from the program cache. Called by `drivers`, `opencl`.

PoCL loads what lies in its cache folder without a check. A damaged file there ends the process by a signal, at every
start anew, or gives a wrong image. So PoCL works in a new folder that only this process writes. Its compiled kernels
are kept in the program cache, whose files have hashes: what is damaged there is compiled again.
"""

import atexit
import contextlib
import functools
import json
import mmap
import os
import shutil
import sys
import tempfile
import threading
import warnings
from collections.abc import Iterator
from pathlib import Path

from isonoise.device import program_cache
from isonoise.input_files import parse_json

try:
    import fcntl
except ImportError:  # Windows: PoCL works in its own folder
    fcntl = None

FOLDER_VARIABLE = "POCL_CACHE_DIR"
"""PoCL's environment variable with its cache folder; the folders of processes are made in it if it is set."""
SPACE_BYTES = 16 * 2**20
"""Space that must be free: a scene's kernels have some 1 MiB, and PoCL ends the process where it cannot write them."""
SPACE_TO_STORE_BYTES = 2**20
"""With less, what PoCL has written may be incomplete, and is not stored."""

_PROGRAM_FILE = "program.bc"
_UNUSABLE = os.path.join(os.devnull, "no-cache")
"""A folder that cannot exist, with which PoCL offers no device."""


@functools.cache
def pocl_folder() -> "PoclFolder | None":
    """The folder of this process; None if PoCL uses its own: with the program cache off, and on Windows."""
    if fcntl is None or (program_cache.cache_folder() is None and _is_own_folder_usable()):
        return None
    return PoclFolder()


def _is_own_folder_usable() -> bool:
    """Whether PoCL can use its own folder, without which it offers no device."""
    try:
        home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
        folder = Path(os.environ.get(FOLDER_VARIABLE) or Path(home) / "pocl")
        folder.mkdir(parents=True, exist_ok=True)
        _check_usable(folder)
    except (OSError, RuntimeError):  # RuntimeError: no home folder
        return False
    return True


def pocl_kernels(key: str) -> contextlib.AbstractContextManager:
    """A context in which PoCL builds the program that has this key in the program cache."""
    folder = pocl_folder()
    return contextlib.nullcontext() if folder is None else folder.program(key)


def store_pocl_kernels() -> None:
    """Write what PoCL has compiled so far to the program cache, which happens at exit otherwise."""
    if folder := pocl_folder():
        with contextlib.suppress(OSError):
            folder.store()


def full_disk() -> str | None:
    """Which disk is full, if PoCL has no space any more."""
    folder = pocl_folder()
    if folder is None or folder.path is None or _free_bytes(folder.path) >= SPACE_TO_STORE_BYTES:
        return None
    return f"the disk of {folder.path} is full; free {SPACE_BYTES >> 20} MiB or set {FOLDER_VARIABLE} to another folder"


@contextlib.contextmanager
def pocl_environment() -> Iterator[None]:
    """While PoCL starts: its environment variable names the folder of this process. Processes that this one starts
    do not inherit it."""
    folder = pocl_folder()
    if folder is None:
        yield
        return
    before = os.environ.get(FOLDER_VARIABLE)
    os.environ[FOLDER_VARIABLE] = _UNUSABLE if folder.path is None else str(folder.path)
    try:
        yield
    finally:
        if before is None:
            del os.environ[FOLDER_VARIABLE]
        else:
            os.environ[FOLDER_VARIABLE] = before


class PoclFolder:
    """The cache folder that PoCL has in this process; at exit its kernels are stored and it is deleted.

    Attributes
    ----------
    path : Path or None
        None if no folder can be used.
    problem : str or None
        Why no folder can be used, and what to do.
    """

    def __init__(self):
        self.path: Path | None = None
        self.problem: str | None = None
        self._lock_file: int | None = None
        self._process = os.getpid()
        self._build_lock = threading.Lock()
        self._programs: dict[str, set[str]] = {}  # key in the program cache -> the program's folders
        self._stored: dict[str, set[str]] = {}  # key -> its files that the program cache has
        self._open()

    def _open(self) -> None:
        """Make the folder where that is possible, and delete those of processes that were killed."""
        chosen = os.environ.get(FOLDER_VARIABLE)
        failures = []
        for parent in _parents(chosen):
            _remove_abandoned(parent)
            try:
                self.path, self._lock_file = _make_folder(parent)
            except OSError as error:
                failures.append(f"{parent}: {error.strerror or error}")
                continue
            break
        tried = "; ".join(failures)
        if self.path is None:
            self.problem = (
                f"PoCL has no folder in which it can keep compiled kernels ({tried}); set {FOLDER_VARIABLE} to a "
                f"folder with {SPACE_BYTES >> 20} MiB of free space"
            )
            return
        if chosen and failures:
            warnings.warn(f"PoCL works in {self.path.parent}: {FOLDER_VARIABLE} cannot be used ({tried})", stacklevel=2)
        atexit.register(self.close)

    @contextlib.contextmanager
    def program(self, key: str) -> Iterator[None]:
        """While a program is built: its kernels come from the program cache, and new ones are noted for it."""
        if self.path is None:
            yield
            return
        with self._build_lock:
            # another context may have loaded the program's files already, and must not see them change
            restored = self._programs.get(key) or self._restore(key)
            before = self._program_folders()
            yield
            new = self._program_folders() - before
            if new:  # what was restored, if anything, is of another version of PoCL
                self._stored.pop(key, None)
            self._programs[key] = new or restored

    def _program_folders(self) -> set[str]:
        """Folders of programs. PoCL names them by a hash, in two levels, with or without a folder around them."""
        return {os.path.dirname(path) for path in _files_below(self.path, 4) if path.endswith(_PROGRAM_FILE)}

    def _restore(self, key: str) -> set[str]:
        """Copy the program's files from the program cache; return its folders."""
        files = _unpack(program_cache.load(key))
        paths = {name: os.path.join(self.path, name) for name in files}
        folders = {os.path.dirname(path) for path in paths.values() if path.endswith(_PROGRAM_FILE)}
        try:
            for folder in {os.path.dirname(path) for path in paths.values()}:
                os.makedirs(folder, exist_ok=True)
            for name, content in files.items():
                with open(paths[name], "wb") as file:
                    file.write(content)
        except OSError:  # the disk is full: PoCL must not find a part of them
            for folder in folders:
                shutil.rmtree(folder, ignore_errors=True)
            return set()
        self._stored[key] = set(files)
        return folders

    def store(self) -> None:
        """Write the kernels that the program cache does not have yet to it."""
        if self.path is None or _free_bytes(self.path) < SPACE_TO_STORE_BYTES:
            return
        for key, folders in self._programs.items():
            paths = sorted(path for folder in folders for path in _files_below(folder))
            names = [os.path.relpath(path, self.path) for path in paths]
            if names and set(names) != self._stored.get(key):
                files = {name: Path(path).read_bytes() for name, path in zip(names, paths, strict=True)}
                program_cache.store(key, _pack(files))
                self._stored[key] = set(files)

    def close(self) -> None:
        """Store the kernels and delete the folder, unless this is a fork of the process that it belongs to."""
        if self.path is None or os.getpid() != self._process:
            return
        try:
            with contextlib.suppress(OSError, KeyboardInterrupt):
                self.store()
        finally:
            shutil.rmtree(self.path, ignore_errors=True)
            os.close(self._lock_file)
            self.path = None


def _files_below(folder: str | Path, levels: int = 9) -> Iterator[str]:
    """Paths of the files in a folder and in its folders, `levels` deep."""
    for entry in os.scandir(folder):
        if not entry.is_dir(follow_symlinks=False):
            yield entry.path
        elif levels > 1:
            yield from _files_below(entry.path, levels - 1)


def _pack(files: dict[str, bytes]) -> bytes:
    """Files in one text of bytes: their names and sizes as JSON in the first line, then their contents."""
    header = json.dumps([[name, len(content)] for name, content in files.items()])
    return b"".join([header.encode(), b"\n", *files.values()])


def _unpack(packed: bytes | None) -> dict[str, bytes]:
    """The files of `_pack`; none for None and for what `_pack` did not write."""
    header, _, contents = (packed or b"").partition(b"\n")
    files, begin = {}, 0
    try:
        for name, size in parse_json(header):
            files[name] = contents[begin : begin + size]
            begin += size
    except (ValueError, TypeError):
        return {}
    return files


def _parents(chosen: str | None) -> list[Path]:
    """Where the folder may be made, the best first: on a local disk rather than in a home folder on a server."""
    parents = [Path(chosen).absolute()] if chosen else []
    with contextlib.suppress(OSError):  # there is none that can be written
        parents.append(Path(tempfile.gettempdir()))
    if cache := program_cache.cache_folder():
        parents.append(cache.parent)
    return [*parents, Path("/dev/shm")]


def _prefix() -> str:
    return f"isonoise-pocl-{os.getuid()}-"


def _make_folder(parent: Path) -> tuple[Path, int]:
    """A new folder, and its open file with the lock. Raises OSError if it cannot be used."""
    parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    file = None
    while file is None:
        path = Path(tempfile.mkdtemp(prefix=_prefix(), dir=parent))
        file = _lock(path)
    try:
        _check_usable(path)
    except OSError:
        shutil.rmtree(path, ignore_errors=True)
        os.close(file)
        raise
    return path, file


def _lock(path: Path) -> int | None:
    """Lock a new folder; None if another process took it for abandoned and deletes it."""
    try:
        file = os.open(path, os.O_RDONLY)
    except FileNotFoundError:
        return None
    is_deleted = False
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        is_deleted = True
    except OSError:  # a file system without locks, where folders of killed processes stay
        pass
    if is_deleted or not path.is_dir():
        os.close(file)
        return None
    return file


def _check_usable(path: Path) -> None:
    """Raise OSError unless the folder has space and its files may be executed."""
    if _free_bytes(path) < SPACE_BYTES:
        raise OSError(f"less than {SPACE_BYTES >> 20} MiB of free space")
    if sys.platform != "linux":  # other systems have other rules for what may be executed
        return
    with tempfile.TemporaryFile(dir=path) as file:
        file.truncate(mmap.PAGESIZE)
        try:
            mmap.mmap(
                file.fileno(), mmap.PAGESIZE, flags=mmap.MAP_PRIVATE, prot=mmap.PROT_READ | mmap.PROT_EXEC
            ).close()
        except OSError as error:
            raise OSError("files there cannot be executed") from error


def _free_bytes(path: Path) -> int:
    status = os.statvfs(path)
    return status.f_bavail * status.f_frsize


def _remove_abandoned(parent: Path) -> None:
    """Delete the folders of processes that ended without doing so: their locks are free."""
    try:
        folders = [entry.path for entry in os.scandir(parent) if entry.name.startswith(_prefix())]
    except OSError:
        return
    for folder in folders:
        with contextlib.suppress(OSError):
            file = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
            try:
                if os.fstat(file).st_uid == os.getuid():
                    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    shutil.rmtree(folder, ignore_errors=True)
            finally:
                os.close(file)
