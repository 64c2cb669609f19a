"""Reads the images of a scene: PNG, JPEG, BMP, TGA, OpenEXR and Radiance HDR, recognised by their content.

The size in an image's header is checked before pixels are decoded, so memory is bounded.
"""

import io
import os
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import numpy as np

from isonoise.errors import SceneError
from isonoise.input_files import size_bytes
from isonoise.scene.files import open_regular_file
from isonoise.scene.image.rgbe import is_rgbe, read_rgbe, rgbe_size
from isonoise.scene.parse.elements import SourceLocation
from isonoise.scene.spectra import srgb_to_linear

_MAX_DECODED_BYTES = 1 << 31
_MAX_PIXELS_PER_BYTE = 1 << 14  # of a file; zlib's maximum is 1032 x 8 pixels of one bit
_EXR_MAGIC = b"\x76\x2f\x31\x01"


@dataclass(frozen=True, eq=False)
class Image:
    """Pixels as stored in the file; the first row is the top one."""

    pixels: np.ndarray  # (height, width, 1 or 3): uint8 or uint16 encoded with sRGB, or float32 linear
    alpha: np.ndarray | None = None  # (height, width, 1), of the same type, linear; None: opaque, or not asked for

    def linear(self, raw: bool = False) -> np.ndarray:
        """Linear values, float32. With `raw`, as in Mitsuba 3, integers are only scaled to [0, 1]."""
        if self.pixels.dtype == np.float32:
            return self.pixels
        max_value = np.iinfo(self.pixels.dtype).max
        values = np.arange(max_value + 1) / max_value
        return (values if raw else srgb_to_linear(values)).astype(np.float32)[self.pixels]


def read_image(path: str | os.PathLike, with_alpha: bool = False) -> Image:
    """Read a file. Raises SceneError if it is missing, of an unknown format, damaged, empty or too large."""
    location = SourceLocation(str(path))
    try:
        with open_regular_file(Path(path)) as file:
            data = file.read(size_bytes(file))
    except OSError as error:
        _raise_unreadable(location, error.strerror)
    if is_rgbe(data):
        width, height = rgbe_size(data, location)
        _check_size(width, height, 12, len(data), location)
        return Image(read_rgbe(data, location))
    if data[:4] == _EXR_MAGIC:
        return _read_exr(os.fsencode(path), len(data), location, with_alpha)
    # TGA files have no magic number
    formats = ("TGA",) if Path(path).suffix.lower() == ".tga" else ("PNG", "JPEG", "BMP")
    return _image(*_read_with_pillow(data, formats, location, with_alpha))


def decode_image(data: bytes, name: str, with_alpha: bool = False) -> Image:
    """Decode a PNG, JPEG, BMP or WebP file in memory, which errors call `name`. Raises SceneError as `read_image`."""
    return _image(*_read_with_pillow(data, ("PNG", "JPEG", "BMP", "WEBP"), SourceLocation(name), with_alpha))


def _image(pixels: np.ndarray, alpha: np.ndarray | None) -> Image:
    """An Image; an alpha that is opaque everywhere is dropped."""
    opaque = 1.0 if pixels.dtype == np.float32 else np.iinfo(pixels.dtype).max
    return Image(pixels, None if alpha is None or (alpha == opaque).all() else alpha)


def _raise_unreadable(location: SourceLocation, reason) -> NoReturn:
    location.raise_error(f"the image cannot be read ({str(reason)[:200] or type(reason).__name__})")


def _check_size(width: int, height: int, bytes_per_pixel: int, file_bytes: int, location: SourceLocation) -> None:
    if width < 1 or height < 1:
        location.raise_error("the image has no pixels")
    needed = width * height * bytes_per_pixel
    if needed > _MAX_DECODED_BYTES:
        location.raise_error(
            f"the image has {width} x {height} pixels and needs {needed >> 20} MiB; "
            f"the limit is {_MAX_DECODED_BYTES >> 20} MiB"
        )
    if width * height > _MAX_PIXELS_PER_BYTE * file_bytes:
        location.raise_error(
            f"the image is truncated: {file_bytes} bytes cannot hold the {width} x {height} pixels of its header"
        )


