"""Figures of a comparison: error against time, maps of sample counts and errors; called by `report` and `poster`."""

import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from isonoise.comparison.metric_columns import format_number, format_percent
from isonoise.comparison.report_tables import strategy_titles
from isonoise.film.files import write_atomically

if TYPE_CHECKING:
    from matplotlib.figure import Figure

METRICS = {
    "rms_p99": ("RMS relative error over the seeds, p99", format_percent),
    "rel_mse": ("relMSE, mean over the seeds", format_number),
}
"""Curves of summary.json: label of the axis, format of its ticks."""

INK = "#010203"
"""Colour of the baseline and of all text; `inline_svg` replaces it by the page's text colour."""

ACCENT = "#d62839"
COLOURS = ("#3b82c4", "#e08a1e", "#3fa34d", "#b05cc6", "#1fa6a6", "#c2557a", "#8a8f2e", "#7a6ad8")
DASHES = ("-", (0, (5, 1.5)), (0, (1.2, 1.2)), (0, (5, 1.5, 1.2, 1.5)))
MAX_BANDS = 6
"""With more curves only baseline and default show their confidence bands."""

MAX_LABEL_CHARACTERS = 30
"""Longer names beside the curves are set in a smaller font."""

RC = {"font.size": 9, "font.family": "sans-serif", "svg.fonttype": "none", "axes.linewidth": 0.6}


@dataclass(frozen=True)
class Map:
    """One map: positive `values` (height, width)."""

    title: str
    values: np.ndarray


@dataclass(frozen=True)
class MapGrid:
    """Maps with a common logarithmic colour scale from `low` to `high`; `colours` is a colour map of matplotlib."""

    maps: Sequence[Map]
    low: float
    high: float
    colours: str


MAX_DECADES = 2.5
"""Range of an error map's scale: pixels without noise would extend it without limit."""


def sample_maps(counts: Mapping[str, np.ndarray]) -> MapGrid:
    """Maps of sample counts (title -> counts). The scale clips the extreme 0.1 % of a map's pixels at either end."""
    maps = [Map(title, np.maximum(count, 1).astype(np.float64)) for title, count in counts.items()]
    ends = np.array([np.quantile(m.values, (0.001, 0.999)) for m in maps])
    return MapGrid(maps, *_widen(ends[:, 0].min(), ends[:, 1].max()), "viridis")


def error_maps(errors: Mapping[str, np.ndarray]) -> MapGrid:
    """Maps of RMS relative errors (title -> errors). The scale clips the extreme 1 % of all pixels at either end."""
    all_errors = np.concatenate([image.ravel() for image in errors.values()])
    noisy = all_errors[all_errors > 0]
    low, high = np.quantile(noisy, (0.01, 0.99)) if noisy.size else (1.0, 1.0)
    low = max(low, high / 10**MAX_DECADES)
    return MapGrid([Map(title, image) for title, image in errors.items()], *_widen(low, high), "magma")


