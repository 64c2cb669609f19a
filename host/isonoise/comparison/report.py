"""What a comparison ends with: tables, pictures and a self-contained report.html, all made from the finished runs."""

import base64
import time
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path

import numpy as np

from isonoise.comparison import metrics, plots, poster
from isonoise.comparison.columns import SCENE_COLUMNS, SINGLE_COLUMNS, number, percent
from isonoise.comparison.presets import POSTER
from isonoise.comparison.results import Results
from isonoise.comparison.summary import summarise, write_summary
from isonoise.comparison.tables import BELOW_REFERENCE, TIME_METRICS, scene_tables, short_table, time_table
from isonoise.errors import UserError
from isonoise.film.files import write_atomically

LONGEST = 256
"""Pixels of a map's longer side in the page."""


def write_report(directory: Path) -> None:
    """Make waves.csv, summary.json, tables.md, plots/*.png and report.html below `directory`, each whole or not at all.

    Raises UserError if there is nothing to report, or a file cannot be read or written.
    """
    directory = Path(directory)
    results = Results(directory)
    summary = summarise(directory)
    shown = [scene for scene in summary["scenes"] if scene["rows"]]
    if not shown:
        raise UserError(f"nothing to report in '{directory}': no seed is finished with every strategy that was begun")
    write_summary(directory, summary)
    try:
        (directory / "plots").mkdir(exist_ok=True)
    except OSError as error:
        raise UserError(f"cannot write into '{directory}': {error.strerror}") from error
    titles = {strategy["slug"]: strategy["title"] for strategy in summary["strategies"]}
    page = _template().render(
        summary=summary,
        scenes=[_scene(results, summary, scene) for scene in shown],
        poster=_poster(results, summary),
        across=[*(time_table(summary, metric) for metric in TIME_METRICS), short_table(summary)],
        columns=[*SCENE_COLUMNS, *SINGLE_COLUMNS],
        below_reference=BELOW_REFERENCE,
        dates=_dates(results),
        devices=sorted({device for scene in shown for device in scene["devices"]}),
        roles={titles[summary[role]]: role for role in ("default", "baseline") if summary[role]},
        swatches={titles[slug]: _swatch(style) for slug, style in plots.line_styles(summary).items()},
        descriptions={titles[row["strategy"]]: row["description"] for scene in shown for row in scene["rows"]},
    )
    write_atomically(directory / "report.html", lambda temporary: temporary.write_text(page, encoding="utf-8"))


def _template():
    from jinja2 import Environment, StrictUndefined

    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    environment.filters |= {"number": number, "percent": percent}
    return environment.from_string(files("isonoise.comparison").joinpath("report.html.j2").read_text(encoding="utf-8"))


def _poster(results: Results, summary: Mapping) -> list[dict]:
    """What the page shows of the poster's figures, if they are wanted; they are written below plots/ too."""
    shown = []
    for figure in poster.poster_figures(results, summary) if results.plan.get("preset") == POSTER else ():
        path = results.directory / "plots" / f"{figure.name}.png"
        if figure.rows:
            plots.write_figure(path, poster.draw(figure))
        else:
            path.unlink(missing_ok=True)  # of other runs
        shown.append(
            {
                "name": figure.name,
                "design": figure.design,
                "missing": figure.missing,
                "rows": [
                    _shown_grid(row.grid, row.caption, row.form) | {"figures": row.figures} for row in figure.rows
                ],
            }
        )
    return shown


def _scene(results: Results, summary: Mapping, scene: Mapping) -> dict:
    """What the page shows of a scene; its pictures are written below plots/ too."""
    from markupsafe import Markup
    from PIL import Image

    from isonoise.film.png import tone_map

    slug = scene["slug"]
    folder = results.directory / "plots"
    planned = next(entry for entry in results.scenes if entry["slug"] == slug)
    picture = Image.fromarray(tone_map(results.reference(planned).rgb))
    write_atomically(folder / f"{slug}-reference.png", lambda temporary: picture.save(temporary, format="PNG"))
    curves = []
    for metric in plots.METRICS:
        name = f"{slug}-{metric.replace('_', '-')}"
        figure = plots.error_plot(summary, scene, metric)
        plots.write_figure(folder / f"{name}.png", figure)
        curves.append(Markup(plots.inline_svg(figure, name)))
    grids = []
    for name, (grid, caption, form) in _grids(results, summary, scene).items():
        plots.write_figure(folder / f"{slug}-{name}.png", plots.grid_figure(grid, caption, form))
        grids.append(_shown_grid(grid, caption, form))
    table, single = scene_tables(summary, scene)
    picture.thumbnail((2 * LONGEST, 2 * LONGEST))
    return {
        "slug": slug,
        "table": table,
        "single": single,
        "reference": _data_uri(plots.png_bytes(picture)),
        "curves": curves,
        "grids": grids,
    }


def _grids(results: Results, summary: Mapping, scene: Mapping) -> dict[str, tuple]:
    """Grids of maps with their caption and how their scale is written, by the name of the file."""
    titles = {strategy["slug"]: strategy["title"] for strategy in summary["strategies"]}
    counts, errors = {}, {}
    for strategy, runs in results.runs(scene["slug"]).items():
        chosen = [runs[seed] for seed in scene["seeds"]]
        counts[titles[strategy]] = chosen[0].count
        errors[titles[strategy]] = metrics.rms_over_seeds(np.stack([run.errors[-1] for run in chosen]))
    samples = f"samples in every pixel, seed {scene['seeds'][0]}"
    return {
        "samples": (plots.sample_maps(counts), samples, number),
        "errors": (plots.error_maps(errors), "RMS relative error over the seeds", percent),
    }


def _shown_grid(grid: plots.MapGrid, caption: str, form) -> dict:
    span = np.log(grid.high / grid.low)
    return {
        "caption": caption,
        "maps": [(m.title, _data_uri(plots.map_png(m, grid, LONGEST))) for m in grid.maps],
        "colours": plots.colour_stops(grid),
        "ticks": [
            (form(t, 1), 100 * float(np.log(t / grid.low) / span)) for t in plots.nice_ticks(grid.low, grid.high)
        ],
    }


def _swatch(style: Mapping) -> dict[str, str]:
    """How the strategy's line looks, for SVG."""
    dash = style["linestyle"]
    return {
        "colour": "currentColor" if style["color"] == plots.INK else style["color"],
        "dashes": "none" if dash == "-" else " ".join(f"{1.4 * length:g}" for length in dash[1]),
    }


def _dates(results: Results) -> str:
    """The days, UTC, on which the runs were finished: those of their files."""
    finished = [
        run.path.stat().st_mtime
        for scene in results.scenes
        for runs in results.runs(scene["slug"]).values()
        for run in runs.values()
    ]
    first, last = (time.strftime("%Y-%m-%d", time.gmtime(moment)) for moment in (min(finished), max(finished)))
    return first if first == last else f"{first} to {last}"


def _data_uri(png: bytes) -> str:
    return "data:image/png;base64," + base64.b64encode(png).decode("ascii")
