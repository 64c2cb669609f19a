"""Figures of matplotlib as files, and as SVG in the page; called by `page`."""

import io
import re
from pathlib import Path
from typing import TYPE_CHECKING

from isonoise.comparison.report.map_grids import png_bytes
from isonoise.film.files import write_atomically

if TYPE_CHECKING:
    from matplotlib.figure import Figure

INK = "#010203"
"""Colour of the baseline and of all text; `page_svg` replaces it by the page's text colour."""

RC = {"font.size": 9, "font.family": "sans-serif", "axes.linewidth": 0.6, "svg.fonttype": "none", "pdf.fonttype": 42}
"""Settings of all figures: text stays text in SVG, and fonts are embedded in PDF."""


def figure_settings():
    """The context in which figures are drawn and written."""
    import matplotlib

    return matplotlib.rc_context(RC)


def write_png(path: Path, figure: "Figure") -> None:
    """Write a figure atomically as a PNG with 256 colours."""
    from PIL import Image

    picture = Image.open(io.BytesIO(_saved(figure, "png", facecolor="white"))).convert("RGB")
    picture = picture.quantize(256, Image.Quantize.MAXCOVERAGE)  # keeps the rare colours at the ends of a scale
    write_atomically(path, lambda temporary: temporary.write_bytes(png_bytes(picture)))


def write_figure(path: Path, figure: "Figure") -> str:
    """Write a figure atomically as PATH.png, PATH.svg and PATH.pdf; return the text of the SVG file."""
    write_png(path.with_name(f"{path.name}.png"), figure)
    metadata = {"CreationDate": None}
    pdf = _saved(figure, "pdf", transparent=True, metadata=metadata)
    svg = _saved(figure, "svg", path.name, transparent=True, metadata={"Date": None})
    for content, ending in ((pdf, "pdf"), (svg, "svg")):
        write_atomically(
            path.with_name(f"{path.name}.{ending}"), lambda temporary, content=content: temporary.write_bytes(content)
        )
    return svg.decode("utf-8")


def page_svg(svg: str, name: str) -> str:
    """The `<svg>` element of an SVG file for a page: text and baseline in the page's colour, ids prefixed by `name`."""
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg[svg.index("<svg") :], flags=re.DOTALL)
    svg = re.sub(r'(\bid="|url\(#|href="#)', rf"\g<1>{name}-", svg)
    return svg.replace(INK, "currentColor")


def _saved(figure: "Figure", form: str, salt: str = "", **options) -> bytes:
    """The content of the figure's file; `salt` makes the ids in an SVG."""
    import matplotlib

    stream = io.BytesIO()
    with matplotlib.rc_context({"svg.hashsalt": salt}):
        figure.savefig(stream, format=form, **options)
    return stream.getvalue()
