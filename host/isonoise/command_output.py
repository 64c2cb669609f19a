"""What a command writes: text for people or one JSON object on standard output, messages on standard error.

`run_command` sets it up. Commands print their text with `print`; with --quiet or --json it is discarded. Messages are
records of the logger `isonoise`, so that programs that use the package can handle them in their own way.
"""

import argparse
import json
import logging
import math
import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout

from isonoise.progress import ProgressBar

logger = logging.getLogger("isonoise")
"""Receives warnings and errors that do not end a command."""
STANDARD_OUTPUT = "-"
"""The file name that means standard output."""

_json_output = None  # standard output while text is discarded


class _Nowhere:
    """A text stream that discards everything."""

    def write(self, text: str) -> int:
        return len(text)

    def flush(self) -> None:
        pass


class _MessageHandler(logging.Handler):
    """Writes `isonoise: MESSAGE` to what standard error is at the moment."""

    def emit(self, record: logging.LogRecord) -> None:
        level = "warning: " if record.levelno == logging.WARNING else ""
        print(f"isonoise: {level}{record.getMessage()}", file=sys.stderr, flush=True)


@contextmanager
def command_output(options: argparse.Namespace) -> Iterator[None]:
    """Set up output and messages as the options --quiet and --json ask for, during the `with` block."""
    global _json_output
    handler, bars_were_shown = _MessageHandler(), ProgressBar.is_shown
    quiet = getattr(options, "quiet", False)
    logger.addHandler(handler)
    logger.propagate = False
    try:
        ProgressBar.is_shown = bars_were_shown and not quiet
        if quiet or prints_json(options):
            _json_output = sys.stdout
            with redirect_stdout(_Nowhere()):
                yield
        else:
            yield
    finally:
        _json_output, ProgressBar.is_shown = None, bars_were_shown
        logger.propagate = True
        logger.removeHandler(handler)


def prints_json(options: argparse.Namespace) -> bool:
    """Whether the command prints JSON in place of text; not if it writes JSON to a file."""
    return getattr(options, "json", None) in (True, STANDARD_OUTPUT)


def print_json(value: object) -> None:
    """Print an object as one line of JSON. NaN and infinity, which JSON does not have, become null."""
    print(json.dumps(without_nan(value)), file=_json_output or sys.stdout, flush=True)


def without_nan(value):
    """The value with None in place of NaN and infinity, in its lists and dicts, too."""
    if isinstance(value, dict):
        return {key: without_nan(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [without_nan(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
