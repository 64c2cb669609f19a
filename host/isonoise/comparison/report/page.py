"""Writes the results of a comparison from its finished runs: tables, plots and a self-contained report.html."""

import base64
import time
from collections.abc import Iterator, Mapping
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from isonoise.comparison import metrics
from isonoise.comparison.metric_columns import (
    SCENE_COLUMNS,
    SINGLE_IMAGE_COLUMNS,
    format_number,
    format_percent,
    shown_columns,
)
from isonoise.comparison.presets import POSTER
from isonoise.comparison.report import figure_files, map_grids, plots, poster
from isonoise.comparison.report.calibration import calibration_plot
from isonoise.comparison.report.wave_series import WaveSeries, read_wave_series
from isonoise.comparison.report_tables import (
    NOISY_REFERENCE,
    scene_table,
    single_image_table,
    strategy_titles,
    tables_across_scenes,
)
from isonoise.comparison.results import Results
from isonoise.comparison.summary import summarise, write_summary
from isonoise.comparison.timing import worker_table
from isonoise.errors import UserError
from isonoise.film.files import write_atomically

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MAP_SIDE = 256
"""Maximum side of a map in the page, in pixels."""


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
    with figure_files.figure_settings():
        scene_sections, poster_figures = (
            [_scene(results, summary, scene) for scene in scenes],
            _poster(results, summary),
        )
    page = _template().render(
        style=Markup(_asset("page.css")),
        script=Markup(_asset("tables.js")),
        summary=summary,
        scenes=scene_sections,
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
    environment.filters |= {"percent": format_percent}
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
                "rows": [_grid(row.grid, row.title, row.form) | {"captions": row.captions} for row in figure.rows],
            }
        )
    return figures


def _scene(results: Results, summary: Mapping, scene: Mapping) -> dict:
    """A scene for the template; also writes its pictures to plots/."""
    from markupsafe import Markup
    from PIL import Image

    from isonoise.film.png import tone_map

    slug = scene["slug"]
    folder = results.directory / "plots"
    picture = Image.fromarray(tone_map(results.reference(results.plan.scene(slug)).rgb))
    write_atomically(folder / f"{slug}-reference.png", lambda temporary: picture.save(temporary, format="PNG"))
    series = {
        strategy: read_wave_series([runs[seed] for seed in scene["seeds"]])
        for strategy, runs in results.runs(results.plan.scene(slug)).items()
    }
    curves = []
    for name, figure in figures(summary, scene, series):
        svg = figure_files.write_figure(folder / name, figure)
        curves.append(Markup(figure_files.page_svg(svg, name)))
    grids = []
    for name, (grid, title, form) in _map_grids(results, summary, scene).items():
        figure_files.write_png(folder / f"{slug}-{name}.png", map_grids.grid_figure(grid, title, form))
        grids.append(_grid(grid, title, form))
    picture.thumbnail((2 * MAP_SIDE, 2 * MAP_SIDE))
    return {
        "slug": slug,
        "table": scene_table(summary, scene),
        "single_images": single_image_table(summary, scene),
        "reference": _data_uri(map_grids.png_bytes(picture)),
        "curves": curves,
        "grids": grids,
    }


def figures(summary: Mapping, scene: Mapping, series: Mapping[str, WaveSeries]) -> "Iterator[tuple[str, Figure]]":
    """The plots of a scene, each with the name of its files."""
    slug = scene["slug"]
    for quantity in plots.QUANTITIES:
        for abscissa in plots.ABSCISSAE:
            name = f"{slug}-{quantity.name}" + ("" if abscissa == "time" else f"-{abscissa}")
            yield name, plots.curve_plot(summary, scene, series, quantity, abscissa)
    yield f"{slug}-calibration", calibration_plot(summary, scene, series)


def _map_grids(results: Results, summary: Mapping, scene: Mapping) -> dict[str, tuple]:
    """Grids of maps by the name of their file, each with its title and the format of its scale."""
    titles = strategy_titles(summary)
    counts, errors = {}, {}
    for strategy, runs in results.runs(results.plan.scene(scene["slug"])).items():
        used = [runs[seed] for seed in scene["seeds"]]
        counts[titles[strategy]] = used[0].count
        errors[titles[strategy]] = metrics.rms_over_seeds(np.stack([run.errors[-1] for run in used]))
    samples = f"samples per pixel, seed {scene['seeds'][0]}"
    return {
        "samples": (map_grids.sample_maps(counts), samples, format_number),
        "errors": (map_grids.error_maps(errors), "RMS relative error over the seeds", format_percent),
    }


def _grid(grid: map_grids.MapGrid, title: str, form) -> dict:
    """A grid of maps for the template."""
    span = np.log(grid.high / grid.low)
    return {
        "title": title,
        "maps": [(m.title, _data_uri(map_grids.map_png(m, grid, MAP_SIDE))) for m in grid.maps],
        "colours": map_grids.colour_stops(grid),
        "ticks": [
            (form(t, 1), 100 * float(np.log(t / grid.low) / span)) for t in map_grids.nice_ticks(grid.low, grid.high)
        ],
    }


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


def _data_uri(png: bytes) -> str:
    return "data:image/png;base64," + base64.b64encode(png).decode("ascii")
