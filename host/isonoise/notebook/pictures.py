"""Pictures in the HTML of a notebook cell: the image and maps of one number per pixel, as PNG data URIs.

Called by `render_html` and `watch`.
"""

import base64
import io
from typing import NamedTuple

import numpy as np

MAX_SIDE = 640
"""Larger pictures are reduced to this many pixels per side, so that a saved notebook stays small."""
MIN_WIDTH = 240
"""Smaller pictures are shown enlarged to about this many screen pixels."""
LOG_SCALE_RATIO = 10
"""A map's colours are on a logarithmic scale if it ends at more than this many times the value where it begins."""
SCALE_QUANTILES = (0.002, 0.998)
"""Quantiles of the positive values at which the scale of a map begins and ends, so that no few pixels decide it."""
MAX_SCALE_RATIO = 1000
"""A scale ends at most at so many times the value where it begins: some errors are mere rounding."""
VIRIDIS = "440154 472d7b 3b528b 2c728e 21918c 28ae80 5ec962 addc30 fde725"
INFERNO = "000004 210c4a 57106e 8a226a bc3754 e45a31 f98e09 f9cb35 fcffa4"
"""Nine colours, evenly spaced, of matplotlib's colour maps: both are uniform to the eye, also for colour-blind ones."""


class ColourScale(NamedTuple):
    """The values at the two ends of a map's colours, and how values are between them.

    `is_log`: colours follow the logarithm. `has_lower`, `has_higher`: some values are beyond the end and have its
    colour.
    """

    low: float
    high: float
    is_log: bool
    has_lower: bool
    has_higher: bool


def image_picture(rgb: np.ndarray, exposure: float | None = None) -> str:
    """A data URI of linear RGB (height, width, 3), tone-mapped as .png files are, reduced to `MAX_SIDE`.

    `exposure` is a factor on RGB; None: by the image's brightness.
    """
    from isonoise.film.png import tone_map

    reduced = [reduce_plane(rgb[..., channel]) for channel in range(3)]
    return png_data_uri(tone_map(np.stack(reduced, axis=-1), exposure))


def map_picture(values: np.ndarray, colours: str) -> tuple[str, ColourScale]:
    """A data URI of a plane (height, width) in the colours of a map, and their scale.

    Values that are not finite have the last colour.
    """
    plane = values.astype(np.float32)
    scale = _colour_scale(plane)
    reduced = reduce_plane(np.clip(plane, scale.low, scale.high))  # without nan: errors and counts have none
    position = np.rint(255 * _position(reduced, scale))
    return png_data_uri(_colour_table(colours)[position.astype(np.uint8)]), scale


def reduce_plane(plane: np.ndarray) -> np.ndarray:
    """The plane as float32, averaged to at most `MAX_SIDE` pixels per side."""
    from PIL import Image

    height, width = plane.shape
    factor = max(height, width) / MAX_SIDE
    picture = np.ascontiguousarray(plane, np.float32)
    if factor <= 1:
        return picture
    size = (max(1, round(width / factor)), max(1, round(height / factor)))
    return np.asarray(Image.fromarray(picture).resize(size, Image.Resampling.BOX))


def png_data_uri(pixels: np.ndarray) -> str:
    """A data URI of a PNG file of 8-bit RGB (height, width, 3)."""
    from PIL import Image

    file = io.BytesIO()
    Image.fromarray(pixels).save(file, format="PNG")
    return f"data:image/png;base64,{base64.b64encode(file.getvalue()).decode()}"


def css_gradient(colours: str) -> str:
    """The colours of a map from left to right, as a CSS value."""
    return f"linear-gradient(to right, {', '.join(f'#{colour}' for colour in colours.split())})"


def _colour_scale(plane: np.ndarray) -> ColourScale:
    positive = plane[np.isfinite(plane) & (plane > 0)]
    if not positive.size:
        return ColourScale(0.0, 0.0, False, False, bool((plane > 0).any()))
    low, high = (float(end) for end in np.quantile(positive, SCALE_QUANTILES, method="nearest"))
    low = max(low, high / MAX_SCALE_RATIO)
    return ColourScale(low, high, high > LOG_SCALE_RATIO * low, bool((plane < low).any()), bool((plane > high).any()))


def _position(values: np.ndarray, scale: ColourScale) -> np.ndarray:
    """Where values are between the ends of the scale, 0 to 1."""
    low, high = scale.low, scale.high
    if scale.is_log:
        values, low, high = np.log(np.maximum(values, np.float32(low))), np.log(low), np.log(high)
    position: np.ndarray = (values - low) / (high - low) if high > low else np.zeros_like(values)
    return position.clip(0, 1)


def _colour_table(colours: str) -> np.ndarray:
    """(256, 3) uint8, interpolated between the colours."""
    stops = np.array([list(bytes.fromhex(colour)) for colour in colours.split()], float)
    at = np.linspace(0, len(stops) - 1, 256)
    channels = [np.interp(at, np.arange(len(stops)), stops[:, channel]) for channel in range(3)]
    table: np.ndarray = np.rint(np.stack(channels, axis=-1)).astype(np.uint8)
    return table
