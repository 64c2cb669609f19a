"""Presents the support of formats to people: `isonoise formats` and scenes/formats.md.

To update the page: `python -m isonoise.scene.formats.tables scenes/formats.md`.
"""

import sys
from collections.abc import Iterable
from pathlib import Path

from isonoise.scene.formats.registry import FORMATS, Format
from isonoise.scene.formats.support import FEATURES

HEADS = ("feature", "support", "what it becomes, what is missing")
_NOT_IN_FORMAT = "-"
_INTRODUCTION = """# Formats

What isonoise reads of each format besides Mitsuba 3 XML, whose plugins are listed in
[supported elements](../host/docs/plugins.md). `isonoise formats` prints these tables. Everything becomes an object of
Mitsuba 3's vocabulary, as `isonoise convert` writes it. If a file uses what is not supported, a render warns of it;
`isonoise info FILE` lists what was found. A dash: the format does not have it.

This page is generated from `host/isonoise/scene/formats/`: `python -m isonoise.scene.formats.tables scenes/formats.md`.
"""


def overview_heads() -> tuple[str, ...]:
    """The heads of `overview_rows`."""
    return "feature", *(format_.title for format_ in FORMATS)


def overview_rows() -> list[tuple[str, ...]]:
    """A row for each feature: its title, then yes, partly, no or, if it is not in the format, a dash."""
    rows = []
    for feature, title in FEATURES.items():
        supports = [format_.support.get(feature) for format_ in FORMATS]
        if any(supports):
            rows.append((title, *(support.status if support else _NOT_IN_FORMAT for support in supports)))
    return rows


def format_rows(format_: Format) -> list[tuple[str, ...]]:
    """A row for each feature of a format: its title, yes, partly or no, and the note."""
    support = format_.support
    return [(title, *support[feature]) for feature, title in FEATURES.items() if feature in support]


def page() -> str:
    """The text of scenes/formats.md."""
    lines = [_INTRODUCTION, *_markdown(overview_heads(), overview_rows())]
    for format_ in FORMATS:
        lines += ["", f"## {format_.title}", "", *_markdown(HEADS, format_rows(format_))]
    return "\n".join([*lines, ""])


def _markdown(heads: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> list[str]:
    return [f"| {' | '.join(row)} |" for row in (heads, ("---",) * len(heads), *rows)]


if __name__ == "__main__":
    for _file in map(Path, sys.argv[1:]):
        _file.write_text(page(), "utf-8")
