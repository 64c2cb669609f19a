"""The tables of a comparison, as columns and cells that the terminal, Markdown and HTML share."""

import io
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from isonoise.comparison.columns import SCENE_COLUMNS, SINGLE_COLUMNS, Cell, Column, percent, short_cell, time_cell, two


@dataclass(frozen=True)
class Table:
    """`rows`: for each strategy its title, a mark ("" or that of below reference) and the cells of all columns."""

    title: str
    notes: Sequence[str]
    columns: Sequence[Column]
    rows: Sequence[tuple[str, str, Sequence[Cell]]]


MARK = " †"

BELOW_REFERENCE = "† below reference: the reference's own p99 error is over a quarter of the error compared."

TIME_METRICS = {"rms_p99": "RMS p99", "rel_mse": "relMSE"}


def time_table(summary: Mapping, metric: str) -> Table:
    """Time to the baseline's final error over the baseline's time: strategies down, scenes across.

    `metric`: a key of `TIME_METRICS`.
    """
    name, baseline = TIME_METRICS[metric], _titles(summary)[summary["baseline"]]
    columns, rows = _across_scenes(summary, lambda row, _: time_cell(row, metric))
    notes = [
        f"Time to reach the {name} that {baseline} ends with, over the time that {baseline} takes: 0.5 is twice as "
        "fast. In brackets the 95 % interval over the seeds.",
        "'> x': not reached in the budget; beside it the ratio at the error that it ends with. '< x': never above it "
        "since the first measurement.",
    ]
    return Table(f"Time to equal {name}, relative to {baseline}", [*notes, *_mark_notes(summary)], columns, rows)


def short_table(summary: Mapping) -> Table:
    """The three figures that belong together: strategies down, scenes across."""
    baseline = _titles(summary)[summary["baseline"]]
    columns, rows = _across_scenes(summary, short_cell)
    notes = [
        f"RMS p99 and relMSE over those of {baseline}, and the image mean over the reference's, when the budget ends."
    ]
    return Table("RMS p99 / relMSE / image mean", [*notes, *_mark_notes(summary)], columns, rows)


def _across_scenes(summary: Mapping, cell: Callable[[Mapping | None, Mapping], Cell]) -> tuple[list[Column], list]:
    """Columns, a scene each, and the rows of all strategies that have one in some scene."""
    columns = [Column(scene["name"], "", True, cell) for scene in summary["scenes"]]
    by_scene = [{row["strategy"]: row for row in scene["rows"]} for scene in summary["scenes"]]
    rows = []
    for strategy in summary["strategies"]:
        found = [rows_of.get(strategy["slug"]) for rows_of in by_scene]
        if any(found):
            below = [row is not None and row["below_reference"] for row in found]
            cells = [cell(row, scene) for row, scene in zip(found, summary["scenes"], strict=True)]
            cells = [replace(c, text=c.text + MARK) if b else c for c, b in zip(cells, below, strict=True)]
            rows.append((strategy["title"], "", cells))
    return columns, rows


def _mark_notes(summary: Mapping) -> list[str]:
    below = any(row["below_reference"] for scene in summary["scenes"] for row in scene["rows"])
    return [BELOW_REFERENCE] if below else []


def scene_tables(summary: Mapping, scene: Mapping) -> tuple[Table, Table]:
    """The table of a scene at the end of its budget, and the one of single images: stated beside true errors."""
    titles = _titles(summary)

    def rows(columns: Sequence[Column]) -> list:
        return [
            (
                titles[row["strategy"]],
                MARK if row["below_reference"] else "",
                [column.cell(row, scene) for column in columns],
            )
            for row in scene["rows"]
        ]

    return (
        Table(scene["name"], scene_notes(summary, scene), SCENE_COLUMNS, rows(SCENE_COLUMNS)),
        Table(f"{scene['name']}: single images", [], SINGLE_COLUMNS, rows(SINGLE_COLUMNS)),
    )


def scene_notes(summary: Mapping, scene: Mapping) -> list[str]:
    """What has to be known to read a scene's figures: size, seeds, reference, bound."""
    planned, seeds = len(summary["seeds"]), len(scene["seeds"])
    notes = [f"{scene['width']}x{scene['height']} pixels, {seeds} seed{'s' * (seeds != 1)}."]
    if scene["runs"] < scene["planned_runs"]:
        notes.append(
            f"Not finished: {scene['runs']} of {scene['planned_runs']} runs. Figures are from the {seeds} of {planned} "
            "seeds that all strategies with runs have."
        )
    reference = scene["reference"]
    p50, p99 = percent(reference["p50"]), percent(reference["p99"])
    if reference["states_error"]:
        notes.append(f"The reference's own relative error: {p50} at p50, {p99} at p99.")
    else:
        notes.append("The reference states no error of its own; it counts as exact.")
    if scene["rel_mse_bound"] is not None:
        notes.append(
            f"At equal samples no allocation can bring the mean relMSE below {two(scene['rel_mse_bound'])} of uniform "
            "sampling's: mean(√V)² / mean(V), V the relative variance of one sample (of the luminance, over the floor)."
        )
    return notes


def text(summary: Mapping) -> str:
    """All tables for a terminal: the brief columns, aligned."""
    from rich.console import Console

    stream = io.StringIO()
    console = Console(file=stream, width=300, color_system=None, markup=False, highlight=False, emoji=False)
    for table, brief in _all(summary):
        console.print(table.title)
        for note in table.notes:
            console.print("  " + note, soft_wrap=True)
        if table.rows:
            console.print(_rich(table, brief))
    return "\n".join(line.rstrip() for line in stream.getvalue().splitlines()) + "\n"


def markdown(summary: Mapping) -> str:
    """All tables as Markdown, with the meaning of the columns at the end."""
    parts = []
    for table, _ in _all(summary):
        parts += [f"### {table.title}", *table.notes]
        if table.rows:
            lines = [["strategy", *(column.head for column in table.columns)], ["---"] * (1 + len(table.columns))]
            lines += [
                [f"`{title}`{mark}", *(f"{c.text} {c.detail}".strip() for c in cells)]
                for title, mark, cells in table.rows
            ]
            parts.append("\n".join(f"| {' | '.join(line)} |" for line in lines))
    meanings = [f"- {column.head}: {column.meaning}." for column in (*SCENE_COLUMNS, *SINGLE_COLUMNS)]
    return "\n\n".join([*parts, "### Columns", "\n".join(meanings)]) + "\n"


def _all(summary: Mapping) -> list[tuple[Table, bool]]:
    """Every table, and whether the terminal shows its brief columns only."""
    tables = [(time_table(summary, metric), False) for metric in TIME_METRICS]
    tables.append((short_table(summary), False))
    return tables + [(scene_tables(summary, scene)[0], True) for scene in summary["scenes"]]


def _rich(table: Table, brief: bool):
    from rich.box import SIMPLE_HEAD
    from rich.table import Table as RichTable

    shown = [i for i, column in enumerate(table.columns) if column.brief or not brief]
    drawn = RichTable(box=SIMPLE_HEAD, pad_edge=False)
    drawn.add_column("strategy", no_wrap=True)
    for i in shown:
        drawn.add_column(table.columns[i].head, justify="right", no_wrap=True)
    for title, mark, cells in table.rows:
        drawn.add_row(title + mark, *(f"{cells[i].text} {cells[i].detail}".strip() for i in shown))
    return drawn


def _titles(summary: Mapping) -> dict[str, str]:
    return {strategy["slug"]: strategy["title"] for strategy in summary["strategies"]}
