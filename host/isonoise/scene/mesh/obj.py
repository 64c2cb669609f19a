"""Reads Wavefront OBJ with numpy: a million triangles take about a second. Called by `load_mesh.py` and `formats/obj`.

v, vt, vn, f, usemtl and mtllib are read. Other statements are counted or ignored.
"""

import math
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from isonoise.scene.files import read_bytes
from isonoise.scene.mesh.mesh import Mesh, make_uvs, parse_numbers
from isonoise.scene.mesh.polygons import triangle_fans, triangulate
from isonoise.scene.parse.elements import SourceLocation

_BYTE_ORDER_MARK = b"\xef\xbb\xbf"
_NEWLINE, _SLASH, _SPACE, _TAB = ord("\n"), ord("/"), ord(" "), ord("\t")
# Forms of a face's corner: number of slashes, whether they are adjacent, columns (vertex, uv, normal) that it sets.
_CORNER_FORMS = (
    (0, False, (0,)),  # 1
    (1, False, (0, 1)),  # 1/2
    (2, False, (0, 1, 2)),  # 1/2/3
    (2, True, (0, 2)),  # 1//3
)
_CORNER_HINT = "the corners of a face are whole numbers: 'f 1 2 3' or 'f 1/1/1 2/2/2 3/3/3'"
_COMMENT = re.compile(rb"\s#\s.*")
"""After a name, which may contain a '#'."""
_COUNTED = (
    *(("objects", b"o ", b"o"), ("groups", b"g ", b"g"), ("lines", b"l ", b"l"), ("points", b"p ", b"p")),
    *(("curves", b"cu", b"curv"), ("curves", b"cu", b"curv2"), ("surfaces", b"su", b"surf")),
)
"""Plural noun, key and first word of the statements that are only counted."""


@dataclass
class ObjFile:
    """The triangles of an OBJ file and their materials."""

    mesh: Mesh
    vertex_colours: np.ndarray  # (v, 3) as in the file, 1 for vertices without; (0, 3) if there are none
    face_material: np.ndarray  # (t,) index into materials
    is_flat: np.ndarray  # (t,) whether smoothing is off: it applies where there are no normals
    materials: list[str]  # names; '' for faces before the first usemtl
    libraries: list[str]  # what follows mtllib, of each statement
    polygons: int  # faces with more than three corners
    counts: dict[str, int]  # statements that are not read, by plural noun


def read_obj(path: Path, flip_tex_coords: bool = True, mend_polygons: bool = False) -> ObjFile:
    """Read a file. `flip_tex_coords` replaces v by 1 - v, Mitsuba 3's default.

    Polygons become triangle fans, as in Mitsuba 3. With `mend_polygons`, concave ones are cut correctly, and those with
    fewer than three corners are left out. Raises SceneError if it is not an OBJ file with faces, or has invalid indices
    or numbers.
    """
    lines = _Lines(_clean_text(read_bytes(path), SourceLocation(str(path))), str(path))
    vertices, colours = lines.vertices()
    normals = lines.vectors(b"vn", 3)
    corners, sizes, face_lines = lines.faces(leave_out_short=mend_polygons)
    if not len(sizes):
        lines.location.raise_error("it has no faces, only vertices" if len(vertices) else "it has no faces")
    owner = np.repeat(np.arange(len(sizes)), sizes)
    for column, (key, name) in enumerate(((b"v ", "vertex"), (b"vt", "texture coordinate"), (b"vn", "normal"))):
        line_numbers = lines.lines_with_key(key)
        defined_before = np.searchsorted(line_numbers, face_lines)[owner]
        indices = _absolute_indices(corners[:, column], defined_before, len(line_numbers), required=column == 0)
        if np.any(indices < -1):
            problem = f"a face uses a {name} that does not exist (there are {len(line_numbers)})"
            lines.location_of(face_lines[owner[np.argmax(indices < -1)]]).raise_error(problem)
        corners[:, column] = indices
    uvs = np.zeros((0, 2), np.float32)
    if np.any(corners[:, 1] >= 0):
        uvs = make_uvs(lines.vectors(b"vt", 2), flip_tex_coords)
    triangles = triangulate(vertices[corners[:, 0]], sizes) if mend_polygons else triangle_fans(sizes)
    mesh, vertex_numbers = _index_corners(vertices, normals, uvs, corners, triangles)
    colours = colours[vertex_numbers] if len(colours) else colours
    polygon_material, names, libraries = lines.materials(face_lines)
    materials, is_flat = (np.repeat(values, sizes - 2) for values in (polygon_material, lines.is_flat(face_lines)))
    counts = lines.counts() | {"incomplete faces": len(lines.lines_with_key(b"f ")) - len(sizes)}
    return ObjFile(mesh, colours, materials, is_flat, names, libraries, int(np.sum(sizes > 3)), counts)


