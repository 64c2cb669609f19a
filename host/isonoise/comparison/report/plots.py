"""Plots of a scene: error and efficiency of the strategies against time and against samples; called by `page`."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from isonoise.comparison.report.axes import draw_frame, set_log_scale, tick_number, tick_percent
from isonoise.comparison.report.figure_files import INK
from isonoise.comparison.report.wave_series import WaveSeries
from isonoise.comparison.report_tables import strategy_titles

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Quantity:
    """What a plot shows: `curve` of summary.json's `curves`, or with `is_efficiency` 1 / (curve * abscissa)."""

    name: str
    curve: str
    label: str
    form: Callable[[float], str]
    is_efficiency: bool = False


QUANTITIES = (
    Quantity("rms-p99", "rms_p99", "RMS relative error over the seeds, p99", tick_percent),
    Quantity("rel-mse", "rel_mse", "relMSE, mean over the seeds", tick_number),
    Quantity("efficiency", "rel_mse", "efficiency, 1 / (relMSE · {})", tick_number, is_efficiency=True),
)
ABSCISSAE = {"time": ("seconds of rendering", "s"), "spp": ("samples per pixel", "spp")}
"""Abscissa -> label of its axis, unit."""

ACCENT = "#d62839"
COLOURS = ("#3b82c4", "#e08a1e", "#3fa34d", "#b05cc6", "#1fa6a6", "#c2557a", "#8a8f2e", "#7a6ad8")
DASHES = ("-", (0, (5, 1.5)), (0, (1.2, 1.2)), (0, (5, 1.5, 1.2, 1.5)))
MAX_BANDS = 4
"""With more curves only baseline and default show their confidence bands."""

LABEL_SIZE = 8.0
"""Points of the names beside the curves."""
MAX_LABEL_CHARACTERS = 26
"""Longer names are broken into lines."""

MIN_RANGE = 4.0
"""The part before the warm-up is left out if the rest of the axis spans this factor."""


@dataclass(frozen=True)
class Line:
    """A strategy's line in a plot, and its 95 % band."""

    slug: str
    x: np.ndarray
    y: np.ndarray
    low: np.ndarray
    high: np.ndarray


def curve_lines(
    scene: Mapping, series: Mapping[str, WaveSeries], quantity: Quantity, abscissa: str
) -> tuple[list[Line], float]:
    """Lines of a scene of summary.json, and the abscissa where the first strategy's warm-up ends.

    `series` maps slugs to the waves of the strategies; `abscissa` is a key of `ABSCISSAE`.
    """
    lines, starts = [], []
    for row in scene["rows"]:
        waves = series[row["strategy"]]
        curve = {key: np.array(values, np.float64) for key, values in row["curves"][quantity.curve].items()}
        x = curve["time"] if abscissa == "time" else waves.spp_at(curve["time"])
        y, low, high = (curve[key] for key in ("error", "low", "high"))
        if quantity.is_efficiency:
            with np.errstate(divide="ignore"):
                y, high, low = (1 / (each * x) for each in (y, low, high))
        lines.append(Line(row["strategy"], x, y, low, high))
        if row["warm_up_spp"]:
            starts.append((waves.elapsed_s if abscissa == "time" else waves.spp)[waves.first])
    first, last = min(line.x[0] for line in lines), max(line.x[-1] for line in lines)
    start = max(min(starts, default=first), first)
    return lines, start if last / start >= MIN_RANGE else first


