"""Tables of a comparison, made from summary.json: for the terminal, tables.md and report.html."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from isonoise.comparison.metric_columns import (
    SCENE_COLUMNS,
    SINGLE_IMAGE_COLUMNS,
    MetricColumn,
    format_percent,
    format_ratio,
    sampler_cell,
    shown_columns,
    summary_cell,
    time_cell,
)
from isonoise.comparison.timing import timing_notes, worker_table
from isonoise.tables import LEFT, Cell, Column, Table, markdown_table, text_table

STRATEGY = Column("strategy", LEFT)
MARK = "†"
NOISY_REFERENCE = f"{MARK} noisy reference: the reference's own p99 error is over a quarter of the error compared."
TIME_METRICS = {"rms_p99": "RMS p99", "rel_mse": "relMSE"}


def time_table(summary: Mapping, metric: str) -> Table:
    """Time to the baseline's final error over the baseline's time to it: a row per strategy, a column per scene.

    `metric` is a key of `TIME_METRICS`.
    """
    name, baseline = TIME_METRICS[metric], strategy_titles(summary)[summary["baseline"]]
    notes = [
        f"Time to reach the final {name} of {baseline}, over the time of {baseline}: 0.5 is twice as fast. In brackets "
        "the 95 % interval over the seeds.",
        "'> x': the error was not reached in the budget; beside it the ratio at the strategy's own final error. '< x': "
        "the error was below it from the first measurement on.",
    ]
    title = f"Time to equal {name}, relative to {baseline}"
    return _table_across_scenes(summary, title, notes, lambda row, _: time_cell(row, metric))


def summary_table(summary: Mapping) -> Table:
    """RMS p99, relMSE and image mean together: a row per strategy, a column per scene."""
    baseline = strategy_titles(summary)[summary["baseline"]]
    note = f"At the end of the budget: RMS p99 and relMSE over those of {baseline}, image mean over the reference's."
    return _table_across_scenes(summary, "RMS p99 / relMSE / image mean", [note], summary_cell)


def _table_across_scenes(
    summary: Mapping, title: str, notes: Sequence[str], cell: Callable[[Mapping | None, Mapping], Cell]
) -> Table:
    scenes = summary["scenes"]
    by_strategy = [{row["strategy"]: row for row in scene["rows"]} for scene in scenes]
    rows = []
    for strategy in summary["strategies"]:
        found = [rows_of_scene.get(strategy["slug"]) for rows_of_scene in by_strategy]
        if any(found):
            cells = [_marked(cell(row, scene), row) for row, scene in zip(found, scenes, strict=True)]
            rows.append([Cell(strategy["title"]), *cells])
    if any(row["reference_too_noisy"] for scene in scenes for row in scene["rows"]):
        notes = [*notes, NOISY_REFERENCE]
    return Table([STRATEGY, *(Column(scene["name"]) for scene in scenes)], rows, title, notes)


def _marked(cell: Cell, row: Mapping | None) -> Cell:
    return replace(cell, text=f"{cell.text} {MARK}") if row and row["reference_too_noisy"] else cell


def scene_table(summary: Mapping, scene: Mapping, in_terminal: bool = False) -> Table:
    """Figures of all strategies at the end of the budget; `in_terminal`: only the columns for the terminal."""
    columns = [column for column in SCENE_COLUMNS if column.in_terminal or not in_terminal]
    return _table_of_scene(summary, scene, columns, scene["name"], _scene_notes(summary, scene))


def single_image_table(summary: Mapping, scene: Mapping) -> Table:
    """Stated and true errors of single images."""
    return _table_of_scene(summary, scene, SINGLE_IMAGE_COLUMNS, f"{scene['name']}: single images", [])


def _table_of_scene(
    summary: Mapping, scene: Mapping, columns: Sequence[MetricColumn], title: str, notes: Sequence[str]
) -> Table:
    titles = strategy_titles(summary)
    columns = shown_columns(columns, [scene])
    rows = [
        [
            Cell(titles[row["strategy"]], MARK if row["reference_too_noisy"] else ""),
            *(column.cell(row, scene) for column in columns),
        ]
        for row in scene["rows"]
    ]
    return Table([STRATEGY, *columns], rows, title, notes)


def sampler_table(summary: Mapping) -> Table:
    """RMS p99 and relMSE over those of independent samples: a row per strategy that was compared with both."""
    note = (
        "RMS p99 / relMSE over those of the same strategy with independent samples, with the 95 % interval of relMSE."
    )
    with_ratio = {row["strategy"] for scene in summary["scenes"] for row in scene["rows"] if "sampler_ratio" in row}
    strategies = [strategy for strategy in summary["strategies"] if strategy["slug"] in with_ratio]
    return _table_across_scenes(
        {**summary, "strategies": strategies}, "Over independent samples", [note], lambda row, _: sampler_cell(row)
    )


def _warm_up_notes(summary: Mapping, scene: Mapping) -> list[str]:
    """Warnings about adaptive strategies that had no samples to distribute."""
    titles = strategy_titles(summary)
    return [
        f"Warning: {titles[row['strategy']]} had {row['spp']:.4g} samples per pixel and its warm-up has "
        f"{row['warm_up_spp']:g}: none of its samples were distributed adaptively."
        for row in scene["rows"]
        if row["warm_up_spp"] is not None and row["spp"] <= row["warm_up_spp"]
    ]


def _scene_notes(summary: Mapping, scene: Mapping) -> list[str]:
    """Size, seeds, error of the reference, bound of the relMSE."""
    planned, seeds = len(summary["seeds"]), len(scene["seeds"])
    notes = [f"{scene['width']}x{scene['height']} pixels, {seeds} seed{'s' * (seeds != 1)}."]
    if scene["runs"] < scene["planned_runs"]:
        notes.append(
            f"Not finished: {scene['runs']} of {scene['planned_runs']} runs. Figures are from the {seeds} of {planned} "
            "seeds that all strategies with runs have."
        )
    reference = scene["reference"]
    p50, p99 = format_percent(reference["p50"]), format_percent(reference["p99"])
    if reference["has_standard_error"]:
        notes.append(f"The reference's own relative error: {p50} at p50, {p99} at p99.")
    else:
        notes.append("The reference has no standard error; it is taken as exact.")
    if scene["rel_mse_lower_bound"] is not None:
        notes.append(
            f"Lower bound of any allocation: {format_ratio(scene['rel_mse_lower_bound'])} times the mean relMSE of "
            "uniform sampling with as many samples. It is mean(√V)² / mean(V), V / n the relative variance of the mean "
            "of n samples (of the luminance, over the floor)."
        )
    return notes + timing_notes(scene) + _warm_up_notes(summary, scene)


def text_tables(summary: Mapping) -> str:
    """All tables for a terminal."""
    scenes = [scene_table(summary, scene, in_terminal=True) for scene in summary["scenes"]]
    parts = []
    for table in [*tables_across_scenes(summary), *scenes, *_worker_tables(summary)]:
        parts += [table.title, *(f"  {note}" for note in table.notes)]
        if table.rows:
            parts += [text_table(table), ""]
    return "\n".join(parts) + "\n"


def markdown_tables(summary: Mapping) -> str:
    """All tables as Markdown, with the meanings of the columns at the end."""
    parts = []
    scenes = [scene_table(summary, scene) for scene in summary["scenes"]]
    for table in [*tables_across_scenes(summary), *scenes, *_worker_tables(summary)]:
        parts += [f"### {table.title}", *table.notes]
        if table.rows:
            rows = [[replace(first, text=f"`{first.text}`"), *cells] for first, *cells in table.rows]
            parts.append(markdown_table(replace(table, rows=rows)))
    columns = shown_columns((*SCENE_COLUMNS, *SINGLE_IMAGE_COLUMNS), summary["scenes"])
    meanings = [f"- {column.head}: {column.meaning}." for column in columns]
    return "\n\n".join([*parts, "### Columns", "\n".join(meanings)]) + "\n"


def tables_across_scenes(summary: Mapping) -> list[Table]:
    """The tables with a column per scene."""
    tables = [*(time_table(summary, metric) for metric in TIME_METRICS), summary_table(summary), sampler_table(summary)]
    return [table for table in tables if table.rows]


def _worker_tables(summary: Mapping) -> list[Table]:
    table = worker_table(summary)
    return [table] if table.rows else []


def strategy_titles(summary: Mapping) -> dict[str, str]:
    """Title of every strategy by its slug."""
    return {strategy["slug"]: strategy["title"] for strategy in summary["strategies"]}
