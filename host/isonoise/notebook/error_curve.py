"""The stated error against the time of a render as an SVG picture, with logarithmic axes. Called by `render_html`."""

import base64
import html
import math
from collections.abc import Sequence
from dataclasses import dataclass

from isonoise.film.log import LogRow
from isonoise.progress import format_number

WIDTH, HEIGHT = 440, 260
LEFT, RIGHT, TOP, BOTTOM = 58, 100, 14, 40
"""Margins for the labels of the axes and, on the right, of the lines."""
LABEL_DISTANCE = 14
"""Least distance of two labels at the ends of lines, in pixels."""
TEXT, GRID, TARGET = "#333333", "#dddddd", "#d62728"
COLOURS = {
    "stated_p50": "#7fb8da",
    "stated_p95": "#4292c6",
    "stated_p99": "#08519c",
    "error_bound": "#8c564b",
    "true_p99": "#000000",
}
LABELS = {
    "stated_p50": "median",
    "stated_p95": "p95",
    "stated_p99": "p99",
    "error_bound": "bound",
    "true_p99": "true p99",
}


@dataclass(frozen=True)
class _Axis:
    """A logarithmic axis from `low` to `high`, drawn from pixel `begin` to pixel `end`."""

    low: float
    high: float
    begin: float
    end: float

    def pixel(self, value: float) -> float:
        share = math.log(value / self.low) / math.log(self.high / self.low)
        return self.begin + share * (self.end - self.begin)

    def ticks(self) -> list[float]:
        """Powers of ten, or with fewer than three of them also twice and five times as much."""
        decades = range(math.floor(math.log10(self.low)), math.ceil(math.log10(self.high)) + 1)
        for factors in ((1,), (1, 2, 5), (1, 1.5, 2, 3, 4, 5, 7)):
            values = [factor * 10.0**decade for decade in decades for factor in factors]
            values = [value for value in values if self.low <= value * (1 + 1e-9) and value <= self.high * (1 + 1e-9)]
            if len(values) >= 3:
                return values
        return values


def error_curve(rows: Sequence[LogRow], target: float | None = None) -> str:
    """Return an SVG file as text.

    Parameters
    ----------
    rows : sequence of LogRow
        The log of the render. Errors that are 0 or not finite are left out.
    target : float or None
        The error that ends the render, drawn as a line.

    Returns
    -------
    str
        The stated errors at the quantiles of the log against the elapsed seconds; with a reference the true error at
        0.99, with a target its upper confidence bound. '' without a row that can be drawn.
    """
    lines = {name: points for name in LABELS if (points := _points(rows, name))}
    if not lines:
        return ""
    times = [x for points in lines.values() for x, _ in points]
    errors = [y for points in lines.values() for _, y in points] + ([target] if target else [])
    x_axis = _axis(times, LEFT, WIDTH - RIGHT)
    y_axis = _axis(errors, HEIGHT - BOTTOM, TOP)
    parts = [*_grid(x_axis, y_axis)]
    labels = []
    for name, points in lines.items():
        pixels = [(x_axis.pixel(x), y_axis.pixel(y)) for x, y in points]
        parts += _line(pixels, COLOURS[name])
        labels.append((pixels[-1][1], LABELS[name], COLOURS[name]))
    if target:
        y = y_axis.pixel(target)
        ends = f'x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{y:.1f}" y2="{y:.1f}"'
        parts.append(f'<line {ends} stroke="{TARGET}" stroke-dasharray="5 3"/>')
        labels.append((y, f"target {format_number(100 * target)} %", TARGET))
    parts += _labels(labels)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" width="{WIDTH}" height="{HEIGHT}" '
        f'font-family="sans-serif" font-size="11" fill="{TEXT}">'
        f'<rect width="{WIDTH}" height="{HEIGHT}" fill="#ffffff"/>{"".join(parts)}</svg>'
    )


def svg_data_uri(svg: str) -> str:
    """The picture as a data URI: viewers of notebooks that remove SVG elements keep images."""
    return f"data:image/svg+xml;base64,{base64.b64encode(svg.encode()).decode()}"


def _points(rows: Sequence[LogRow], name: str) -> list[tuple[float, float]]:
    if name == "true_p99":
        pairs = [(row.elapsed_s, row.true.p99) for row in rows if row.true is not None]
    else:
        pairs = [(row.elapsed_s, getattr(row, name)) for row in rows]
    return [(x, y) for x, y in pairs if x > 0 and 0 < y < math.inf]


def _axis(values: Sequence[float], begin: float, end: float) -> _Axis:
    """An axis that holds all values, at least a factor of 2 long, with a margin of 4 %."""
    low, high = min(values), max(values)
    factor = max(math.sqrt(2 * low / high), 1.0) * max(high / low, 2.0) ** 0.04
    return _Axis(low / factor, high * factor, begin, end)


def _grid(x_axis: _Axis, y_axis: _Axis) -> list[str]:
    parts = []
    for value in x_axis.ticks():
        x = f"{x_axis.pixel(value):.1f}"
        parts.append(f'<line x1="{x}" x2="{x}" y1="{TOP}" y2="{HEIGHT - BOTTOM}" stroke="{GRID}"/>')
        parts.append(f'<text x="{x}" y="{HEIGHT - BOTTOM + 15}" text-anchor="middle">{format_number(value)}</text>')
    for value in y_axis.ticks():
        y = y_axis.pixel(value)
        parts.append(f'<line x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{y:.1f}" y2="{y:.1f}" stroke="{GRID}"/>')
        label = f"{format_number(100 * value)} %"
        parts.append(f'<text x="{LEFT - 6}" y="{y + 4:.1f}" text-anchor="end">{label}</text>')
    centre = (LEFT + WIDTH - RIGHT) / 2
    parts.append(f'<text x="{centre}" y="{HEIGHT - 6}" text-anchor="middle">seconds of rendering</text>')
    middle = (TOP + HEIGHT - BOTTOM) / 2
    turned = f'transform="rotate(-90 12 {middle})"'
    parts.append(f'<text x="12" y="{middle + 4}" text-anchor="middle" {turned}>stated error</text>')
    return parts


def _line(pixels: Sequence[tuple[float, float]], colour: str) -> list[str]:
    path = " ".join(f"{x:.1f},{y:.1f}" for x, y in pixels)
    dots = [f'<circle cx="{x:.1f}" cy="{y:.1f}" r="2" fill="{colour}"/>' for x, y in pixels]
    return [f'<polyline points="{path}" fill="none" stroke="{colour}" stroke-width="1.6"/>', *dots]


def _labels(labels: Sequence[tuple[float, str, str]]) -> list[str]:
    """Labels at the right of the plot, moved apart so that none covers another."""
    parts, last = [], -math.inf
    ordered = sorted(labels)
    lowest = HEIGHT - BOTTOM + 4 - LABEL_DISTANCE * (len(ordered) - 1)
    for index, (y, text, colour) in enumerate(ordered):
        last = max(min(y + 4, lowest + LABEL_DISTANCE * index), last + LABEL_DISTANCE)
        x = WIDTH - RIGHT + 6
        parts.append(f'<rect x="{x}" y="{last - 8:.1f}" width="8" height="8" fill="{colour}"/>')
        parts.append(f'<text x="{x + 12}" y="{last:.1f}">{html.escape(text)}</text>')
    return parts
