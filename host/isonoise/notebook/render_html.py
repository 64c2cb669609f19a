"""The HTML that a notebook shows of a render: facts, image, error map, sample map, error curve and layers.

Called by `Outcome._repr_html_` and `WaveRecord._repr_html_`.
"""

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np

from isonoise.error.stated_error import relative_standard_error
from isonoise.film.log import LogRow
from isonoise.notebook.error_curve import error_curve, svg_data_uri
from isonoise.notebook.figures import image_figure, map_figure, page
from isonoise.notebook.pictures import INFERNO, VIRIDIS
from isonoise.progress import format_number, format_percent
from isonoise.statistics import Statistics

NO_LAYERS: Mapping[str, np.ndarray] = MappingProxyType({})


def render_html(
    facts: str,
    statistics: Statistics,
    floor: float,
    rows: Sequence[LogRow] = (),
    target: float | None = None,
    layers: Mapping[str, np.ndarray] = NO_LAYERS,
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
    layers : mapping of str to array
        Further layers of the image, by name.
    """
    figures = [
        image_figure("image", statistics.rgb),
        map_figure("standard error of the pixels", relative_standard_error(statistics, floor), INFERNO, format_percent),
        map_figure("samples per pixel", statistics.count, VIRIDIS, format_number),
    ]
    if curve := error_curve(rows, target):
        picture = f'<img src="{svg_data_uri(curve)}" alt="stated error against time" style="max-width:100%"/>'
        figures.append(f'<figure style="margin:0">{picture}</figure>')
    if layers:
        from isonoise.notebook.layer_figures import layer_figure  # renders without layers do not need it

        figures += [layer_figure(name, layers[name]) for name in layers]
    return page(facts, figures)
