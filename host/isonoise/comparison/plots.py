"""Pictures of a comparison: error against time, and maps of sample counts and errors."""

import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from isonoise.comparison.columns import number, percent
from isonoise.film.files import write_atomically

if TYPE_CHECKING:
    from matplotlib.figure import Figure

METRICS = {
    "rms_p99": ("RMS relative error over the seeds, p99", percent),
    "rel_mse": ("relMSE, mean over the seeds", number),
}
"""Curves of the summary: their axis label and how its ticks are written."""

INK = "#010203"
"""Colour of the baseline and of all text: a mark that stands for the page's own text colour in SVG."""

ACCENT = "#d62839"
COLOURS = ("#3b82c4", "#e08a1e", "#3fa34d", "#b05cc6", "#1fa6a6", "#c2557a", "#8a8f2e", "#7a6ad8")
DASHES = ("-", (0, (5, 1.5)), (0, (1.2, 1.2)), (0, (5, 1.5, 1.2, 1.5)))
BANDS = 6  # up to so many curves, each shows its band; of more, the two that matter

LABEL = 30
"""Characters of a name that fit beside the curves; longer ones are written smaller."""

RC = {"font.size": 9, "font.family": "sans-serif", "svg.fonttype": "none", "axes.linewidth": 0.6}


@dataclass(frozen=True)
class Map:
    """One picture of a grid: `values` (height, width), positive, all of one scale."""

    title: str
    values: np.ndarray


@dataclass(frozen=True)
class MapGrid:
    """Maps of one scene in one colour scale from `low` to `high`, logarithmic; `colours` is matplotlib's name."""

    maps: Sequence[Map]
    low: float
    high: float
    colours: str


DECADES = 2.5
"""Most powers of ten that a map of errors shows below its largest: pixels without noise would stretch it for ever."""


def sample_maps(counts: Mapping[str, np.ndarray]) -> MapGrid:
    """`counts`: title -> samples of every pixel. The scale leaves out a thousandth of a map's pixels at either end."""
    maps = [Map(title, np.maximum(count, 1).astype(np.float64)) for title, count in counts.items()]
    ends = np.array([np.quantile(m.values, (0.001, 0.999)) for m in maps])
    return MapGrid(maps, *_spread(ends[:, 0].min(), ends[:, 1].max()), "viridis")


def error_maps(errors: Mapping[str, np.ndarray]) -> MapGrid:
    """`errors`: title -> RMS relative error of every pixel. The scale leaves out a hundredth at either end."""
    together = np.concatenate([image.ravel() for image in errors.values()])
    noisy = together[together > 0]
    low, high = np.quantile(noisy, (0.01, 0.99)) if noisy.size else (1.0, 1.0)
    low = max(low, high / 10**DECADES)
    return MapGrid([Map(title, image) for title, image in errors.items()], *_spread(low, high), "magma")


def error_plot(summary: Mapping, scene: Mapping, metric: str) -> "Figure":
    """Error against time, both logarithmic, of all strategies of a scene, with 95 % bands over the seeds.

    `metric`: a key of `METRICS`. Baseline and default strategy are bold; labels stand at the lines' ends.
    """
    from matplotlib.figure import Figure
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    label, form = METRICS[metric]
    figure = Figure(figsize=(7.2, 4.8), dpi=150)
    axes = figure.add_axes((0.1, 0.1, 0.56, 0.88))
    axes.set(xscale="log", yscale="log")
    bold = {summary["baseline"], summary["default"]}
    titles = {strategy["slug"]: strategy["title"] for strategy in summary["strategies"]}
    styles = line_styles(summary)
    ends, bands = [], []
    for row in scene["rows"]:
        name = row["strategy"]
        curve = {key: np.array(values, dtype=float) for key, values in row["curves"][metric].items()}
        style = styles[name] | {"linewidth": 2.2 if name in bold else 1.0, "zorder": 4 if name in bold else 3}
        axes.plot(
            curve["time"], curve["error"], **style, marker="o" if len(curve["time"]) < 9 else None, markersize=2.5
        )
        if len(scene["rows"]) <= BANDS or name in bold:
            bands.append((curve["time"], curve["low"], curve["high"], style["color"]))
        ends.append((curve["time"][-1], curve["error"][-1], titles[name], style, name in bold))
    axes.set_ylim(axes.get_ylim())  # of the lines: bands of few seeds may go anywhere
    for time, low, high, colour in bands:
        axes.fill_between(time, low, high, color=colour, alpha=0.13, linewidth=0)
    axes.set_xlabel("seconds of rendering", color=INK)
    axes.set_ylabel(label, color=INK)
    for axis, write in ((axes.xaxis, number), (axes.yaxis, form)):
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


