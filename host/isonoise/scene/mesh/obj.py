"""Reads Wavefront OBJ and MTL with numpy: a million triangles take about a second.

v, vt, vn, f, usemtl and mtllib are read. Polygons become triangle fans. Other statements are ignored.
"""

import math
import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from isonoise.scene.files import read_bytes
from isonoise.scene.mesh.mesh import Mesh, make_uvs, parse_numbers
from isonoise.scene.parse.elements import SourceLocation

_NEWLINE, _SLASH, _SPACE, _TAB = ord("\n"), ord("/"), ord(" "), ord("\t")
# Forms of a face's corner: number of slashes, whether they are adjacent, columns (vertex, uv, normal) that it sets.
_CORNER_FORMS = (
    (0, False, (0,)),  # 1
    (1, False, (0, 1)),  # 1/2
    (2, False, (0, 1, 2)),  # 1/2/3
    (2, True, (0, 2)),  # 1//3
)


@dataclass
class ObjFile:
    """The triangles of an OBJ file and their materials."""

    mesh: Mesh
    face_material: np.ndarray  # (t,) index into materials
    materials: list[str]  # names; '' for faces before the first usemtl
    libraries: list[str] = field(default_factory=list)  # names of mtllib statements


def read_obj(path: Path, flip_tex_coords: bool = True) -> ObjFile:
    """Read a file. `flip_tex_coords` replaces v by 1 - v, Mitsuba 3's default.

    Raises SceneError if it is not an OBJ file with faces, or has invalid indices or numbers.
    """
    location = SourceLocation(str(path))
    text = read_bytes(path)
    if b"\0" in text:
        location.raise_error("not an OBJ file: it contains binary data")
    text = text.replace(b"\r", b" ").replace(b"\\ \n", b"  ").replace(b"\\\n", b" ")
    text = re.sub(rb"#[^\n]*", b"", text) if b"#" in text else text
    text = re.sub(rb"\n[ \t]+", b"\n", b"\n" + text) + b"\n"
    lines = _Lines(text, location)
    vertices = lines.vectors(b"v ", 3)
    normals = lines.vectors(b"vn", 3)
    if not (np.isfinite(vertices).all() and np.isfinite(normals).all()):
        location.raise_error("a vertex or normal is not a finite number")
    corners, sizes, face_lines = lines.faces()
    if not len(sizes):
        location.raise_error("it has no faces")
    owner = np.repeat(np.arange(len(sizes)), sizes)
    for column, (key, name) in enumerate(((b"v ", "vertex"), (b"vt", "texture coordinate"), (b"vn", "normal"))):
        line_numbers = lines.lines_with_key(key)
        defined_before = np.searchsorted(line_numbers, face_lines)[owner]
        corners[:, column] = _absolute_indices(
            corners[:, column], defined_before, len(line_numbers), name, location, required=column == 0
        )
    uvs = np.zeros((0, 2), np.float32)
    if np.any(corners[:, 1] >= 0):
        uvs = make_uvs(lines.vectors(b"vt", 2), flip_tex_coords)
    mesh = _index_corners(vertices, normals, uvs, corners, _triangle_fans(sizes))
    polygon_material, names, libraries = lines.materials(face_lines)
    return ObjFile(mesh, np.repeat(polygon_material, sizes - 2), names, libraries)


