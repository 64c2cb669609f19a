"""The HTML that a notebook shows of a render: facts, image, error map, sample map and error curve.

Called by `Outcome._repr_html_` and `WaveRecord._repr_html_`. Styles are inline and pictures are data URIs, so that a
saved notebook needs no other file.
"""

import html
from collections.abc import Callable, Sequence

import numpy as np

from isonoise.error.stated_error import relative_standard_error
from isonoise.film.log import LogRow
from isonoise.notebook.error_curve import error_curve, svg_data_uri
from isonoise.notebook.pictures import (
    INFERNO,
    MAX_SIDE,
    MIN_WIDTH,
    VIRIDIS,
    ColourScale,
    css_gradient,
    image_picture,
    map_picture,
)
from isonoise.progress import format_number, format_percent
from isonoise.statistics import Statistics

FormatValue = Callable[[float], str]
"""Makes the text of a value."""
ROW_STYLE = "display:flex;flex-wrap:wrap;gap:12px;align-items:flex-start;margin:6px 0"
FIGURE_STYLE = "margin:0;flex:0 1 {width}px;min-width:160px"
CAPTION_STYLE = "font-size:85%;margin-top:2px"


def render_html(
    facts: str, statistics: Statistics, floor: float, rows: Sequence[LogRow] = (), target: float | None = None
) -> str:
    """Return HTML of a render.

    Parameters
    ----------
    facts : str
        A line of text above the pictures.
    statistics : Statistics
        Of all samples.
    floor : float
        Relative errors divide by max(luminance, floor).
    rows : sequence of LogRow
        The log, for the error curve; none: no curve.
    target : float or None
        The error that ends the render, a line in the curve.
    """
    figures = [
        image_figure(statistics.rgb),
        map_figure("standard error of the pixels", relative_standard_error(statistics, floor), INFERNO, format_percent),
        map_figure("samples per pixel", statistics.count, VIRIDIS, format_number),
    ]
    if curve := error_curve(rows, target):
        picture = f'<img src="{svg_data_uri(curve)}" alt="stated error against time" style="max-width:100%"/>'
        figures.append(f'<figure style="margin:0">{picture}</figure>')
    return page(facts, figures)


def page(facts: str, figures: Sequence[str]) -> str:
    """A line of text above figures, which are side by side as far as there is room."""
    return f'<div><div>{html.escape(facts)}</div><div style="{ROW_STYLE}">{"".join(figures)}</div></div>'


def image_figure(rgb: np.ndarray) -> str:
    """The image, with its size below it."""
    height, width = rgb.shape[:2]
    reduced = f", shown reduced to {MAX_SIDE} pixels" if max(width, height) > MAX_SIDE else ""
    return _figure(image_picture(rgb), "image", f"image, {width}x{height}{reduced}", width)


def map_figure(title: str, values: np.ndarray, colours: str, format_value: FormatValue) -> str:
    """A map, with its colours and their values below it."""
    picture, scale = map_picture(values, colours)
    return _figure(picture, title, _legend(title, scale, colours, format_value), values.shape[1], is_html=True)


def _figure(picture: str, alt: str, caption: str, pixels: int, is_html: bool = False) -> str:
    width = min(max(pixels, MIN_WIDTH), MAX_SIDE)
    rendering = "image-rendering:pixelated;" if pixels < width else ""
    text = caption if is_html else html.escape(caption)
    return (
        f'<figure style="{FIGURE_STYLE.format(width=width)}">'
        f'<img src="{picture}" alt="{html.escape(alt)}" style="{rendering}width:100%;display:block"/>'
        f'<figcaption style="{CAPTION_STYLE}">{text}</figcaption></figure>'
    )


def _legend(title: str, scale: ColourScale, colours: str, format_value: FormatValue) -> str:
    """Title, and the values at both ends of a bar of colours; a single value if there is only one."""
    low, high = (html.escape(format_value(value)) for value in (scale.low, scale.high))
    if scale.low == scale.high and not (scale.has_lower or scale.has_higher):
        return f"{html.escape(title)}: {high}"
    bar = f'<span style="flex:1;height:0.8em;background:{css_gradient(colours)}"></span>'
    kind = ", logarithmic" if scale.is_log else ""
    values = f"<span>{'≤ ' * scale.has_lower}{low}</span>{bar}<span>{'≥ ' * scale.has_higher}{high}</span>"
    return f'{html.escape(title)}{kind}<div style="display:flex;gap:6px;align-items:center">{values}</div>'
