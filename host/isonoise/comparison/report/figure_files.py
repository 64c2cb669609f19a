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
"""Colour of the baseline and of all text; `inline_svg` replaces it by the page's text colour."""

RC = {"font.size": 9, "font.family": "sans-serif", "svg.fonttype": "none", "axes.linewidth": 0.6}


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
