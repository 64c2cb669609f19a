"""Compiles textures of the description to records and texel arrays for the device; equal ones are stored once.

Conventions are Mitsuba 3's (3.9.1): v = 0 is the top row of an image, texel centers are at (i + 0.5) / size, `to_uv` is
applied to the surface's uv, and nothing is clamped. A texture that is read as a number is a bitmap's luminance, or the
mean of a constant colour's channels.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from isonoise.errors import SceneError
from isonoise.scene.compile_cache import CompileCache
from isonoise.scene.image.image import Image, read_image
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
        ("first", "u4"),  # bitmap: its first texel, in texel_bytes or texel_floats; mesh_attribute: its first value
        ("nested", "u4", 2),  # checkerboard: textures of its two colours, both with a lower index
        ("colour", "f4", 3),  # colour: linear RGB; mesh_attribute: the scale in all channels
    ]
)

CONSTANTS = {name: value for name, value in list(globals().items()) if name.startswith("TEXTURE_")}

SRGB = srgb_to_linear(np.arange(256) / 255).astype(np.float32)
"""Linear value of each encoded byte, (256,) float32: the table with which the device decodes texel_bytes."""


def is_constant(value) -> bool:
    """Whether a value of the description is a constant colour or number that needs no texture."""
    return not isinstance(value, dict) or value["type"] in ("rgb", "spectrum")


def mesh_attributes_used(part: dict) -> set[str]:
    """Names of the mesh attributes that the textures inside a part of the description read."""
    names, queue, visited = set(), [part], set()
    while queue:
        part = queue.pop()
        if id(part) not in visited:  # with references, paths can grow exponentially with depth
            visited.add(id(part))
            names |= {part["name"]} if part.get("type") == "mesh_attribute" else set()
            queue += [value for value in part.values() if isinstance(value, dict)]
    return names


@dataclass(frozen=True)
class MeshAttributes:
    """The attributes of one mesh of the scene."""

    vertices: int
    faces: int
    values: Mapping[str, np.ndarray]  # by name ('vertex_...' or 'face_...'): (vertices or faces, 1 or 3)


@dataclass(frozen=True)
class TextureArrays:
    """All textures as the device reads them. Arrays are empty if there are none."""

    records: np.ndarray  # (n,) TEXTURE
    bytes: np.ndarray  # (b, 4) uint8: RGB texels and an unused byte
    floats: np.ndarray  # (f, 4) float32: linear RGB texels and an unused value
    attributes: np.ndarray  # (a, 3) float32


class Textures:
    """Collects textures; equal ones are stored once. Images are those of the cache, which gets new ones."""

    def __init__(self, cache: CompileCache | None = None):
        self._cache = cache or CompileCache()
        self._records: list[np.ndarray] = []
        self._means: list[np.ndarray] = []
        self._index_by_record: dict[bytes, int] = {}
        self._index_by_id: dict[tuple[int, str], tuple[dict, int]] = {}  # holds the dict, so that its id stays valid
        self._attribute_names: list[str] = []
        self._bitmaps: dict[tuple[str | int, bool], _Bitmap] = {}
        self._images: list[str | Image] = []  # holds images in memory, so that their id() stays valid
        self._texels: dict[int, list[np.ndarray]] = {
            0: [],
            TEXTURE_FLOATS: [],
        }  # by the flag: texel_bytes, texel_floats

    def index(self, texture, kind: str) -> int:
        """The index of a texture or a constant value; a new image is read.

        `kind` is the kind of spectra inside it: 'reflectance', 'unbounded' or 'radiance' (see `spectra`); any other
        word means a number. Raises SceneError if an image cannot be read.
        """
        if isinstance(texture, dict):
            if (id(texture), kind) not in self._index_by_id:
                self._index_by_id[id(texture), kind] = (texture, self._add(texture, kind))
            return self._index_by_id[id(texture), kind][1]
        return self._add(texture, kind)

    def _add(self, texture, kind: str) -> int:
        record = np.zeros(1, TEXTURE)
        if is_constant(texture):
            mean = colour_to_rgb(texture, kind)
            record["kind"], record["colour"] = TEXTURE_COLOUR, mean
        elif texture["type"] == "bitmap":
            mean = self._fill_bitmap(record, texture)
        elif texture["type"] == "checkerboard":
            record["kind"], record["to_uv"] = TEXTURE_CHECKERBOARD, _to_uv(texture)
            record["nested"] = nested = [self.index(texture[name], kind) for name in ("color0", "color1")]
            mean = 0.5 * (self._means[nested[0]] + self._means[nested[1]])
        else:
            mean = self._fill_mesh_attribute(record, texture)
        key = record.tobytes()
        if key not in self._index_by_record:
            self._index_by_record[key] = len(self._records)
            self._records.append(record)
            self._means.append(mean)
        return self._index_by_record[key]

    def mean(self, index: int) -> np.ndarray:
        """Mean linear RGB (3,) float64 over one period of the texture; for a mesh attribute its scale."""
        return self._means[index]

    def aspect(self, index: int) -> float:
        """Width over height of the image of a texture; 1 if it is none, as in Mitsuba 3."""
        width, height = self._records[index]["size"][0].tolist()
        return width / height if height else 1.0

    @property
    def reads_attributes(self) -> bool:
        """Whether a texture reads attributes of meshes: then `arrays` needs them."""
        return bool(self._attribute_names)

    def arrays(self, meshes: Sequence[MeshAttributes] = ()) -> TextureArrays:
        """Everything that was collected; `meshes` are those of the scene, in order."""
        records = np.concatenate(self._records) if self._records else np.zeros(0, TEXTURE)
        values, first_values = self._attribute_values(meshes)
        is_attribute = records["kind"] == TEXTURE_MESH_ATTRIBUTE
        records["first"][is_attribute] = first_values[records["first"][is_attribute]]
        return TextureArrays(
            records, self._stored_texels(0, np.uint8), self._stored_texels(TEXTURE_FLOATS, np.float32), values
        )

    def _stored_texels(self, store: int, dtype) -> np.ndarray:
        texels = self._texels[store]
        return np.concatenate(texels) if texels else np.zeros((0, 4), dtype)

    def _fill_bitmap(self, record: np.ndarray, texture: dict) -> np.ndarray:
        source, raw = _image_source(texture), bool(texture.get("raw", False))
        bitmap = self._bitmaps.get((_key(source), raw)) or self._store_image(source, raw)
        flags = bitmap.store
        flags |= TEXTURE_NEAREST if texture.get("filter_type") == "nearest" else 0
        flags |= {"mirror": TEXTURE_MIRROR, "clamp": TEXTURE_CLAMP}.get(texture.get("wrap_mode"), 0)
        flags |= TEXTURE_RAW if raw and bitmap.store == 0 else 0
        record["kind"], record["flags"], record["to_uv"] = TEXTURE_BITMAP, flags, _to_uv(texture)
        record["size"], record["first"] = bitmap.size, bitmap.first
        return bitmap.mean

    def _store_image(self, source: str | Image, raw: bool) -> "_Bitmap":
        """Store an image, which is read first if `source` is a path."""
        image = self._cache.get(("texels", source, raw), lambda: _read_texels(source, raw))
        first = sum(len(other) for other in self._texels[image.store])
        self._texels[image.store].append(image.texels)
        for is_raw, mean in image.means.items():
            self._bitmaps[_key(source), is_raw] = _Bitmap(image.store, image.size, first, mean)
        self._images.append(source)
        return self._bitmaps[_key(source), raw]

    def _fill_mesh_attribute(self, record: np.ndarray, texture: dict) -> np.ndarray:
        name, scale = texture["name"], float(texture.get("scale", 1.0))
        if not name.startswith(("vertex_", "face_")):
            raise SceneError(f"mesh_attribute '{name}': the name has to begin with 'vertex_' or 'face_'")
        if name not in self._attribute_names:
            self._attribute_names.append(name)
        record["kind"], record["flags"] = TEXTURE_MESH_ATTRIBUTE, TEXTURE_PER_FACE if name.startswith("face_") else 0
        record["first"], record["colour"] = (
            self._attribute_names.index(name),
            scale,
        )  # `arrays` replaces it by the first value
        return np.full(3, scale)

    def _attribute_values(self, meshes: Sequence[MeshAttributes]) -> tuple[np.ndarray, np.ndarray]:
        """Values (a, 3) of all used attributes, and for each attribute the index of the value of vertex or face 0.

        Only meshes from the first to the last one with the attribute are stored. So the index of vertex or face 0 may
        be negative; it is stored modulo 2^32.
        """
        values, first_values, value_count = [], [], 0
        for name in self._attribute_names:
            owners = [number for number, mesh in enumerate(meshes) if name in mesh.values]
            counts = [mesh.faces if name.startswith("face_") else mesh.vertices for mesh in meshes]
            first, last = (owners[0], owners[-1] + 1) if owners else (0, 0)
            first_values.append((value_count - sum(counts[:first])) % (1 << 32))
            for mesh, count in zip(meshes[first:last], counts[first:last], strict=True):
                part = np.asarray(mesh.values.get(name, np.zeros((count, 1))), np.float32)
                values.append(np.broadcast_to(part, (count, 3)))
                value_count += count
        stacked = np.concatenate(values) if values else np.zeros((0, 3), np.float32)
        return stacked, np.array(first_values, np.uint32)


@dataclass(frozen=True)
class _Texels:
    """An image as it is stored."""

    store: int  # 0: texel_bytes, TEXTURE_FLOATS: texel_floats
    size: tuple[int, int]  # width, height
    texels: np.ndarray  # (width * height, 4)
    means: dict[bool, np.ndarray]  # linear mean (3,) float64, by whether the image is read raw


def _read_texels(source: str | Image, raw: bool) -> _Texels:
    """The texels of an image, which is read first if `source` is a path.

    8-bit texels are stored as they are; the RAW flag decides how they are read.
    """
    image = source if isinstance(source, Image) else read_image(source)
    height, width, channels = image.pixels.shape
    store = 0 if image.pixels.dtype == np.uint8 else TEXTURE_FLOATS
    values = image.linear(raw) if store else image.pixels
    if store and not (np.isfinite(values.min()) and np.isfinite(values.max())):
        name = "bitmap" if isinstance(source, Image) else source
        raise SceneError(f"{name}: the image has pixels that are not finite numbers")
    texels = np.zeros((height * width, 4), values.dtype)
    texels[:, :3] = values.reshape(-1, channels)
    kinds = (raw,) if image.pixels.dtype == np.uint16 else (False, True)
    means = {is_raw: _mean(texels) if store else _mean_of_bytes(texels, is_raw) for is_raw in kinds}
    return _Texels(store, (width, height), texels, means)


@dataclass(frozen=True)
class _Bitmap:
    """A stored image."""

    store: int  # 0: texel_bytes, TEXTURE_FLOATS: texel_floats
    size: tuple[int, int]  # width, height
    first: int  # index of the first texel
    mean: np.ndarray  # (3,) float64, linear


def _image_source(texture: dict) -> str | Image:
    """The file of a bitmap, or its image in memory."""
    return next(texture[name] for name in ("filename", "bitmap", "data") if name in texture)


def _key(source: str | Image) -> str | int:
    """What identifies an image: its path, or the object in memory."""
    return id(source) if isinstance(source, Image) else source


def _mean(texels: np.ndarray) -> np.ndarray:
    return texels[:, :3].mean(axis=0, dtype=np.float64)


def _mean_of_bytes(texels: np.ndarray, raw: bool) -> np.ndarray:
    values = np.arange(256) / 255 if raw else SRGB.astype(np.float64)
    return np.stack([np.bincount(channel, minlength=256) @ values for channel in texels[:, :3].T]) / len(texels)


def _to_uv(texture: dict) -> np.ndarray:
    """The first two rows (6,) of the 3x3 matrix `to_uv`; of a 4x4 matrix, the third row and column are dropped."""
    matrix = np.asarray(texture.get("to_uv", np.eye(3)), float)
    if matrix.shape == (4, 4):
        matrix = matrix[np.ix_([0, 1, 3], [0, 1, 3])]
    return matrix[:2].ravel()
