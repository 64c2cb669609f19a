"""Stanford PLY (ASCII and binary), read with numpy; polygons become fans of triangles.

A header's counts are held against the size of the file before anything is allocated.
"""

import struct
from array import array
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import numpy as np

from isonoise.scene.files import read_bytes
from isonoise.scene.mesh.mesh import Mesh, checked, parse_numbers, texture_coordinates
from isonoise.scene.mesh.ply_attributes import attribute_values, attributes_of
from isonoise.scene.parse.elements import SourceLocation

_TYPES = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"}
_TYPES |= {"float": "f4", "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2"}
_TYPES |= {"int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8"}
_TYPES |= {"half": "f2", "float16": "f2", "long": "i8", "ulong": "u8"}  # Mitsuba 3's own
_CODES = {"i1": "b", "u1": "B", "i2": "h", "u2": "H", "i4": "i", "u4": "I", "f2": "e", "f4": "f", "f8": "d"}
_CODES |= {"i8": "q", "u8": "Q"}
_UVS = (("u", "v"), ("texture_u", "texture_v"), ("s", "t"))
_HEADER = 1 << 16  # bytes in which a header has to end
_LIST = 1 << 16  # longest list of one face
_GATHERED = 1 << 22  # bytes of records that are collected at once


@dataclass
class _Property:
    name: str
    type: str  # numpy type of the value, or of the items of a list
    count: str = ""  # numpy type of a list's length; '' for a single value


@dataclass
class _Element:
    name: str
    count: int
    properties: list[_Property]


def read_ply(path: Path, flip_tex_coords: bool = False) -> Mesh:
    """Read a file; `flip_tex_coords`: its v runs downwards.

    Raises SceneError where it is not a PLY mesh, is cut off, or its indices or numbers are bad.
    """
    location = SourceLocation(str(path))
    data = read_bytes(path)
    order, elements, start = _header(data, location)
    body = _Body(data, start, order, location)
    vertices = faces = None
    for element in elements:
        if element.name == "vertex":
            vertices = _vertices(element, body.table(element), flip_tex_coords, location)
        elif element.name == "face":
            faces = body.triangles(element)
        else:
            body.triangles(element)
        if vertices is not None and faces is not None:
            break
    if vertices is None or faces is None or not len(faces[0]):
        location.raise_error("a mesh needs vertices and faces")
    vertices.faces = faces[0]
    vertices.attributes |= faces[1]
    return checked(vertices, location)


def _vertices(element: _Element, columns: dict[str, np.ndarray], flip: bool, location: SourceLocation) -> Mesh:
    """A mesh that lacks its faces."""
    if any(axis not in columns for axis in "xyz"):
        location.raise_error("its vertices lack x, y or z")
    mesh = Mesh(_stacked(columns, "xyz", np.float64), np.zeros((0, 3), np.int64), np.zeros((0, 3)))
    if all(f"n{axis}" in columns for axis in "xyz"):
        mesh.normals = _stacked(columns, ("nx", "ny", "nz"), np.float64)
    uv = next((pair for pair in _UVS if all(name in columns for name in pair)), None)
    if uv:
        mesh.uvs = texture_coordinates(_stacked(columns, uv, np.float64), flip)
    names = [item.name for item in element.properties]
    for name, positions in attributes_of(names, "vertex").items():
        parts = [columns[names[i]] for i in positions]
        mesh.attributes[name] = attribute_values(parts, [element.properties[i].type for i in positions])
    return mesh


def _stacked(columns: dict[str, np.ndarray], names, dtype) -> np.ndarray:
    with np.errstate(invalid="ignore"):  # the check of the mesh tells
        return np.stack([columns[name] for name in names], axis=1).astype(dtype)


