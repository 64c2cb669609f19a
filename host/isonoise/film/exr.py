"""OpenEXR files: images with named layers, how they were made in the header, and references with standard errors."""

import math
import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from isonoise.errors import UserError
from isonoise.film.files import write_atomically

_DENSEST = 1 << 14  # pixels that a byte of a file can stand for


def write_exr(path: str | os.PathLike, layers: Mapping[str, np.ndarray], header: Mapping[str, object]) -> None:
    """Write an OpenEXR file (scan lines, ZIP, lossless) that is there whole or not at all.

    Args:
        layers: arrays of one (height, width). Name "" with shape (height, width, 3) gives the channels R, G, B; another
            name `a` gives a.R, a.G, a.B, or with shape (height, width) the channel `a`. Unsigned integers are stored
            as UINT (exact; OpenEXR's readers convert to float where a program wants that), all else as 32-bit FLOAT.
        header: how the image was made. Values are stored as strings, numbers in full precision, because OpenEXR's own
            int and float attributes have 32 bits: a count of samples does not fit.

    Raises:
        UserError: the file cannot be written.
    """
    import OpenEXR

    channels = {}
    for name, pixels in layers.items():
        dtype = np.uint32 if np.issubdtype(pixels.dtype, np.unsignedinteger) else np.float32
        planes = {name: pixels} if pixels.ndim == 2 else _rgb_planes(name, pixels)
        channels |= {key: np.ascontiguousarray(plane, dtype) for key, plane in planes.items()}
    attributes = {key: str(value) for key, value in header.items()}
    attributes |= {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}

    def write(temporary: Path) -> None:
        try:
            OpenEXR.File(attributes, channels).write(str(temporary))
        except RuntimeError as error:  # the library's word for a full disk or a file it cannot open
            raise OSError(str(error)) from error

    write_atomically(path, write)


def read_exr(path: str | os.PathLike) -> tuple[dict[str, np.ndarray], dict[str, object]]:
    """Read every channel and the header of a single-part OpenEXR file.

    Returns:
        channels by name, each (height, width) in its own type (float16, float32 or uint32), and the header's
        attributes without those that only describe the file's layout (`read_header`).

    Raises:
        UserError: there is no such file, or it is not an OpenEXR file that can be read.
    """
    file = _open(path, header_only=False)
    return {name: channel.pixels for name, channel in file.channels().items()}, _made_how(file)


def read_header(path: str | os.PathLike) -> tuple[list[str], tuple[int, int], dict[str, object]]:
    """Read what an OpenEXR file says about itself, without its pixels.

    Returns:
        channel names, the size (width, height), and the attributes that say how the image was made.

    Raises:
        UserError: as for `read_exr`.
    """
    file = _open(path, header_only=True)
    header = file.header()
    low, high = header["dataWindow"]
    channels = [channel.name for channel in header["channels"]]
    return channels, (int(high[0] - low[0]) + 1, int(high[1] - low[1]) + 1), _made_how(file)


def read_reference(path: str | os.PathLike) -> tuple[np.ndarray, np.ndarray | None]:
    """Read a reference image and, where the file has the channels stderr.R, stderr.G, stderr.B, its standard error.

    Returns:
        linear RGB (height, width, 3) float32, and the standard error of the same shape or None.

    Raises:
        UserError: as for `read_exr`, or channels are missing, or a value is not finite.
    """
    channels, _ = read_exr(path)
    rgb = _stack(channels, "", path)
    if rgb is None:
        raise UserError(f"'{path}' cannot serve as a reference: it has no channels R, G, B, only {', '.join(channels)}")
    return rgb, _stack(channels, "stderr.", path)


def _rgb_planes(name: str, pixels: np.ndarray) -> dict[str, np.ndarray]:
    prefix = f"{name}." if name else ""
    return {prefix + channel: pixels[..., i] for i, channel in enumerate("RGB")}


def _stack(channels: Mapping[str, np.ndarray], prefix: str, path: str | os.PathLike) -> np.ndarray | None:
    names = [prefix + channel for channel in "RGB"]
    if not all(name in channels for name in names):
        return None
    rgb = np.stack([channels[name] for name in names], axis=-1).astype(np.float32)
    if not np.isfinite(rgb).all():
        raise UserError(f"'{path}' cannot serve as a reference: {', '.join(names)} hold values that are not finite")
    return rgb


def _open(path: str | os.PathLike, header_only: bool):
    import OpenEXR

    path = Path(path)
    try:
        path.open("rb").close()
    except (OSError, ValueError) as error:
        raise UserError(f"cannot read '{path}': {getattr(error, 'strerror', None) or error}") from error
    if not OpenEXR.isOpenExrFile(str(path)):
        raise UserError(f"cannot read '{path}': it is not an OpenEXR file")
    try:
        file = OpenEXR.File(str(path), separate_channels=True, header_only=True)
        low, high = file.header()["dataWindow"]
        if math.prod(int(side) + 1 for side in np.subtract(high, low, dtype=np.int64)) > _DENSEST * path.stat().st_size:
            raise ValueError("it claims more pixels than it can hold")
        file = file if header_only else OpenEXR.File(str(path), separate_channels=True)
    except (OSError, RuntimeError, ValueError, KeyError) as error:
        raise UserError(f"cannot read '{path}': {error}") from error
    if not file.parts:  # what the library makes of pixels that it cannot read
        raise UserError(f"cannot read '{path}': the file is cut off or damaged")
    return file


_LAYOUT = {
    "channels", "compression", "dataWindow", "displayWindow", "lineOrder", "pixelAspectRatio", "screenWindowCenter",
    "screenWindowWidth", "type", "tiles", "name", "version", "chunkCount",
}  # fmt: skip


def _made_how(file) -> dict[str, object]:
    return {key: value for key, value in file.header().items() if key not in _LAYOUT}
