"""Reads STL and GLB with trimesh: triangles and base colour of every part. Called by `scene/default_scene.py`."""

import contextlib
import io
import logging
import math
import struct
import warnings
from pathlib import Path

import numpy as np

from isonoise.errors import SceneError
from isonoise.input_files import parse_json
from isonoise.scene import transforms
from isonoise.scene.files import is_inside, outside_message, read_bytes
from isonoise.scene.mesh.mesh import Mesh, MeshPart
from isonoise.scene.parse.elements import path_exists
from isonoise.scene.spectra import srgb_to_linear

_MAX_TEXELS = 1 << 26  # of a texture; only its mean is used
# Bytes that the accessors of a GLB may describe: accessors may share data, so they may exceed the file's size.
_MIN_ACCESSOR_BYTES, _MAX_ACCESSOR_RATIO = 1 << 20, 16
_COMPONENTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}


def read_parts(path: Path, folder: Path | None = None) -> list[MeshPart]:
    """The parts of a file in world space.

    Files that it names have to be inside `folder`, unless that is None. Raises SceneError if trimesh cannot read it or
    it has no triangles.
    """
    import trimesh

    data, file_type = read_bytes(path), path.suffix[1:].lower()
    if file_type == "glb":
        _check_accessors(path, data)
    named_files = _NamedFiles(path, folder)
    logging.getLogger("trimesh").addHandler(logging.NullHandler())  # without a handler it prints tracebacks
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")  # _parts checks what matters
            options = {"resolver": named_files, "process": False, "maintain_order": True}
            loaded = trimesh.load_scene(io.BytesIO(data), file_type=file_type, **options)
            if named_files.error:
                raise named_files.error
            return _parts(path, loaded)
    except SceneError:
        raise
    except Exception as error:  # trimesh raises errors of any type for an invalid file
        reason = str(error).splitlines()[0][:100] if str(error) else type(error).__name__
        not_readable = SceneError(f"{path}: not a readable {path.suffix[1:].upper()} file ({reason})")
        raise named_files.error or not_readable from None


class _NamedFiles:
    """Files that a GLB file names: buffers and images. trimesh reads them by `[name]`, and ignores missing images."""

    def __init__(self, path: Path, folder: Path | None):
        self.path, self.folder = path, folder
        self.contents: dict[str, bytes] = {}
        self.error: SceneError | None = None  # of the first file that exists and cannot be used

    def __getitem__(self, name: str) -> bytes:
        if name not in self.contents:
            self.contents[name] = self._read(name)
        return self.contents[name]

    def _read(self, name: str) -> bytes:
        file = self.path.parent / name.strip()
        exists = path_exists(file)
        try:
            if exists and not is_inside(file, self.folder):
                raise SceneError(f"{self.path}: {outside_message(file, self.folder)}")
            return read_bytes(file)
        except SceneError as error:
            self.error = self.error or (error if exists else None)
            raise


def _parts(path: Path, loaded) -> list[MeshPart]:
    nodes = [(loaded.graph.get(name), loaded.geometry) for name in sorted(loaded.graph.nodes_geometry)]
    parts = [_part(geometry[key], matrix) for (matrix, key), geometry in nodes if hasattr(geometry[key], "faces")]
    parts = [part for part in parts if len(part.mesh.faces)]
    if not parts:
        raise SceneError(f"{path}: it has no triangles")
    for part in parts:
        faces, count = part.mesh.faces, len(part.mesh.vertices)
        if faces.min() < 0 or faces.max() >= count or not np.isfinite(part.mesh.vertices).all():
            raise SceneError(f"{path}: a vertex is not a finite number, or a face uses a vertex that does not exist")
    return parts


def _part(geometry, matrix: np.ndarray) -> MeshPart:
    vertices = transforms.transform_points(matrix, np.asarray(geometry.vertices, float))
    faces = np.asarray(geometry.faces, np.int64)
    normals = np.zeros((0, 3))
    # trimesh keeps the file's normals in its cache. The public attribute would compute missing ones, but STL and glTF
    # without normals mean flat shading.
    if "vertex_normals" in geometry._cache:
        normals = transforms.transform_normals(matrix, np.asarray(geometry.vertex_normals, float))
    if np.linalg.det(matrix[:3, :3]) < 0:
        faces = faces[:, ::-1]
    reflectance, radiance = _colours(getattr(geometry.visual, "material", None))
    return MeshPart(Mesh(vertices, faces, normals), reflectance, radiance, face_normals=not len(normals))


def _colours(material) -> tuple[tuple[float, ...], tuple[float, ...] | None]:
    """(base colour, emission or None) of a glTF material, linear RGB; a texture is replaced by its mean."""
    base = getattr(material, "baseColorFactor", None)
    texture = getattr(material, "baseColorTexture", None)
    emission = getattr(material, "emissiveFactor", None)
    if base is None and texture is None and emission is None:
        return MeshPart.reflectance, None
    colour = np.ones(3) if base is None else np.asarray(base, float)[:3] / 255.0
    if texture is not None and math.prod(texture.size) > _MAX_TEXELS:
        raise ValueError(f"a texture has {texture.size[0]} x {texture.size[1]} pixels, more than {_MAX_TEXELS:,}")
    if texture is not None:
        encoded = np.asarray(texture.convert("RGB").resize((64, 64)), float) / 255.0
        colour = colour * srgb_to_linear(encoded).mean(axis=(0, 1))
    is_emissive = emission is not None and np.max(emission) > 0
    return tuple(np.clip(colour, 0.0, 1.0)), tuple(np.asarray(emission, float)) if is_emissive else None


def _check_accessors(path: Path, data: bytes) -> None:
    """Raise SceneError where the accessors of a GLB file describe much more data than the file holds.

    trimesh allocates zeros for accessors without data. Other errors in the file are left to trimesh.
    """
    described = 0
    try:
        accessors = parse_json(data[20 : 20 + struct.unpack("<I", data[12:16])[0]])["accessors"]
    except (ValueError, KeyError, TypeError, struct.error):
        return
    for accessor in accessors if isinstance(accessors, list) else ():
        with contextlib.suppress(ValueError, KeyError, TypeError, OverflowError):
            described += 4 * abs(int(accessor["count"])) * _COMPONENTS[accessor["type"]]
    if described > _MIN_ACCESSOR_BYTES + _MAX_ACCESSOR_RATIO * len(data):
        raise SceneError(f"{path}: its accessors describe {described >> 20} MiB, more than the file can hold")
