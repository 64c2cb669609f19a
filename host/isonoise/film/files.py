"""Atomic output files: written under a temporary name in the same folder, then renamed."""

import os
import re
import secrets
from collections.abc import Callable
from pathlib import Path

from isonoise.errors import UserError


def check_writable(path: str | os.PathLike) -> Path:
    """Check, before any work is done, that a file can be written at `path`.

    Creates a file in the same folder and removes it: permission bits do not show a read-only or full file system.

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
        probe = _temporary_path(target)
        probe.touch(exist_ok=False)
        probe.unlink()
    except (OSError, ValueError, RuntimeError) as error:  # ValueError: null byte; RuntimeError: cyclic links
        raise UserError(f"cannot write '{path}': {_reason(error)}") from error
    return target


def write_atomically(path: str | os.PathLike, write: Callable[[Path], None]) -> None:
    """Call `write(temporary)`, which creates the file `temporary`, then rename it to `path`.

    It is flushed to the disk before it is renamed. If `write` fails or is interrupted, the temporary file is removed
    and an existing file at `path` stays.

    Raises
    ------
    UserError
        If the file cannot be written.
    """
    target = Path(path).resolve()
    temporary = _temporary_path(target)
    try:
        write(temporary)
        _flush_to_disk(temporary)
        os.replace(temporary, target)
    except OSError as error:
        raise UserError(f"cannot write '{path}': {_reason(error)}") from error
    finally:
        temporary.unlink(missing_ok=True)


def remove_temporary_files(folder: Path) -> None:
    """Remove temporary files of killed processes below `folder`."""
    for path in folder.rglob(".*.tmp*"):
        if re.fullmatch(r"\.[0-9a-f]{12}\.tmp(\.\w+)?", path.name):
            path.unlink(missing_ok=True)


def _temporary_path(target: Path) -> Path:
    return target.with_name(f".{secrets.token_hex(6)}.tmp{target.suffix}")


def _flush_to_disk(path: Path) -> None:
    with open(path, "rb+") as file:
        os.fsync(file.fileno())


def _reason(error: Exception) -> str:
    return getattr(error, "strerror", None) or str(error)
