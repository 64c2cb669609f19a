"""Reads Stanford PLY files, ASCII and binary, with numpy. Called by `load_mesh.py` and `formats/ply`.

The counts in a header are checked against the size of the file before anything is allocated.
"""

import struct
from array import array
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import numpy as np

from isonoise.scene.files import read_decompressed
from isonoise.scene.mesh.mesh import Mesh, make_uvs, parse_numbers, validate_mesh
from isonoise.scene.mesh.ply_attributes import attribute_values, find_attributes
from isonoise.scene.mesh.polygons import triangulate
from isonoise.scene.parse.elements import SourceLocation

# numpy type of each PLY type
_TYPES = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"}
_TYPES |= {"float": "f4", "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2"}
_TYPES |= {"int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8"}
_TYPES |= {"half": "f2", "float16": "f2", "long": "i8", "ulong": "u8"}  # Mitsuba 3's own
# `struct` code of each numpy type
_CODES = {"i1": "b", "u1": "B", "i2": "h", "u2": "H", "i4": "i", "u4": "I", "f2": "e", "f4": "f", "f8": "d"}
_CODES |= {"i8": "q", "u8": "Q"}
_BYTE_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_UV_NAMES = (("u", "v"), ("texture_u", "texture_v"), ("s", "t"))
_MAX_HEADER_BYTES = 1 << 16
_MAX_LIST_LENGTH = 1 << 16
_GATHER_BYTES = 1 << 22  # records of irregular length that are copied at once


@dataclass
class _Property:
    name: str
    type: str  # numpy type of the value, or of the items of a list
    count_type: str = ""  # numpy type of a list's length; '' for a single value


@dataclass
class _Element:
    name: str
    count: int
    properties: list[_Property]

    def columns(self) -> list[str]:
        """A unique field name for each property."""
        return [f"{number} {item.name}" for number, item in enumerate(self.properties)]


@dataclass
class PlyFile:
    """A mesh, and what else the file says."""

    mesh: Mesh
    comments: list[str]
    counts: dict[str, int]  # number of records of each element
    corner_uvs: np.ndarray  # (t, 3, 2) float32: texture coordinates of the corners of faces, or (0, 3, 2)


def read_ply(path: Path, flip_tex_coords: bool = False) -> Mesh:
    """The mesh of a file, its polygons cut into fans as in Mitsuba 3: see `read_ply_file`."""
    return read_ply_file(path, flip_tex_coords).mesh


def read_ply_file(path: Path, flip_tex_coords: bool = False, cut_concave: bool = False) -> PlyFile:
    """Read a file. `flip_tex_coords` replaces v by 1 - v; `cut_concave` cuts concave polygons correctly.

    Raises SceneError if it is not a PLY mesh, is truncated, or has invalid vertex indices or numbers.
    """
    location = SourceLocation(str(path))
    data = read_decompressed(path)
    byte_order, elements, comments, start = _read_header(data, location)
    body = _Body(data, start, byte_order, location)
    mesh = faces = None
    for element in elements:
        if element.name == "vertex":
            mesh = _read_vertices(element, body.read_columns(element), flip_tex_coords, location)
        elif element.name == "face":
            faces = body.read_triangles(element, mesh.vertices if cut_concave and mesh else None)
        else:
            body.read_triangles(element)
        if mesh is not None and faces is not None:
            break
    counts = {element.name: element.count for element in elements}
    if mesh is None or faces is None or not len(faces[0]):
        location.raise_error("a mesh needs vertices and faces" + _hint(counts))
    mesh.faces = faces[0]
    mesh.attributes |= faces[1]
    corner_uvs = make_uvs(faces[2].reshape(-1, 2), flip_tex_coords).reshape(-1, 3, 2)
    return PlyFile(validate_mesh(mesh, location), comments, counts, corner_uvs)


