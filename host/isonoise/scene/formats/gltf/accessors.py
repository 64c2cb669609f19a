"""Reads the accessors of a glTF file as arrays. Called by `primitives.py`, `deform.py` and `nodes.py`."""

import numpy as np

from isonoise.scene.formats.gltf.document import Document
from isonoise.scene.formats.gltf.json_objects import JsonObject

_DTYPES = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_COMPONENTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
# Bytes of all accessors without data of their own, which are zeros: over the size of the file and its buffers.
_MIN_ZERO_BYTES, _MAX_ZERO_RATIO = 1 << 20, 16


class Accessors:
    """The arrays of a file's accessors, each read once and read-only. Methods raise SceneError for invalid ones."""

    def __init__(self, document: Document):
        self.document = document
        self._arrays: dict[tuple[int, bool], np.ndarray] = {}
        self._zero_bytes = 0

    def read_floats(self, owner: JsonObject, name: str, *types: str) -> np.ndarray:
        """(n, components) float32 of the accessor whose index is `owner`'s value `name`; normalised integers decoded.

        `types` are the allowed ones, such as 'VEC3'. The values may be not finite.
        """
        return self._read(owner, name, types, False)

    def read_integers(self, owner: JsonObject, name: str, type_: str) -> np.ndarray:
        """(n, components) of an unsigned integer type."""
        return self._read(owner, name, (type_,), True)

    def _read(self, owner: JsonObject, name: str, types: tuple[str, ...], as_integers: bool) -> np.ndarray:
        index = owner.integer(name)
        accessor = self.document.get("accessors", index, owner, name)
        accessor.string("type", choices=types)
        if (index, as_integers) not in self._arrays:
            stored = self._read_stored(accessor)
            if as_integers and stored.dtype.kind != "u":
                accessor.fail("componentType", f"{owner.place_of(name)} needs unsigned integers")
            array = np.ascontiguousarray(stored) if as_integers else _to_floats(stored, accessor)
            array.flags.writeable = False
            self._arrays[index, as_integers] = array
        return self._arrays[index, as_integers]

    def _read_stored(self, accessor: JsonObject) -> np.ndarray:
        """(n, components) in the type in which the file has them."""
        dtype, columns = _component_dtype(accessor), _COMPONENTS[accessor.string("type")]
        count = accessor.integer("count")
        if "bufferView" in accessor:
            values = self._read_rows(accessor, count, dtype, columns)
        else:
            self._check_zeros(accessor, count * columns * dtype.itemsize)
            values = np.zeros((count, columns), dtype)
        sparse = accessor.object("sparse")
        return self._substitute(values, sparse) if sparse else values

    def _check_zeros(self, accessor: JsonObject, size_bytes: int) -> None:
        self._zero_bytes += size_bytes
        if self._zero_bytes > _MIN_ZERO_BYTES + _MAX_ZERO_RATIO * self.document.size_bytes:
            accessor.fail("count", "accessors without a buffer view describe much more data than the file holds")

    def _read_rows(self, owner: JsonObject, count: int, dtype: np.dtype, columns: int) -> np.ndarray:
        """(count, columns) of the buffer view that an accessor, or a part of a sparse one, names."""
        data, stride = self.document.buffer_view(owner)
        offset, row_bytes = owner.integer("byteOffset", 0), columns * dtype.itemsize
        stride = stride or row_bytes
        if stride < row_bytes:
            owner.fail("bufferView", f"its byteStride {stride} is smaller than an element of {row_bytes} bytes")
        if count and offset + (count - 1) * stride + row_bytes > len(data):
            end = offset + (count - 1) * stride + row_bytes
            owner.fail("bufferView", f"{count} elements end at byte {end} of a buffer view of {len(data)} bytes")
        return np.ndarray(
            (count, columns), dtype, data if count else b"", offset if count else 0, (stride, dtype.itemsize)
        )

    def _substitute(self, values: np.ndarray, sparse: JsonObject) -> np.ndarray:
        """The values with those replaced that a sparse accessor lists."""
        count, places, replacements = sparse.integer("count"), sparse.object("indices"), sparse.object("values")
        if places is None or replacements is None:
            sparse.fail("", "it needs 'indices' and 'values'")
        dtype = _component_dtype(places)
        if dtype.kind != "u":
            places.fail("componentType", "indices are unsigned integers")
        rows = self._read_rows(places, count, dtype, 1)[:, 0]
        if count and rows.max() >= len(values):
            places.fail("", f"index {rows.max()} is out of range; the accessor has {len(values)} elements")
        result = np.array(values)
        result[rows] = self._read_rows(replacements, count, values.dtype, values.shape[1])
        return result


def _component_dtype(owner: JsonObject) -> np.dtype:
    code = owner.integer("componentType")
    if code not in _DTYPES:
        owner.fail("componentType", f"{code} is none of {', '.join(map(str, _DTYPES))}")
    return np.dtype(_DTYPES[code])


def _to_floats(stored: np.ndarray, accessor: JsonObject) -> np.ndarray:
    """float32 values, decoded if the accessor is normalised (glTF 2.0 section 3.6.2.2)."""
    values = stored.astype(np.float32, order="C")
    if stored.dtype.kind == "f" or not accessor.boolean("normalized", False):
        return values
    values /= np.iinfo(stored.dtype).max
    return np.maximum(values, -1.0, out=values) if stored.dtype.kind == "i" else values
