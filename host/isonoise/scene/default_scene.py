"""Builds a scene around a bare mesh: a camera that frames it, the mesh's colours, and lights if it has none.

Called by `load` for OBJ, PLY, STL and GLB files.
"""

import math
from pathlib import Path

import numpy as np

from isonoise.errors import SceneError
from isonoise.scene import transforms
from isonoise.scene.files import is_inside, outside_message
from isonoise.scene.mesh.mesh import Mesh, MeshPart, used_vertices
from isonoise.scene.mesh.obj import read_mtl, read_obj
from isonoise.scene.mesh.ply import read_ply
from isonoise.scene.parse.elements import path_exists

_IMAGE_SIZE = 512
_FOV_DEGREES = 35.0
_CAMERA_DIRECTION = (0.55, 0.4, 1.0)  # from the mesh to the camera: three-quarter view from above, y up
_KEY_LIGHT_DIRECTION = (-0.6, 1.0, 0.5)  # from the mesh to the key light
_MARGIN = 1.05
_MAX_MTL_FILES = 100  # of one OBJ
_MAX_DEPTH, _SAMPLE_COUNT = 8, 64


def default_scene(path: Path, folder: Path | None = None) -> dict:
    """A scene dict for an OBJ, PLY, STL or GLB file.

    Files that it names have to be inside `folder`, unless that is None. Raises SceneError where a file cannot be read.
    """
    parts = _read_parts(path, folder)
    points = np.concatenate([used_vertices(part.mesh.vertices, part.mesh.faces) for part in parts])
    low, high = points.min(axis=0), points.max(axis=0)
    with np.errstate(over="ignore"):
        radius = 0.5 * float(np.linalg.norm(high - low))
    if not (math.isfinite(radius) and radius > 0):
        raise SceneError(f"{path}: the mesh has no extent")
    center = 0.5 * (low + high)
    scene = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": _MAX_DEPTH},
        "sensor": _sensor(points - center, center, radius),
    }
    for number, part in enumerate(parts):
        scene[f"part_{number}"] = _shape(part)
    if not any(part.radiance for part in parts):
        scene["environment"] = {"type": "constant", "radiance": 0.25}
        scene["key_light"] = _key_light(center, radius)
    return scene


def _read_parts(path: Path, folder: Path | None) -> list[MeshPart]:
    suffix = path.suffix.lower()
    if suffix == ".obj":
        return _obj_parts(path, folder)
    if suffix == ".ply":
        return [MeshPart(read_ply(path))]
    from isonoise.scene.mesh.trimesh_import import read_parts

    return read_parts(path, folder)


def _obj_parts(path: Path, folder: Path | None) -> list[MeshPart]:
    """One part for each material that the file uses, with the MTL file's diffuse colour and emission."""
    obj = read_obj(path)
    mtl: dict[str, dict] = {}
    libraries = list(dict.fromkeys(obj.libraries))
    if len(libraries) > _MAX_MTL_FILES:
        raise SceneError(f"{path}: it names more than {_MAX_MTL_FILES} MTL files")
    for library in libraries:
        file = _find_library(path, library, folder)
        mtl |= read_mtl(file) if file else {}
    parts = []
    order = np.argsort(obj.face_material, kind="stable")
    used, first = np.unique(obj.face_material[order], return_index=True)
    for index, faces in zip(used, np.split(order, first[1:]), strict=True):
        material = mtl.get(obj.materials[index], {})
        emission = material.get("Ke")
        reflectance = tuple(min(value, 1.0) for value in material.get("Kd", MeshPart.reflectance))
        radiance = tuple(emission) if emission and max(emission) > 0 else None
        parts.append(MeshPart(select_faces(obj.mesh, faces), reflectance, radiance))
    return parts


def _find_library(path: Path, name: str, folder: Path | None) -> Path | None:
    """The MTL file of this name, or one without the name's folders beside the OBJ file; None if there is neither."""
    candidates = [path.parent / name, path.parent / Path(name).name]
    existing = [file for file in candidates if path_exists(file) and not file.is_dir()]
    found = next((file for file in existing if is_inside(file, folder)), None)
    if existing and not found:
        raise SceneError(f"{path}: {outside_message(existing[0], folder)}")
    return found


def select_faces(mesh: Mesh, face_indices: np.ndarray) -> Mesh:
    """A mesh of the given faces and the vertices that they use."""
    if len(face_indices) == len(mesh.faces):
        return mesh
    used, faces = np.unique(mesh.faces[face_indices], return_inverse=True)
    return Mesh(mesh.vertices[used], faces.reshape(-1, 3), mesh.normals[used] if len(mesh.normals) else mesh.normals)


def _shape(part: MeshPart) -> dict:
    shape = {
        "type": "mesh",
        "vertices": part.mesh.vertices,
        "faces": part.mesh.faces,
        "face_normals": part.face_normals,
        "bsdf": {
            "type": "twosided",
            "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": list(part.reflectance)}},
        },
    }
    if len(part.mesh.normals):
        shape["normals"] = part.mesh.normals
    if part.radiance:
        shape["emitter"] = {"type": "area", "radiance": {"type": "rgb", "value": list(part.radiance)}}
    return shape


def _sensor(points: np.ndarray, center: np.ndarray, radius: float) -> dict:
    """A camera with a square image, at the smallest distance from which every point is visible, plus a margin.

    `points` are relative to `center`.
    """
    to_camera = np.array(_CAMERA_DIRECTION) / np.linalg.norm(_CAMERA_DIRECTION)
    axes = transforms.look_at(to_camera, (0, 0, 0), (0, 1, 0))[:3, :3]
    left, up, forward = np.einsum("ij,jk->ki", points, axes)
    half_extent = np.maximum(np.abs(left), np.abs(up))
    distance = float((half_extent * _MARGIN / math.tan(math.radians(_FOV_DEGREES / 2)) - forward).max())
    distance = max(distance, 1.5 * radius)
    return {
        "type": "perspective",
        "fov": _FOV_DEGREES,
        "near_clip": 1e-3 * radius,
        "far_clip": 1e3 * radius,
        "to_world": transforms.look_at(center + distance * to_camera, center, (0, 1, 0)),
        "film": {"type": "hdrfilm", "width": _IMAGE_SIZE, "height": _IMAGE_SIZE, "rfilter": {"type": "gaussian"}},
        "sampler": {"type": "multijitter", "sample_count": _SAMPLE_COUNT},
    }


def _key_light(center: np.ndarray, radius: float) -> dict:
    """A soft square light above and to the left, outside the image, facing the mesh."""
    direction = np.array(_KEY_LIGHT_DIRECTION) / np.linalg.norm(_KEY_LIGHT_DIRECTION)
    to_world = transforms.look_at(center + 4.0 * radius * direction, center, (0, 0, 1))
    return {
        "type": "rectangle",
        "to_world": to_world @ transforms.scale(1.2 * radius),
        "bsdf": {"type": "diffuse", "reflectance": 0.0},
        "emitter": {"type": "area", "radiance": 8.0},
    }
