"""Cache of compiled programs on disk. Used by `device.opencl`, `device.pocl_cache` and `device.tuned`.

A file belongs to one source, its options and one device with its driver; it begins with a hash of its content. Invalid
files count as missing, with a warning; other errors are ignored. The cache saves time and never makes a render fail.
"""

import contextlib
import functools
import hashlib
import os
import secrets
import shutil
import stat
import sys
import tempfile
import time
import warnings
from collections.abc import Iterable
from pathlib import Path

from isonoise.input_files import read_regular_file

FOLDER_VARIABLE = "ISONOISE_PROGRAM_CACHE"
"""Environment variable with another folder, or `off`."""
MAX_SIZE_BYTES = 256 * 2**20
"""Of all files together; a program has 50 to 500 kB. The least recently used files are removed first."""

MAX_WRITE_S = 3600
"""A temporary file that is older belongs to no process."""

_MAGIC = b"isonoise program 1\n"
_HASH_SIZE = hashlib.sha256().digest_size


def cache_folder() -> Path | None:
    """Folder of the files, which may not exist yet; None if the cache is off."""
    chosen = os.environ.get(FOLDER_VARIABLE)
    if chosen:
        return None if chosen.lower() == "off" else Path(chosen)
    try:
        folder = _user_cache_folder() / "isonoise" / "programs"
    except RuntimeError:  # no home folder
        folder = None
    return _writable_folder(folder)


@functools.cache
def _writable_folder(folder: Path | None) -> Path | None:
    """The folder if files can be written there, else one for temporary files; None if there is none either."""
    if folder is not None:
        # os.path, because methods of Path raise an error below a folder that is not readable
        existing = next(path for path in (folder, *folder.parents) if os.path.exists(path))
        if os.path.isdir(existing) and os.access(existing, os.W_OK | os.X_OK):
            return folder
    if not hasattr(os, "getuid"):
        return folder
    try:
        temporary = Path(tempfile.gettempdir()) / f"isonoise-programs-{os.getuid()}"
        temporary.mkdir(mode=0o700, exist_ok=True)
        status = temporary.lstat()
    except OSError:
        return None
    is_own = stat.S_ISDIR(status.st_mode) and status.st_uid == os.getuid()  # else another user's code might be loaded
    return temporary if is_own and os.access(temporary, os.R_OK | os.W_OK | os.X_OK) else None


def _user_cache_folder() -> Path:
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")


def program_key(source: str, options: Iterable[str], driver: Iterable[str]) -> str:
    """Name of a program's file. `driver` identifies the device and the version of its driver."""
    parts = [source, *options, "", *driver]  # "" separates the two: no part is empty
    digest = hashlib.sha256()
    for part in parts:
        text = part.encode()
        digest.update(len(text).to_bytes(8, "little") + text)
    return digest.hexdigest()


def load(key: str) -> bytes | None:
    """The program's binary; None if there is none, or with a warning if it is damaged."""
    folder = cache_folder()
    if folder is None:
        return None
    try:
        content = read_regular_file(folder / key)
    except (FileNotFoundError, NotADirectoryError):
        return None
    except PermissionError as error:
        _warn_of_folder(folder, error.strerror)
        return None
    except OSError as error:
        _remove_damaged(folder / key, error.strerror or str(error))
        return None
    header, binary = content[: len(_MAGIC) + _HASH_SIZE], content[len(_MAGIC) + _HASH_SIZE :]
    if header != _MAGIC + hashlib.sha256(binary).digest():
        _remove_damaged(folder / key, "wrong checksum")
        return None
    with contextlib.suppress(OSError):
        os.utime(folder / key)  # last use
    return binary


def has(key: str) -> bool:
    """Whether the program's file exists; it may be damaged."""
    folder = cache_folder()
    return folder is not None and os.path.isfile(folder / key)


@functools.cache  # once per process
def _warn_of_folder(folder: Path, reason: str) -> None:
    text = f"the program cache {folder} cannot be read ({reason}); programs are compiled at each start"
    warnings.warn(text, stacklevel=3)


def _remove_damaged(path: Path, reason: str) -> None:
    warnings.warn(f"{path} is damaged ({reason}); what it held is compiled or measured again", stacklevel=3)
    with contextlib.suppress(OSError):
        if path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink()


def store(key: str, binary: bytes) -> None:
    """Write the program's binary atomically; several processes may do so at the same time."""
    folder = cache_folder()
    if folder is None:
        return
    temporary = folder / f"{secrets.token_hex(8)}.tmp"
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        try:
            temporary.write_bytes(_MAGIC + hashlib.sha256(binary).digest() + binary)
            os.replace(temporary, folder / key)
        finally:
            temporary.unlink(missing_ok=True)
        _remove_least_recently_used(folder)
    except OSError:
        return


def remove(key: str) -> None:
    """Remove the file if it exists."""
    folder = cache_folder()
    if folder is not None:
        with contextlib.suppress(OSError):
            (folder / key).unlink()


def _remove_least_recently_used(folder: Path) -> None:
    """Remove files until the rest is within the limit, and temporary files of processes that were killed."""
    files = []
    for entry in os.scandir(folder):
        with contextlib.suppress(FileNotFoundError):  # removed by another process
            status = entry.stat()
            if entry.name.endswith(".tmp") and status.st_mtime < time.time() - MAX_WRITE_S:
                os.unlink(entry.path)
                continue
            files.append((status.st_mtime, status.st_size, entry.path))
    total = sum(size for _, size, _ in files)
    for _, size, path in sorted(files):
        if total <= MAX_SIZE_BYTES:
            break
        with contextlib.suppress(FileNotFoundError):
            os.unlink(path)
        total -= size
