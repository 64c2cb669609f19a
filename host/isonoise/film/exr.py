"""OpenEXR files: images with named layers, render settings in the header, references with standard errors."""

import math
import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from isonoise.argument_checks import check_path
from isonoise.errors import UserError
from isonoise.film.files import write_atomically
from isonoise.input_files import open_regular_file

_MAX_PIXELS_PER_BYTE = 1 << 14
"""Of a compressed file; a header that claims more is damaged."""
_WINDOWS = ("dataWindow", "displayWindow")
_MAGIC = b"\x76\x2f\x31\x01"


def write_exr(path: str | os.PathLike, layers: Mapping[str, np.ndarray], header: Mapping[str, object]) -> None:
    """Write an OpenEXR file (scan lines, ZIP, lossless) atomically.

    Parameters
    ----------
    path : path
        The file.
    layers : mapping of str to array
        Arrays of one size. The name "" with shape (height, width, 3) gives the channels R, G, B; another name `a` gives
        a.R, a.G, a.B, or with shape (height, width) the channel `a`. Unsigned integers are stored as UINT (exact;
        OpenEXR readers convert to float on request), float16 as HALF, all others as 32-bit FLOAT.
    header : mapping
        Render settings. Values are stored as strings, numbers in full precision, because OpenEXR's own int and float
        attributes have 32 bits: a sample count does not fit. `film_windows` has the windows of a cropped image.

    Raises
    ------
    UserError
        If the file cannot be written.
    """
    import OpenEXR

    check_path("path", path)
    channels = image_channels(check_image_layers(layers))
    attributes = {key: value if key in _WINDOWS else _encodable(str(value)) for key, value in header.items()}
    attributes |= {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}

    def write(temporary: Path) -> None:
        try:
            OpenEXR.File(attributes, channels).write(os.fsencode(temporary))
        except RuntimeError as error:  # OpenEXR's error for a full disk or a file that it cannot open
            reason = str(error).replace(str(temporary), os.fspath(path)).rstrip(".")
            raise OSError(reason) from error

    write_atomically(path, write)


