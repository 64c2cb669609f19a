"""Plot of a scene: stated against true errors after every wave; called by `page`."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from isonoise.comparison.report.axes import draw_frame, set_log_scale, tick_number, tick_percent
from isonoise.comparison.report.figure_files import INK
from isonoise.comparison.report.plots import LABEL_SIZE, label_width, line_styles
from isonoise.comparison.report.wave_series import QUANTILES, WaveSeries
from isonoise.comparison.report_tables import strategy_titles

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WIDTH = 8.6
"""Inches of the figure."""


def calibration_plot(summary: Mapping, scene: Mapping, series: Mapping[str, WaveSeries]) -> "Figure":
    """Stated against true errors (above) and their ratio against the samples (below), a column per quantile.

    Each point is a wave after the warm-up, geometric mean over the seeds. Where the stated error is right the lines lie
    on the dashed line. `series` maps slugs to the waves of the strategies. Those without stated errors are left out.
    """
    from matplotlib.figure import Figure

    shown = [row["strategy"] for row in scene["rows"] if series[row["strategy"]].has_stated_errors]
    figure = Figure(figsize=(WIDTH, 5.6), dpi=150, layout="constrained")
    panels = figure.subplots(2, len(QUANTILES), squeeze=False)
    styles, bold = line_styles(summary), {summary["baseline"], summary["default"]}
    for (above, below), quantile in zip(panels.T, QUANTILES, strict=True):
        errors, ratios, samples = [], [], []
        for slug in shown:
            waves = series[slug]
            true, stated, spp = (a[waves.first :] for a in (waves.true[quantile], waves.stated[quantile], waves.spp))
            marker = {"marker": "o" if len(spp) < 30 else None, "markersize": 2}
            style = styles[slug] | marker | {"linewidth": 1.8 if slug in bold else 1.0}
            above.plot(true, stated, **style)
            below.plot(spp, stated / true, **style)
            errors += [true, stated]
            ratios.append(stated / true)
            samples.append(spp)
        low, high = _limits(errors)
        above.plot([low, high], [low, high], color=INK, linewidth=0.8, linestyle=(0, (4, 3)))
        below.axhline(1, color=INK, linewidth=0.8, linestyle=(0, (4, 3)))
        for which in "xy":
            set_log_scale(above, which, low, high, tick_percent)
        set_log_scale(below, "x", *_limits(samples), tick_number)
        set_log_scale(below, "y", *_limits([*ratios, np.ones(1)]), tick_number)
        above.set_title(quantile, color=INK, fontsize=10)
        above.set_xlabel("true relative error", color=INK)
        below.set_xlabel("samples per pixel", color=INK)
        for axes in (above, below):
            draw_frame(axes)
            axes.tick_params(axis="x", labelrotation=0, labelsize=8)
            axes.tick_params(axis="y", labelsize=8)
    panels[0, 0].set_ylabel("stated relative error", color=INK)
    panels[1, 0].set_ylabel("stated / true", color=INK)
    _draw_legend(figure, [(strategy_titles(summary)[slug], styles[slug], slug in bold) for slug in shown])
    return figure


def _draw_legend(figure: "Figure", entries: Sequence[tuple[str, Mapping, bool]]) -> None:
    """Write the strategies' names below the plots, in as many columns as there is room for."""
    from matplotlib.lines import Line2D

    lines = [Line2D([], [], **style, linewidth=1.8 if is_bold else 1.0) for _, style, is_bold in entries]
    titles = [title for title, _, _ in entries]
    columns = max(1, int((WIDTH - 0.3) / (label_width(titles) + 0.6)))
    figure.legend(
        lines,
        titles,
        loc="outside lower center",
        ncols=min(columns, len(titles)),
        frameon=False,
        fontsize=LABEL_SIZE,
        labelcolor=INK,
    )


def _limits(arrays: Sequence[np.ndarray]) -> tuple[float, float]:
    values = np.concatenate(arrays)
    values = values[np.isfinite(values) & (values > 0)]
    return (float(values.min()), float(values.max())) if values.size else (1.0, 1.0)
