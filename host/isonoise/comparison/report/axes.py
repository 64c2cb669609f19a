"""Axes of the report's plots: logarithmic scales with readable ticks, the same colours in all plots."""

from collections.abc import Callable

import numpy as np

from isonoise.comparison.metric_columns import format_number
from isonoise.comparison.report.figure_files import INK
from isonoise.comparison.report.map_grids import nice_ticks

MARGIN = 0.04
"""Empty part of an axis at each end, as a share of the values' range."""

DIGITS = (1, 1.5, 2, 3, 4, 5, 6, 8)
"""First digits of the ticks of axes that span less than about a power of ten."""


def set_log_scale(axes, which: str, low: float, high: float, form: Callable[[float], str]) -> None:
    """Give the axis `which`, "x" or "y", a logarithmic scale that shows the values from `low` to `high`."""
    from matplotlib.ticker import FixedFormatter, FixedLocator, NullLocator

    if not 0 < low < high * (1 - 1e-3):
        low, high = (low / 1.1, high * 1.1) if low > 0 else (0.1, 1.0)
    margin = (high / low) ** MARGIN
    low, high = low / margin, high * margin
    ticks = _ticks(low, high)
    axes.set(**{f"{which}scale": "log", f"{which}lim": (low, high)})
    axis = getattr(axes, f"{which}axis")
    axis.set_minor_locator(NullLocator())
    axis.set_major_locator(FixedLocator(ticks))
    axis.set_major_formatter(FixedFormatter([form(tick) for tick in ticks]))


def draw_frame(axes) -> None:
    """Colours, grid and frame of a plot."""
    axes.tick_params(colors=INK, width=0.6)
    axes.grid(color=INK, alpha=0.12, linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(INK)
    axes.patch.set_alpha(0)


def tick_number(value: float) -> str:
    """Text of a tick: up to four significant digits."""
    text = format_number(value, 4)
    return text.rstrip("0").rstrip(".") if "." in text and "e" not in text else text


def tick_percent(value: float) -> str:
    return f"{tick_number(100 * value)} %"


def _ticks(low: float, high: float) -> list[float]:
    """Ticks of a logarithmic axis: 1, 2, 5 times powers of ten, or more of them if these are fewer than three."""
    from matplotlib.ticker import MaxNLocator

    powers = 10.0 ** np.arange(np.floor(np.log10(low)), np.ceil(np.log10(high)))
    even = MaxNLocator(5, steps=[1, 2, 5, 10]).tick_values(low, high)
    candidates = (nice_ticks(low, high), np.outer(powers, DIGITS).ravel(), even)
    for ticks in candidates:
        inside = [float(tick) for tick in ticks if low <= tick <= high]
        if len(inside) >= 3:
            break
    return inside
