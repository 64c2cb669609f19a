"""Tables of text cells, for the terminal, Markdown and notebooks; called by the commands that print tables.

`comparison/report/page.html.j2` renders the same `Table` as HTML.
"""

import html
import textwrap
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

LEFT, RIGHT = "<", ">"
GAP = "  "
"""Between two columns."""
MAX_HTML_CHARS = 48
"""Longer texts are cut off in HTML tables."""


@dataclass(frozen=True)
class Cell:
    """One cell of a table.

    `detail` follows `text`: an interval in brackets, for example. `value` is the number to sort by. `tone` is 'good' or
    'bad' where the value differs significantly from its null hypothesis, else ''.
    """

    text: str = ""
    detail: str = ""
    value: float | None = None
    tone: str = ""

    def __str__(self) -> str:
        return f"{self.text} {self.detail}".strip()


@dataclass(frozen=True)
class Column:
    """One column: its head, its alignment, its least width in characters and an explanation of its values."""

    head: str = ""
    align: str = RIGHT
    min_width: int = 0
    meaning: str = ""


@dataclass(frozen=True)
class Table:
    """A table with a title above it and notes between the two; a row has a cell for every column."""

    columns: Sequence[Column]
    rows: Sequence[Sequence[Cell | str]]
    title: str = ""
    notes: Sequence[str] = ()


def columns(*heads: str, left: Iterable[int] = (0,)) -> list[Column]:
    """Columns with these heads; those whose index is in `left` are aligned to the left, the others to the right."""
    left = set(left)
    return [Column(head, LEFT if index in left else RIGHT) for index, head in enumerate(heads)]


def text_table(table: Table, *, heads: bool = True, indent: str = " ", wrap: int | None = None) -> str:
    """The rows as aligned lines of text, without title and notes.

    Parameters
    ----------
    heads : bool
        Whether the heads of the columns and a rule stand above the rows.
    indent : str
        Begins every line.
    wrap : int, optional
        Width of the terminal in characters: the last column is wrapped so that lines fit.
    """
    rows = [[str(cell) for cell in row] for row in table.rows]
    above = [[column.head for column in table.columns]] if heads else []
    widths = [
        max([column.min_width, *(len(row[index]) for row in above + rows)])
        for index, column in enumerate(table.columns)
    ]
    left = len(indent) + sum(widths[:-1]) + len(GAP) * (len(widths) - 1)
    if wrap:
        widths[-1] = min(widths[-1], max(wrap - left, 30))
    if heads:
        above.append(["\u2500" * width for width in widths])
    lines = []
    for row in above + rows:
        last = textwrap.wrap(row[-1], widths[-1]) or [""] if wrap else [row[-1]]
        aligned = zip([*row[:-1], last[0]], table.columns, widths, strict=True)
        first = GAP.join(f"{cell:{column.align}{width}}" for cell, column, width in aligned)
        lines += [indent + first, *(" " * left + line for line in last[1:])]
    return "\n".join(line.rstrip() for line in lines)


def label_lines(
    rows: Iterable[tuple[str, str]], *, indent: str = "", min_width: int = 0, wrap: int | None = None
) -> str:
    """Lines of a label and its value each; an empty label continues the value above. Options as of `text_table`."""
    pairs = Table([Column("", LEFT, min_width), Column("", LEFT)], list(rows))
    return text_table(pairs, heads=False, indent=indent, wrap=wrap)


def markdown_table(table: Table) -> str:
    """The rows as a Markdown table, without title and notes."""
    heads = [[column.head for column in table.columns], ["---"] * len(table.columns)]
    return "\n".join(f"| {' | '.join(map(str, row))} |" for row in [*heads, *table.rows])


def html_table(table: Table) -> str:
    """The rows as an HTML table with styles of its own, without title and notes.

    The meaning of a column is a tooltip of its head; a cell with a long text ends with an ellipsis and has the whole
    text as its tooltip.
    """
    sides = ["left" if column.align == LEFT else "right" for column in table.columns]
    heads = []
    for column, side in zip(table.columns, sides, strict=True):
        meaning = f' title="{html.escape(column.meaning)}"' if column.meaning else ""
        heads.append(f'<th style="text-align:{side}"{meaning}>{html.escape(column.head)}</th>')
    rows = ["".join(map(_html_cell, row, sides)) for row in table.rows]
    body = "".join(f"<tr>{row}</tr>" for row in rows)
    return f"<table><thead><tr>{''.join(heads)}</tr></thead><tbody>{body}</tbody></table>"


def _html_cell(cell: Cell | str, side: str) -> str:
    text, style = html.escape(str(cell)), f"text-align:{side};white-space:nowrap"
    if len(str(cell)) <= MAX_HTML_CHARS:
        return f'<td style="{style}">{text}</td>'
    style += f";max-width:{MAX_HTML_CHARS // 2}em;overflow:hidden;text-overflow:ellipsis"
    return f'<td style="{style}" title="{text}">{text}</td>'
