"""The figures of the method's poster, made anew from the finished runs of a comparison.

Pajot, Barthe, Paulin, "Robust adaptive sampling for Monte-Carlo-based rendering", SIGGRAPH Asia 2011 Posters, 49:1.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from isonoise.comparison import metrics, plots
from isonoise.comparison.columns import SCENE_COLUMNS, number, percent, two
from isonoise.comparison.results import Results, Run
from isonoise.strategies.registry import DEFAULT_STRATEGY

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Design:
    """What a figure shows: rows of maps of one scene, a panel a strategy.

    `panels`: spec -> title. `rows`: of `rms` (over the seeds), `single` (the error of one run) and `samples`.
    `heads`: the table's columns whose figures stand under the maps of `rms`. `ideal`: whether the row `rms` ends with
    what an image with the same error in every pixel would show.
    """

    title: str
    look: str
    scene: str
    panels: Mapping[str, str]
    rows: Sequence[str]
    heads: Sequence[str]
    ideal: bool = False


@dataclass(frozen=True)
class Row:
    """Maps side by side in one scale; `form` writes its numbers; `figures`: lines of text that stand under each map."""

    caption: str
    grid: plots.MapGrid
    form: Callable[..., str]
    figures: Sequence[Sequence[str]]


@dataclass(frozen=True)
class PosterFigure:
    """A figure as it came out; without rows where `missing` says which runs there have to be first."""

    name: str
    design: Design
    rows: Sequence[Row]
    missing: str


THREE = ("RMS p99", "relMSE", "image mean")

DESIGNS = (
    Design(
        title="Bright spots: noise relative to the mean, or to the median",
        look="A bright outlier raises a pixel's standard error and its mean together, so that e_a never exceeds 1. The "
        "medians of small groups stay where they were: e_m grows, and the samples follow. Look at the image mean too: "
        "samples that follow outliers dilute them, and the image becomes darker than it should be.",
        scene="bright-spots",
        panels={
            "relative-mean": "e_a, relative to the mean",
            "relative-median": "e_m, relative to the median",
            "relative-median:kappa=inf,batch=1": "e_m as the poster writes it",
            "relative-median:kappa=inf,batch=1,literal=true": "e_m read literally: the variance",
        },
        rows=("rms", "samples"),
        heads=THREE,
    ),
    Design(
        title="Penumbra: adaptive waves alone, or in turn with uniform ones",
        look="A pixel whose first samples agree by chance looks finished. Without uniform waves in between nothing "
        "finds that out: look in the single run for pixels and patches that stand out from what surrounds them.",
        scene="penumbra",
        panels={
            "uniform": "uniform",
            "relative-mean:ratio=inf": "e_a, without alternation",
            "relative-median:ratio=inf": "e_m, without alternation",
            "relative-median": "e_m, with alternation",
            DEFAULT_STRATEGY: "the default",
        },
        rows=("single", "rms"),
        heads=THREE,
    ),
    Design(
        title="The test scene: where the noise is left",
        look="The more even a map, the better the noise is spread; p99/p50 says how even, in brackets what it is where "
        "all pixels have the same error. So few seeds scatter themselves: the last map is drawn, with the same error "
        "in every pixel, and is as even as a map of these seeds can be.",
        scene="cornell",
        panels={
            "uniform": "uniform",
            "tsallis": "Tsallis, q = 2",
            "tsallis:q=1": "Tsallis, q = 1 (Shannon)",
            "relative-median": "e_m",
            DEFAULT_STRATEGY: "the default",
        },
        rows=("rms",),
        heads=(*THREE, "p99/p50"),
        ideal=True,
    ),
)
"""In the poster's order. e_a and e_m are the names that it gives to the measures."""


def poster_figures(results: Results, summary: Mapping) -> list[PosterFigure]:
    """The figures, from the seeds that the tables are from; `summary` is that of `summarise`."""
    return [_figure(f"poster-{k}", design, results, summary) for k, design in enumerate(DESIGNS, start=1)]


def draw(figure: PosterFigure) -> "Figure":
    """A figure with rows as one picture; its numbers stand under the maps."""
    from matplotlib.figure import Figure

    across = max(len(row.grid.maps) for row in figure.rows)
    height, width = figure.rows[0].grid.maps[0].values.shape
    lines = sum(2 + max(map(len, row.figures)) for row in figure.rows)
    drawn = Figure(
        figsize=(2.1 * across + 1, 2.1 * height / width * len(figure.rows) + 0.13 * lines + 0.3),
        dpi=130,
        layout="constrained",
    )
    drawn.suptitle(figure.design.title, fontsize=11, weight="bold")
    axes = drawn.subplots(len(figure.rows), across, squeeze=False)
    for k, (places, row) in enumerate(zip(axes, figure.rows, strict=True)):
        for place, shown, figures in zip(places, row.grid.maps, row.figures, strict=True):
            plots.draw_map(place, shown if k == 0 else replace(shown, title=""), row.grid)
            place.set_xlabel("\n".join(figures), fontsize=7.5)
        plots.draw_scale(drawn, list(places), row.grid, row.caption, row.form, location="right", aspect=25)
    return drawn


