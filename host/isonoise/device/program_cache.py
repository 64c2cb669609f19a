"""Compiled programs between processes: the driver's binaries in files of ours.

A file is for one text, its options and one device with its driver; its content begins with its own hash. Whatever is
not as it should be (a folder that cannot be written, a file cut off or from elsewhere) counts as not there: the cache
saves time and is never a reason to fail.
"""

import contextlib
import hashlib
import os
import secrets
import sys
from collections.abc import Iterable
from pathlib import Path

FOLDER_VARIABLE = "ISONOISE_PROGRAM_CACHE"
"""Environment variable with the folder in place of the usual one, or `off`."""
SIZE_LIMIT = 256 * 2**20
"""Bytes of all files together; a program has 50 to 500 thousand. What was not used for longest goes first."""

_MAGIC = b"isonoise program 1\n"
_HASH_SIZE = hashlib.sha256().digest_size


def cache_folder() -> Path | None:
    """Where the files are, whether or not it is there already; None if programs shall not be kept."""
    chosen = os.environ.get(FOLDER_VARIABLE)
    if chosen:
        return None if chosen.lower() == "off" else Path(chosen)
    try:
        return _caches_of_user() / "isonoise" / "programs"
    except RuntimeError:  # there is no home
        return None


def _caches_of_user() -> Path:
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")


def program_key(source: str, options: Iterable[str], driver: Iterable[str]) -> str:
    """Name of a program's file. `driver`: whatever tells apart devices and versions of their drivers."""
    parts = [source, *options, "", *driver]  # no option and no fact is empty
    digest = hashlib.sha256()
    for part in parts:
        text = part.encode()
        digest.update(len(text).to_bytes(8, "little") + text)
    return digest.hexdigest()


def load(key: str) -> bytes | None:
    """The program's binary, if it is there and whole."""
    folder = cache_folder()
    if folder is None:
        return None
    try:
        content = (folder / key).read_bytes()
    except OSError:
        return None
    head, binary = content[: len(_MAGIC) + _HASH_SIZE], content[len(_MAGIC) + _HASH_SIZE :]
    if head != _MAGIC + hashlib.sha256(binary).digest():
        return None
    with contextlib.suppress(OSError):
        os.utime(folder / key)  # it was used now
    return binary


def store(key: str, binary: bytes) -> None:
    """Keeps the program's binary, in place of an older one; processes may do so at the same time."""
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
        _remove_oldest(folder)
    except OSError:
        return


def forget(key: str) -> None:
    """Removes the file, if it is there."""
    folder = cache_folder()
    if folder is not None:
        with contextlib.suppress(OSError):
            (folder / key).unlink()


def _remove_oldest(folder: Path) -> None:
    """Removes the files that were not used for longest, until the rest is within the limit."""
    files = []
    for entry in os.scandir(folder):
        with contextlib.suppress(FileNotFoundError):  # another process removes as well
            state = entry.stat()
            files.append((state.st_mtime, state.st_size, entry.path))
    size = sum(size for _, size, _ in files)
    for _, its_size, path in sorted(files):
        if size <= SIZE_LIMIT:
            break
        with contextlib.suppress(FileNotFoundError):
            os.unlink(path)
        size -= its_size