def film_windows(
    film: tuple[int, int], offset: tuple[int, int], size: tuple[int, int]
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Attributes of an image that is a window of the film, as Mitsuba 3 writes them; none if it is the whole film.

    Parameters
    ----------
    film, size : (width, height) of the film and of the image
    offset : (x, y), the pixel of the film where the image begins
    """
    if (film, offset) == (size, (0, 0)):
        return {}
    low = np.array(offset, np.int32)
    whole = (np.zeros(2, np.int32), np.array(film, np.int32) - 1)
    return {"dataWindow": (low, low + np.array(size, np.int32) - 1), "displayWindow": whole}


def check_image_layers(layers: Mapping[str, np.ndarray]) -> Mapping[str, np.ndarray]:
    """The layers. Raises UserError unless they are arrays of numbers of one size, (height, width) or with RGB."""
    if not isinstance(layers, Mapping) or not layers:
        raise UserError(f"layers = {layers!r} is not a dict with at least one array")
    sizes = set()
    for name, pixels in layers.items():
        array = isinstance(pixels, np.ndarray) and pixels.dtype.kind in "fiub" and pixels.size > 0
        if not array or not (pixels.shape[2:] == (3,) or (pixels.ndim == 2 and name)):
            shape = "(height, width, 3)" + (" or (height, width)" if name else "")
            raise UserError(f"layer '{name}' is {_kind(pixels)}; it has to be an array of numbers of shape {shape}")
        sizes.add(pixels.shape[:2])
    if len(sizes) > 1:
        raise UserError(f"the layers have different sizes: {', '.join(map(str, sorted(sizes)))}")
    return layers


def _kind(value: object) -> str:
    return f"of shape {value.shape}, type {value.dtype}" if isinstance(value, np.ndarray) else f"{value!r:.100}"


def image_channels(layers: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The channels of the layers by name, each (height, width) as `write_exr` stores it. Channels are layers, too."""
    channels = {}
    for name, pixels in layers.items():
        planes = {name: pixels} if pixels.ndim == 2 else _rgb_planes(name, pixels)
        channels |= {key: np.ascontiguousarray(plane, _stored_type(pixels.dtype)) for key, plane in planes.items()}
    return channels


def _stored_type(dtype: np.dtype) -> type:
    if np.issubdtype(dtype, np.unsignedinteger):
        return np.uint32
    return np.float16 if dtype == np.float16 else np.float32


def read_exr(path: str | os.PathLike) -> tuple[dict[str, np.ndarray], dict[str, object]]:
    """Read every channel and the header of a single-part OpenEXR file.

    Parameters
    ----------
    path : path
        The file.

    Returns
    -------
    channels : dict
        Name -> (height, width) array of its own type (float16, float32 or uint32).
    attributes : dict
        The header without the attributes that describe the file's layout.

    Raises
    ------
    UserError
        If the file is missing or not a readable OpenEXR file.
    """
    file = _open(check_path("path", path), header_only=False)
    return {name: channel.pixels for name, channel in file.channels().items()}, _render_attributes(file, path)


def read_header(path: str | os.PathLike) -> tuple[list[str], tuple[int, int], dict[str, object]]:
    """Read the header of an OpenEXR file: channel names, size (width, height), and attributes as `read_exr`.

    Raises UserError as `read_exr` does.
    """
    file = _open(path, header_only=True)
    header = file.header()
    low, high = header["dataWindow"]
    try:
        channels = [channel.name for channel in header["channels"]]
    except UnicodeDecodeError as error:
        raise UserError(f"{os.fspath(path)}: the name of a channel is not UTF-8; the file is damaged") from error
    return channels, (int(high[0] - low[0]) + 1, int(high[1] - low[1]) + 1), _render_attributes(file, path)


def read_reference(path: str | os.PathLike) -> tuple[np.ndarray, np.ndarray | None]:
    """Read a reference image and its standard error.

    Parameters
    ----------
    path : path
        The file.

    Returns
    -------
    rgb : (height, width, 3) float32
        Linear RGB.
    standard_error : (height, width, 3) float32 or None
        Channels stderr.R, stderr.G, stderr.B; None if the file has none.

    Raises
    ------
    UserError
        As for `read_exr`, or if channels are missing or not finite.
    """
    return reference_layers(read_exr(path)[0], path)


def reference_layers(
    channels: Mapping[str, np.ndarray], path: str | os.PathLike
) -> tuple[np.ndarray, np.ndarray | None]:
    """What `read_reference` returns, from the channels of the file `path`. Raises UserError as it does."""
    rgb = _read_rgb(channels, "", path)
    if rgb is None:
        raise UserError(f"'{path}' is no reference: it has no channels R, G, B, only {', '.join(channels)}")
    return rgb, _read_rgb(channels, "stderr.", path)


def _encodable(text: str) -> str:
    """The text with escapes in place of what UTF-8 does not have: names of files may have any bytes."""
    return text.encode("utf-8", "backslashreplace").decode("utf-8")


def _rgb_planes(name: str, pixels: np.ndarray) -> dict[str, np.ndarray]:
    prefix = f"{name}." if name else ""
    return {prefix + channel: pixels[..., i] for i, channel in enumerate("RGB")}


def _read_rgb(channels: Mapping[str, np.ndarray], prefix: str, path: str | os.PathLike) -> np.ndarray | None:
    names = [prefix + channel for channel in "RGB"]
    if not all(name in channels for name in names):
        return None
    rgb = np.stack([channels[name] for name in names], axis=-1).astype(np.float32)
    if not np.isfinite(rgb).all():
        raise UserError(f"'{path}' is no reference: {', '.join(names)} have values that are not finite")
    return rgb


def _open(path: str | os.PathLike, header_only: bool):
    import OpenEXR

    path = Path(path)
    try:
        with open_regular_file(path) as file:
            magic = file.read(len(_MAGIC))
    except OSError as error:
        raise UserError(f"cannot read '{path}': {error.strerror}") from error
    if magic != _MAGIC:
        raise UserError(f"cannot read '{path}': it is not an OpenEXR file")
    try:
        name = os.fsencode(path)
        file = OpenEXR.File(name, separate_channels=True, header_only=True)
        low, high = file.header()["dataWindow"]
        pixels = math.prod(int(side) + 1 for side in np.subtract(high, low, dtype=np.int64))
        if pixels > _MAX_PIXELS_PER_BYTE * path.stat().st_size:
            raise ValueError("its header claims more pixels than the file can hold")
        file = file if header_only else OpenEXR.File(name, separate_channels=True)
    except (OSError, RuntimeError, ValueError, KeyError) as error:
        raise UserError(f"cannot read '{path}': {error}") from error
    if not file.parts:  # OpenEXR's result for pixels that it cannot read
        raise UserError(f"cannot read '{path}': the file is cut off or damaged")
    return file


_LAYOUT_ATTRIBUTES = {
    "channels", "compression", "dataWindow", "displayWindow", "lineOrder", "pixelAspectRatio", "screenWindowCenter",
    "screenWindowWidth", "type", "tiles", "name", "version", "chunkCount",
}  # fmt: skip


def _render_attributes(file, path: str | os.PathLike) -> dict[str, object]:
    try:
        str(file.header())
    except UnicodeDecodeError as error:  # OpenEXR's text of an attribute of an unknown type
        raise UserError(f"{os.fspath(path)}: the type of an attribute is not UTF-8; the file is damaged") from error
    return {key: value for key, value in file.header().items() if key not in _LAYOUT_ATTRIBUTES}
