"""The figures of the poster, reproduced from the finished runs of a comparison; called by `page`.

Pajot, Barthe, Paulin, "Robust adaptive sampling for Monte-Carlo-based rendering", SIGGRAPH Asia 2011 Posters, 49:1.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from isonoise.comparison import metrics
from isonoise.comparison.metric_columns import SCENE_COLUMNS, format_number, format_percent, format_ratio
from isonoise.comparison.report import map_grids
from isonoise.comparison.results import Results, Run
from isonoise.strategies.registry import DEFAULT_STRATEGY

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Design:
    """Layout of a figure: rows of maps of one scene, one panel per strategy.

    `panels` maps specs to titles. `rows` names the rows of maps: `rms` (over the seeds), `single` (error of one run),
    `samples`. `heads` are the columns of the tables whose figures stand below the maps of `rms`. With `has_ideal` the
    row `rms` ends with a simulated map of equal errors in all pixels.
    """

    title: str
    explanation: str
    scene: str
    panels: Mapping[str, str]
    rows: Sequence[str]
    heads: Sequence[str]
    has_ideal: bool = False


@dataclass(frozen=True)
class Row:
    """Maps side by side with a common scale; `form` formats its numbers, `captions` are lines of text per map."""

    title: str
    grid: map_grids.MapGrid
    form: Callable[..., str]
    captions: Sequence[Sequence[str]]


@dataclass(frozen=True)
class PosterFigure:
    """A figure, or no rows if runs are missing; `missing` then says which."""

    name: str
    design: Design
    rows: Sequence[Row]
    missing: str


INTERVAL = re.compile(r" \([^)]*\u2013[^)]*\)")
"""An interval in a cell of a table; captions have no room for it."""
MAIN_HEADS = ("RMS p99", "relMSE", "image mean")

DESIGNS = (
    Design(
        title="Bright spots: noise relative to the mean, or to the median",
        explanation="A bright outlier raises a pixel's standard error and its mean together, so e_a never exceeds 1. "
        "The medians of small groups do not change: e_m grows, and the pixel gets more samples. Compare the image "
        "means, too: samples that follow outliers dilute them, and the image becomes darker than it should be.",
        scene="bright-spots",
        panels={
            "relative-mean": "e_a, relative to the mean",
            "relative-median": "e_m, relative to the median",
            "relative-median:kappa=inf,batch=1": "e_m, definition of the poster",
            "relative-median:kappa=inf,batch=1,literal=true": "e_m, literal: the variance",
        },
        rows=("rms", "samples"),
        heads=MAIN_HEADS,
    ),
    Design(
        title="Penumbra: adaptive waves alone, or alternating with uniform ones",
        explanation="If the first samples of a pixel agree by chance, its error estimate is too small. Without uniform "
        "waves in between this is not corrected: in the single run such pixels and patches stand out from their "
        "neighbours.",
        scene="penumbra",
        panels={
            "uniform": "uniform",
            "relative-mean:ratio=inf": "e_a, without alternation",
            "relative-median:ratio=inf": "e_m, without alternation",
            "relative-median": "e_m, with alternation",
            DEFAULT_STRATEGY: "the default",
        },
        rows=("single", "rms"),
        heads=MAIN_HEADS,
    ),
    Design(
        title="The test scene: distribution of the remaining noise",
        explanation="The more uniform a map, the more uniform the noise. p99/p50 measures it. In brackets is its value "
        "for equal errors in all pixels; it is not 1, because the RMS of a few seeds varies by itself. The last map is "
        "simulated with equal errors in all pixels: no map of these seeds can be more uniform.",
        scene="cornell",
        panels={
            "uniform": "uniform",
            "tsallis": "Tsallis, q = 2",
            "tsallis:q=1": "Tsallis, q = 1 (Shannon)",
            "relative-median": "e_m",
            DEFAULT_STRATEGY: "the default",
        },
        rows=("rms",),
        heads=(*MAIN_HEADS, "p99/p50"),
        has_ideal=True,
    ),
)
"""In the order of the poster. e_a and e_m are its names of the measures."""


def poster_figures(results: Results, summary: Mapping) -> list[PosterFigure]:
    """The figures, from the seeds that the tables use; `summary` comes from `summarise`."""
    return [_figure(f"poster-{k}", design, results, summary) for k, design in enumerate(DESIGNS, start=1)]


def draw(figure: PosterFigure) -> "Figure":
    """A figure with rows as one picture; its numbers stand below the maps."""
    from matplotlib.figure import Figure

    column_count = max(len(row.grid.maps) for row in figure.rows)
    height, width = figure.rows[0].grid.maps[0].values.shape
    text_lines = sum(2 + max(map(len, row.captions)) for row in figure.rows)
    drawing = Figure(
        figsize=(2.1 * column_count + 1, 2.1 * height / width * len(figure.rows) + 0.13 * text_lines + 0.3),
        dpi=130,
        layout="constrained",
    )
    drawing.suptitle(figure.design.title, fontsize=11, weight="bold")
    axes = drawing.subplots(len(figure.rows), column_count, squeeze=False)
    for k, (panels, row) in enumerate(zip(axes, figure.rows, strict=True)):
        for panel, map_, captions in zip(panels, row.grid.maps, row.captions, strict=True):
            map_grids.draw_map(panel, map_ if k == 0 else replace(map_, title=""), row.grid)
            panel.set_xlabel("\n".join(captions), fontsize=7.5)
        map_grids.draw_colour_bar(drawing, list(panels), row.grid, row.title, row.form, location="right", aspect=25)
    return drawing


def _figure(name: str, design: Design, results: Results, summary: Mapping) -> PosterFigure:
    scene = next((s for s in summary["scenes"] if s["name"] == design.scene), None)
    if scene is None:
        return PosterFigure(name, design, (), f"no run of {design.scene} is finished")
    if not scene["rows"]:
        return PosterFigure(name, design, (), f"no seed of {design.scene} is finished with every strategy")
    by_slug = {row["strategy"]: row for row in scene["rows"]}
    by_spec = {s.spec: by_slug[s.slug] for s in results.plan.strategies if s.slug in by_slug}
    missing = [spec for spec in design.panels if spec not in by_spec]
    if missing:
        return PosterFigure(name, design, (), f"no run of {design.scene} is finished with {', '.join(missing)}")
    finished = results.runs(results.plan.scene(scene["slug"]))
    runs = {spec: [finished[by_spec[spec]["strategy"]][seed] for seed in scene["seeds"]] for spec in design.panels}
    return PosterFigure(name, design, _rows(design, scene, by_spec, runs), "")


def _rows(design: Design, scene: Mapping, by_spec: Mapping, runs: Mapping[str, Sequence[Run]]) -> list[Row]:
    seeds, titles = scene["seeds"], list(design.panels.values())
    final = {spec: np.stack([run.errors[-1] for run in seed_runs]) for spec, seed_runs in runs.items()}
    error_rows = {}
    if "single" in design.rows:
        images = [np.abs(errors[0], dtype=np.float64) for errors in final.values()]
        last = [seed_runs[0].rows[-1] for seed_runs in runs.values()]
        captions = [[f"p99 {format_percent(r['true_p99'])}", f"worst {format_percent(r['true_max'])}"] for r in last]
        error_rows["single"] = (f"error, seed {seeds[0]}", _maps(titles, images), captions)
    if "rms" in design.rows:
        images = [metrics.rms_over_seeds(errors) for errors in final.values()]
        columns = [column for head in design.heads for column in SCENE_COLUMNS if column.head == head]
        captions = [
            [INTERVAL.sub("", f"{c.head} {c.cell(by_spec[spec], scene)}") for c in columns] for spec in design.panels
        ]
        maps = _maps(titles, images)
        if design.has_ideal:
            ideal, lines = _ideal_map(by_spec[DEFAULT_STRATEGY]["rms"]["p50"], len(seeds), images[0].shape)
            maps, captions = [*maps, ideal], [*captions, lines]
        error_rows["rms"] = (f"RMS error, {len(seeds)} seed{'s' * (len(seeds) != 1)}", maps, captions)
    scale = map_grids.error_maps({(kind, m.title): m.values for kind, (_, maps, _) in error_rows.items() for m in maps})
    rows = {
        kind: Row(title, replace(scale, maps=maps), format_percent, captions)
        for kind, (title, maps, captions) in error_rows.items()
    }
    if "samples" in design.rows:
        counts = [seed_runs[0].count for seed_runs in runs.values()]
        captions = [[f"{count.min():,} to {count.max():,}", f"mean {format_number(count.mean())}"] for count in counts]
        grid = map_grids.sample_maps(dict(zip(titles, counts, strict=True)))
        rows["samples"] = Row(f"samples, seed {seeds[0]}", grid, format_number, captions)
    return [rows[kind] for kind in design.rows]


def _maps(titles: Sequence[str], images: Sequence[np.ndarray]) -> list[map_grids.Map]:
    return [map_grids.Map(title, image) for title, image in zip(titles, images, strict=True)]


def _ideal_map(median: float, seeds: int, shape: tuple[int, int]) -> tuple[map_grids.Map, list[str]]:
    """Simulated RMS over the seeds for equal normal errors in all pixels, distributed like sqrt(chi^2_S / S)."""
    level = median / np.sqrt(metrics.chi_square_quantile(0.5, seeds))
    values = level * np.sqrt(np.random.default_rng(0).chisquare(seeds, shape))
    lines = ["simulated, with the default's p50", f"p99/p50 {format_ratio(metrics.ideal_uniformity(seeds))}"]
    return map_grids.Map("equal errors", values), lines
