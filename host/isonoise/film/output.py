"""A render's image files: which layers they hold, and which format a file name stands for."""

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
    """Layers of an image file, by the names of `write_exr`.

    "" is the mean linear RGB (height, width, 3) float32, `samples` the count of each pixel (uint32), `error` one
    relative standard error of the pixel's luminance, se / max(mean, floor), inf where n < 2, and `M_x` the running mean
    of the chunk medians where the strategy keeps it (all (height, width)).
    """
    layers = {"": statistics.rgb, "samples": statistics.count, "error": relative_standard_error(statistics, floor)}
    if statistics.median is not None:
        layers["M_x"] = statistics.median
    return layers


def check_output(path: str | os.PathLike) -> Path:
    """Find out before rendering whether an image can be written to `path`; returns it with links followed.

    Raises:
        UserError: no format goes by the file's extension, or the file cannot be written.
    """
    extension = Path(path).suffix.lower()
    if extension not in EXTENSIONS:
        named = f"the extension '{extension}'" if extension else "no extension"
        raise UserError(f"output '{path}' has {named}: use .exr (all layers, float32) or .png (a tone-mapped look)")
    return check_writable(path)


def write_image(path: str | os.PathLike, layers: Mapping[str, np.ndarray], header: Mapping[str, object]) -> None:
    """Write an image as the extension says: .exr with all layers and the header, .png with the tone-mapped image alone.

    Raises:
        UserError: as for `check_output`.
    """
    check_output(path)
    if Path(path).suffix.lower() == ".png":
        from isonoise.film.png import write_png

        write_png(path, layers[""])
    else:
        from isonoise.film.exr import write_exr

        write_exr(path, layers, header)