def grid_figure(grid: MapGrid, caption: str, form=number) -> "Figure":
    """The maps side by side with one colour bar."""
    from matplotlib.figure import Figure

    across = min(5, len(grid.maps))
    down = -(-len(grid.maps) // across)
    height, width = grid.maps[0].values.shape
    figure = Figure(figsize=(2.1 * across, (2.1 * height / width + 0.25) * down + 0.6), dpi=130, layout="compressed")
    axes = figure.subplots(down, across, squeeze=False)
    for place in axes.flat:
        place.axis("off")
    for place, drawn in zip(axes.flat, grid.maps, strict=False):
        draw_map(place, drawn, grid)
    draw_scale(figure, axes, grid, caption, form, location="bottom", aspect=60, shrink=0.6)
    return figure


def draw_map(axes, drawn: Map, grid: MapGrid) -> None:
    """One map of a grid, with its title, in matplotlib's `axes`."""
    from matplotlib.colors import LogNorm

    norm = LogNorm(grid.low, grid.high)
    axes.imshow(np.maximum(drawn.values, grid.low), norm=norm, cmap=grid.colours, interpolation="nearest")
    axes.set_title(drawn.title, fontsize=8)
    axes.set(xticks=[], yticks=[])


def draw_scale(figure: "Figure", axes, grid: MapGrid, caption: str, form=number, **how) -> None:
    """The colour bar of a grid beside `axes`; `how` goes to matplotlib's `colorbar`."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LogNorm

    bar = figure.colorbar(ScalarMappable(LogNorm(grid.low, grid.high), grid.colours), ax=axes, **how)
    bar.set_label(caption)
    bar.ax.minorticks_off()
    ticks = nice_ticks(grid.low, grid.high)
    bar.set_ticks(ticks, labels=[form(value, 1) for value in ticks])


def map_png(drawn: Map, grid: MapGrid, longest: int = 256) -> bytes:
    """One map as a small PNG: its own pixels, or means of blocks of them where a side is over `longest`."""
    from matplotlib import colormaps
    from PIL import Image

    levels = 64  # enough to the eye on noise, and half the size of 256
    values = np.maximum(shrink(drawn.values, longest), grid.low)
    share = np.log(values / grid.low) / np.log(grid.high / grid.low)
    picture = Image.fromarray(np.clip(share * (levels - 1) + 0.5, 0, levels - 1).astype(np.uint8), mode="P")
    picture.putpalette(
        (colormaps[grid.colours](np.linspace(0, 1, levels))[:, :3] * 255).round().astype(np.uint8).tobytes()
    )
    return png_bytes(picture)


def shrink(values: np.ndarray, longest: int) -> np.ndarray:
    """Means of k by k blocks, k the smallest with both sides at most `longest`; what is left at the edge is cut off."""
    k = -(-max(values.shape[:2]) // longest)
    height, width = (side // k * k for side in values.shape[:2])
    blocks = values[:height, :width].reshape(height // k, k, width // k, k, *values.shape[2:])
    return blocks.mean(axis=(1, 3))


def png_bytes(picture) -> bytes:
    """A PIL image as the bytes of a PNG file."""
    stream = io.BytesIO()
    picture.save(stream, format="PNG", optimize=True)
    return stream.getvalue()


def write_figure(path: Path, figure: "Figure") -> None:
    """Write a figure as a PNG of 256 colours, whole or not at all."""
    import matplotlib
    from PIL import Image

    stream = io.BytesIO()
    with matplotlib.rc_context(RC):
        figure.savefig(stream, format="png", facecolor="white")
    picture = Image.open(stream).convert("RGB")
    picture = picture.quantize(256, Image.Quantize.MAXCOVERAGE)  # others merge the rare colours at the end of a scale
    write_atomically(path, lambda temporary: temporary.write_bytes(png_bytes(picture)))


def inline_svg(figure: "Figure", name: str) -> str:
    """A figure as an `<svg>` element to stand in a page: text and baseline in the page's colour, ids of its own."""
    import matplotlib

    stream = io.StringIO()
    with matplotlib.rc_context(RC | {"svg.hashsalt": name}):
        figure.savefig(stream, format="svg", transparent=True, metadata={"Date": None})
    svg = stream.getvalue()
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg[svg.index("<svg") :], flags=re.DOTALL)
    svg = re.sub(r'(\bid="|url\(#|href="#)', rf"\g<1>{name}-", svg)
    return svg.replace(INK, "currentColor")