def error_plot(summary: Mapping, scene: Mapping, metric: str) -> "Figure":
    """Error against time, log-log, of all strategies of a scene, with 95 % bands over the seeds.

    `metric` is a key of `METRICS`. The lines of baseline and default strategy are bold; names stand at the lines' ends.
    """
    from matplotlib.figure import Figure
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    label, form = METRICS[metric]
    figure = Figure(figsize=(7.2, 4.8), dpi=150)
    axes = figure.add_axes((0.125, 0.1, 0.535, 0.88))
    axes.set(xscale="log", yscale="log")
    bold = {summary["baseline"], summary["default"]}
    titles = strategy_titles(summary)
    styles = line_styles(summary)
    ends, bands = [], []
    for row in scene["rows"]:
        name = row["strategy"]
        curve = {key: np.array(values, dtype=float) for key, values in row["curves"][metric].items()}
        style = styles[name] | {"linewidth": 2.2 if name in bold else 1.0, "zorder": 4 if name in bold else 3}
        axes.plot(
            curve["time"], curve["error"], **style, marker="o" if len(curve["time"]) < 9 else None, markersize=2.5
        )
        if len(scene["rows"]) <= MAX_BANDS or name in bold:
            bands.append((curve["time"], curve["low"], curve["high"], style["color"]))
        ends.append((curve["time"][-1], curve["error"][-1], titles[name], style, name in bold))
    axes.set_ylim(axes.get_ylim())  # fits the lines: bands of few seeds can be very wide
    for time, low, high, colour in bands:
        axes.fill_between(time, low, high, color=colour, alpha=0.13, linewidth=0)
    axes.set_xlabel("seconds of rendering", color=INK)
    axes.set_ylabel(label, color=INK)
    for axis, write in ((axes.xaxis, format_number), (axes.yaxis, form)):
        axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axis.set_minor_locator(NullLocator())
        axis.set_major_formatter(FuncFormatter(lambda value, _, write=write: write(value, 1)))
    axes.tick_params(colors=INK, width=0.6)
    axes.grid(color=INK, alpha=0.12, linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(INK)
    axes.patch.set_alpha(0)
    _label_ends(axes, ends)
    return figure


def grid_figure(grid: MapGrid, caption: str, form=format_number) -> "Figure":
    """The maps side by side with a common colour bar."""
    from matplotlib.figure import Figure

    column_count = min(5, len(grid.maps))
    row_count = -(-len(grid.maps) // column_count)
    height, width = grid.maps[0].values.shape
    figure = Figure(
        figsize=(2.1 * column_count, (2.1 * height / width + 0.25) * row_count + 0.6), dpi=130, layout="compressed"
    )
    axes = figure.subplots(row_count, column_count, squeeze=False)
    for panel in axes.flat:
        panel.axis("off")
    for panel, map_ in zip(axes.flat, grid.maps, strict=False):
        draw_map(panel, map_, grid)
    draw_colour_bar(figure, axes, grid, caption, form, location="bottom", aspect=60, shrink=0.6)
    return figure


def draw_map(axes, map_: Map, grid: MapGrid) -> None:
    """Draw one map of a grid and its title into `axes` of matplotlib."""
    from matplotlib.colors import LogNorm

    norm = LogNorm(grid.low, grid.high)
    axes.imshow(np.maximum(map_.values, grid.low), norm=norm, cmap=grid.colours, interpolation="nearest")
    axes.set_title(map_.title, fontsize=8)
    axes.set(xticks=[], yticks=[])


def draw_colour_bar(figure: "Figure", axes, grid: MapGrid, caption: str, form=format_number, **options) -> None:
    """Draw the colour bar of a grid beside `axes`; `options` are passed to matplotlib's `colorbar`."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LogNorm

    bar = figure.colorbar(ScalarMappable(LogNorm(grid.low, grid.high), grid.colours), ax=axes, **options)
    bar.set_label(caption)
    bar.ax.minorticks_off()
    ticks = nice_ticks(grid.low, grid.high)
    bar.set_ticks(ticks, labels=[form(value, 1) for value in ticks])


def map_png(map_: Map, grid: MapGrid, max_side: int = 256) -> bytes:
    """One map as a small PNG; larger maps than `max_side` pixels are reduced by means of blocks."""
    from matplotlib import colormaps
    from PIL import Image

    levels = 64  # looks the same on noise, with half the file size of 256
    values = np.maximum(shrink(map_.values, max_side), grid.low)
    position = np.log(values / grid.low) / np.log(grid.high / grid.low)
    picture = Image.fromarray(np.clip(position * (levels - 1) + 0.5, 0, levels - 1).astype(np.uint8), mode="P")
    picture.putpalette(
        (colormaps[grid.colours](np.linspace(0, 1, levels))[:, :3] * 255).round().astype(np.uint8).tobytes()
    )
    return png_bytes(picture)


def shrink(values: np.ndarray, max_side: int) -> np.ndarray:
    """Means of k by k blocks, with the least k that makes both sides at most `max_side`; incomplete blocks are cut."""
    k = -(-max(values.shape[:2]) // max_side)
    height, width = (side // k * k for side in values.shape[:2])
    blocks = values[:height, :width].reshape(height // k, k, width // k, k, *values.shape[2:])
    return blocks.mean(axis=(1, 3))


def png_bytes(picture) -> bytes:
    """A PIL image as the bytes of a PNG file."""
    stream = io.BytesIO()
    picture.save(stream, format="PNG", optimize=True)
    return stream.getvalue()


def write_figure(path: Path, figure: "Figure") -> None:
    """Write a figure atomically as a PNG with 256 colours."""
    import matplotlib
    from PIL import Image

    stream = io.BytesIO()
    with matplotlib.rc_context(RC):
        figure.savefig(stream, format="png", facecolor="white")
    picture = Image.open(stream).convert("RGB")
    picture = picture.quantize(256, Image.Quantize.MAXCOVERAGE)  # keeps the rare colours at the ends of a scale
    write_atomically(path, lambda temporary: temporary.write_bytes(png_bytes(picture)))


def inline_svg(figure: "Figure", name: str) -> str:
    """A figure as an `<svg>` element for a page: text and baseline in the page's colour, ids prefixed by `name`."""
    import matplotlib

    stream = io.StringIO()
    with matplotlib.rc_context(RC | {"svg.hashsalt": name}):
        figure.savefig(stream, format="svg", transparent=True, metadata={"Date": None})
    svg = stream.getvalue()
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg[svg.index("<svg") :], flags=re.DOTALL)
    svg = re.sub(r'(\bid="|url\(#|href="#)', rf"\g<1>{name}-", svg)
    return svg.replace(INK, "currentColor")


def nice_ticks(low: float, high: float) -> list[float]:
    """Ticks 1, 2, 5 times powers of ten from `low` to `high`; powers of ten alone if there are more than eight."""
    powers = range(int(np.floor(np.log10(low))), int(np.ceil(np.log10(high))) + 1)
    for digits in ((1, 2, 5), (1,)):
        ticks = [digit * 10.0**power for power in powers for digit in digits if low <= digit * 10.0**power <= high]
        if len(ticks) <= 8:
            break
    return ticks


def colour_stops(grid: MapGrid, count: int = 12) -> list[str]:
    """Evenly spaced colours of the grid's colour map, for CSS."""
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    return [to_hex(colormaps[grid.colours](position)) for position in np.linspace(0, 1, count)]


def line_styles(summary: Mapping) -> dict[str, dict]:
    """Colour and dashes by the strategy's slug, the same in all plots."""
    styles = {summary["baseline"]: {"color": INK, "linestyle": "-"}}
    if summary["default"] not in (None, summary["baseline"]):
        styles[summary["default"]] = {"color": ACCENT, "linestyle": "-"}
    others = [s["slug"] for s in summary["strategies"] if s["slug"] not in styles]
    for i, name in enumerate(others):
        dash = DASHES[i // len(COLOURS) % len(DASHES)]
        styles[name] = {"color": COLOURS[i % len(COLOURS)], "linestyle": dash}
    return styles


def _label_ends(axes, ends: Sequence[tuple]) -> None:
    """Write the names beside the ends of the lines, moved apart where they would overlap."""
    transform = axes.transData + axes.transAxes.inverted()
    ends = sorted((end for end in ends if np.isfinite(end[1])), key=lambda end: end[1])
    points = [transform.transform((time, error)) for time, error, *_ in ends]
    line_height = 11.5 / (axes.figure.get_figheight() * 72 * axes.get_position().height)
    heights = spread_apart([y for _, y in points], line_height)
    for (x, y), height, (_, _, title, style, bold) in zip(points, heights, ends, strict=True):
        axes.plot(
            [x, 1.045, 1.06],
            [y, height, height],
            transform=axes.transAxes,
            clip_on=False,
            color=style["color"],
            linewidth=0.5,
            alpha=0.6,
        )
        line = {**style, "linewidth": 2.2 if bold else 1.2}
        axes.plot([1.06, 1.12], [height, height], transform=axes.transAxes, clip_on=False, **line)
        axes.text(
            1.13,
            height,
            title,
            transform=axes.transAxes,
            va="center",
            fontsize=min(8.0, 8.0 * MAX_LABEL_CHARACTERS / len(title)),
            color=INK,
            weight="bold" if bold else "normal",
        )


def spread_apart(heights: Sequence[float], gap: float, low: float = 0.0, high: float = 1.0) -> list[float]:
    """Rising heights, moved as little as possible to be `gap` apart and between `low` and `high`, if they fit.

    Heights that touch form a block; a block is placed to minimise the sum of the squared moves.
    """
    blocks: list[tuple[float, list[float]]] = []  # first height of a block, first height that each member asks for
    for height in heights:
        wanted = [height]
        while True:
            first = max(min(sum(wanted) / len(wanted), high - gap * (len(wanted) - 1)), low)
            if not blocks or blocks[-1][0] + gap * len(blocks[-1][1]) <= first:
                break
            before = blocks.pop()[1]
            wanted = before + [w - gap * len(before) for w in wanted]
        blocks.append((first, wanted))
    return [first + gap * i for first, wanted in blocks for i in range(len(wanted))]


def _widen(low: float, high: float) -> tuple[float, float]:
    """Widens an empty range, which no logarithmic scale can show."""
    return (float(low), float(high)) if high > low * 1.001 else (float(low) / 1.1, float(high) * 1.1)
