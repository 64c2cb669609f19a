"""A render's image files: their layers, and the file format by extension."""

import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from isonoise.error.stated_error import relative_standard_error
from isonoise.errors import UserError
from isonoise.film.files import check_writable
from isonoise.statistics import Statistics

EXTENSIONS = (".exr", ".png")


def image_layers(statistics: Statistics, floor: float) -> dict[str, np.ndarray]:
    """Layers of an image file, named as `write_exr` expects.

    "" is the mean linear RGB, (height, width, 3) float32. The others are (height, width): `samples` the count (uint32),
    `error` the relative standard error of the luminance, se / max(mean, floor), inf where n < 2, and `M_x` the running
    mean of the chunk medians if the strategy needs it.
    """
    layers = {"": statistics.rgb, "samples": statistics.count, "error": relative_standard_error(statistics, floor)}
    if statistics.median is not None:
        layers["M_x"] = statistics.median
    return layers


def check_output(path: str | os.PathLike) -> Path:
    """Check, before rendering, that an image can be written to `path`; returns it with symbolic links resolved.

    Raises UserError if the extension is unknown or the file cannot be written.
    """
    extension = Path(path).suffix.lower()
    if extension not in EXTENSIONS:
        named = f"the extension '{extension}'" if extension else "no extension"
        raise UserError(f"output '{path}' has {named}: use .exr (all layers, float32) or .png (tone-mapped preview)")
    return check_writable(path)


def write_image(path: str | os.PathLike, layers: Mapping[str, np.ndarray], header: Mapping[str, object]) -> None:
    """Write an image: .exr with all layers and the header, .png with the tone-mapped image only.

    Raises UserError as `check_output` does.
    """
    check_output(path)
    if Path(path).suffix.lower() == ".png":
        from isonoise.film.png import write_png

        write_png(path, layers[""])
    else:
        from isonoise.film.exr import write_exr

        write_exr(path, layers, header)
