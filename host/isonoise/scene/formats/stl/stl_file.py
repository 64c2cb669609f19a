"""Reads STL files, binary and ASCII, with numpy. Called by `read.py`.

Two conventions for colours in the unused two bytes of a binary facet are known: VisCAM's, and that of Materialise
Magics, whose header contains `COLOR=` and the colour of the whole object.
"""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from isonoise.scene.files import read_bytes
from isonoise.scene.mesh.mesh import parse_numbers
from isonoise.scene.parse.elements import SourceLocation
from isonoise.scene.spectra import srgb_to_linear

_HEADER_BYTES, _FACET_BYTES = 80, 50
_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_HAS_COLOUR = 1 << 15  # bit of an attribute; for Magics it means the colour of the object
_RED_FIRST, _BLUE_FIRST = (0, 5, 10), (10, 5, 0)  # first bits of red, green and blue, 5 bits each
_GREY = 0.5


@dataclass
class StlFile:
    """The triangles of a file."""

    corners: np.ndarray  # (t, 3, 3)
    colours: np.ndarray  # (t, 3) linear, or (0, 3)
    solids: int
    has_ascii_colours: bool = False  # statements that are not part of the format


def read_stl(path: Path) -> StlFile:
    """Read a file. Raises SceneError if it is not an STL file, is truncated, has no triangles or invalid numbers."""
    location, data = SourceLocation(str(path)), read_bytes(path)
    count = int.from_bytes(data[_HEADER_BYTES : _HEADER_BYTES + 4], "little")
    end = _HEADER_BYTES + 4 + _FACET_BYTES * count
    is_text = data.lstrip()[:5].lower() == b"solid" and len(data) != end
    stl = _read_ascii(data, location) if is_text else _read_binary(data, count, end, location)
    if not len(stl.corners):
        location.raise_error("it has no triangles")
    if not np.isfinite(stl.corners).all():
        location.raise_error("a vertex is not a finite number")
    return stl


def _read_binary(data: bytes, count: int, end: int, location: SourceLocation) -> StlFile:
    if len(data) < _HEADER_BYTES + 4:
        location.raise_error("not a readable STL file: it has neither the text 'solid' nor a whole header")
    if len(data) < end:
        location.raise_error(f"not a readable STL file: truncated, its header states {count} triangles")
    facets = np.frombuffer(data, _FACET, count, _HEADER_BYTES + 4)
    return StlFile(facets["corners"].astype(np.float64), _colours(data[:_HEADER_BYTES], facets["attribute"]), 1)


def _colours(header: bytes, attributes: np.ndarray) -> np.ndarray:
    """(t, 3) linear colours of facets, or (0, 3) if the file has none."""
    marker = header.find(b"COLOR=")
    own, shifts, default = (attributes & _HAS_COLOUR) != 0, _BLUE_FIRST, np.full(3, _GREY)
    if 0 <= marker <= _HEADER_BYTES - 10:
        own, shifts = ~own, _RED_FIRST
        default = srgb_to_linear(np.frombuffer(header, np.uint8, 3, marker + 6) / 255)
    elif not own.any():
        return np.zeros((0, 3))
    encoded = np.stack([attributes >> shift & 31 for shift in shifts], axis=1) / 31
    return np.where(own[:, None], srgb_to_linear(encoded), default)


def _read_ascii(data: bytes, location: SourceLocation) -> StlFile:
    text = data.lower()
    rows = re.findall(rb"\bvertex\s+([^\n\r]*)", text)
    numbers = parse_numbers(b" ".join(rows))
    facets = len(re.findall(rb"\bendfacet\b", text))
    if len(numbers) != 9 * facets or len(rows) != 3 * facets:
        wrong = next((row for row in rows if len(parse_numbers(row)) != 3 or len(row.split()) != 3), None)
        problem = "a facet needs three vertices" if wrong is None else "a vertex needs three numbers"
        location.raise_error(f"not a readable STL file: {problem}")
    solids = len(re.findall(rb"\bendsolid\b", text))
    has_colours = re.search(rb"^\s*colou?r\b", text, re.MULTILINE) is not None
    return StlFile(numbers.reshape(-1, 3, 3), np.zeros((0, 3)), max(solids, 1), has_colours)