def _figure(name: str, design: Design, results: Results, summary: Mapping) -> PosterFigure:
    scene = next((s for s in summary["scenes"] if s["name"] == design.scene), None)
    if scene is None:
        return PosterFigure(name, design, (), f"no run of {design.scene} is finished")
    if not scene["rows"]:
        return PosterFigure(name, design, (), f"no seed of {design.scene} is finished with every strategy")
    of_slug = {row["strategy"]: row for row in scene["rows"]}
    table = {s["spec"]: of_slug[s["slug"]] for s in results.strategies if s["slug"] in of_slug}
    absent = [spec for spec in design.panels if spec not in table]
    if absent:
        return PosterFigure(name, design, (), f"no run of {design.scene} is finished with {', '.join(absent)}")
    found = results.runs(scene["slug"])
    runs = {spec: [found[table[spec]["strategy"]][seed] for seed in scene["seeds"]] for spec in design.panels}
    return PosterFigure(name, design, _rows(design, scene, table, runs), "")


def _rows(design: Design, scene: Mapping, table: Mapping, runs: Mapping[str, Sequence[Run]]) -> list[Row]:
    seeds, titles = scene["seeds"], list(design.panels.values())
    final = {spec: np.stack([run.errors[-1] for run in of]) for spec, of in runs.items()}
    rows = {}
    if "single" in design.rows:
        images = [np.abs(errors[0], dtype=np.float64) for errors in final.values()]
        lasts = [of[0].rows[-1] for of in runs.values()]
        under = [[f"p99 {percent(last['true_p99'])}", f"worst {percent(last['true_max'])}"] for last in lasts]
        rows["single"] = (f"error, seed {seeds[0]}", _maps(titles, images), percent, under)
    if "rms" in design.rows:
        images = [metrics.rms_over_seeds(errors) for errors in final.values()]
        columns = [column for head in design.heads for column in SCENE_COLUMNS if column.head == head]
        under = [_lines(columns, table[spec], scene) for spec in design.panels]
        maps = _maps(titles, images)
        if design.ideal:
            drawn, lines = _ideal(table[DEFAULT_STRATEGY]["rms"]["p50"], len(seeds), images[0].shape)
            maps, under = [*maps, drawn], [*under, lines]
        rows["rms"] = (f"RMS error, {len(seeds)} seed{'s' * (len(seeds) != 1)}", maps, percent, under)
    scale = plots.error_maps({(kind, m.title): m.values for kind, (_, maps, *_) in rows.items() for m in maps})
    made = {kind: Row(text, replace(scale, maps=maps), form, under) for kind, (text, maps, form, under) in rows.items()}
    if "samples" in design.rows:
        counts = [of[0].count for of in runs.values()]
        under = [[f"{count.min():,} to {count.max():,}", f"mean {number(count.mean())}"] for count in counts]
        made["samples"] = Row(
            f"samples, seed {seeds[0]}", plots.sample_maps(dict(zip(titles, counts, strict=True))), number, under
        )
    return [made[kind] for kind in design.rows]


def _maps(titles: Sequence[str], images: Sequence[np.ndarray]) -> list[plots.Map]:
    return [plots.Map(title, image) for title, image in zip(titles, images, strict=True)]


def _lines(columns: Sequence, row: Mapping, scene: Mapping) -> list[str]:
    """What the table has in these columns, a line each."""
    cells = [(column.head, column.cell(row, scene)) for column in columns]
    return [f"{head} {cell.text} {cell.detail}".rstrip() for head, cell in cells]


def _ideal(median: float, seeds: int, shape: tuple[int, int]) -> tuple[plots.Map, list[str]]:
    """RMS over the seeds where every pixel has the same normal error, distributed like sqrt(chi^2_S / S)."""
    level = median / np.sqrt(metrics.chi_square_quantile(0.5, seeds))
    values = level * np.sqrt(np.random.default_rng(0).chisquare(seeds, shape))
    lines = ["drawn, at the default's p50", f"p99/p50 {two(metrics.perfect_uniformity(seeds))}"]
    return plots.Map("the same error everywhere", values), lines
