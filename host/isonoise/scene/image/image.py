"""Images that a scene names: PNG, JPEG, BMP, TGA, OpenEXR and Radiance HDR, told apart by their content.

Whatever a file claims, it is judged by its header before pixels are decoded, so that memory is bounded.
"""

import os
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import numpy as np

from isonoise.errors import SceneError
from isonoise.scene.files import open_regular_file
from isonoise.scene.image.rgbe import is_rgbe, read_rgbe, rgbe_size
from isonoise.scene.parse.elements import SourceLocation
from isonoise.scene.spectra import srgb_to_linear

_LARGEST = 1 << 31  # bytes of decoded pixels
_DENSEST = 1 << 14  # pixels that a byte of a file can stand for; with zlib 1032 x 8 of one bit
_EXR = b"\x76\x2f\x31\x01"


@dataclass(frozen=True)
class Image:
    """Pixels as the file has them, without alpha; the first row is on top."""

    pixels: np.ndarray  # (height, width, 1 or 3) uint8, uint16 or float32

    @property
    def encoded(self) -> bool:
        """Whether the values are integers, encoded as sRGB has it; else they are linear."""
        return self.pixels.dtype != np.float32

    def linear(self, raw: bool = False) -> np.ndarray:
        """Linear values, float32; with `raw` integers are only brought into [0, 1], as Mitsuba 3 means that word."""
        if not self.encoded:
            return self.pixels
        largest = np.iinfo(self.pixels.dtype).max
        values = np.arange(largest + 1) / largest
        return (values if raw else srgb_to_linear(values)).astype(np.float32)[self.pixels]


def read_image(path: str | os.PathLike) -> Image:
    """Read a file. Raises SceneError where it is missing, no such image, damaged, without pixels, or too large."""
    location = SourceLocation(str(path))
    try:
        with open_regular_file(Path(path)) as file:
            data = file.read()
    except (OSError, ValueError) as error:
        location.raise_error(f"the image cannot be read ({getattr(error, 'strerror', None) or error})")
    if is_rgbe(data):
        width, height = rgbe_size(data, location)
        _check_size(width, height, 12, len(data), location)
        return Image(read_rgbe(data, location))
    if data[:4] == _EXR:
        return Image(_read_exr(str(path), len(data), location))
    formats = ("TGA",) if Path(path).suffix.lower() == ".tga" else ("PNG", "JPEG", "BMP")  # TGA has no mark of its own
    return Image(_read_encoded(data, formats, location))


def _check_size(width: int, height: int, bytes_a_pixel: int, file_bytes: int, location: SourceLocation) -> None:
    if width < 1 or height < 1:
        location.raise_error("the image has no pixels")
    needed = width * height * bytes_a_pixel
    if needed > _LARGEST:
        location.raise_error(
            f"the image has {width} x {height} pixels; it may take {_LARGEST >> 20} MiB, not {needed >> 20}"
        )
    if width * height > _DENSEST * file_bytes:
        location.raise_error(
            f"the image claims {width} x {height} pixels, more than {file_bytes} bytes can hold: it is cut off"
        )


def _read_encoded(data: bytes, formats: tuple[str, ...], location: SourceLocation) -> np.ndarray:
    """By pillow: (height, width, 1 or 3) uint8 or uint16."""
    import io

    import PIL.Image

    def fail(error: Exception) -> NoReturn:
        location.raise_error(f"the image cannot be read ({str(error)[:200] or type(error).__name__})")

    def opened() -> PIL.Image.Image:
        largest, PIL.Image.MAX_IMAGE_PIXELS = PIL.Image.MAX_IMAGE_PIXELS, None  # sizes are checked here
        try:
            return PIL.Image.open(io.BytesIO(data), formats=formats)
        finally:
            PIL.Image.MAX_IMAGE_PIXELS = largest

    def decoded(rawmode: str = "", mode: str = "") -> np.ndarray:
        """All pixels, from rows unpacked in another way than pillow would, or converted to another mode."""
        with opened() as image:
            if rawmode:
                image.tile = [(*tile[:3], rawmode) for tile in image.tile]
            return np.asarray(image.convert(mode) if mode else image)

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of metadata that is not read
        try:
            with opened() as image:
                mode, (width, height), tiles = image.mode, image.size, image.tile
        except PIL.UnidentifiedImageError:
            location.raise_error("not an image that can be read: PNG, JPEG, BMP, TGA, OpenEXR or Radiance HDR")
        except Exception as error:  # pillow has no list of what it raises on damaged files
            fail(error)
        _check_size(width, height, 8, len(data), location)
        deep = str(tiles[0][3]) if tiles and tiles[0][0] == "zip" and str(tiles[0][3]).endswith(";16B") else ""
        try:
            if deep in ("RGB;16B", "RGBA;16B"):  # pillow keeps the high bytes alone: the low ones take a second look
                high, low = decoded(deep), decoded(deep[:-1] + "L")
                return high[..., :3].astype(np.uint16) << 8 | low[..., :3]
            if deep == "LA;16B":
                high, low = np.moveaxis(decoded("RGBA")[..., :2], 2, 0)
                return (high.astype(np.uint16) << 8 | low)[..., None]
            if mode.startswith("I"):
                return decoded().astype(np.uint16)[..., None]
            return np.atleast_3d(decoded(mode="L" if mode in ("1", "L", "LA", "La") else "RGB"))
        except Exception as error:
            fail(error)


def _read_exr(path: str, file_bytes: int, location: SourceLocation) -> np.ndarray:
    """(height, width, 1 or 3) float32 of the first part."""
    import OpenEXR

    try:
        header = OpenEXR.File(path, separate_channels=True, header_only=True).header()
        low, high = (np.asarray(corner, np.int64) for corner in header["dataWindow"])
        names = [channel.name for channel in header["channels"]]
    except Exception as error:  # the library's own range from RuntimeError to KeyError
        location.raise_error(f"the image cannot be read ({str(error)[:200]})")
    width, height = (int(side) for side in high - low + 1)
    _check_size(width, height, 4 * max(len(names), 3), file_bytes, location)
    wanted = _exr_channels(names, location)
    try:
        file = OpenEXR.File(path, separate_channels=True)
        planes = [file.channels()[name].pixels for name in wanted]
    except Exception as error:
        location.raise_error(f"the image cannot be read ({str(error)[:200]})")
    if any(np.shape(plane) != (height, width) for plane in planes):
        location.raise_error("the image cannot be read (its channels differ in size, or it is cut off)")
    with np.errstate(all="ignore"):  # what is no finite number stays so, and whoever uses it tells
        return np.stack(planes, axis=-1, dtype=np.float32, casting="unsafe")


def _exr_channels(names: list[str], location: SourceLocation) -> list[str]:
    by_name = {name.upper(): name for name in names}
    for wanted in ("RGB", "Y"):
        if all(letter in by_name for letter in wanted) and not {"RY", "BY"} & set(by_name):
            return [by_name[letter] for letter in wanted]
    if len(names) == 1:
        return names
    raise SceneError(f"{location}: the image has no channels R, G, B, and no Y alone, but {', '.join(names)[:200]}")
