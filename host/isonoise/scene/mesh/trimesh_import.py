"""STL and GLB through trimesh: triangles and base colours of every part, as the file has them."""

import contextlib
import json
import logging
import math
import struct
import warnings
from pathlib import Path

import numpy as np

from isonoise.errors import SceneError
from isonoise.scene import transforms
from isonoise.scene.files import read_bytes
from isonoise.scene.mesh.mesh import Mesh, Part
from isonoise.scene.spectra import srgb_to_linear

_TEXELS = 1 << 26  # of a texture, of which only the mean counts
_SMALL, _RATIO = 1 << 20, 16  # bytes that accessors may claim, and for each of the file's; they may share their data
_NUMBERS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}


def read_parts(path: Path) -> list[Part]:
    """The parts of a file in world space. Raises SceneError where trimesh cannot read it or there are no triangles."""
    import trimesh

    if path.suffix.lower() == ".glb":
        _check_claims(path)
    logging.getLogger("trimesh").addHandler(logging.NullHandler())  # or it prints tracebacks of its own
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")  # the checks here tell what matters
            return _parts(path, trimesh.load_scene(str(path), process=False, maintain_order=True))
    except SceneError:
        raise
    except Exception as error:  # trimesh raises whatever the first unexpected byte leads to
        reason = str(error).splitlines()[0][:100] if str(error) else type(error).__name__
        raise SceneError(f"{path}: not a readable {path.suffix[1:].upper()} file ({reason})") from None


def _parts(path: Path, loaded) -> list[Part]:
    placed = [(loaded.graph.get(name), loaded.geometry) for name in sorted(loaded.graph.nodes_geometry)]
    parts = [_part(geometry[key], matrix) for (matrix, key), geometry in placed if hasattr(geometry[key], "faces")]
    parts = [part for part in parts if len(part.mesh.faces)]
    if not parts:
        raise SceneError(f"{path}: there are no triangles in it")
    for part in parts:
        faces, count = part.mesh.faces, len(part.mesh.vertices)
        if faces.min() < 0 or faces.max() >= count or not np.isfinite(part.mesh.vertices).all():
            raise SceneError(f"{path}: a vertex is not a finite number, or a face names one that does not exist")
    return parts


def _part(geometry, matrix: np.ndarray) -> Part:
    vertices = transforms.transform_points(matrix, np.asarray(geometry.vertices, float))
    faces = np.asarray(geometry.faces, np.int64)
    normals = np.zeros((0, 3))
    # Normals that the file brings lie in trimesh's cache; asking for the attribute would make up those it lacks,
    # where STL and glTF mean flat triangles.
    if "vertex_normals" in geometry._cache:
        normals = transforms.transform_normals(matrix, np.asarray(geometry.vertex_normals, float))
    if np.linalg.det(matrix[:3, :3]) < 0:
        faces = faces[:, ::-1]
    reflectance, radiance = _colours(getattr(geometry.visual, "material", None))
    return Part(Mesh(vertices, faces, normals), reflectance, radiance, flat=not len(normals))


def _colours(material) -> tuple[tuple[float, ...], tuple[float, ...] | None]:
    """(base colour, emission or None) in linear RGB of a glTF material; a texture counts with its mean."""
    base = getattr(material, "baseColorFactor", None)
    texture = getattr(material, "baseColorTexture", None)
    emission = getattr(material, "emissiveFactor", None)
    if base is None and texture is None and emission is None:
        return Part.reflectance, None
    colour = np.ones(3) if base is None else np.asarray(base, float)[:3] / 255.0
    if texture is not None and math.prod(texture.size) > _TEXELS:
        raise ValueError(f"a texture of {texture.size[0]} x {texture.size[1]} pixels")
    if texture is not None:
        encoded = np.asarray(texture.convert("RGB").resize((64, 64)), float) / 255.0
        colour = colour * srgb_to_linear(encoded).mean(axis=(0, 1))
    shines = emission is not None and np.max(emission) > 0
    return tuple(np.clip(colour, 0.0, 1.0)), tuple(np.asarray(emission, float)) if shines else None


def _check_claims(path: Path) -> None:
    """Hold what the accessors of a GLB file claim against its size: trimesh makes zeros of those without data.

    Whatever else is wrong with the file is left to trimesh.
    """
    data, claimed = read_bytes(path), 0
    try:
        accessors = json.loads(data[20 : 20 + struct.unpack("<I", data[12:16])[0]])["accessors"]
    except (ValueError, KeyError, TypeError, struct.error, RecursionError):
        return
    for accessor in accessors if isinstance(accessors, list) else ():
        with contextlib.suppress(ValueError, KeyError, TypeError, OverflowError):
            claimed += 4 * abs(int(accessor["count"])) * _NUMBERS[accessor["type"]]
    if claimed > _SMALL + _RATIO * len(data):
        raise SceneError(f"{path}: its accessors claim {claimed >> 20} MiB, more than the file can hold")