class _Lines:
    """The lines of a text, found by their first two characters (the key; a tab counts as a space)."""

    def __init__(self, text: bytes, location: SourceLocation):
        self.location = location
        self.bytes = np.frombuffer(text, np.uint8)
        newlines = np.flatnonzero(self.bytes == _NEWLINE)
        self.starts, self.ends = newlines[:-1] + 1, newlines[1:]
        first, second = self.bytes[self.starts], self.bytes[np.minimum(self.starts + 1, len(text) - 1)]
        second = np.where(second == _TAB, _SPACE, second)
        self.keys = first.astype(np.uint16) << 8 | second
        self.lines_by_key: dict[bytes, np.ndarray] = {}

    def lines_with_key(self, key: bytes) -> np.ndarray:
        """Numbers of the lines with this key."""
        if key not in self.lines_by_key:
            self.lines_by_key[key] = np.flatnonzero(self.keys == (key[0] << 8 | key[1]))
        return self.lines_by_key[key]

    def text_without_key(self, line_numbers: np.ndarray) -> bytes:
        """The given lines without their key, each with its newline."""
        steps = np.zeros(len(self.bytes) + 1, np.int8)
        steps[self.starts[line_numbers] + 2] = 1
        steps[self.ends[line_numbers] + 1] -= 1
        return self.bytes[np.cumsum(steps[:-1], dtype=np.int8).view(bool)].tobytes()

    def vectors(self, key: bytes, size: int) -> np.ndarray:
        """(n, size): the first numbers of each line with this key; further ones (weights, colours) are dropped."""
        line_numbers = self.lines_with_key(key)
        if not len(line_numbers):
            return np.zeros((0, size))
        text = self.text_without_key(line_numbers)
        values = parse_numbers(text)
        _, sizes = _find_words(np.frombuffer(text, np.uint8))
        if sizes.min() < size or len(values) != sizes.sum():
            number = {2: "two", 3: "three"}[size]
            self.location.raise_error(f"a line that begins with '{key.decode().strip()}' needs {number} numbers")
        first = np.cumsum(sizes) - sizes
        return values[first[:, None] + np.arange(size)]

    def faces(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Corners (c, 3) of (vertex, uv, normal), 0 where not given; corner count and line number of each face."""
        line_numbers = self.lines_with_key(b"f ")
        if not len(line_numbers):
            return np.zeros((0, 3), np.int64), np.zeros(0, np.int64), line_numbers
        data = np.frombuffer(self.text_without_key(line_numbers), np.uint8)
        begins, sizes = _find_words(data)
        if sizes.min() < 3:
            self.location.raise_error("a face has fewer than three corners")
        slashes = np.flatnonzero(data == _SLASH)
        slash_count = np.bincount(np.searchsorted(begins, slashes, side="right") - 1, minlength=len(begins))
        has_adjacent = np.zeros(len(begins), bool)
        adjacent = slashes[:-1][np.diff(slashes) == 1]
        has_adjacent[np.searchsorted(begins, adjacent, side="right") - 1] = True
        corners = np.zeros((len(begins), 3), np.int64)
        for count, is_adjacent, columns in _CORNER_FORMS:
            selected = (slash_count == count) & (has_adjacent == is_adjacent)
            if selected.any():
                corners[np.ix_(selected, columns)] = self._parse_corners(data, begins, selected, len(columns))
        return corners, sizes, line_numbers

    def _parse_corners(self, data: np.ndarray, begins: np.ndarray, selected: np.ndarray, columns: int) -> np.ndarray:
        """(n, columns) indices of the selected words of a text."""
        if not selected.all():
            owner = np.cumsum(np.bincount(begins, minlength=len(data))) - 1
            data = np.where(selected[np.maximum(owner, 0)], data, _SPACE).astype(np.uint8)
        values = parse_numbers(data.tobytes().replace(b"/", b" "))
        if len(values) != columns * selected.sum() or np.any(values != np.rint(values)):
            self.location.raise_error("the corners of a face are whole numbers: 'f 1 2 3' or 'f 1/1/1 2/2/2 3/3/3'")
        return np.clip(values, -(2**40), 2**40).astype(np.int64).reshape(-1, columns)

    def materials(self, face_lines: np.ndarray) -> tuple[np.ndarray, list[str], list[str]]:
        """(material index of each face, material names, library names)."""
        uses = [(line, name) for line, word, name in self._statements(b"us") if word == b"usemtl"]
        libraries = [name for _, word, name in self._statements(b"mt") if word == b"mtllib"]
        names = ["", *dict.fromkeys(name for _, name in uses if name)]
        numbers = {name: number for number, name in enumerate(names)}
        index = np.array([0, *(numbers[name] for _, name in uses)])
        return index[np.searchsorted([line for line, _ in uses], face_lines)], names, libraries

    def _statements(self, key: bytes):
        """(line number, first word, rest) of each line with this key."""
        for line in self.lines_with_key(key):
            word, _, rest = self.bytes[self.starts[line] : self.ends[line]].tobytes().partition(b" ")
            yield line, word, rest.strip().decode("utf-8", "replace")


def _find_words(data: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(offset of each word of a text, number of words in each line)."""
    is_blank = (data == _SPACE) | (data == _TAB) | (data == _NEWLINE)
    begins = np.flatnonzero(~is_blank & np.concatenate([[True], is_blank[:-1]]))
    return begins, np.diff(np.searchsorted(begins, np.flatnonzero(data == _NEWLINE)), prepend=0)


def _absolute_indices(
    index: np.ndarray, defined_before: np.ndarray, count: int, name: str, location: SourceLocation, required: bool
) -> np.ndarray:
    """Indices from 0, or -1 where not given. A file counts from 1, or backwards from the last one defined so far."""
    result = np.where(index < 0, index + defined_before, index - 1)
    if np.any((result < 0) & (index != 0)) or np.any(result >= count) or (required and np.any(index == 0)):
        location.raise_error(f"a face uses a {name} that does not exist (there are {count})")
    return result


def _index_corners(
    vertices: np.ndarray, normals: np.ndarray, uvs: np.ndarray, corners: np.ndarray, triangles: np.ndarray
) -> Mesh:
    """A mesh with one vertex for each distinct corner, as in Mitsuba 3: normals are not smoothed across uv seams.

    `triangles` (t, 3) are numbers of corners.
    """
    if np.all(corners[:, 1:] < 0):
        return Mesh(vertices, corners[:, 0][triangles], np.zeros((0, 3)))
    sizes = corners.max(axis=0) + 2
    uv_and_normal = (corners[:, 1] + 1) * sizes[2] + corners[:, 2] + 1
    if math.prod(sizes.tolist()) >= 2**63:  # the keys below would overflow
        uv_and_normal = np.unique(uv_and_normal, return_inverse=True)[1].reshape(-1)
    key = corners[:, 0] * (uv_and_normal.max() + 1) + uv_and_normal
    _, first, inverse = np.unique(key, return_index=True, return_inverse=True)
    used = corners[first]
    return Mesh(
        vertices[used[:, 0]],
        inverse.reshape(-1)[triangles],
        _take_or_zero(normals, used[:, 2]),
        _take_or_zero(uvs, used[:, 1]),
    )


def _take_or_zero(values: np.ndarray, index: np.ndarray) -> np.ndarray:
    """values[index], 0 where the index is -1; empty if it is -1 everywhere."""
    is_given = index >= 0
    if not is_given.any():
        return values[:0]
    return np.where(is_given[:, None], values[index], values.dtype.type(0))


def _triangle_fans(sizes: np.ndarray) -> np.ndarray:
    """Corner numbers (t, 3) of the triangles of polygons with these corner counts."""
    first = np.cumsum(sizes) - sizes
    count = sizes - 2
    within = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    start = np.repeat(first, count)
    return np.stack([start, start + within + 1, start + within + 2], axis=1)


def read_mtl(path: Path) -> dict[str, dict[str, list[float]]]:
    """Diffuse colour 'Kd' and emission 'Ke', where given, of the materials of an MTL file."""
    materials: dict[str, dict[str, list[float]]] = {}
    current: dict[str, list[float]] = {}
    for line in read_bytes(path).decode("utf-8", "replace").splitlines():
        key, _, rest = line.partition("#")[0].strip().partition(" ")
        if key == "newmtl":
            current = materials.setdefault(rest.strip(), {})
        elif key in ("Kd", "Ke"):
            values = parse_numbers(rest.encode())
            if len(values) not in (1, 3) or not np.isfinite(values).all() or min(values) < 0:
                SourceLocation(str(path), element=key).raise_error(f"not a colour: '{rest.strip()[:40]}'")
            current[key] = np.broadcast_to(values, 3).tolist()
    return materials
