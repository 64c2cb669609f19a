"""Plots of a comparison: error against time; called by `page`."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from isonoise.comparison.metric_columns import format_number, format_percent
from isonoise.comparison.report.figure_files import INK
from isonoise.comparison.report_tables import strategy_titles

if TYPE_CHECKING:
    from matplotlib.figure import Figure

METRICS = {
    "rms_p99": ("RMS relative error over the seeds, p99", format_percent),
    "rel_mse": ("relMSE, mean over the seeds", format_number),
}
"""Curves of summary.json: label of the axis, format of its ticks."""

ACCENT = "#d62839"
COLOURS = ("#3b82c4", "#e08a1e", "#3fa34d", "#b05cc6", "#1fa6a6", "#c2557a", "#8a8f2e", "#7a6ad8")
DASHES = ("-", (0, (5, 1.5)), (0, (1.2, 1.2)), (0, (5, 1.5, 1.2, 1.5)))
MAX_BANDS = 6
"""With more curves only baseline and default show their confidence bands."""

MAX_LABEL_CHARACTERS = 30
"""Longer names beside the curves are set in a smaller font."""


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
