"""Encodes images of the scene description: integers as PNG, floats as OpenEXR. Called by `scene_files.py`."""

import struct
import zlib
from pathlib import Path

import numpy as np

_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_PNG_COLOUR_TYPES = {1: 0, 3: 2}  # by number of channels: grey, RGB
_PNG_FILTER_SUB = 1  # each byte minus that of the pixel before it


def encode_png(pixels: np.ndarray) -> bytes:
    """A PNG of pixels (height, width, 1 or 3), uint8 or uint16. Pillow writes no 16-bit RGB."""
    height, width, channels = pixels.shape
    bits = 8 * pixels.itemsize
    rows = pixels.astype(pixels.dtype.newbyteorder(">")).reshape(height, -1).view(np.uint8)
    step = channels * pixels.itemsize
    filtered = np.empty((height, 1 + rows.shape[1]), np.uint8)
    filtered[:, 0] = _PNG_FILTER_SUB
    filtered[:, 1 : 1 + step] = rows[:, :step]
    filtered[:, 1 + step :] = rows[:, step:] - rows[:, :-step]
    header = struct.pack(">IIBBBBB", width, height, bits, _PNG_COLOUR_TYPES[channels], 0, 0, 0)
    chunks = ((b"IHDR", header), (b"IDAT", zlib.compress(filtered.tobytes(), 6)), (b"IEND", b""))
    return _PNG_SIGNATURE + b"".join(_png_chunk(*chunk) for chunk in chunks)


def _png_chunk(name: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))


def write_float_exr(path: Path, pixels: np.ndarray) -> None:
    """Write pixels (height, width, 1 or 3) float32 as channel Y, or R, G and B."""
    import OpenEXR

    names = "Y" if pixels.shape[2] == 1 else "RGB"
    channels = {name: np.ascontiguousarray(pixels[..., i], np.float32) for i, name in enumerate(names)}
    attributes = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    try:
        OpenEXR.File(attributes, channels).write(str(path))
    except RuntimeError as error:  # OpenEXR's error for a full disk
        raise OSError(str(error)) from error
