"""Writes the results of a comparison from its finished runs: tables, plots and a self-contained report.html."""

import time
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path

from isonoise.comparison.metric_columns import (
    SCENE_COLUMNS,
    SINGLE_IMAGE_COLUMNS,
    format_number,
    format_percent,
    shown_columns,
)
from isonoise.comparison.presets import POSTER
from isonoise.comparison.report import figure_files, map_grids, plots, poster
from isonoise.comparison.report.scene_section import MAP_SIDE, scene_section
from isonoise.comparison.report.viewer_data import viewer_factor
from isonoise.comparison.report_tables import (
    NOISY_REFERENCE,
    strategy_titles,
    tables_across_scenes,
)
from isonoise.comparison.results import Results
from isonoise.comparison.summary import summarise, write_summary
from isonoise.comparison.timing import worker_table
from isonoise.errors import UserError
from isonoise.film.files import write_atomically


def write_report(directory: Path) -> dict:
    """Write the tidy tables, summary.json, tables.md, plots/* and report.html to `directory`, each file atomically.

    Returns the summary. Raises UserError if there is nothing to report or a file cannot be read or written.
    """
    directory = Path(directory)
    results = Results(directory)
    summary = summarise(directory)
    scenes = [scene for scene in summary["scenes"] if scene["rows"]]
    if not scenes:
        raise UserError(f"nothing to report in '{directory}': no seed is finished with every strategy that has runs")
    write_summary(directory, summary)
    try:
        (directory / "plots").mkdir(exist_ok=True)
    except OSError as error:
        raise UserError(f"cannot write into '{directory}': {error.strerror}") from error
    from markupsafe import Markup

    titles = strategy_titles(summary)
    factor = viewer_factor([(scene["width"], scene["height"], 1 + len(scene["rows"])) for scene in scenes])
    with figure_files.figure_settings():
        sections = [scene_section(results, summary, scene, factor) for scene in scenes]
        poster_figures = _poster(results, summary)
    page = _template().render(
        style=Markup(_asset("page.css")),
        script=Markup(_asset("tables.js") + _asset("viewer.js")),
        summary=summary,
        scenes=sections,
        poster=poster_figures,
        max_bands=plots.MAX_BANDS,
        across=tables_across_scenes(summary),
        workers=worker_table(summary),
        columns=shown_columns([*SCENE_COLUMNS, *SINGLE_IMAGE_COLUMNS], scenes),
        noisy_reference=NOISY_REFERENCE,
        dates=_dates(results),
        devices=sorted({device for scene in scenes for device in scene["devices"]}),
        roles={titles[summary[role]]: role for role in ("default", "baseline") if summary[role]},
        swatches={titles[slug]: _swatch(style) for slug, style in plots.line_styles(summary).items()},
        descriptions={titles[row["strategy"]]: row["description"] for scene in scenes for row in scene["rows"]},
    )
    write_atomically(directory / "report.html", lambda temporary: temporary.write_text(page, encoding="utf-8"))
    return summary


def _template():
    from jinja2 import Environment, StrictUndefined

    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    environment.filters |= {"percent": format_percent, "number": format_number}
    return environment.from_string(_asset("page.html.j2"))


def _asset(name: str) -> str:
    """Text of a file beside this module."""
    return files("isonoise.comparison.report").joinpath(name).read_text(encoding="utf-8")


def _poster(results: Results, summary: Mapping) -> list[dict]:
    """The poster's figures for the template, with the preset `poster`; also writes them to plots/."""
    figures = []
    for figure in poster.poster_figures(results, summary) if results.plan.preset == POSTER else ():
        path = results.directory / "plots" / f"{figure.name}.png"
        if figure.rows:
            figure_files.write_png(path, poster.draw(figure))
        else:
            path.unlink(missing_ok=True)  # a figure of earlier runs
        figures.append(
            {
                "name": figure.name,
                "design": figure.design,
                "missing": figure.missing,
                "rows": [
                    map_grids.grid_values(row.grid, row.title, row.form, MAP_SIDE) | {"captions": row.captions}
                    for row in figure.rows
                ],
            }
        )
    return figures


def _swatch(style: Mapping) -> dict[str, str]:
    """The line style of a strategy for SVG."""
    dash = style["linestyle"]
    return {
        "colour": "currentColor" if style["color"] == figure_files.INK else style["color"],
        "dashes": "none" if dash == "-" else " ".join(f"{1.4 * length:g}" for length in dash[1]),
    }


def _dates(results: Results) -> str:
    """First and last day (UTC) on which runs were finished, from the times of their files."""
    finished = [
        run.path.stat().st_mtime
        for scene in results.plan.scenes
        for runs in results.runs(scene).values()
        for run in runs.values()
    ]
    first, last = (time.strftime("%Y-%m-%d", time.gmtime(moment)) for moment in (min(finished), max(finished)))
    return first if first == last else f"{first} to {last}"
