"""Reads and writes Mitsuba's `.vol` files, version 3: a grid of 32-bit floats. Called when media are compiled.

The format is documented in Mitsuba 3's src/volumes/grid.cpp. Its other encodings (16-bit floats, bytes) are refused by
Mitsuba 3 as well. The counts in a header are checked against the size of the file before anything is allocated.
"""

import os
import struct
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from isonoise.errors import SceneError
from isonoise.input_files import size_bytes
from isonoise.scene.files import open_regular_file
from isonoise.scene.parse.elements import SourceLocation

_HEADER = struct.Struct("<3sB5i6f")
_VERSION, _FLOAT32 = 3, 1
_UNIT_CUBE = np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]])


@dataclass(frozen=True, eq=False)
class VolumeGrid:
    """Values on a grid; value (z, y, x) is the one at the centre of its cell."""

    values: np.ndarray  # (nz, ny, nx, channels) float32; channels is 1 or 3
    bounds: np.ndarray = field(default_factory=_UNIT_CUBE.copy)  # (2, 3): corners of the box, used on request only


def check_grid(values: np.ndarray, location: SourceLocation) -> np.ndarray:
    """The values of a grid as (nz, ny, nx, channels) float32. Raises SceneError if they are no valid grid."""
    values = values[..., np.newaxis] if values.ndim == 3 else values
    if values.ndim != 4 or values.dtype.kind not in "iuf":
        location.raise_error("a grid has the shape (nz, ny, nx) or (nz, ny, nx, channels) and consists of numbers")
    if values.shape[3] not in (1, 3):
        location.raise_error(f"the grid has {values.shape[3]} channels; 1 and 3 are supported")
    if not values.size:
        location.raise_error("the grid has no cells")
    with np.errstate(over="ignore"):  # checked below
        values = np.ascontiguousarray(values, np.float32)
    lowest, highest = float(values.min()), float(values.max())  # NaN if there is one
    if not (np.isfinite(lowest) and np.isfinite(highest)):
        location.raise_error("the grid has values that are not finite 32-bit numbers")
    if lowest < 0:
        location.raise_error(f"the values of a grid cannot be negative, got {lowest:g}")
    return values


def read_vol(path: str | os.PathLike) -> VolumeGrid:
    """Read a file. Raises SceneError if it is missing, of another format, damaged or empty."""
    location = SourceLocation(str(path))
    try:
        with open_regular_file(Path(path)) as file:
            size = size_bytes(file)
            shape, bounds = _parse_header(file.read(_HEADER.size), size, location)
            data = file.read(4 * int(np.prod(shape, dtype=object)))
    except OSError as error:
        raise SceneError(f"{path}: the volume cannot be read ({error.strerror})") from None
    if len(data) != 4 * np.prod(shape):  # the file shrank meanwhile
        location.raise_error("the volume is truncated")
    return VolumeGrid(check_grid(np.frombuffer(data, "<f4").reshape(shape), location), bounds)


def _parse_header(
    header: bytes, file_bytes: int, location: SourceLocation
) -> tuple[tuple[int, int, int, int], np.ndarray]:
    """The shape of the grid (nz, ny, nx, channels), and its bounds (2, 3)."""
    if header[:3] != b"VOL":
        location.raise_error("not a Mitsuba volume: it does not begin with VOL")
    if len(header) < _HEADER.size:
        location.raise_error("the volume is truncated")
    _, version, encoding, nx, ny, nz, channels, *corners = _HEADER.unpack(header)
    if version != _VERSION:
        location.raise_error(f"version {version} of the format is not supported (3 is)")
    if encoding != _FLOAT32:
        location.raise_error(f"encoding {encoding} is not supported (1 is: 32-bit floats)")
    if min(nx, ny, nz, channels) < 1:
        location.raise_error(f"the volume has {nx} x {ny} x {nz} cells and {channels} channels: there is nothing in it")
    if 4 * nx * ny * nz * channels > file_bytes - _HEADER.size:
        location.raise_error(
            f"the volume is truncated: {file_bytes} bytes cannot hold the {nx} x {ny} x {nz} cells with {channels} "
            "channels of its header"
        )
    return (nz, ny, nx, channels), np.array(corners, float).reshape(2, 3)


def write_vol(path: str | os.PathLike, grid: VolumeGrid) -> None:
    """Write a file that Mitsuba 3 reads."""
    nz, ny, nx, channels = grid.values.shape
    header = _HEADER.pack(b"VOL", _VERSION, _FLOAT32, nx, ny, nz, channels, *grid.bounds.ravel().tolist())
    Path(path).write_bytes(header + grid.values.astype("<f4").tobytes())