def _hint(counts: dict[str, int]) -> str:
    """What a file without faces is."""
    if counts.get("tristrips"):
        return "; this one has triangle strips: convert it, for example with MeshLab"
    if counts.get("vertex"):
        return "; this is a point cloud: make a mesh of it, for example with MeshLab's surface reconstruction"
    return ""


def _read_vertices(element: _Element, columns: dict[str, np.ndarray], flip: bool, location: SourceLocation) -> Mesh:
    """A mesh without faces."""
    if any(axis not in columns for axis in "xyz"):
        location.raise_error("its vertices lack x, y or z")
    mesh = Mesh(_stack_columns(columns, "xyz"), np.zeros((0, 3), np.int64), np.zeros((0, 3)))
    if all(f"n{axis}" in columns for axis in "xyz"):
        mesh.normals = _stack_columns(columns, ("nx", "ny", "nz"))
    uv_names = next((pair for pair in _UV_NAMES if all(name in columns for name in pair)), None)
    if uv_names:
        mesh.uvs = make_uvs(_stack_columns(columns, uv_names), flip)
    names = [item.name for item in element.properties]
    for name, positions in find_attributes(names, "vertex").items():
        components = [columns[names[i]] for i in positions]
        mesh.attributes[name] = attribute_values(components, [element.properties[i].type for i in positions])
    return mesh


def _stack_columns(columns: dict[str, np.ndarray], names) -> np.ndarray:
    with np.errstate(invalid="ignore"):  # validate_mesh checks the numbers
        return np.stack([columns[name] for name in names], axis=1).astype(np.float64)


def _read_header(data: bytes, location: SourceLocation) -> tuple[str, list[_Element], list[str], int]:
    """(byte order '<', '>' or '' for ASCII, elements, comments, offset of the body)."""
    if data[:3] != b"ply":
        location.raise_error("not a PLY file")
    marker = data.find(b"end_header", 0, _MAX_HEADER_BYTES)
    end = data.find(b"\n", marker)
    if marker < 0 or end < 0:
        location.raise_error("its header has no end")
    byte_order, elements, comments = None, [], []
    for line in data[:marker].decode("utf-8", "replace").splitlines():
        words = line.split()
        if words[:1] == ["comment"]:
            comments.append(line.split("comment", 1)[1].strip())
        if words[:1] == ["format"]:
            byte_order = _BYTE_ORDERS.get(words[1] if len(words) > 1 else "")
        elif words[:1] == ["element"]:
            if len(words) != 3 or not words[2].isdigit() or len(words[2]) > 15:
                location.raise_error(f"invalid header line '{line[:60]}'")
            elements.append(_Element(words[1], int(words[2]), []))
        elif words[:1] == ["property"]:
            if not elements:
                location.raise_error("its header has a property before any element")
            elements[-1].properties.append(_parse_property(words, line, location))
    if byte_order is None:
        location.raise_error(f"its format is none of {', '.join(_BYTE_ORDERS)}")
    return byte_order, elements, comments, end + 1


def _parse_property(words: list[str], line: str, location: SourceLocation) -> _Property:
    is_list = words[1:2] == ["list"]
    types = words[2:4] if is_list else words[1:2]
    if len(words) != (5 if is_list else 3) or any(type_ not in _TYPES for type_ in types):
        location.raise_error(f"invalid header line '{line[:60]}'")
    return _Property(words[-1], _TYPES[types[-1]], _TYPES[types[0]] if is_list else "")


