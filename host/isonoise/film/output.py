"""A render's image files: their layers, the file format by extension, and writing them while and after it renders."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

import numpy as np

from isonoise.error.stated_error import relative_standard_error
from isonoise.errors import UserError
from isonoise.film.fallback import WrittenFile, unused_path, write_with_fallback
from isonoise.film.files import check_writable
from isonoise.statistics import Statistics

EXTENSIONS = (".exr", ".png")
_NO_LAYERS: Mapping[str, np.ndarray] = MappingProxyType({})


def image_layers(
    statistics: Statistics, floor: float, layers: Mapping[str, np.ndarray] = _NO_LAYERS
) -> dict[str, np.ndarray]:
    """Layers of an image file, named as `write_exr` expects.

    "" is the mean linear RGB, (height, width, 3) float32. The others are (height, width): `samples` the count (uint32),
    `error` the relative standard error of the luminance, se / max(mean, floor), inf where n < 2, and `M_x` the running
    mean of the chunk medians if the strategy needs it. `layers`, such as those of `Outcome`, follow channel by channel.
    """
    images = {"": statistics.rgb, "samples": statistics.count, "error": relative_standard_error(statistics, floor)}
    if statistics.median is not None:
        images["M_x"] = statistics.median
    if layers:
        from isonoise.film.layers import layer_channels  # most images have none

        images |= layer_channels(layers)
    return images


def check_output(path: str | os.PathLike) -> Path:
    """Check, before rendering, that an image can be written to `path`; returns it with symbolic links resolved.

    Raises UserError if the extension is unknown or the file cannot be written.
    """
    extension = Path(path).suffix.lower()
    if extension not in EXTENSIONS:
        named = f"the extension '{extension}'" if extension else "no extension"
        raise UserError(f"output '{path}' has {named}: use .exr (all layers, float32) or .png (tone-mapped preview)")
    return check_writable(path)


def write_image(
    path: str | os.PathLike,
    layers: Mapping[str, np.ndarray],
    header: Mapping[str, object],
    exposure: float | None = None,
    stops: float = 0.0,
) -> None:
    """Write an image: .exr with all layers and the header, .png with the image only, tone-mapped.

    The .png shows the denoised image if there is one. `exposure` and `stops` are as for `tone_map`.

    Raises UserError as `check_output` does.
    """
    check_output(path)
    if Path(path).suffix.lower() == ".png":
        from isonoise.film.png import write_png

        write_png(path, _shown(layers), exposure, stops)
    else:
        from isonoise.film.exr import write_exr

        write_exr(path, layers, header)


def _shown(layers: Mapping[str, np.ndarray]) -> np.ndarray:
    """The image that a preview shows, (height, width, 3)."""
    if "denoised.R" not in layers:
        return layers[""]
    return np.stack([layers[f"denoised.{channel}"] for channel in "RGB"], axis=-1)


class ImageFiles:
    """The image files of one render. They may be written several times while it runs, and once when it has ended.

    An image in which some pixels have no sample replaces no existing file: at the end it gets the name
    `NAME.partial.EXTENSION`. During the render it is not written, because a killed process would leave it behind.

    Parameters
    ----------
    paths : sequence of str
        The files, checked at once as by `check_output`.
    """

    def __init__(self, paths: Sequence[str]):
        for path in paths:
            check_output(path)
        self._paths = paths
        self._written: set[str] = set()

    def write(
        self,
        statistics: Statistics,
        floor: float,
        header: Mapping[str, object],
        has_ended: bool = True,
        may_be_partial: bool = False,
        exposure: float | None = None,
        layers: Mapping[str, np.ndarray] = _NO_LAYERS,
        stops: float = 0.0,
    ) -> list[WrittenFile]:
        """Write all images that can be written.

        Parameters
        ----------
        has_ended : bool
            Whether the render has ended: then images that cannot be written go to another place.
        may_be_partial : bool
            Whether pixels without samples are as the user wants them.
        exposure : float or None
            Factor on radiance in .png files; None: by the image's brightness.
        layers : mapping of str to array
            Layers beside the colour, as of `Outcome`.
        stops : float
            Correction of the exposure of .png files: a factor of 2 to this power.

        Returns
        -------
        list of WrittenFile
            One per path; its path is None without a failure if the image is left out during the render.
        """
        images = _layers_within_memory(statistics, floor, layers)
        is_partial = not may_be_partial and not ((statistics.count > 0) | (statistics.rejected > 0)).all()

        def write(path: str | os.PathLike) -> None:
            write_image(path, images, header, exposure, stops)

        return [self._write_one(path, write, has_ended, is_partial) for path in self._paths]

    def _write_one(self, path: str, write, has_ended: bool, is_partial: bool) -> WrittenFile:
        write_safely = write_with_fallback if has_ended else _try_to_write
        if is_partial and path not in self._written and os.path.lexists(path):
            return write_safely(unused_path(Path(path), "partial"), write) if has_ended else WrittenFile(None)
        written = write_safely(path, write)
        if not written.failure:
            self._written.add(path)
        return written


def _try_to_write(path: str | os.PathLike, write) -> WrittenFile:
    try:
        write(path)
        return WrittenFile(os.fspath(path))
    except (UserError, MemoryError) as error:
        return WrittenFile(None, error)


def _layers_within_memory(
    statistics: Statistics, floor: float, layers: Mapping[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """`image_layers`, or without memory for them those that need none."""
    try:
        return image_layers(statistics, floor, layers)
    except MemoryError:
        return {"": statistics.rgb, "samples": statistics.count}
