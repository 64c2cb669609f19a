"""When, where and from which sources a measurement was made: part of the header of every report."""

import contextlib
import os
import platform
import subprocess
from datetime import datetime, timezone
from pathlib import Path

import isonoise


def origin_fields() -> dict[str, object]:
    """The JSON fields `date`, `host`, `commit`, `has_local_changes` and `cpu_model`."""
    checkout = checkout_folder()
    return {
        "date": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "host": platform.node(),
        **(commit_fields(checkout) if checkout else NO_COMMIT),
        "cpu_model": cpu_model(),
    }


NO_COMMIT = {"commit": None, "has_local_changes": None}


def checkout_folder() -> Path | None:
    """The checkout that isonoise runs from; None if it is an installed package."""
    folder = Path(isonoise.__file__).resolve().parents[2]
    return folder if is_checkout(folder) else None


def is_checkout(folder: Path) -> bool:
    return (folder / "pyproject.toml").is_file() and (folder / "host" / "isonoise" / "__init__.py").is_file()


def commit_fields(checkout: Path) -> dict[str, object]:
    """The commit of a checkout, and whether tracked files differ from it; None without git or its repository."""
    command = ["git", "--no-optional-locks", "-C", str(checkout), "status", "--porcelain=2", "--branch", "-uno"]
    environment = os.environ | {"GIT_CEILING_DIRECTORIES": str(checkout.parent)}  # no repository around the checkout
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True, env=environment)
    except (OSError, subprocess.SubprocessError):
        return dict(NO_COMMIT)
    lines = done.stdout.splitlines()
    commits = [line.removeprefix("# branch.oid ") for line in lines if line.startswith("# branch.oid ")]
    if not commits or commits[0] == "(initial)":
        return dict(NO_COMMIT)
    return {"commit": commits[0], "has_local_changes": any(not line.startswith("#") for line in lines)}


def cpu_model() -> str | None:
    """The CPU's name, as Linux or Python knows it."""
    with contextlib.suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines():
            name, _, value = line.partition(":")
            if name.strip() == "model name":
                return value.strip()
    return platform.processor() or None
