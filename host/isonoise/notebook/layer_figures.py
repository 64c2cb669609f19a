"""Layers of an image, such as albedo and depth, as figures of a notebook. Called by `render_html`."""

import colorsys

import numpy as np

from isonoise.layers import LAYERS, NO_HIT_DEPTH
from isonoise.notebook.figures import image_figure, map_figure, picture_figure
from isonoise.notebook.pictures import MAX_SIDE, VIRIDIS, png_data_uri, reduce_plane
from isonoise.progress import format_number

GOLDEN_RATIO = 0.618034
"""Hues that are multiples of it are far apart for neighbouring numbers."""


def layer_figure(name: str, plane: np.ndarray) -> str:
    """The figure of a layer of `isonoise.layers.LAYERS`.

    Colours are shown as colours, albedo without exposure; vectors as red, green and blue from their least to their
    largest value; indices in different colours; other numbers as a map.
    """
    if LAYERS[name].channels == "RGB":
        return image_figure(name, plane, 1.0 if name == "albedo" else None)
    if plane.ndim == 3:
        return _vector_figure(name, plane)
    if name.endswith("_index"):
        return _index_figure(name, plane.astype(int))
    values = np.where(plane >= NO_HIT_DEPTH, np.inf, plane) if name == "depth" else plane
    return map_figure(name, values, VIRIDIS, format_number)


def _vector_figure(name: str, plane: np.ndarray) -> str:
    low, high = float(plane.min()), float(plane.max())
    shown = np.zeros((*plane.shape[:2], 3))
    shown[..., : plane.shape[2]] = (plane - low) / ((high - low) or 1.0)
    pixels = np.stack([reduce_plane(shown[..., channel]) for channel in range(3)], axis=-1)
    axes = ", ".join(LAYERS[name].channels.lower())
    caption = f"{name}: {axes} as red, green, blue from {format_number(low)} to {format_number(high)}"
    return picture_figure(png_data_uri(np.rint(255 * pixels).astype(np.uint8)), name, caption, plane.shape[1])


def _index_figure(name: str, plane: np.ndarray) -> str:
    """Every number has a colour of its own; -1, for no hit, is black. Pixels are left out where it is too large."""
    numbers, places = np.unique(plane, return_inverse=True)
    hues = [colorsys.hsv_to_rgb(number * GOLDEN_RATIO % 1, 0.6, 0.9 * (number >= 0)) for number in numbers.tolist()]
    colours = np.rint(255 * np.array(hues)).astype(np.uint8)[places.reshape(plane.shape)]
    step = -(-max(plane.shape) // MAX_SIDE)
    found = int((numbers >= 0).sum())
    caption = f"{name}: {found} different number{'s' * (found != 1)}"
    return picture_figure(png_data_uri(np.ascontiguousarray(colours[::step, ::step])), name, caption, plane.shape[1])
