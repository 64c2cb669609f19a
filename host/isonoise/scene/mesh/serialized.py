"""Mitsuba's `serialized` meshes, versions 3 and 4: zlib streams one after another, and a table of where they begin.

The format is documented in Mitsuba 3's src/shapes/serialized.cpp. Memory is bounded by the size of the file: what a
header promises is held against it before anything is read, and streams are inflated only as far as they are needed.
"""

import os
import struct
import zlib
from pathlib import Path
from typing import BinaryIO

import numpy as np

from isonoise.errors import SceneError
from isonoise.scene.files import open_regular_file
from isonoise.scene.mesh.mesh import Mesh, checked, texture_coordinates
from isonoise.scene.parse.elements import SourceLocation

_FORMAT = 0x041C
_OFFSETS = {3: "I", 4: "Q"}  # versions that are read -> type of an offset in the table
_NORMALS, _UVS, _COLOURS, _DOUBLE = 0x1, 0x2, 0x8, 0x2000
_NAME = 1 << 16  # bytes of a name
_CHUNK = 1 << 16
# Meshes deflate to between a half and a twelfth (measured: scans, grids, loose triangles); DEFLATE can do 1030.
_SMALL, _RATIO = 1 << 26, 100


def read_serialized(path: Path, shape_index: int = 0) -> Mesh:
    """One mesh of a file, colours as the attribute 'vertex_color'.

    As in Mitsuba 3, the flag for face normals counts for nothing. Raises SceneError where it is not such a file, is
    cut off, has no shape of this number, or its indices or numbers are bad.
    """
    location = SourceLocation(str(path), element=f"shape {shape_index}")
    try:
        with open_regular_file(path) as file:
            version, start, size = _find(file, shape_index, location)
            file.seek(start)
            with np.errstate(all="ignore"):  # the check of the mesh tells
                return _mesh(_Stream(file, size - start, location), version, location)
    except OSError as error:
        raise SceneError(f"{path}: cannot be read ({error.strerror})") from None


def _find(file: BinaryIO, shape_index: int, location: SourceLocation) -> tuple[int, int, int]:
    """(version, where the stream of the shape begins, size of the file)."""
    size = os.fstat(file.fileno()).st_size
    head = file.read(4)
    format_, version = struct.unpack("<HH", head) if len(head) == 4 else (0, 0)
    if format_ != _FORMAT:
        location.raise_error("not a serialized Mitsuba mesh")
    if version not in _OFFSETS:
        location.raise_error(f"version {version} of the format is not read (3 and 4 are)")
    if shape_index == 0:
        return version, 4, size  # as in Mitsuba 3, a file with one mesh needs no table
    entry = struct.calcsize("<" + _OFFSETS[version])
    file.seek(max(size - 4, 0))
    count = struct.unpack("<I", file.read(4))[0]
    table = size - 4 - count * entry
    if table < 4:
        location.raise_error("the table at its end is damaged, or the file is cut off")
    if shape_index >= count:
        location.raise_error(f"there is no such shape; the file has {count}, counted from 0")
    file.seek(table + shape_index * entry)
    offset = struct.unpack("<" + _OFFSETS[version], file.read(entry))[0]
    if offset + 4 > table:
        location.raise_error("the table at its end is damaged")
    return version, offset + 4, size


class _Stream:
    """A zlib stream, inflated as far as it is read."""

    def __init__(self, file: BinaryIO, size: int, location: SourceLocation):
        self.file, self.location = file, location
        self.room = _SMALL + _RATIO * size  # bytes that it may reasonably hold
        self.inflater = zlib.decompressobj()
        self.pending = bytearray()

    def _inflated(self, most: int) -> bytes:
        """The next bytes, at least one."""
        piece = b""
        while not piece:
            source = self.inflater.unconsumed_tail or self.file.read(_CHUNK)
            try:
                piece = self.inflater.decompress(source, most)
            except zlib.error:
                self.location.raise_error("its compressed data is damaged")
            if not piece and (not source or self.inflater.eof):
                self.location.raise_error("cut off, or its header promises too much")
        return piece

    def read(self, count: int) -> bytearray:
        data = self.pending[:count]
        del self.pending[:count]
        while len(data) < count:
            data += self._inflated(min(count - len(data), _CHUNK))
        return data

    def skip_text(self):
        """Pass over a text and the zero at its end."""
        while (end := self.pending.find(0)) < 0:
            if len(self.pending) > _NAME:
                self.location.raise_error("its name has no end")
            self.pending += self._inflated(_CHUNK)
        del self.pending[: end + 1]

    def array(self, type_: str, rows: int, columns: int) -> np.ndarray:
        return np.frombuffer(self.read(rows * columns * np.dtype(type_).itemsize), type_).reshape(rows, columns)


def _mesh(stream: _Stream, version: int, location: SourceLocation) -> Mesh:
    flags = struct.unpack("<I", stream.read(4))[0]
    if version == 4:
        stream.skip_text()
    vertices, faces = struct.unpack("<QQ", stream.read(16))
    number, index = "<f8" if flags & _DOUBLE else "<f4", "<u4" if vertices < 2**32 else "<u8"
    per_vertex = 3 + 3 * bool(flags & _NORMALS) + 2 * bool(flags & _UVS) + 3 * bool(flags & _COLOURS)
    size = vertices * per_vertex * np.dtype(number).itemsize + faces * 3 * np.dtype(index).itemsize
    if size > stream.room:
        location.raise_error(
            f"its header promises {vertices} vertices and {faces} triangles, more than the file can hold"
        )
    if not vertices or not faces:
        location.raise_error("a mesh needs vertices and faces")
    mesh = Mesh(stream.array(number, vertices, 3).astype(np.float64), np.zeros((0, 3), np.int64), np.zeros((0, 3)))
    if flags & _NORMALS:
        mesh.normals = stream.array(number, vertices, 3).astype(np.float64)
    if flags & _UVS:
        mesh.uvs = texture_coordinates(stream.array(number, vertices, 2), flip=False)
    if flags & _COLOURS:
        mesh.attributes["vertex_color"] = stream.array(number, vertices, 3).astype(np.float32)
    mesh.faces = stream.array(index, faces, 3).astype(np.int64)  # what does not fit is negative, and refused
    return checked(mesh, location)
