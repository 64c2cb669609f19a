"""Figures in the HTML of a notebook cell: pictures with text below them, side by side.

Called by `render_html` and `layer_figures`. Styles are inline and pictures are data URIs, so that a saved notebook
needs no other file.
"""

import html
from collections.abc import Callable, Sequence

import numpy as np

from isonoise.notebook.pictures import (
    MAX_SIDE,
    MIN_WIDTH,
    ColourScale,
    css_gradient,
    image_picture,
    map_picture,
)

FormatValue = Callable[[float], str]
"""Makes the text of a value."""
ROW_STYLE = "display:flex;flex-wrap:wrap;gap:12px;align-items:flex-start;margin:6px 0"
FIGURE_STYLE = "margin:0;flex:0 1 {width}px;min-width:160px"
CAPTION_STYLE = "font-size:85%;margin-top:2px"


def page(facts: str, figures: Sequence[str]) -> str:
    """A line of text above figures, which are side by side as far as there is room."""
    return f'<div><div>{html.escape(facts)}</div><div style="{ROW_STYLE}">{"".join(figures)}</div></div>'


def image_figure(name: str, rgb: np.ndarray, exposure: float | None = None) -> str:
    """Linear RGB with its name and size below it. `exposure` is a factor, None: by the image's brightness."""
    height, width = rgb.shape[:2]
    reduced = f", shown reduced to {MAX_SIDE} pixels" if max(width, height) > MAX_SIDE else ""
    return picture_figure(image_picture(rgb, exposure), name, f"{name}, {width}x{height}{reduced}", width)


def map_figure(title: str, values: np.ndarray, colours: str, format_value: FormatValue) -> str:
    """A map, with its colours and their values below it."""
    picture, scale = map_picture(values, colours)
    return _figure(picture, title, _legend(title, scale, colours, format_value), values.shape[1])


def picture_figure(picture: str, alt: str, caption: str, width: int) -> str:
    """A picture of an image of this width in pixels, with text below it; `alt` is its text for screen readers."""
    return _figure(picture, alt, html.escape(caption), width)


def _figure(picture: str, alt: str, caption: str, pixels: int) -> str:
    """As `picture_figure`, with a caption that is HTML."""
    width = min(max(pixels, MIN_WIDTH), MAX_SIDE)
    rendering = "image-rendering:pixelated;" if pixels < width else ""
    return (
        f'<figure style="{FIGURE_STYLE.format(width=width)}">'
        f'<img src="{picture}" alt="{html.escape(alt)}" style="{rendering}width:100%;display:block"/>'
        f'<figcaption style="{CAPTION_STYLE}">{caption}</figcaption></figure>'
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