class _Body:
    """The records after the header, read in order. An ASCII body is parsed to 64-bit floats first."""

    def __init__(self, data: bytes, start: int, byte_order: str, location: SourceLocation):
        self.location, self.byte_order = location, byte_order
        self.data = memoryview(data)[start:] if byte_order else memoryview(parse_numbers(data[start:]).tobytes())
        self.position = 0

    def dtype(self, name: str) -> str:
        return self.byte_order + name if self.byte_order else "f8"

    def layout(self, element: _Element, lengths: tuple[int, ...]) -> np.dtype:
        """dtype of a record whose lists have these lengths; the lengths themselves are 'length 0', 'length 1', ..."""
        fields, list_number = [], 0
        for column, item in zip(element.columns(), element.properties, strict=True):
            if item.count_type:
                fields.append((f"length {list_number}", self.dtype(item.count_type)))
                fields.append((column, self.dtype(item.type), (lengths[list_number],)))
                list_number += 1
            else:
                fields.append((column, self.dtype(item.type)))
        return np.dtype(fields)

    def read_columns(self, element: _Element) -> dict[str, np.ndarray]:
        """Columns by property name of an element without lists."""
        if any(item.count_type for item in element.properties) or not element.properties:
            self.location.raise_error(f"the properties of element '{element.name}' have to be single numbers")
        records = self.view(element, self.layout(element, ()), element.count)
        self.position += records.nbytes
        names = (item.name for item in element.properties)
        return {name: records[column] for name, column in zip(names, element.columns(), strict=True)}

    def read_triangles(
        self, element: _Element, vertices: np.ndarray | None = None
    ) -> tuple[np.ndarray, dict[str, np.ndarray], np.ndarray]:
        """((t, 3) vertex indices, attributes, (t, 3, 2) texture coordinates of corners or (0, 3, 2)) of polygons.

        Skips an element of any other kind. With `vertices`, concave polygons are cut correctly.
        """
        columns = element.columns()
        index_column = next((c for c in columns if c.endswith((" vertex_indices", " vertex_index"))), "")
        uv_column = next((c for c in columns if c.endswith(" texcoord")), "") if index_column else ""
        names = ["" if item.count_type else item.name for item in element.properties]
        attributes = find_attributes(names, element.name) if index_column else {}
        faces, owners = [np.zeros((0, 3), np.int64)], [np.zeros(0, np.int64)]
        corner_uvs = [np.zeros((0, 3, 2))]
        value_parts: dict[str, list[np.ndarray]] = {name: [] for name in attributes}
        for numbers, records in self.records_by_length(element):
            if not index_column:
                continue
            with np.errstate(invalid="ignore"):  # a NaN becomes an index that validate_mesh rejects
                polygons = records[index_column].astype(np.int64)
            size = polygons.shape[1]
            triangles = _triangulate(polygons, vertices, self.location)
            faces.append(polygons.reshape(-1)[triangles])
            owners.append(np.repeat(numbers, size - 2))
            if uv_column:
                uvs = records[uv_column]
                is_complete = uvs.ndim == 2 and uvs.shape[1] == 2 * size
                uvs = uvs.reshape(-1, 2) if is_complete else np.zeros((polygons.size, 2))
                corner_uvs.append(uvs[triangles].astype(np.float64))
            for name, positions in attributes.items():
                components = [records[columns[i]] for i in positions]
                values = attribute_values(components, [element.properties[i].type for i in positions])
                value_parts[name].append(np.repeat(values, size - 2, axis=0))
        order = np.argsort(np.concatenate(owners), kind="stable") if len(faces) > 2 else slice(None)
        values = {name: np.concatenate(parts)[order] for name, parts in value_parts.items() if parts}
        corners = np.concatenate(corner_uvs)
        return np.concatenate(faces)[order], values, corners[order] if len(corners) else corners

    def records_by_length(self, element: _Element) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """(record numbers, records) of the element, in groups whose lists have equal lengths.

        In most files all records have the lengths of the first one: they are one array. From the first record that
        differs, records are found one by one.
        """
        if not element.count or not element.properties:
            return
        lists = self.list_layout(element)
        lengths, _ = self.list_lengths(element, lists, self.position)
        layout = self.layout(element, lengths)
        max_count = (len(self.data) - self.position) // layout.itemsize if layout.itemsize else element.count
        records = self.view(element, layout, max(min(element.count, max_count), 1))
        is_same = np.ones(len(records), bool)
        for number, length in enumerate(lengths):
            is_same &= records[f"length {number}"] == length
        run = len(records) if is_same.all() else int(np.argmin(is_same))
        yield np.arange(run), records[:run]
        self.position += run * layout.itemsize
        positions, groups, group_of_lengths = array("q"), array("q"), {}
        for _ in range(element.count - run):
            lengths, end = self.list_lengths(element, lists, self.position)
            positions.append(self.position)
            groups.append(group_of_lengths.setdefault(lengths, len(group_of_lengths)))
            self.position = end
        if group_of_lengths:
            layouts = [self.layout(element, lengths) for lengths in group_of_lengths]
            yield from self.gather(run, np.asarray(positions), np.asarray(groups), layouts)

    def gather(self, first: int, positions: np.ndarray, groups: np.ndarray, layouts: list[np.dtype]):
        """(record numbers, records) at these positions by group, a bounded number of bytes at a time."""
        data, order = np.frombuffer(self.data, np.uint8), np.argsort(groups, kind="stable")
        for members in np.split(order, np.flatnonzero(np.diff(groups[order])) + 1):
            layout = layouts[groups[members[0]]]
            for numbers in np.array_split(members, -(-len(members) * layout.itemsize // _GATHER_BYTES)):
                records = data[positions[numbers][:, None] + np.arange(layout.itemsize)]
                yield first + numbers, records.view(layout)[:, 0]

    def view(self, element: _Element, layout: np.dtype, count: int) -> np.ndarray:
        if count * layout.itemsize > len(self.data) - self.position:
            self.raise_truncated(element)
        return np.frombuffer(self.data, layout, count, self.position)

    def list_layout(self, element: _Element) -> list[tuple[int, struct.Struct, int]]:
        """(bytes before the length, struct of the length, bytes of an item) of every list.

        A last entry without items gives the bytes after the last list.
        """
        lists, bytes_before = [], 0
        for item in element.properties:
            size = np.dtype(self.dtype(item.type)).itemsize
            if item.count_type:
                code = (self.byte_order or "=") + _CODES[self.dtype(item.count_type)[-2:]]
                lists.append((bytes_before, struct.Struct(code), size))
                bytes_before = 0
            else:
                bytes_before += size
        return [*lists, (bytes_before, struct.Struct("0s"), 0)]

    def list_lengths(self, element: _Element, lists: list, position: int) -> tuple[tuple[int, ...], int]:
        """(lengths of the lists of the record at a position, position of the next record)."""
        lengths = []
        try:
            for bytes_before, length_struct, item_size in lists[:-1]:
                length = length_struct.unpack_from(self.data, position + bytes_before)[0]
                if not 0 <= length <= _MAX_LIST_LENGTH or length != int(length):
                    self.location.raise_error(f"a list of element '{element.name}' has {length} entries")
                lengths.append(int(length))
                position += bytes_before + length_struct.size + int(length) * item_size
        except struct.error:
            self.raise_truncated(element)
        position += lists[-1][0]
        if position > len(self.data):
            self.raise_truncated(element)
        return tuple(lengths), position

    def raise_truncated(self, element: _Element) -> NoReturn:
        self.location.raise_error(f"truncated: its header states {element.count} of element '{element.name}'")


def _triangulate(polygons: np.ndarray, vertices: np.ndarray | None, location: SourceLocation) -> np.ndarray:
    """Corner numbers (t, 3) of the triangles of polygons (p, n) of vertex indices; fans without `vertices`."""
    count, size = polygons.shape
    if size < 3:
        location.raise_error("a face has fewer than three corners")
    if vertices is not None and size > 3 and polygons.min() >= 0 and polygons.max() < len(vertices):
        return triangulate(vertices[polygons.reshape(-1)], np.full(count, size))
    fan = np.stack([np.zeros(size - 2, np.int64), np.arange(1, size - 1), np.arange(2, size)], axis=1)
    return (size * np.arange(count)[:, None, None] + fan).reshape(-1, 3)
