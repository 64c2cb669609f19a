"""The parser of a command: keeps line breaks in help texts, and names the nearest option or command after a typo."""

import argparse
import importlib
import re
import sys
from collections.abc import Sequence

from isonoise.suggestions import suggestion


class CommandParser(argparse.ArgumentParser):
    """A parser that keeps line breaks, and gets the epilog `epilog_name` from `help_texts` when help is printed."""

    epilog_name = None

    def __init__(self, **options):
        super().__init__(formatter_class=argparse.RawDescriptionHelpFormatter, **options)
        # argparse takes what matches this for a value and no option: points and axes, too, not just numbers
        self._negative_number_matcher = re.compile(r"-(?:[0-9.][0-9.,:eE+-]*|[xyz])$")
        self._words: Sequence[str] = ()

    def format_help(self) -> str:
        if self.epilog_name:
            self.epilog = getattr(importlib.import_module("isonoise.help_texts"), self.epilog_name)()
        return super().format_help()

    def parse_known_args(self, args=None, namespace=None):
        """As argparse does it. A parser of a command reports what it does not know itself: it knows its options."""
        self._words = sys.argv[1:] if args is None else list(args)
        namespace, unknown = super().parse_known_args(args, namespace)
        if unknown and not self._has_commands():
            self.error(f"unrecognized arguments: {' '.join(unknown)}")
        return namespace, unknown

    def error(self, message: str):
        """Print usage and message, with the nearest option or command if there was a typo, and exit with code 2."""
        super().error(message + "".join(self._suggestions(message)))

    def _suggestions(self, message: str):
        choice = re.search(r"invalid choice: '([^']*)' \(choose from (.*)\)", message)
        if choice:
            yield suggestion(choice[1], re.findall(r"[\w-]+", choice[2]))
        options = [option for option in self._option_string_actions if option.startswith("--")]
        for word in self._words:
            name = word.partition("=")[0]
            if name == "--" or (self._has_commands() and not name.startswith("-")):
                return  # what follows are no options of this parser
            if name.startswith("--") and not any(option.startswith(name) for option in options):
                yield f"; there is no option {name}"
                yield suggestion(name, options)

    def _has_commands(self) -> bool:
        return self._subparsers is not None
