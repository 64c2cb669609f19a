"""The comparisons of an experiment with several budgets or devices: shared references, and tables over all of them.

Called by `isonoise compare` and `session`.
"""

import shutil
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from isonoise.comparison.checked_files import is_valid_image
from isonoise.comparison.experiment import Member
from isonoise.comparison.identity import reference_identity
from isonoise.comparison.metric_columns import EMPTY, ratio_cell
from isonoise.comparison.plan import PLAN_FILE, Plan, variance_path
from isonoise.comparison.report_tables import strategy_titles
from isonoise.comparison.summary import summarise
from isonoise.comparison.summary_table import summary_table
from isonoise.comparison.tidy_tables import write_table, write_tables
from isonoise.errors import UserError
from isonoise.film.files import write_atomically
from isonoise.tables import LEFT, Cell, Column, Table, markdown_table, text_table

FIGURES = {
    "relMSE, relative to {baseline}": ("rel_mse_ratio",),
    "RMS p99, relative to {baseline}": ("rms_ratio", "p99"),
    "relMSE over that of the same strategy with independent samples": ("sampler_ratio", "rel_mse"),
    "RMS p99 over that of the same strategy with independent samples": ("sampler_ratio", "rms_p99"),
}
"""Title of a table -> keys of its intervals in a row of summary.json."""


def share_references(source: Path, target: Path, plan: Plan) -> None:
    """Copy the references and variances that `target` lacks from another comparison of the same scenes."""
    for scene in plan.scenes:
        names = {"variance": variance_path(Path(), scene)}
        if scene.reference_sha256 is None:
            names["reference"] = Path(scene.reference)
        for kind, name in names.items():
            identity = reference_identity(plan, scene, kind)
            if is_valid_image(source / name, identity) and not is_valid_image(target / name, identity):
                _copy(source / name, target / name)


def series_tables(summaries: Mapping[Member, Mapping]) -> list[Table]:
    """A table per figure: a row per scene, device and budget, a column per strategy.

    `summaries` are those of the comparisons (`summary.summarise`).
    """
    return [table for figure in FIGURES.items() if (table := _table(*figure, summaries)).rows]


def write_series(
    directory: Path, members: Sequence[Member], reported: Mapping[Member, Mapping | None], log: Callable[[str], None]
) -> None:
    """Write tables.md and the tidy tables to `directory`, and print the former. Raises UserError if that fails.

    `reported` are the summaries that this call has written. Those of the other comparisons, after an interrupt, are
    computed from their runs.
    """
    summaries = {}
    for member in sorted(members, key=lambda member: (member.device, member.budget)):
        folder = directory / member.folder
        summary = reported.get(member)
        if summary is None and (folder / PLAN_FILE).is_file():
            summary = summarise(folder)
        if summary is not None:
            summaries[member] = summary
    tables = series_tables(summaries)
    text = "\n\n".join(f"### {table.title}\n\n{markdown_table(table)}" for table in tables) + "\n"
    write_atomically(directory / "tables.md", lambda temporary: temporary.write_text(text, encoding="utf-8"))
    if summaries:
        write_tables(directory)
        by_folder = {member.folder: summary for member, summary in summaries.items()}
        write_table(directory, "summary", summary_table(directory, by_folder))
    for table in tables:
        log(f"{table.title}\n{text_table(table)}\n")


def _table(title: str, keys: Sequence[str], summaries: Mapping[Member, Mapping]) -> Table:
    titles = {slug: name for summary in summaries.values() for slug, name in strategy_titles(summary).items()}
    cells = {
        (scene["name"], member): {row["strategy"]: ratio_cell(row, *keys) for row in scene["rows"]}
        for member, summary in summaries.items()
        for scene in summary["scenes"]
    }
    shown = [slug for slug in titles if any(row.get(slug, EMPTY) != EMPTY for row in cells.values())]
    names = list(dict.fromkeys(name for name, _ in cells))
    has_devices = len({member.device for member in summaries}) > 1
    unit = next((member.unit for member in summaries), "spp")
    rows = [
        [
            Cell(name),
            *([Cell(str(member.device))] if has_devices else []),
            Cell(f"{member.budget:g}"),
            *(cells[name, member].get(slug, EMPTY) for slug in shown),
        ]
        for name in names
        for member in summaries
        if shown and (name, member) in cells
    ]
    baseline = next((titles[summary["baseline"]] for summary in summaries.values()), "")
    columns = [
        Column("scene", LEFT),
        *([Column("device", LEFT)] if has_devices else []),
        Column(unit),
        *(Column(titles[slug]) for slug in shown),
    ]
    return Table(columns, rows, title.format(baseline=baseline))


def _copy(source: Path, target: Path) -> None:
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(target, lambda temporary: shutil.copyfile(source, temporary))
    except OSError as error:
        raise UserError(f"cannot copy '{source}' to '{target}': {error.strerror}") from error