def nice_ticks(low: float, high: float) -> list[float]:
    """Numbers 1, 2 or 5 times a power of ten between `low` and `high`; if there are more than eight, powers alone."""
    powers = range(int(np.floor(np.log10(low))), int(np.ceil(np.log10(high))) + 1)
    for digits in ((1, 2, 5), (1,)):
        ticks = [digit * 10.0**power for power in powers for digit in digits if low <= digit * 10.0**power <= high]
        if len(ticks) <= 8:
            break
    return ticks


def colour_stops(grid: MapGrid, count: int = 12) -> list[str]:
    """The colour map's colours, evenly spaced, as CSS writes them."""
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    return [to_hex(colormaps[grid.colours](share)) for share in np.linspace(0, 1, count)]


def line_styles(summary: Mapping) -> dict[str, dict]:
    """Colour and dashes by strategy, the same in all plots."""
    styles = {summary["baseline"]: {"color": INK, "linestyle": "-"}}
    if summary["default"] not in (None, summary["baseline"]):
        styles[summary["default"]] = {"color": ACCENT, "linestyle": "-"}
    others = [s["slug"] for s in summary["strategies"] if s["slug"] not in styles]
    for i, name in enumerate(others):
        dash = DASHES[i // len(COLOURS) % len(DASHES)]
        styles[name] = {"color": COLOURS[i % len(COLOURS)], "linestyle": dash}
    return styles


def _label_ends(axes, ends: Sequence[tuple]) -> None:
    """Names beside the ends of the lines, best at the bottom, moved apart where they would touch."""
    transform = axes.transData + axes.transAxes.inverted()
    ends = sorted((end for end in ends if np.isfinite(end[1])), key=lambda end: end[1])
    points = [transform.transform((time, error)) for time, error, *_ in ends]
    apart = 11.5 / (axes.figure.get_figheight() * 72 * axes.get_position().height)
    heights = _spread_apart([y for _, y in points], apart)
    for (x, y), at, (_, _, title, style, bold) in zip(points, heights, ends, strict=True):
        axes.plot(
            [x, 1.045, 1.06],
            [y, at, at],
            transform=axes.transAxes,
            clip_on=False,
            color=style["color"],
            linewidth=0.5,
            alpha=0.6,
        )
        line = {**style, "linewidth": 2.2 if bold else 1.2}
        axes.plot([1.06, 1.12], [at, at], transform=axes.transAxes, clip_on=False, **line)
        axes.text(
            1.13,
            at,
            title,
            transform=axes.transAxes,
            va="center",
            fontsize=min(8.0, 8.0 * LABEL / len(title)),
            color=INK,
            weight="bold" if bold else "normal",
        )


def _spread_apart(heights: Sequence[float], apart: float, low: float = 0.0, high: float = 1.0) -> list[float]:
    """Rising heights, moved as little as it takes to be `apart` and between `low` and `high`, if they fit there.

    Those that touch form a block; a block lies where the squares of its moves are least.
    """
    blocks: list[tuple[float, list[float]]] = []  # first height of a block, and what its members want that to be
    for height in heights:
        wanted = [height]
        while True:
            first = max(min(sum(wanted) / len(wanted), high - apart * (len(wanted) - 1)), low)
            if not blocks or blocks[-1][0] + apart * len(blocks[-1][1]) <= first:
                break
            before = blocks.pop()[1]
            wanted = before + [w - apart * len(before) for w in wanted]
        blocks.append((first, wanted))
    return [first + apart * i for first, wanted in blocks for i in range(len(wanted))]


def _spread(low: float, high: float) -> tuple[float, float]:
    """A scale that is not empty."""
    return (float(low), float(high)) if high > low * 1.001 else (float(low) / 1.1, float(high) * 1.1)