def _read_with_pillow(
    data: bytes, formats: tuple[str, ...], location: SourceLocation, with_alpha: bool
) -> tuple[np.ndarray, np.ndarray | None]:
    """Pixels (height, width, 1 or 3) and alpha (height, width, 1) or None, uint8 or uint16."""
    import PIL

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about metadata, which is not read
        try:
            with _open_with_pillow(data, formats) as image:
                mode, (width, height), tiles = image.mode, image.size, image.tile
                with_alpha = with_alpha and image.has_transparency_data
        except PIL.UnidentifiedImageError:
            location.raise_error("not a supported image; supported are PNG, JPEG, BMP, TGA, OpenEXR and Radiance HDR")
        except Exception as error:  # pillow raises errors of any type for a damaged file
            _raise_unreadable(location, error)
        _check_size(width, height, 8, len(data), location)
        try:
            return _decode_with_pillow(data, formats, mode, tiles, with_alpha)
        except Exception as error:
            _raise_unreadable(location, error)


def _open_with_pillow(data: bytes, formats: tuple[str, ...]):
    import PIL.Image

    limit, PIL.Image.MAX_IMAGE_PIXELS = PIL.Image.MAX_IMAGE_PIXELS, None  # _check_size checks the size
    try:
        return PIL.Image.open(io.BytesIO(data), formats=formats)
    finally:
        PIL.Image.MAX_IMAGE_PIXELS = limit


def _decode_with_pillow(
    data: bytes, formats: tuple[str, ...], mode: str, tiles: list, with_alpha: bool
) -> tuple[np.ndarray, np.ndarray | None]:
    def decode(raw_mode: str = "", mode: str = "") -> np.ndarray:
        """All pixels; rows are unpacked with another raw mode than pillow's, or converted to another mode."""
        with _open_with_pillow(data, formats) as image:
            if raw_mode:
                image.tile = [(*tile[:3], raw_mode) for tile in image.tile]
            return np.asarray(image.convert(mode) if mode else image)

    raw_mode = str(tiles[0][3]) if tiles and tiles[0][0] == "zip" else ""
    if raw_mode in ("RGB;16B", "RGBA;16B"):  # pillow keeps only the high bytes: decode again for the low ones
        high, low = decode(raw_mode), decode(raw_mode[:-1] + "L")
        pixels = high.astype(np.uint16) << 8 | low
        return pixels[..., :3], pixels[..., 3:] if with_alpha and raw_mode == "RGBA;16B" else None
    if raw_mode == "LA;16B":
        halves = decode("RGBA")
        pixels = halves[..., ::2].astype(np.uint16) << 8 | halves[..., 1::2]
        return pixels[..., :1], pixels[..., 1:] if with_alpha else None
    if mode.startswith("I"):
        return decode().astype(np.uint16)[..., None], None
    is_grey = mode in ("1", "L", "LA", "La")
    if with_alpha:
        pixels = decode(mode="RGBA")
        return pixels[..., :1] if is_grey else pixels[..., :3], pixels[..., 3:]
    return np.atleast_3d(decode(mode="L" if is_grey else "RGB")), None


def _read_exr(path: bytes, file_bytes: int, location: SourceLocation, with_alpha: bool) -> Image:
    """The first part of a file, float32."""
    import OpenEXR

    try:
        header = OpenEXR.File(path, separate_channels=True, header_only=True).header()
        low, high = (np.asarray(corner, np.int64) for corner in header["dataWindow"])
        names = [channel.name for channel in header["channels"]]
    except Exception as error:  # OpenEXR raises many types, from RuntimeError to KeyError
        _raise_unreadable(location, error)
    width, height = (int(side) for side in high - low + 1)
    _check_size(width, height, 4 * max(len(names), 3), file_bytes, location)
    selected = _exr_channels(names, location)
    with_alpha = with_alpha and "A" in names and "A" not in selected
    selected += ["A"] if with_alpha else []
    try:
        file = OpenEXR.File(path, separate_channels=True)
        planes = [file.channels()[name].pixels for name in selected]
    except Exception as error:
        _raise_unreadable(location, error)
    if any(np.shape(plane) != (height, width) for plane in planes):
        _raise_unreadable(location, "its channels differ in size, or it is truncated")
    with np.errstate(all="ignore"):  # values that are not finite are kept; the users of the image check them
        pixels = np.stack(planes, axis=-1, dtype=np.float32, casting="unsafe")
    return _image(pixels[..., :-1], pixels[..., -1:]) if with_alpha else Image(pixels)


def _exr_channels(names: list[str], location: SourceLocation) -> list[str]:
    """The channels to read: R, G, B, or Y, or the only one."""
    by_letter = {name.upper(): name for name in names}
    for letters in ("RGB", "Y"):
        if all(letter in by_letter for letter in letters) and not {"RY", "BY"} & set(by_letter):
            return [by_letter[letter] for letter in letters]
    if len(names) == 1:
        return names
    raise SceneError(f"{location}: the image needs channels R, G, B, or Y alone; it has {', '.join(names)[:200]}")
