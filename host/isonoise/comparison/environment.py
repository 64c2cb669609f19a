"""What renders a comparison: program, packages, device, driver; called by `planning`, `session` and workers.

The plan has what determines the images (`program_version`, `device_identity`). `environment.json` has all that is
known, an entry for each environment that has rendered for the comparison.
"""

import functools
import hashlib
import json
import os
import platform
from collections.abc import Iterator
from datetime import datetime, timezone
from importlib import resources
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import isonoise
from isonoise.device.drivers import describe_driver, driver_fields
from isonoise.device.selection import SelectedDevice
from isonoise.film.files import write_atomically
from isonoise.input_files import read_json

ENVIRONMENT_FILE = "environment.json"
_PACKAGES = ("numpy", "pyopencl", "pocl-binary-distribution", "OpenEXR", "trimesh", "pillow", "mitsuba", "distributed")
"""Their versions are recorded."""
_NOT_RENDERING = (
    *("benchmark", "commands", "comparison", "convert", "film", "live", "notebook", "selftest"),
    *("__main__.py", "argument_types.py", "cli.py", "command_output.py", "command_parser.py", "help_texts.py"),
    *("progress.py", "run_command.py", "tables.py"),
)
"""Packages and modules that do not take part in a render; files of runs have a format number of their own."""
_DIGITS = 12


@functools.cache
def program_version() -> str:
    """Version of isonoise and the beginning of a SHA-256 of its source files that take part in a render.

    In a clone the version alone stays the same while files are edited.
    """
    digest = hashlib.sha256()
    for name, path in _rendering_files():
        digest.update(name.encode() + b"\0" + path.read_bytes().replace(b"\r\n", b"\n") + b"\0")
    return f"{isonoise.__version__} (sources {digest.hexdigest()[:_DIGITS]})"


def device_identity(device: SelectedDevice) -> str:
    """The kind of a device, and its driver: the same for parts of equal size of a device."""
    return f"{device.kind}, {describe_driver(device.device)}"


def record_environment(directory: Path, device: SelectedDevice | None) -> None:
    """Add the present environment to `environment.json`, unless its last entry is the same.

    `device` is None if workers of a cluster render; every run says which worker and device it had. Raises UserError if
    the file cannot be written.
    """
    path = directory / ENVIRONMENT_FILE
    try:
        entries = list(read_json(path))
    except (OSError, ValueError, TypeError):
        entries = []
    entry = _environment(device)
    if entries and {**entries[-1], "since": None} == {**entry, "since": None}:
        return
    text = json.dumps([*entries, entry], indent=1) + "\n"
    write_atomically(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))


def _environment(device: SelectedDevice | None) -> dict:
    return {
        "since": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "isonoise": program_version(),
        "python": platform.python_version(),
        "packages": {name: found for name in _PACKAGES if (found := _version(name))},
        "system": platform.platform(),
        "processor_cores": os.cpu_count(),
        "device": None
        if device is None
        else {"label": device.label, "kind": device.kind, **driver_fields(device.device)},
    }


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def _rendering_files() -> Iterator[tuple[str, Path]]:
    """Names and paths of Python and OpenCL files, sorted."""
    package = Path(isonoise.__file__).parent
    kernels = Path(str(resources.files("isonoise.kernels").joinpath("path"))).parent
    for root, patterns in ((package, ("*.py",)), (kernels, ("*.cl", "*.h"))):
        files = {path.relative_to(root).as_posix(): path for pattern in patterns for path in root.rglob(pattern)}
        yield from sorted((name, path) for name, path in files.items() if name.split("/")[0] not in _NOT_RENDERING)
