"""Runs a command for `cli`: signals, exceptions and failures of standard output become messages and exit codes."""

import argparse
import importlib
import os
import signal
import sys
import traceback
import warnings

from isonoise.command_output import command_output
from isonoise.commands import EXIT_BAD_INPUT, EXIT_ERROR_NOT_MET, EXIT_INTERNAL_ERROR
from isonoise.errors import UserError
from isonoise.heap import keep_freed_memory
from isonoise.signals import deferred, exit_code, handle_signals, interrupted_exit_code, raise_if_received
from isonoise.standard_streams import SafeStream

_python_format = warnings.formatwarning
_PRINTING_COMMANDS = ("devices", "formats", "info", "plugins")
"""They do nothing but print, so a reader of standard output that has read enough, such as `head`, is no error."""


def run_command(options: argparse.Namespace, output: SafeStream) -> int:
    """Run the command `options.command`, which prints to `output`; return the exit code."""
    with handle_signals():
        code = _run(options)
        output.flush()
        code = _code_of_output(options.command, output.failure, code)
        return code if code > EXIT_ERROR_NOT_MET else exit_code() or code


def _run(options: argparse.Namespace) -> int:
    """Run the command; return its exit code. Errors are printed."""
    try:
        warnings.formatwarning = _format_warning
        keep_freed_memory()
        with deferred():  # compiled modules lose a KeyboardInterrupt, or turn it into another error
            command = importlib.import_module(f"isonoise.commands.{options.command}")
        raise_if_received()
        with command_output(options):
            return command.run(options)
    except BaseException as error:
        return _report(error)


def _format_warning(message: Warning | str, category: type[Warning], *place, **options) -> str:
    """Warnings for the user in one line; those about code as Python formats them."""
    if category is UserWarning:
        return f"isonoise: warning: {message}\n"
    return _python_format(message, category, *place, **options)


def _report(error: BaseException) -> int:
    """Print an exception that ended a command; return the exit code."""
    code = interrupted_exit_code()
    if isinstance(error, KeyboardInterrupt):
        print("isonoise: interrupted", file=sys.stderr)
        return code or 128 + signal.SIGINT
    if (
        code is not None
    ):  # compiled code, such as an extension's import, may turn a KeyboardInterrupt into another error
        print(f"isonoise: interrupted ({error})", file=sys.stderr)
        return code
    if isinstance(error, UserError):
        print(f"isonoise: {error}", file=sys.stderr)
        return EXIT_BAD_INPUT
    if isinstance(error, MemoryError):
        print("isonoise: there is not enough memory for this input", file=sys.stderr)
        return EXIT_BAD_INPUT
    traceback.print_exception(error)
    name, place = type(error).__name__, _place_in_code_of_user(error)
    if place:
        print(f"isonoise: error ({name}) in {place}, which is no part of isonoise", file=sys.stderr)
    else:
        print(f"isonoise: internal error ({name}); please report it with the lines above", file=sys.stderr)
    return EXIT_INTERNAL_ERROR


def _place_in_code_of_user(error: BaseException) -> str | None:
    """File and line of a strategy, measure or rule of the user in which the error arose; None if it was in none."""
    import sysconfig  # not needed by commands that end well

    others = (os.path.dirname(__file__), *(sysconfig.get_path(name) for name in ("stdlib", "purelib", "platlib")))
    for frame in reversed(traceback.extract_tb(error.__traceback__)):
        path = os.path.abspath(frame.filename)
        if os.path.exists(path) and not path.startswith(tuple(f"{folder}{os.sep}" for folder in others)):
            return f"'{frame.filename}', line {frame.lineno}"
    return None


def _code_of_output(command: str, failure: OSError | None, code: int) -> int:
    """The exit code after `code`, with the `failure` of standard output, which is reported."""
    if failure is None or (isinstance(failure, BrokenPipeError) and command in _PRINTING_COMMANDS):
        return code
    print(f"isonoise: cannot write to standard output: {failure.strerror}", file=sys.stderr)
    return code if code > EXIT_ERROR_NOT_MET or exit_code() else EXIT_BAD_INPUT