def _clean_text(text: bytes, location: SourceLocation) -> bytes:
    """The lines of a file without leading blanks, each after a newline; continued lines are joined."""
    if b"\0" in text:
        location.raise_error("not an OBJ file: it contains binary data")
    text = (
        text.removeprefix(_BYTE_ORDER_MARK).replace(b"\r\n", b"\n").replace(b"\r", b"\n" if b"\n" not in text else b" ")
    )
    if b"\\" in text:  # the newlines that are removed follow the joined line, so that line numbers stay
        text = re.sub(rb"(?:[^\n]*\\ *\n)+[^\n]*", _join_lines, text)
    return re.sub(rb"\n[ \t]+", b"\n", b"\n" + text) + b"\n"


def _join_lines(match: re.Match) -> bytes:
    text = match.group()
    return re.sub(rb"\\ *\n", b" ", text) + b"\n" * text.count(b"\n")


class _Lines:
    """The lines of a text, found by their first two characters (the key; a tab counts as a space)."""

    def __init__(self, text: bytes, file: str):
        self.location = SourceLocation(file)
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
        """The given lines without their key and comments, each with its newline."""
        steps = np.zeros(len(self.bytes) + 1, np.int8)
        steps[self.starts[line_numbers] + 2] = 1
        steps[self.ends[line_numbers] + 1] -= 1
        text = self.bytes[np.cumsum(steps[:-1], dtype=np.int8).view(bool)].tobytes()
        return re.sub(rb"#[^\n]*", b"", text) if b"#" in text else text

    def location_of(self, line: int) -> SourceLocation:
        return SourceLocation(self.location.file, int(line) + 1)

    def vertices(self) -> tuple[np.ndarray, np.ndarray]:
        """Positions (n, 3) and colours (n, 3): 1 where not given, or (0, 3) if none is."""
        values, sizes, first = self.numbers(b"v ", 3)
        positions = values[first[:, None] + np.arange(3)]
        has_colour = sizes >= 6
        if not has_colour.any():
            return positions, np.zeros((0, 3))
        colours = np.ones((len(positions), 3))
        last = (first + sizes)[has_colour]  # 'x y z r g b' or 'x y z w r g b'
        colours[has_colour] = values[last[:, None] + np.arange(-3, 0)]
        return positions, colours

    def vectors(self, key: bytes, size: int) -> np.ndarray:
        """(n, size): the first numbers of each line with this key."""
        values, _, first = self.numbers(key, size)
        return values[first[:, None] + np.arange(size)]

    def numbers(self, key: bytes, min_size: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(numbers, how many each line with this key has, index of the first one of each line)."""
        line_numbers = self.lines_with_key(key)
        if not len(line_numbers):
            return np.zeros(0), np.zeros(0, np.int64), np.zeros(0, np.int64)
        text = self.text_without_key(line_numbers)
        values = parse_numbers(text)
        _, sizes = _find_words(np.frombuffer(text, np.uint8))
        if sizes.min() < min_size or len(values) != sizes.sum():
            lines = enumerate(text.split(b"\n"))
            wrong = next(i for i, line in lines if len(parse_numbers(line)) < max(min_size, len(line.split())))
            number = {2: "two", 3: "three"}[min_size]
            problem = f"a line that begins with '{key.decode().strip()}' needs {number} numbers"
            self.location_of(line_numbers[wrong]).raise_error(problem)
        first = np.cumsum(sizes) - sizes
        if key != b"vt" and not np.isfinite(values).all():
            line = line_numbers[np.searchsorted(first, np.argmin(np.isfinite(values)), side="right") - 1]
            self.location_of(line).raise_error("a vertex or normal is not a finite number")
        return values, sizes, first

    def faces(self, leave_out_short: bool = False) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Corners (c, 3) of (vertex, uv, normal), 0 where not given; corner count and line number of each face.

        Faces with fewer than three corners are an error, or left out.
        """
        line_numbers = self.lines_with_key(b"f ")
        if not len(line_numbers):
            return np.zeros((0, 3), np.int64), np.zeros(0, np.int64), line_numbers
        data = np.frombuffer(self.text_without_key(line_numbers), np.uint8)
        _, sizes = _find_words(data)
        if sizes.min() < 3:
            if not leave_out_short:
                self.location_of(line_numbers[np.argmin(sizes)]).raise_error("a face has fewer than three corners")
            line_numbers, sizes = line_numbers[sizes >= 3], sizes[sizes >= 3]
            data = np.frombuffer(self.text_without_key(line_numbers), np.uint8)
            if not len(line_numbers):
                return np.zeros((0, 3), np.int64), sizes, line_numbers
        data = _without_trailing_slashes(data)
        begins, sizes_without = _find_words(data)
        if (sizes_without != sizes).any():
            self.location_of(line_numbers[np.argmax(sizes_without != sizes)]).raise_error(_CORNER_HINT)
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
            self.location.raise_error(_CORNER_HINT)
        return np.clip(values, -(2**40), 2**40).astype(np.int64).reshape(-1, columns)

    def materials(self, face_lines: np.ndarray) -> tuple[np.ndarray, list[str], list[str]]:
        """(material index of each face, material names, library names)."""
        uses = [(line, name) for line, word, name in self._statements(b"us") if word == b"usemtl"]
        libraries = [name for _, word, name in self._statements(b"mt") if word == b"mtllib"]
        names = ["", *dict.fromkeys(name for _, name in uses if name)]
        numbers = {name: number for number, name in enumerate(names)}
        index = np.array([0, *(numbers.get(name, 0) for _, name in uses)])
        return index[np.searchsorted([line for line, _ in uses], face_lines)], names, libraries

    def is_flat(self, face_lines: np.ndarray) -> np.ndarray:
        """Whether 's off' or 's 0' holds for each face."""
        statements = [(line, name) for line, word, name in self._statements(b"s ") if word == b"s"]
        values = np.array([False, *(name in ("off", "0") for _, name in statements)])
        return values[np.searchsorted([line for line, _ in statements], face_lines)]

    def counts(self) -> dict[str, int]:
        """How many statements of each counted kind there are."""
        counts: dict[str, int] = {}
        for noun, key, word in _COUNTED:
            if len(self.lines_with_key(key)):
                counts[noun] = counts.get(noun, 0) + sum(found == word for _, found, _ in self._statements(key))
        return counts

    def _statements(self, key: bytes):
        """(line number, first word, rest) of each line with this key."""
        for line in self.lines_with_key(key):
            word, *rest = self.bytes[self.starts[line] : self.ends[line]].tobytes().split(None, 1)
            yield line, word, decode(_COMMENT.sub(b"", rest[0]).strip()) if rest else ""


def decode(text: bytes) -> str:
    """Text of OBJ and MTL files: UTF-8, or else Latin-1."""
    try:
        return text.decode("utf-8")
    except UnicodeDecodeError:
        return text.decode("latin-1")


def _without_trailing_slashes(data: np.ndarray) -> np.ndarray:
    """A text of faces with '1/2/' as '1/2' and '1//' as '1'."""
    for _ in range(2):
        is_slash = data == _SLASH
        is_trailing = is_slash & np.isin(np.append(data[1:], _NEWLINE), (_SPACE, _TAB, _NEWLINE))
        if not is_trailing.any():
            break
        data = data[~is_trailing]
    return data


def _find_words(data: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(offset of each word of a text, number of words in each line)."""
    is_blank = (data == _SPACE) | (data == _TAB) | (data == _NEWLINE)
    begins = np.flatnonzero(~is_blank & np.concatenate([[True], is_blank[:-1]]))
    return begins, np.diff(np.searchsorted(begins, np.flatnonzero(data == _NEWLINE)), prepend=0)


def _absolute_indices(index: np.ndarray, defined_before: np.ndarray, count: int, required: bool) -> np.ndarray:
    """Indices from 0, -1 where not given, -2 where invalid.

    A file counts from 1, or backwards from the last one defined so far.
    """
    result = np.where(index < 0, index + defined_before, index - 1)
    is_invalid = ((result < 0) & (index != 0)) | (result >= count) | ((index == 0) if required else False)
    return np.where(is_invalid, -2, result)


def _index_corners(
    vertices: np.ndarray, normals: np.ndarray, uvs: np.ndarray, corners: np.ndarray, triangles: np.ndarray
) -> tuple[Mesh, np.ndarray]:
    """A mesh with one vertex for each distinct corner, and the number in the file of each of its vertices.

    As in Mitsuba 3, normals are not smoothed across uv seams. `triangles` (t, 3) are numbers of corners.
    """
    if np.all(corners[:, 1:] < 0):
        return Mesh(vertices, corners[:, 0][triangles], np.zeros((0, 3))), np.arange(len(vertices))
    sizes = corners.max(axis=0) + 2
    uv_and_normal = (corners[:, 1] + 1) * sizes[2] + corners[:, 2] + 1
    if math.prod(sizes.tolist()) >= 2**63:  # the keys below would overflow
        uv_and_normal = np.unique(uv_and_normal, return_inverse=True)[1].reshape(-1)
    key = corners[:, 0] * (uv_and_normal.max() + 1) + uv_and_normal
    _, first, inverse = np.unique(key, return_index=True, return_inverse=True)
    used = corners[first]
    mesh = Mesh(
        vertices[used[:, 0]],
        inverse.reshape(-1)[triangles],
        _take_or_zero(normals, used[:, 2]),
        _take_or_zero(uvs, used[:, 1]),
    )
    return mesh, used[:, 0]


def _take_or_zero(values: np.ndarray, index: np.ndarray) -> np.ndarray:
    """values[index], 0 where the index is -1; empty if it is -1 everywhere."""
    is_given = index >= 0
    if not is_given.any():
        return values[:0]
    return np.where(is_given[:, None], values[index], values.dtype.type(0))
