"""What goes wrong on a device, as errors for the user. Used by `device.opencl` and `device.drivers`.

Build errors name kernel file, line and options; failures of a driver in mid-render become DeviceErrors; a device is
refused in a process that was forked after its use.
"""

import contextlib
import functools
import os
import re
import tempfile
from collections.abc import Callable, Iterable
from pathlib import Path

from isonoise.errors import DeviceError

_PLACE = re.compile(r"(?<![\w./-])(?P<file>\w[\w./-]*\.(?:cl|h))[:(](?P<line>\d+)(?::\d+)?\)?:?\s*(?P<text>[^\n]*)")
"""FILE:LINE:COLUMN: MESSAGE, as compilers made of Clang write it, or FILE(LINE): MESSAGE; of a file of `kernels/`."""
_SOURCE_OF_PYOPENCL = re.compile(r"\(source saved as (.+)\)\s*$")

_LOST = {
    "DEVICE_NOT_AVAILABLE", "DEVICE_NOT_FOUND", "INVALID_COMMAND_QUEUE", "INVALID_CONTEXT", "INVALID_DEVICE",
    "OUT_OF_RESOURCES",
}  # fmt: skip
_OUT_OF_MEMORY = {"MEM_OBJECT_ALLOCATION_FAILURE", "OUT_OF_HOST_MEMORY"}

log_folders: list[str | None] = [None, "."]
"""Where logs of compilers are saved, the first that can be written: the folder for temporary files, the current one."""
_driver_process: int | None = None
"""The process that loaded the drivers."""


def note_driver_use() -> None:
    """Remember that this process has loaded the drivers."""
    global _driver_process
    if _driver_process is None:
        _driver_process = os.getpid()


def is_forked() -> bool:
    """Whether this process was forked from one that had loaded the drivers: their threads do not exist here."""
    return _driver_process is not None and _driver_process != os.getpid()


def refuse_after_fork() -> None:
    """Raise DeviceError in a forked process, where a driver would wait for ever for its threads."""
    if is_forked():
        raise DeviceError(
            f"OpenCL drivers do not work in a process forked after their first use (by process {_driver_process}); "
            "start processes with multiprocessing's method 'spawn', or fork before the first use of isonoise"
        )


def reports_failures(action: str) -> Callable:
    """A decorator for methods of `Device`: errors of the driver become DeviceErrors that say what it was doing."""

    def decorate(method: Callable) -> Callable:
        @functools.wraps(method)
        def checked(self, *arguments, **options):
            refuse_after_fork()
            try:
                return method(self, *arguments, **options)
            except self.driver_error as error:
                raise device_failure(self.name, action, error) from error

        return checked

    return decorate


def device_failure(device: str, action: str, error: Exception) -> DeviceError:
    """The error for a driver's `error`, a `pyopencl.Error`."""
    from pyopencl import status_code

    status = status_code.to_string(error.code, "error %d")
    if status in _OUT_OF_MEMORY:
        advice = "memory is exhausted: end other programs, or render a smaller image or scene"
    elif status in _LOST:
        advice = (
            "the device was lost: removed, reset after a launch that took too long, or out of resources. See whether "
            "`isonoise devices` still lists it, or choose another device with --device"
        )
    else:
        advice = "update the driver, or choose another device with --device"
    return DeviceError(f"{device} failed while {action} ({error.routine or 'OpenCL'}: {status}); {advice}")


def build_failure(
    device: str, source: str, options: Iterable[str], error: Exception, reason: str | None = None
) -> DeviceError:
    """The error for a program that the compiler refused: names file, line, options, and a file with the whole log.

    `reason` takes the place of file and line, if the caller knows one.
    """
    log = str(error)
    if saved := _SOURCE_OF_PYOPENCL.search(log):  # it is in the file that _save_log writes
        with contextlib.suppress(OSError):
            Path(saved[1]).unlink()
        log = log[: saved.start()]
    options = tuple(options)
    place = next((match for match in _PLACE.finditer(log) if "error" in _line_of(match)), None)
    if reason:
        what = f"a kernel: {reason}"
    elif place:
        what = f"{place['file']}:{place['line']}: {place['text'].removeprefix('error:').strip()}"
    else:
        what = "a kernel"
    log_file = _save_log(device, source, " ".join(options), log)
    details = f"log, source and all options are in {log_file}" if log_file else f"log:\n{log}"
    shown = " ".join(option for option in options if not option.endswith("=0"))
    return DeviceError(f"the OpenCL compiler of {device} refused {what}\n  options, but those =0: {shown}\n  {details}")


def _line_of(match: re.Match) -> str:
    """The part of the match's line up to its end."""
    return match.string[match.string.rfind("\n", 0, match.start()) + 1 : match.end()]


def _save_log(device: str, source: str, options: str, log: str) -> str | None:
    """Write a new file with all that the compiler got and said; return its name, or None if that fails."""
    content = f"device: {device}\noptions: {options}\n\n--- log\n{log}\n\n--- source\n{source}\n"
    for folder in log_folders:
        name = None
        try:
            number, name = tempfile.mkstemp(prefix="isonoise-build-", suffix=".log", dir=folder)
            with open(number, "w", encoding="utf-8", errors="replace") as file:
                file.write(content)
        except OSError:
            if name:  # the disk is full
                with contextlib.suppress(OSError):
                    os.unlink(name)
            continue
        return os.path.abspath(name)
    return None
