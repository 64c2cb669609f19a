"""Textures of the description -> records and texel stores for the device, each of them once.

Conventions are Mitsuba 3's (3.9.1): v = 0 is the top row of an image, texel centres lie at one half, `to_uv` is applied
to the surface's uv, nothing is clamped, and a texture that stands for a number gives a bitmap's luminance and the mean
of a plain colour's channels.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from isonoise.errors import SceneError
from isonoise.scene.image.image import read_image
from isonoise.scene.spectra import colour_to_rgb, srgb_to_linear

TEXTURE_COLOUR, TEXTURE_BITMAP, TEXTURE_CHECKERBOARD, TEXTURE_MESH_ATTRIBUTE = range(4)
TEXTURE_NEAREST, TEXTURE_MIRROR, TEXTURE_CLAMP, TEXTURE_RAW, TEXTURE_FLOATS, TEXTURE_PER_FACE = (
    1 << i for i in range(6)
)

TEXTURE = np.dtype(
    [
        ("kind", "u4"),
        ("flags", "u4"),  # bitmap: NEAREST | MIRROR | CLAMP (neither: repeat) | RAW | FLOATS; mesh_attribute: PER_FACE
        ("to_uv", "f4", 6),  # rows of the affine map of uv; bitmap, checkerboard
        ("size", "u4", 2),  # bitmap: width, height
        ("first", "u4"),  # bitmap: its first texel, in the store of bytes or of floats; mesh_attribute: its first value
        ("nested", "u4", 2),  # checkerboard: textures of its two colours, both of lower index
        ("colour", "f4", 3),  # colour: linear RGB; mesh_attribute: the scale in all three
    ]
)

CONSTANTS = {name: value for name, value in list(globals().items()) if name.startswith("TEXTURE_")}

SRGB = srgb_to_linear(np.arange(256) / 255).astype(np.float32)
"""Linear value of an encoded byte, (256,) float32; what the device decodes texels of bytes by."""

_PLAIN = ("rgb", "spectrum", "uniform", "srgb")


def is_plain(value) -> bool:
    """Whether a value of the description is one colour or number all over, and needs no texture."""
    return not isinstance(value, dict) or value["type"] in _PLAIN


def plain_colour(value, kind: str) -> np.ndarray:
    """Linear RGB (3,) float64 of a plain value; `kind` is as for `colour_to_rgb`."""
    if isinstance(value, dict) and value["type"] == "srgb":
        value = value["color"]
    elif isinstance(value, dict) and value["type"] == "uniform":
        value = value["value"]
    if isinstance(value, dict):
        return colour_to_rgb(value, kind)
    return np.broadcast_to(np.asarray(value, float), 3).copy()


def mesh_attributes_used(part: dict) -> set[str]:
    """Names of the mesh attributes that the textures inside a part of the description read."""
    names, queue, passed = set(), [part], set()
    while queue:
        part = queue.pop()
        if id(part) not in passed:  # references may name one object twice on every level
            passed.add(id(part))
            names |= {part["name"]} if part.get("type") == "mesh_attribute" else set()
            queue += [value for value in part.values() if isinstance(value, dict)]
    return names


@dataclass(frozen=True)
class MeshAttributes:
    """What one mesh of the scene has to offer, in the order of the meshes."""

    vertices: int
    faces: int
    values: Mapping[str, np.ndarray]  # by name ('vertex_...' or 'face_...'): (vertices or faces, 1 or 3)


@dataclass(frozen=True)
class TextureArrays:
    """All textures as the device has them. Absent things are empty arrays."""

    records: np.ndarray  # (n,) TEXTURE
    bytes: np.ndarray  # (b, 4) uint8: RGB texels and a byte that is not used
    floats: np.ndarray  # (f, 4) float32: linear RGB texels and a number that is not used
    attributes: np.ndarray  # (a, 3) float32


class Textures:
    """Collects textures, equal ones once."""

    def __init__(self):
        self._records: list[np.ndarray] = []
        self._means: list[np.ndarray] = []
        self._known: dict[bytes, int] = {}
        self._met: dict[tuple[int, str], tuple[dict, int]] = {}  # by identity; the dict itself, so that it lives
        self._names: list[str] = []  # of the mesh attributes in use
        self._bitmaps: dict[tuple[str, bool], _Bitmap] = {}
        self._texels: dict[int, list[np.ndarray]] = {0: [], TEXTURE_FLOATS: []}

    def index(self, texture, kind: str) -> int:
        """The index of a texture or of a plain value; its image is read when it is met first.

        `kind` says what spectra inside it are: 'reflectance', 'unbounded' or 'radiance' (see `spectra`); any other word
        is for numbers. Raises SceneError where an image cannot be read.
        """
        if isinstance(texture, dict):
            if (id(texture), kind) not in self._met:  # once: references may name one object twice on every level
                self._met[id(texture), kind] = (texture, self._enter(texture, kind))
            return self._met[id(texture), kind][1]
        return self._enter(texture, kind)

    def _enter(self, texture, kind: str) -> int:
        record = np.zeros(1, TEXTURE)
        if is_plain(texture):
            mean = plain_colour(texture, kind)
            record["kind"], record["colour"] = TEXTURE_COLOUR, mean
        elif texture["type"] == "bitmap":
            mean = self._bitmap(record, texture)
        elif texture["type"] == "checkerboard":
            record["kind"], record["to_uv"] = TEXTURE_CHECKERBOARD, _to_uv(texture)
            record["nested"] = nested = [self.index(texture[name], kind) for name in ("color0", "color1")]
            mean = 0.5 * (self._means[nested[0]] + self._means[nested[1]])
        else:
            mean = self._mesh_attribute(record, texture)
        key = record.tobytes()
        if key not in self._known:
            self._known[key] = len(self._records)
            self._records.append(record)
            self._means.append(mean)
        return self._known[key]

    def mean(self, index: int) -> np.ndarray:
        """Mean linear RGB (3,) float64 over one period of the texture; of a mesh attribute its scale."""
        return self._means[index]

    def arrays(self, meshes: Sequence[MeshAttributes] = ()) -> TextureArrays:
        """Everything that was collected; `meshes` are those of the scene, in the order of their vertices and faces."""
        records = np.concatenate(self._records) if self._records else np.zeros(0, TEXTURE)
        values, named = self._attribute_values(meshes)
        of_meshes = records["kind"] == TEXTURE_MESH_ATTRIBUTE
        records["first"][of_meshes] = named[records["first"][of_meshes]]
        return TextureArrays(records, self._store(0, np.uint8), self._store(TEXTURE_FLOATS, np.float32), values)

    def _store(self, which: int, dtype) -> np.ndarray:
        texels = self._texels[which]
        return np.concatenate(texels) if texels else np.zeros((0, 4), dtype)

    def _bitmap(self, record: np.ndarray, texture: dict) -> np.ndarray:
        path, raw = texture["filename"], bool(texture.get("raw", False))
        bitmap = self._bitmaps.get((path, raw)) or self._read(path, raw)
        flags = bitmap.store
        flags |= TEXTURE_NEAREST if texture.get("filter_type") == "nearest" else 0
        flags |= {"mirror": TEXTURE_MIRROR, "clamp": TEXTURE_CLAMP}.get(texture.get("wrap_mode"), 0)
        flags |= TEXTURE_RAW if raw and bitmap.store == 0 else 0
        record["kind"], record["flags"], record["to_uv"] = TEXTURE_BITMAP, flags, _to_uv(texture)
        record["size"], record["first"] = bitmap.size, bitmap.first
        return bitmap.mean

    def _read(self, path: str, raw: bool) -> "_Bitmap":
        """The image in its store. Bytes are stored as they are: to be raw is a matter of reading them."""
        image = read_image(path)
        height, width, channels = image.pixels.shape
        store = 0 if image.pixels.dtype == np.uint8 else TEXTURE_FLOATS
        values = image.linear(raw) if store else image.pixels
        if store and not (np.isfinite(values.min()) and np.isfinite(values.max())):
            raise SceneError(f"{path}: the image has pixels that are no finite numbers")
        texels = np.zeros((height * width, 4), values.dtype)
        texels[:, :3] = values.reshape(-1, channels)
        first = sum(len(other) for other in self._texels[store])
        self._texels[store].append(texels)
        for meaning in (raw,) if image.pixels.dtype == np.uint16 else (False, True):
            mean = _mean(texels) if store else _mean_of_bytes(texels, meaning)
            self._bitmaps[path, meaning] = _Bitmap(store, (width, height), first, mean)
        return self._bitmaps[path, raw]

    def _mesh_attribute(self, record: np.ndarray, texture: dict) -> np.ndarray:
        name, scale = texture["name"], float(texture.get("scale", 1.0))
        if not name.startswith(("vertex_", "face_")):
            raise SceneError(f"mesh_attribute '{name}': its name has to begin with 'vertex_' or 'face_'")
        if name not in self._names:
            self._names.append(name)
        record["kind"], record["flags"] = TEXTURE_MESH_ATTRIBUTE, TEXTURE_PER_FACE if name.startswith("face_") else 0
        record["first"], record["colour"] = self._names.index(name), scale  # `arrays` puts the first value there
        return np.full(3, scale)

    def _attribute_values(self, meshes: Sequence[MeshAttributes]) -> tuple[np.ndarray, np.ndarray]:
        """Values (a, 3) of all attributes in use, and for each of them the place of the scene's vertex or face 0.

        Only the run of meshes from the first to the last that has an attribute takes memory; the place may lie before
        the values, by arithmetic modulo 2^32.
        """
        values, places, filled = [], [], 0
        for name in self._names:
            having = [number for number, mesh in enumerate(meshes) if name in mesh.values]
            counts = [mesh.faces if name.startswith("face_") else mesh.vertices for mesh in meshes]
            first, last = (having[0], having[-1] + 1) if having else (0, 0)
            places.append((filled - sum(counts[:first])) % (1 << 32))
            for mesh, count in zip(meshes[first:last], counts[first:last], strict=True):
                part = np.asarray(mesh.values.get(name, np.zeros((count, 1))), np.float32)
                values.append(np.broadcast_to(part, (count, 3)))
                filled += count
        stacked = np.concatenate(values) if values else np.zeros((0, 3), np.float32)
        return stacked, np.array(places, np.uint32)


@dataclass(frozen=True)
class _Bitmap:
    """An image in a store."""

    store: int  # 0: bytes, TEXTURE_FLOATS: floats
    size: tuple[int, int]  # width, height
    first: int  # texel of the store
    mean: np.ndarray  # (3,) float64, linear


def _mean(texels: np.ndarray) -> np.ndarray:
    return texels[:, :3].mean(axis=0, dtype=np.float64)


def _mean_of_bytes(texels: np.ndarray, raw: bool) -> np.ndarray:
    values = np.arange(256) / 255 if raw else SRGB.astype(np.float64)
    return np.stack([np.bincount(channel, minlength=256) @ values for channel in texels[:, :3].T]) / len(texels)


def _to_uv(texture: dict) -> np.ndarray:
    """Rows (6,) of the map of uv: of a 3x3 matrix the first two; a 4x4 matrix loses its third row and column."""
    matrix = np.asarray(texture.get("to_uv", np.eye(3)), float)
    if matrix.shape == (4, 4):
        matrix = matrix[np.ix_([0, 1, 3], [0, 1, 3])]
    return matrix[:2].ravel()
