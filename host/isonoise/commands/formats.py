"""`isonoise formats`: which features of other formats than Mitsuba 3 XML are supported."""

import argparse
import shutil

from isonoise.command_output import print_json
from isonoise.commands import EXIT_DONE
from isonoise.errors import UserError
from isonoise.scene.formats import tables
from isonoise.scene.formats.registry import FORMATS
from isonoise.tables import Table, columns, text_table


def run(options: argparse.Namespace) -> int:
    """Run the command; return the exit code. Raises UserError for an unknown format."""
    if options.name is None:
        _print_rows(options.json, None, tables.overview_heads(), tables.overview_rows())
        return EXIT_DONE
    suffix = f".{options.name.lower().removeprefix('.')}"
    format_ = next((format_ for format_ in FORMATS if suffix in format_.suffixes), None)
    if format_ is None:
        known = ", ".join(suffix[1:] for format_ in FORMATS for suffix in format_.suffixes)
        raise UserError(f"unknown format '{options.name}'; one of {known}. For Mitsuba 3 XML: isonoise plugins")
    _print_rows(options.json, format_.title, tables.HEADS, tables.format_rows(format_))
    return EXIT_DONE


def _print_rows(as_json: bool, title: str | None, heads: tuple[str, ...], rows: list[tuple[str, ...]]) -> None:
    if as_json:
        print_json([dict(zip(heads, row, strict=True)) for row in rows])
        return
    table = Table(columns(*heads, left=range(len(heads))), rows)
    text = text_table(table, indent="  ", wrap=shutil.get_terminal_size((120, 24)).columns)
    print(f"{title}\n{text}" if title else text)