def _header(data: bytes, location: SourceLocation) -> tuple[str, list[_Element], int]:
    """(byte order '<', '>' or '' for ASCII, elements, where the body begins)."""
    if data[:3] != b"ply":
        location.raise_error("not a PLY file")
    marker = data.find(b"end_header", 0, _HEADER)
    end = data.find(b"\n", marker)
    if marker < 0 or end < 0:
        location.raise_error("its header has no end")
    order, elements = None, []
    for line in data[:marker].decode("ascii", "replace").splitlines():
        words = line.split()
        if words[:1] == ["format"]:
            order = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}.get(
                words[1] if len(words) > 1 else ""
            )
        elif words[:1] == ["element"]:
            if len(words) != 3 or not words[2].isdigit() or len(words[2]) > 15:
                location.raise_error(f"unreadable header line '{line[:60]}'")
            elements.append(_Element(words[1], int(words[2]), []))
        elif words[:1] == ["property"]:
            if not elements:
                location.raise_error("its header names a property before any element")
            elements[-1].properties.append(_property(words, line, location))
    if order is None:
        location.raise_error("its format is neither ascii nor binary_little_endian nor binary_big_endian")
    return order, elements, end + 1


def _property(words: list[str], line: str, location: SourceLocation) -> _Property:
    is_list = words[1:2] == ["list"]
    types = words[2:4] if is_list else words[1:2]
    if len(words) != (5 if is_list else 3) or any(type_ not in _TYPES for type_ in types):
        location.raise_error(f"unreadable header line '{line[:60]}'")
    return _Property(words[-1], _TYPES[types[-1]], _TYPES[types[0]] if is_list else "")


