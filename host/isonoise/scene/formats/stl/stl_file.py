"""Reads STL files, binary and ASCII, with trimesh, and decodes the colours of their facets. Called by `read.py`.

Two conventions for colours in the unused two bytes of a binary facet are known: VisCAM's, and that of Materialise
Magics, whose header contains `COLOR=` and the colour of the whole object.
"""

import io
import logging
import re
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from isonoise.scene.files import read_bytes
from isonoise.scene.parse.elements import SourceLocation
from isonoise.scene.spectra import srgb_to_linear

_HEADER_BYTES, _FACET_BYTES = 80, 50
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
    """Read a file. Raises SceneError if trimesh cannot read it, or it has no triangles or invalid numbers."""
    location, data = SourceLocation(str(path)), read_bytes(path)
    count = data[_HEADER_BYTES : _HEADER_BYTES + 4]
    end = _HEADER_BYTES + 4 + _FACET_BYTES * int.from_bytes(count, "little")
    # binary files may begin with 'solid' too; text has no zero bytes, counts below 2^24 have one
    is_ascii = data.lstrip()[:5].lower() == b"solid" and b"\0" not in count
    if not is_ascii:
        if len(data) < end:
            location.raise_error("not a readable STL file: it is shorter than its header states")
        data = data[:end]  # trimesh refuses files that go on
    try:
        solids = _load_solids(data)
    except Exception as error:  # trimesh raises errors of any type for an invalid file
        reason = str(error).splitlines()[0][:100] if str(error) else type(error).__name__
        location.raise_error(f"not a readable STL file ({reason})")
    if not solids:
        is_cut = is_ascii and b"endsolid" not in data.lower()
        location.raise_error("it ends before 'endsolid'" if is_cut else "it has no triangles")
    corners = np.concatenate([np.asarray(solid.vertices, np.float64)[solid.faces] for solid in solids])
    if not np.isfinite(corners).all():
        location.raise_error("a vertex is not a finite number")
    attributes = solids[0].face_attributes.get("stl")  # of binary files, which have one solid
    if attributes is not None:
        return StlFile(corners, _colours(data[:_HEADER_BYTES], attributes.reshape(-1)), 1)
    has_colours = re.search(rb"^\s*colou?r\b", data.lower(), re.MULTILINE) is not None
    return StlFile(corners, np.zeros((0, 3)), len(solids), has_colours)


def _load_solids(data: bytes) -> list:
    """The solids with triangles, as `trimesh.Trimesh`."""
    import trimesh

    logging.getLogger("trimesh").addHandler(logging.NullHandler())  # without a handler it prints tracebacks
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")  # `read_stl` checks what matters
        loaded = trimesh.load_scene(io.BytesIO(data), file_type="stl", process=False, maintain_order=True)
    solids = [loaded.geometry[loaded.graph.get(name)[1]] for name in sorted(loaded.graph.nodes_geometry)]
    return [solid for solid in solids if len(solid.faces)]


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
