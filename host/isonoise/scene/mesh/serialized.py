"""Reads Mitsuba's `serialized` meshes, versions 3 and 4: consecutive zlib streams, then a table of their offsets.

The format is documented in Mitsuba 3's src/shapes/serialized.cpp. Memory is bounded by the size of the file: the
counts in a header are checked against it before anything is read, and a stream is inflated only as far as needed.
"""

import os
import struct
import zlib
from pathlib import Path
from typing import BinaryIO

import numpy as np

from isonoise.errors import SceneError
from isonoise.scene.files import open_regular_file
from isonoise.scene.mesh.mesh import Mesh, make_uvs, validate_mesh
from isonoise.scene.parse.elements import SourceLocation

_FORMAT_ID = 0x041C
_OFFSET_TYPES = {3: "I", 4: "Q"}  # supported versions -> struct type of an offset in the table
_HAS_NORMALS, _HAS_UVS, _HAS_COLOURS, _IS_DOUBLE = 0x1, 0x2, 0x8, 0x2000
_MAX_NAME_BYTES = 1 << 16
_CHUNK_BYTES = 1 << 16
# Upper bound on the inflated size. Meshes deflate to between 1/2 and 1/12 (measured: scans, grids, loose triangles);
# DEFLATE's maximum is 1/1030.
_MIN_INFLATED_BYTES, _MAX_INFLATE_RATIO = 1 << 26, 100


def read_serialized(path: Path, shape_index: int = 0) -> Mesh:
    """Read one mesh of a file; vertex colours become the attribute 'vertex_color'.

    The flag for face normals is ignored, as in Mitsuba 3. Raises SceneError if the file is not in this format, is
    truncated, has no shape of this index, or has invalid vertex indices or numbers.
    """
    location = SourceLocation(str(path), element=f"shape {shape_index}")
    try:
        with open_regular_file(path) as file:
            version, start, size = _find_stream(file, shape_index, location)
            file.seek(start)
            with np.errstate(all="ignore"):  # validate_mesh checks the numbers
                return _read_mesh(_InflatedStream(file, size - start, location), version, location)
    except OSError as error:
        raise SceneError(f"{path}: cannot be read ({error.strerror})") from None


def _find_stream(file: BinaryIO, shape_index: int, location: SourceLocation) -> tuple[int, int, int]:
    """(version, offset of the shape's stream, size of the file)."""
    size = os.fstat(file.fileno()).st_size
    head = file.read(4)
    format_id, version = struct.unpack("<HH", head) if len(head) == 4 else (0, 0)
    if format_id != _FORMAT_ID:
        location.raise_error("not a serialized Mitsuba mesh")
    if version not in _OFFSET_TYPES:
        location.raise_error(f"version {version} of the format is not supported (3 and 4 are)")
    if shape_index == 0:
        return version, 4, size  # as in Mitsuba 3, a file with one mesh needs no table
    entry_bytes = struct.calcsize("<" + _OFFSET_TYPES[version])
    file.seek(max(size - 4, 0))
    count = struct.unpack("<I", file.read(4))[0]
    table = size - 4 - count * entry_bytes
    if table < 4:
        location.raise_error("the offset table at its end is damaged, or the file is truncated")
    if shape_index >= count:
        location.raise_error(f"the file has no such shape; it has {count}, counted from 0")
    file.seek(table + shape_index * entry_bytes)
    offset = struct.unpack("<" + _OFFSET_TYPES[version], file.read(entry_bytes))[0]
    if offset + 4 > table:
        location.raise_error("the offset table at its end is damaged")
    return version, offset + 4, size


class _InflatedStream:
    """A zlib stream that is inflated as it is read."""

    def __init__(self, file: BinaryIO, size: int, location: SourceLocation):
        self.file, self.location = file, location
        self.max_bytes = _MIN_INFLATED_BYTES + _MAX_INFLATE_RATIO * size
        self.inflater = zlib.decompressobj()
        self.pending = bytearray()

    def _inflate(self, max_bytes: int) -> bytes:
        """The next bytes, at least one."""
        piece = b""
        while not piece:
            source = self.inflater.unconsumed_tail or self.file.read(_CHUNK_BYTES)
            try:
                piece = self.inflater.decompress(source, max_bytes)
            except zlib.error:
                self.location.raise_error("its compressed data is damaged")
            if not piece and (not source or self.inflater.eof):
                self.location.raise_error("truncated, or its header states too large counts")
        return piece

    def read(self, count: int) -> bytearray:
        data = self.pending[:count]
        del self.pending[:count]
        while len(data) < count:
            data += self._inflate(min(count - len(data), _CHUNK_BYTES))
        return data

    def skip_string(self):
        """Skip a zero-terminated string."""
        while (end := self.pending.find(0)) < 0:
            if len(self.pending) > _MAX_NAME_BYTES:
                self.location.raise_error("its name is not terminated")
            self.pending += self._inflate(_CHUNK_BYTES)
        del self.pending[: end + 1]

    def read_array(self, dtype: str, rows: int, columns: int) -> np.ndarray:
        return np.frombuffer(self.read(rows * columns * np.dtype(dtype).itemsize), dtype).reshape(rows, columns)


def _read_mesh(stream: _InflatedStream, version: int, location: SourceLocation) -> Mesh:
    flags = struct.unpack("<I", stream.read(4))[0]
    if version == 4:
        stream.skip_string()
    vertices, faces = struct.unpack("<QQ", stream.read(16))
    number, index = "<f8" if flags & _IS_DOUBLE else "<f4", "<u4" if vertices < 2**32 else "<u8"
    per_vertex = 3 + 3 * bool(flags & _HAS_NORMALS) + 2 * bool(flags & _HAS_UVS) + 3 * bool(flags & _HAS_COLOURS)
    size = vertices * per_vertex * np.dtype(number).itemsize + faces * 3 * np.dtype(index).itemsize
    if size > stream.max_bytes:
        location.raise_error(f"its header states {vertices} vertices and {faces} faces, more than the file can hold")
    if not vertices or not faces:
        location.raise_error("a mesh needs vertices and faces")
    mesh = Mesh(stream.read_array(number, vertices, 3).astype(np.float64), np.zeros((0, 3), np.int64), np.zeros((0, 3)))
    if flags & _HAS_NORMALS:
        mesh.normals = stream.read_array(number, vertices, 3).astype(np.float64)
    if flags & _HAS_UVS:
        mesh.uvs = make_uvs(stream.read_array(number, vertices, 2), flip=False)
    if flags & _HAS_COLOURS:
        mesh.attributes["vertex_color"] = stream.read_array(number, vertices, 3).astype(np.float32)
    mesh.faces = stream.read_array(index, faces, 3).astype(np.int64)  # an overflow is negative, and rejected below
    return validate_mesh(mesh, location)
