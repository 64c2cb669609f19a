"""Wavefront OBJ and MTL, read with numpy: a million triangles take about a second.

Read are v, vt, vn, f, usemtl and mtllib; polygons become fans of triangles; what draws no surface is passed over.
"""

import math
import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from isonoise.scene.files import read_bytes
from isonoise.scene.mesh.mesh import Mesh, parse_numbers, texture_coordinates
from isonoise.scene.parse.elements import SourceLocation

_NEWLINE, _SLASH = 10, ord("/")


@dataclass
class ObjFile:
    """The triangles of an OBJ file, and which material each one names."""

    mesh: Mesh
    face_material: np.ndarray  # (t,) index into materials
    materials: list[str]  # names; '' for faces before the first usemtl
    libraries: list[str] = field(default_factory=list)  # mtllib names


def read_obj(path: Path, flip_tex_coords: bool = True) -> ObjFile:
    """Read a file; `flip_tex_coords`: its v runs downwards, as in Mitsuba 3's default.

    Raises SceneError where it is not an OBJ with faces, or its indices or numbers are bad.
    """
    location = SourceLocation(str(path))
    text = read_bytes(path)
    if b"\0" in text:
        location.raise_error("not an OBJ file: it holds binary data")
    text = text.replace(b"\r", b" ").replace(b"\\ \n", b"  ").replace(b"\\\n", b" ")
    text = re.sub(rb"#[^\n]*", b"", text) if b"#" in text else text
    text = re.sub(rb"\n[ \t]+", b"\n", b"\n" + text) + b"\n"
    lines = _Lines(text)
    vertices = lines.vectors(b"v ", 3, location)
    normals = lines.vectors(b"vn", 3, location)
    _check_finite(vertices, location)
    _check_finite(normals, location)
    corners, sizes, face_lines = lines.faces(location)
    if not len(sizes):
        location.raise_error("there are no faces in it")
    before = [np.searchsorted(lines.of(key), face_lines) for key in (b"v ", b"vt", b"vn")]
    defined = [len(lines.of(key)) for key in (b"v ", b"vt", b"vn")]
    owner = np.repeat(np.arange(len(sizes)), sizes)
    for column, name in enumerate(("vertex", "texture coordinate", "normal")):
        corners[:, column] = _absolute(corners[:, column], before[column][owner], defined[column], name, location)
    uvs = np.zeros((0, 2), np.float32)
    if np.any(corners[:, 1] >= 0):
        uvs = texture_coordinates(lines.vectors(b"vt", 2, location), flip_tex_coords)
    mesh = _indexed(vertices, normals, uvs, corners, _fans(sizes))
    of_face, names, libraries = lines.materials(face_lines)
    return ObjFile(mesh, np.repeat(of_face, sizes - 2), names, libraries)


