"""Meshes without a scene: a dict with a camera that frames them, their colours, and a light where they bring none."""

import math
from pathlib import Path

import numpy as np

from isonoise.errors import SceneError
from isonoise.scene import transforms
from isonoise.scene.mesh.mesh import Mesh, Part, used_vertices
from isonoise.scene.mesh.obj import read_mtl, read_obj
from isonoise.scene.mesh.ply import read_ply
from isonoise.scene.parse.elements import path_exists

_SIZE, _FOV = 512, 35.0
_VIEW = (0.55, 0.4, 1.0)  # from the mesh to the camera: three-quarter view from above, y up
_KEY = (-0.6, 1.0, 0.5)  # from the mesh to the key light
_MARGIN = 1.05
_LIBRARIES = 100  # MTL files of one OBJ
_DEPTH, _SAMPLES = 8, 64


def default_scene(path: Path) -> dict:
    """A scene dict for an OBJ, PLY, STL or GLB file. Raises SceneError where it cannot be read."""
    parts = _read(path)
    points = np.concatenate([used_vertices(part.mesh.vertices, part.mesh.faces) for part in parts])
    low, high = points.min(axis=0), points.max(axis=0)
    with np.errstate(over="ignore"):
        radius = 0.5 * float(np.linalg.norm(high - low))
    if not (math.isfinite(radius) and radius > 0):
        raise SceneError(f"{path}: the mesh has no extent")
    center = 0.5 * (low + high)
    scene = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": _DEPTH},
        "sensor": _sensor(points - center, center, radius),
    }
    for number, part in enumerate(parts):
        scene[f"part_{number}"] = _shape(part)
    if not any(part.radiance for part in parts):
        scene["sky"] = {"type": "constant", "radiance": 0.25}
        scene["key"] = _key_light(center, radius)
    return scene


def _read(path: Path) -> list[Part]:
    kind = path.suffix.lower()
    if kind == ".obj":
        return _obj_parts(path)
    if kind == ".ply":
        return [Part(read_ply(path))]
    from isonoise.scene.mesh.trimesh_import import read_parts

    return read_parts(path)


def _obj_parts(path: Path) -> list[Part]:
    """One part for each material that the file uses, with MTL's diffuse colour and emission."""
    obj = read_obj(path)
    known: dict[str, dict] = {}
    libraries = list(dict.fromkeys(obj.libraries))
    if len(libraries) > _LIBRARIES:
        raise SceneError(f"{path}: it names more than {_LIBRARIES} files of materials")
    for library in libraries:
        beside = [path.parent / library, path.parent / Path(library).name]
        known |= next((read_mtl(file) for file in beside if library and path_exists(file) and not file.is_dir()), {})
    parts = []
    order = np.argsort(obj.face_material, kind="stable")
    used, first = np.unique(obj.face_material[order], return_index=True)
    for index, faces in zip(used, np.split(order, first[1:]), strict=True):
        colours = known.get(obj.materials[index], {})
        emission = colours.get("Ke")
        parts.append(
            Part(
                compact(obj.mesh, faces),
                tuple(min(value, 1.0) for value in colours.get("Kd", Part.reflectance)),
                tuple(emission) if emission and max(emission) > 0 else None,
            )
        )
    return parts


def compact(mesh: Mesh, chosen: np.ndarray) -> Mesh:
    """The chosen faces, by their numbers, with the vertices that they use."""
    if len(chosen) == len(mesh.faces):
        return mesh
    used, faces = np.unique(mesh.faces[chosen], return_inverse=True)
    return Mesh(mesh.vertices[used], faces.reshape(-1, 3), mesh.normals[used] if len(mesh.normals) else mesh.normals)


def _shape(part: Part) -> dict:
    shape = {
        "type": "mesh",
        "vertices": part.mesh.vertices,
        "faces": part.mesh.faces,
        "face_normals": part.flat,
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
    """A square camera at the least distance from which it sees every vertex, with a little margin."""
    to_camera = np.array(_VIEW) / np.linalg.norm(_VIEW)
    axes = transforms.look_at(to_camera, (0, 0, 0), (0, 1, 0))[:3, :3]
    left, up, ahead = np.einsum("ij,jk->ki", points, axes)
    across = np.maximum(np.abs(left), np.abs(up))
    distance = float((across * _MARGIN / math.tan(math.radians(_FOV / 2)) - ahead).max())
    distance = max(distance, 1.5 * radius)
    return {
        "type": "perspective",
        "fov": _FOV,
        "near_clip": 1e-3 * radius,
        "far_clip": 1e3 * radius,
        "to_world": transforms.look_at(center + distance * to_camera, center, (0, 1, 0)),
        "film": {"type": "hdrfilm", "width": _SIZE, "height": _SIZE, "rfilter": {"type": "gaussian"}},
        "sampler": {"type": "independent", "sample_count": _SAMPLES},
    }


def _key_light(center: np.ndarray, radius: float) -> dict:
    """A soft square light above and to the left, out of the picture, turned to the mesh."""
    towards = np.array(_KEY) / np.linalg.norm(_KEY)
    to_world = transforms.look_at(center + 4.0 * radius * towards, center, (0, 0, 1))
    return {
        "type": "rectangle",
        "to_world": to_world @ transforms.scale(1.2 * radius),
        "bsdf": {"type": "diffuse", "reflectance": 0.0},
        "emitter": {"type": "area", "radiance": 8.0},
    }