def curve_plot(
    summary: Mapping, scene: Mapping, series: Mapping[str, WaveSeries], quantity: Quantity, abscissa: str
) -> "Figure":
    """A quantity of all strategies of a scene, log-log, with 95 % bands over the seeds.

    The axes show the part after the warm-up. The lines of baseline and default strategy are bold; names stand at the
    lines' ends. Parameters as for `curve_lines`.
    """
    from matplotlib.figure import Figure

    lines, start = curve_lines(scene, series, quantity, abscissa)
    bold = {summary["baseline"], summary["default"]}
    styles, titles = line_styles(summary), strategy_titles(summary)
    labels = {line.slug: break_name(titles[line.slug]) for line in lines}
    left, bottom, width, right, gap = 0.95, 0.5, 3.9, 0.6 + label_width(labels.values()), label_gap(labels.values())
    height = max(3.7, gap * len(lines))
    figure = Figure(figsize=(left + width + right, bottom + height + 0.12), dpi=150)
    axes = figure.add_axes(
        (
            left / figure.get_figwidth(),
            bottom / figure.get_figheight(),
            width / figure.get_figwidth(),
            height / figure.get_figheight(),
        )
    )
    for line in lines:
        is_bold = line.slug in bold
        style = styles[line.slug] | {"linewidth": 2.2 if is_bold else 1.0, "zorder": 4 if is_bold else 3}
        axes.plot(line.x, line.y, **style, marker="o" if len(line.x) < 9 else None, markersize=2.5)
        if len(lines) <= MAX_BANDS or is_bold:
            axes.fill_between(line.x, line.low, line.high, color=style["color"], alpha=0.13, linewidth=0)
    label, unit = ABSCISSAE[abscissa]
    axes.set_xlabel(label, color=INK)
    axes.set_ylabel(quantity.label.format(unit), color=INK)
    set_log_scale(axes, "x", start, max(line.x[-1] for line in lines), tick_number)
    set_log_scale(axes, "y", *_range_after(lines, start), quantity.form)  # bands of few seeds can be very wide
    draw_frame(axes)
    _label_ends(axes, lines, labels, styles, bold, gap / height)
    return figure


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


def break_name(title: str) -> str:
    """A strategy's name in lines of about `MAX_LABEL_CHARACTERS`, broken after colons and commas."""
    lines = [""]
    for part in (
        title.replace(",", ",\n").replace(":", ":\n").split("\n") if len(title) > MAX_LABEL_CHARACTERS else [title]
    ):
        if lines[-1] and len(lines[-1] + part) > MAX_LABEL_CHARACTERS:
            lines.append("")
        lines[-1] += part
    return "\n".join(lines)


def label_width(labels: Sequence[str]) -> float:
    """Inches of the widest line of the labels."""
    from matplotlib.textpath import TextPath

    lines = {line for label in labels for line in label.split("\n")}
    return max(TextPath((0, 0), line, LABEL_SIZE).get_extents().x1 for line in lines if line) / 72


def label_gap(labels: Sequence[str]) -> float:
    """Inches between the middles of neighbouring labels."""
    return (1.2 * max(label.count("\n") + 1 for label in labels) + 0.25) * LABEL_SIZE / 72


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


def _range_after(lines: Sequence[Line], start: float) -> tuple[float, float]:
    """Smallest and largest ordinate of the lines from `start` on, with their interpolated values there."""
    found = []
    for line in lines:
        positive = np.isfinite(line.y) & (line.y > 0)
        if positive.any():
            x, y = np.log(line.x[positive]), np.log(line.y[positive])
            found += [*np.exp(y[x >= np.log(start)]), float(np.exp(np.interp(np.log(start), x, y)))]
    return (min(found), max(found)) if found else (1.0, 1.0)


def _label_ends(
    axes, lines: Sequence[Line], labels: Mapping[str, str], styles: Mapping[str, dict], bold: set, gap: float
) -> None:
    """Write the names beside the ends of the lines, moved apart where they would overlap.

    `gap` is the height of a label as a share of the axes' height.
    """
    transform = axes.transData + axes.transAxes.inverted()
    lines = sorted((line for line in lines if np.isfinite(line.y[-1]) and line.y[-1] > 0), key=lambda line: line.y[-1])
    points = [transform.transform((line.x[-1], line.y[-1])) for line in lines]
    heights = spread_apart([y for _, y in points], gap, gap / 2, 1 - gap / 2)
    options = {"transform": axes.transAxes, "clip_on": False}
    for (x, y), height, line in zip(points, heights, lines, strict=True):
        style, is_bold = styles[line.slug], line.slug in bold
        axes.plot([x, 1.045, 1.06], [y, height, height], **options, color=style["color"], linewidth=0.5, alpha=0.6)
        axes.plot([1.06, 1.12], [height, height], **options, **style, linewidth=2.2 if is_bold else 1.2)
        axes.text(
            1.13,
            height,
            labels[line.slug],
            transform=axes.transAxes,
            va="center",
            fontsize=LABEL_SIZE,
            color=INK,
        )
