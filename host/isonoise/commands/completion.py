"""`isonoise completion`: prints a script with which a shell completes commands, options and file names."""

import argparse
import importlib.util

from isonoise.commands import EXIT_DONE
from isonoise.errors import UserError

_FILES = ("SCENE", "IN", "OUT", "FILE", "REF", "LOG", "CHECKPOINT", "DIR")
"""Metavars of arguments that are files, up to the extension; `SCENE|OUT.exr|CHECKPOINT` names several."""


def run(options: argparse.Namespace) -> int:
    """Run the command; return the exit code. Raises UserError without the package shtab."""
    if importlib.util.find_spec("shtab") is None:
        raise UserError("completion needs shtab: pip install 'isonoise[completion]'")
    import shtab

    print(shtab.complete(with_file_names(options.make_parser()), shell=options.shell))
    return EXIT_DONE


def with_file_names(parser: argparse.ArgumentParser) -> argparse.ArgumentParser:
    """The parser, whose arguments that are files say so, for shtab."""
    import shtab

    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for command in action.choices.values():
                with_file_names(command)
        elif str(action.metavar or "").partition(".")[0].partition("|")[0].rpartition("]")[2] in _FILES:
            action.complete = shtab.DIRECTORY if action.metavar == "DIR" else shtab.FILE
    return parser
