"""Reads an OBJ file with its MTL files as a scene. Called by `formats/registry.py`."""

from pathlib import Path

import numpy as np

from isonoise.errors import SceneError
from isonoise.scene.files import is_inside, outside_message
from isonoise.scene.formats.mesh_shape import mesh_shape, rgb
from isonoise.scene.formats.report import ImportReport
from isonoise.scene.mesh.mesh import Mesh
from isonoise.scene.mesh.obj import read_mtl, read_obj
from isonoise.scene.parse.elements import path_exists

_MAX_MTL_FILES = 100  # of one OBJ


def read(path: Path, folder: Path | None, report: ImportReport) -> dict:
    """The scene dict of a file: one shape for each material that it uses. Raises SceneError where it is invalid."""
    obj = read_obj(path)
    mtl: dict[str, dict] = {}
    libraries = list(dict.fromkeys(obj.libraries))
    if len(libraries) > _MAX_MTL_FILES:
        raise SceneError(f"{path}: it names more than {_MAX_MTL_FILES} MTL files")
    for library in libraries:
        file = _find_library(path, library, folder)
        mtl |= read_mtl(file) if file else {}
    report.use("triangles")
    report.count("triangles", len(obj.mesh.faces))
    scene = {"type": "scene"}
    order = np.argsort(obj.face_material, kind="stable")
    used, first = np.unique(obj.face_material[order], return_index=True)
    for number, (index, faces) in enumerate(zip(used, np.split(order, first[1:]), strict=True)):
        material = mtl.get(obj.materials[index], {})
        reflectance = [min(value, 1.0) for value in material.get("Kd", (0.5, 0.5, 0.5))]
        bsdf = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": rgb(reflectance)}}
        shape = scene[f"part_{number}"] = mesh_shape(select_faces(obj.mesh, faces), bsdf)
        if max(material.get("Ke", (0.0,))) > 0:
            shape["emitter"] = {"type": "area", "radiance": rgb(material["Ke"])}
    return scene


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
    return Mesh(
        mesh.vertices[used],
        faces.reshape(-1, 3),
        mesh.normals[used] if len(mesh.normals) else mesh.normals,
        mesh.uvs[used] if len(mesh.uvs) else mesh.uvs,
    )