class _Body:
    """The records after the header, read in order. An ASCII body is one of 64-bit floats throughout."""

    def __init__(self, data: bytes, start: int, order: str, location: SourceLocation):
        self.location, self.order = location, order
        self.data = memoryview(data)[start:] if order else memoryview(parse_numbers(data[start:]).tobytes())
        self.position = 0

    def type(self, name: str) -> str:
        return self.order + name if self.order else "f8"

    def layout(self, element: _Element, lengths: tuple[int, ...]) -> np.dtype:
        """The record of an element whose lists have these lengths; list lengths are 'length 0', 'length 1', ..."""
        fields, remaining = [], list(lengths)
        for number, item in enumerate(element.properties):
            if item.count:
                fields.append((f"length {len(lengths) - len(remaining)}", self.type(item.count)))
                fields.append((f"{number} {item.name}", self.type(item.type), (remaining.pop(0),)))
            else:
                fields.append((f"{number} {item.name}", self.type(item.type)))
        return np.dtype(fields)

    def table(self, element: _Element) -> dict[str, np.ndarray]:
        """Columns by name of an element without lists."""
        if any(item.count for item in element.properties) or not element.properties:
            self.location.raise_error(f"element '{element.name}' has to have properties that are single numbers")
        layout = self.layout(element, ())
        records = self.view(element, layout, element.count)
        self.position += records.nbytes
        return {item.name: records[f"{n} {item.name}"] for n, item in enumerate(element.properties)}

    def triangles(self, element: _Element) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """((t, 3) vertex indices, attributes) of an element of polygons; passes over an element of any other kind."""
        fields = [f"{n} {item.name}" for n, item in enumerate(element.properties)]
        indices = next((f for f in fields if f.endswith((" vertex_indices", " vertex_index"))), "")
        attributes = attributes_of(["" if p.count else p.name for p in element.properties], element.name)
        faces, owners = [np.zeros((0, 3), np.int64)], [np.zeros(0, np.int64)]
        parts: dict[str, list[np.ndarray]] = {name: [] for name in attributes} if indices else {}
        for numbers, records in self.groups(element):
            if not indices:
                continue
            polygons = records[indices]
            with np.errstate(invalid="ignore"):  # what is no number names no vertex
                faces.append(_fans(polygons.astype(np.int64), self.location))
            owners.append(np.repeat(numbers, polygons.shape[1] - 2))
            for name, of_group in parts.items():
                columns = [records[fields[i]] for i in attributes[name]]
                values = attribute_values(columns, [element.properties[i].type for i in attributes[name]])
                of_group.append(np.repeat(values, polygons.shape[1] - 2, axis=0))
        order = np.argsort(np.concatenate(owners), kind="stable") if len(faces) > 2 else slice(None)
        values = {name: np.concatenate(of_group)[order] for name, of_group in parts.items() if of_group}
        return np.concatenate(faces)[order], values

    def groups(self, element: _Element) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """(numbers, records) of those records of an element whose lists are equally long; each is in one group.

        In most files that is one run of all. After the first that differs, records are found one by one.
        """
        if not element.count or not element.properties:
            return
        steps = self.steps(element)
        lengths, _ = self.lengths(element, steps, self.position)
        layout = self.layout(element, lengths)
        fits = (len(self.data) - self.position) // layout.itemsize if layout.itemsize else element.count
        records = self.view(element, layout, max(min(element.count, fits), 1))
        same = np.ones(len(records), bool)
        for number, length in enumerate(lengths):
            same &= records[f"length {number}"] == length
        run = len(records) if same.all() else int(np.argmin(same))
        yield np.arange(run), records[:run]
        self.position += run * layout.itemsize
        positions, kinds, known = array("q"), array("q"), {}
        for _ in range(element.count - run):
            lengths, end = self.lengths(element, steps, self.position)
            positions.append(self.position)
            kinds.append(known.setdefault(lengths, len(known)))
            self.position = end
        if known:
            yield from self.gathered(element, run, np.asarray(positions), np.asarray(kinds), list(known))

    def gathered(self, element: _Element, first: int, positions: np.ndarray, kinds: np.ndarray, known: list[tuple]):
        """The groups of records that lie at these positions, a bounded number of bytes at a time."""
        data, order = np.frombuffer(self.data, np.uint8), np.argsort(kinds, kind="stable")
        for of_kind in np.split(order, np.flatnonzero(np.diff(kinds[order])) + 1):
            layout = self.layout(element, known[kinds[of_kind[0]]])
            for numbers in np.array_split(of_kind, -(-len(of_kind) * layout.itemsize // _GATHERED)):
                records = data[positions[numbers][:, None] + np.arange(layout.itemsize)]
                yield first + numbers, records.view(layout)[:, 0]

    def view(self, element: _Element, layout: np.dtype, count: int) -> np.ndarray:
        if count * layout.itemsize > len(self.data) - self.position:
            self.raise_cut_off(element)
        return np.frombuffer(self.data, layout, count, self.position)

    def steps(self, element: _Element) -> list[tuple[int, struct.Struct, int]]:
        """(bytes before its length, what the length is, bytes of an item) of every list; the last one has no items."""
        steps, before = [], 0
        for item in element.properties:
            size = np.dtype(self.type(item.type)).itemsize
            if item.count:
                steps.append((before, struct.Struct((self.order or "=") + _CODES[self.type(item.count)[-2:]]), size))
                before = 0
            else:
                before += size
        return [*steps, (before, struct.Struct("0s"), 0)]

    def lengths(self, element: _Element, steps: list, position: int) -> tuple[tuple[int, ...], int]:
        """(lengths of the lists of the record at a position, where the next one begins)."""
        lengths = []
        try:
            for before, number, size in steps[:-1]:
                length = number.unpack_from(self.data, position + before)[0]
                if not 0 <= length <= _LIST or length != int(length):
                    self.location.raise_error(f"a list of element '{element.name}' has {length} entries")
                lengths.append(int(length))
                position += before + number.size + int(length) * size
        except struct.error:
            self.raise_cut_off(element)
        position += steps[-1][0]
        if position > len(self.data):
            self.raise_cut_off(element)
        return tuple(lengths), position

    def raise_cut_off(self, element: _Element) -> NoReturn:
        self.location.raise_error(
            f"cut off, or its header promises too much: {element.count} of element '{element.name}'"
        )


def _fans(polygons: np.ndarray, location: SourceLocation) -> np.ndarray:
    corners = polygons.shape[1]
    if corners < 3:
        location.raise_error("a face has fewer than three corners")
    triangles = [polygons[:, [0, i, i + 1]] for i in range(1, corners - 1)]
    return np.stack(triangles, axis=1).reshape(-1, 3)