class _Lines:
    """The lines of a text, found by what they begin with."""

    def __init__(self, text: bytes):
        self.bytes = np.frombuffer(text, np.uint8)
        ends = np.flatnonzero(self.bytes == _NEWLINE)
        self.starts, self.ends = ends[:-1] + 1, ends[1:]
        first, second = self.bytes[self.starts], self.bytes[np.minimum(self.starts + 1, len(text) - 1)]
        second = np.where(second == ord("\t"), ord(" "), second)
        self.keys = first.astype(np.uint16) << 8 | second
        self.found: dict[bytes, np.ndarray] = {}

    def of(self, key: bytes) -> np.ndarray:
        """Numbers of the lines that begin with these two characters."""
        if key not in self.found:
            self.found[key] = np.flatnonzero(self.keys == (key[0] << 8 | key[1]))
        return self.found[key]

    def text(self, chosen: np.ndarray, skip: int) -> bytes:
        """The chosen lines without their first `skip` characters, each with its newline."""
        steps = np.zeros(len(self.bytes) + 1, np.int8)
        steps[self.starts[chosen] + skip] = 1
        steps[self.ends[chosen] + 1] -= 1
        return self.bytes[np.cumsum(steps[:-1], dtype=np.int8).view(bool)].tobytes()

    def vectors(self, key: bytes, size: int, location: SourceLocation) -> np.ndarray:
        """(n, size) first numbers of the lines of this key; what follows (weights, colours) is dropped."""
        chosen = self.of(key)
        if not len(chosen):
            return np.zeros((0, size))
        text = self.text(chosen, 2)
        values = parse_numbers(text)
        _, sizes = _words(np.frombuffer(text, np.uint8))
        if sizes.min() < size or len(values) != sizes.sum():
            number = {2: "two", 3: "three"}[size]
            location.raise_error(f"a line that begins with '{key.decode().strip()}' does not hold {number} numbers")
        first = np.cumsum(sizes) - sizes
        return values[first[:, None] + np.arange(size)]

    def faces(self, location: SourceLocation) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Corners (c, 3) of (vertex, texture, normal), 0 where left out; number of corners and line of each face."""
        chosen = self.of(b"f ")
        if not len(chosen):
            return np.zeros((0, 3), np.int64), np.zeros(0, np.int64), chosen
        text = self.text(chosen, 2)
        data = np.frombuffer(text, np.uint8)
        begins, sizes = _words(data)
        if sizes.min() < 3:
            location.raise_error("a face has fewer than three corners")
        slashes = np.flatnonzero(data == _SLASH)
        per_corner = np.bincount(np.searchsorted(begins, slashes, side="right") - 1, minlength=len(begins))
        double = np.zeros(len(begins), bool)
        adjacent = slashes[:-1][np.diff(slashes) == 1]
        double[np.searchsorted(begins, adjacent, side="right") - 1] = True
        corners = np.zeros((len(begins), 3), np.int64)
        for count, is_double, columns in (
            (0, False, (0,)),
            (1, False, (0, 1)),
            (2, False, (0, 1, 2)),
            (2, True, (0, 2)),
        ):
            these = (per_corner == count) & (double == is_double)
            if these.any():
                corners[np.ix_(these, columns)] = self._corners(data, begins, these, len(columns), location)
        return corners, sizes, chosen

    @staticmethod
    def _corners(
        data: np.ndarray, begins: np.ndarray, these: np.ndarray, columns: int, location: SourceLocation
    ) -> np.ndarray:
        if not these.all():
            owner = np.cumsum(np.bincount(begins, minlength=len(data))) - 1
            data = np.where(these[np.maximum(owner, 0)], data, 32).astype(np.uint8)
        values = parse_numbers(data.tobytes().replace(b"/", b" "))
        if len(values) != columns * these.sum() or np.any(values != np.rint(values)):
            location.raise_error("a face is not made of whole numbers such as 'f 1 2 3' or 'f 1/1/1 2/2/2 3/3/3'")
        return np.clip(values, -(2**40), 2**40).astype(np.int64).reshape(-1, columns)

    def materials(self, face_lines: np.ndarray) -> tuple[np.ndarray, list[str], list[str]]:
        """(material index of each face, names of the materials, names of the libraries)."""
        uses = [(line, name) for line, key, name in self._named(b"us") if key == b"usemtl"]
        libraries = [name for _, key, name in self._named(b"mt") if key == b"mtllib"]
        names = ["", *dict.fromkeys(name for _, name in uses if name)]
        numbers = {name: number for number, name in enumerate(names)}
        index = np.array([0, *(numbers[name] for _, name in uses)])
        return index[np.searchsorted([line for line, _ in uses], face_lines)], names, libraries

    def _named(self, key: bytes):
        for line in self.of(key):
            word, _, name = self.bytes[self.starts[line] : self.ends[line]].tobytes().partition(b" ")
            yield line, word, name.strip().decode("utf-8", "replace")


def _words(data: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(where each word of a text begins, how many words each of its lines has)."""
    blank = (data == ord(" ")) | (data == ord("\t")) | (data == _NEWLINE)
    begins = np.flatnonzero(~blank & np.concatenate([[True], blank[:-1]]))
    return begins, np.diff(np.searchsorted(begins, np.flatnonzero(data == _NEWLINE)), prepend=0)


def _absolute(index: np.ndarray, before: np.ndarray, count: int, name: str, location: SourceLocation) -> np.ndarray:
    """Indices from 0, -1 where left out: the file counts from 1, or backwards from the last one defined so far."""
    result = np.where(index < 0, index + before, index - 1)
    if np.any((result < 0) & (index != 0)) or np.any(result >= count) or (name == "vertex" and np.any(index == 0)):
        location.raise_error(f"a face names a {name} that does not exist (there are {count})")
    return result


def _check_finite(vectors: np.ndarray, location: SourceLocation):
    if not np.isfinite(vectors).all():
        location.raise_error("a vertex or normal is not a finite number")


def _indexed(vertices: np.ndarray, normals: np.ndarray, uvs: np.ndarray, corners: np.ndarray, fans: np.ndarray) -> Mesh:
    """One vertex for each combination of indices, as in Mitsuba 3: texture seams part the smooth normals."""
    if np.all(corners[:, 1:] < 0):
        return Mesh(vertices, corners[:, 0][fans], np.zeros((0, 3)))
    sizes = corners.max(axis=0) + 2
    pair = (corners[:, 1] + 1) * sizes[2] + corners[:, 2] + 1
    if math.prod(sizes.tolist()) >= 2**63:
        pair = np.unique(pair, return_inverse=True)[1].reshape(-1)
    key = corners[:, 0] * (pair.max() + 1) + pair
    _, first, inverse = np.unique(key, return_index=True, return_inverse=True)
    used = corners[first]
    parts = [_or_zero(normals, used[:, 2]), _or_zero(uvs, used[:, 1])]
    return Mesh(vertices[used[:, 0]], inverse.reshape(-1)[fans], *parts)


def _or_zero(values: np.ndarray, index: np.ndarray) -> np.ndarray:
    """values[index], 0 where the index is -1; empty if it is -1 everywhere."""
    given = index >= 0
    if not given.any():
        return values[:0]
    return np.where(given[:, None], values[index], values.dtype.type(0))


def _fans(sizes: np.ndarray) -> np.ndarray:
    """Triangles (t, 3) of corner numbers for polygons whose corners lie one after another."""
    first = np.cumsum(sizes) - sizes
    count = sizes - 2
    within = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    start = np.repeat(first, count)
    return np.stack([start, start + within + 1, start + within + 2], axis=1)


def read_mtl(path: Path) -> dict[str, dict[str, list[float]]]:
    """Diffuse colour 'Kd' and emission 'Ke' of the materials of an MTL file, where it has them."""
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
