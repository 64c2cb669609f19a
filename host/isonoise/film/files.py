"""Output files appear whole or not at all: they are written beside their final name and then moved there."""

import os
import re
import secrets
from collections.abc import Callable
from pathlib import Path

from isonoise.errors import UserError


def check_writable(path: str | os.PathLike) -> Path:
    """Find out, before any work is done, whether a file can be put at `path`.

    A file is made beside it and removed again: permission bits do not tell about read-only or full file systems.

    Returns:
        the path, with symbolic links followed, so that a link's target is written and the link stays.

    Raises:
        UserError: the folder is missing or cannot be written, or something that is not a writable file is in the way.
    """
    path = Path(path)
    try:
        target = path.resolve()
        if target.is_dir():
            raise UserError(f"cannot write '{path}': it is a folder; name a file in it")
        if target.exists() and not target.is_file():
            raise UserError(f"cannot write '{path}': it is not a regular file")
        if not target.parent.is_dir():
            raise UserError(f"cannot write '{path}': there is no folder '{path.parent}'; create it first")
        if target.exists() and not os.access(target, os.W_OK):
            raise UserError(f"cannot write '{path}': the file there is write-protected")
        probe = _temporary_beside(target)
        probe.touch(exist_ok=False)
        probe.unlink()
    except (OSError, ValueError, RuntimeError) as error:  # ValueError: a null byte; RuntimeError: a loop of links
        raise UserError(f"cannot write '{path}': {_reason(error)}") from error
    return target


def write_atomically(path: str | os.PathLike, write: Callable[[Path], None]) -> None:
    """Call `write(temporary)`, which makes a file at `temporary`, then move that file to `path`.

    The temporary file lies in the same folder, so the move is one atomic step; it is on the disk before it gets its
    name. Whatever ends `write` early, an interrupt included, leaves no temporary file and an older file as it was.

    Raises:
        UserError: the file cannot be written.
    """
    target = Path(path).resolve()
    temporary = _temporary_beside(target)
    try:
        write(temporary)
        _flush_to_disk(temporary)
        os.replace(temporary, target)
    except OSError as error:
        raise UserError(f"cannot write '{path}': {_reason(error)}") from error
    finally:
        temporary.unlink(missing_ok=True)


def remove_temporary_files(folder: Path) -> None:
    """Remove what `write_atomically` could not, below `folder`, when its process was killed."""
    for path in folder.rglob(".*.tmp*"):
        if re.fullmatch(r"\.[0-9a-f]{12}\.tmp(\.\w+)?", path.name):
            path.unlink(missing_ok=True)


def _temporary_beside(target: Path) -> Path:
    return target.with_name(f".{secrets.token_hex(6)}.tmp{target.suffix}")


def _flush_to_disk(path: Path) -> None:
    with open(path, "rb+") as file:
        os.fsync(file.fileno())


def _reason(error: Exception) -> str:
    return getattr(error, "strerror", None) or str(error)
