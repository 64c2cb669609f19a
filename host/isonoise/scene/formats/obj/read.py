"""Reads an OBJ file with its MTL files as a scene. Called by `formats/registry.py`."""

from pathlib import Path

import numpy as np

from isonoise.errors import SceneError
from isonoise.scene.formats.mesh_shape import mesh_shape
from isonoise.scene.formats.named_files import find_file
from isonoise.scene.formats.obj.materials import Materials
from isonoise.scene.formats.obj.mtl import Material, read_mtl
from isonoise.scene.formats.report import ImportReport
from isonoise.scene.mesh.mesh import Mesh
from isonoise.scene.mesh.obj import ObjFile, read_obj
from isonoise.scene.spectra import srgb_to_linear

_MAX_MTL_FILES = 100  # of one OBJ
_COUNTED_FEATURES = {
    **dict.fromkeys(("lines", "points", "incomplete faces"), "lines_points"),
    **dict.fromkeys(("curves", "surfaces"), "curves"),
}
_DEFAULT = Material("")
_NO_MATERIAL = ("", "None", "(null)")  # names that programs write for faces without a material


def read(path: Path, folder: Path | None, report: ImportReport) -> dict:
    """The scene dict of a file: a shape for each material that it uses. Raises SceneError where it is invalid."""
    obj = read_obj(path, mend_polygons=True)
    _report_geometry(obj, report)
    mtl = _read_libraries(path, obj, folder, report)
    materials = Materials(path, folder, report)
    scene = {"type": "scene"}
    is_flat = obj.is_flat & (not len(obj.mesh.normals))
    for number, (part, faces) in enumerate(_split(2 * obj.face_material + is_flat)):
        material = mtl.get(obj.materials[part // 2], _DEFAULT)
        mesh, vertices = select_faces(obj.mesh, faces)
        if len(obj.vertex_colours):
            _add_colours(mesh, obj.vertex_colours[vertices], material, materials, report)
        bsdf = materials.bsdf(material, _uv_length(mesh, material), "vertex_color" in mesh.attributes)
        shape = scene[f"part_{number}"] = mesh_shape(mesh, bsdf, bool(part % 2))
        shape["id"] = f"part_{number}: {material.name}"
        if radiance := materials.radiance(material):
            shape["emitter"] = {"type": "area", "radiance": radiance}
    return scene


def _report_geometry(obj: ObjFile, report: ImportReport) -> None:
    report.use("triangles")
    report.count("triangles", len(obj.mesh.faces))
    report.count("materials", len(np.unique(obj.face_material)))
    if obj.polygons:
        report.use("polygons")
        report.count("polygons", obj.polygons)
    for feature, values in (("normals", obj.mesh.normals), ("uvs", obj.mesh.uvs)):
        if len(values):
            report.use(feature)
    for noun, count in obj.counts.items():
        if count:
            report.count(noun, count)
            if noun in _COUNTED_FEATURES:
                report.use(_COUNTED_FEATURES[noun])


def _read_libraries(path: Path, obj: ObjFile, folder: Path | None, report: ImportReport) -> dict[str, Material]:
    """The materials of all MTL files, by name."""
    materials: dict[str, Material] = {}
    statements = list(dict.fromkeys(obj.libraries))
    if len(statements) > _MAX_MTL_FILES:
        raise SceneError(f"{path}: it names more than {_MAX_MTL_FILES} MTL files")
    is_missing = False
    for text in statements:
        whole = find_file(path, text, folder)
        for name in [text] if whole else _split_names(text)[:_MAX_MTL_FILES]:
            report.use("includes")
            if file := whole or find_file(path, name, folder):
                materials |= read_mtl(file)
            else:
                is_missing = True
                report.limit("includes", "there is no such file: its materials are grey", name)
    for index in np.unique(obj.face_material):
        name = obj.materials[index]
        if name not in _NO_MATERIAL and name not in materials and not is_missing:
            report.limit("diffuse", "no MTL file defines it: it is grey", f"material '{name}'")
    return materials


def _split_names(text: str) -> list[str]:
    """The file names of an `mtllib` statement: blanks separate names, but names may contain blanks too."""
    names, words = [], []
    for word in text.split(" "):
        words.append(word)
        if word.strip().strip('"').lower().endswith(".mtl"):
            names.append(" ".join(words).strip())
            words = []
    rest = " ".join(words).strip()
    return [*names, rest] if rest else names


def _split(keys: np.ndarray) -> list[tuple[int, np.ndarray]]:
    """(key, indices of the faces with it), in the order of keys."""
    order = np.argsort(keys, kind="stable")
    used, first = np.unique(keys[order], return_index=True)
    return list(zip(used.tolist(), np.split(order, first[1:]), strict=True))


def select_faces(mesh: Mesh, face_indices: np.ndarray) -> tuple[Mesh, np.ndarray]:
    """A mesh of the given faces and the vertices that they use, and the numbers of these vertices."""
    if len(face_indices) == len(mesh.faces):
        return mesh, np.arange(len(mesh.vertices))
    used, faces = np.unique(mesh.faces[face_indices], return_inverse=True)
    part = Mesh(
        mesh.vertices[used],
        faces.reshape(-1, 3),
        mesh.normals[used] if len(mesh.normals) else mesh.normals,
        mesh.uvs[used] if len(mesh.uvs) else mesh.uvs,
    )
    return part, used


def _add_colours(
    mesh: Mesh, colours: np.ndarray, material: Material, materials: Materials, report: ImportReport
) -> None:
    """Give the mesh its vertex colours times Kd as an attribute, unless they are white."""
    colours = colours / 255.0 if colours.max() > 1 else colours
    if (colours == 1).all():
        return
    report.use("vertex_colours")
    if "kd" in material.maps:
        report.limit("vertex_colours", "left out where there is a texture (map_Kd)", material.name)
        return
    factor = materials.diffuse_factor(material) if "kd" in material.numbers else 1.0
    mesh.attributes["vertex_color"] = (srgb_to_linear(np.clip(colours, 0.0, 1.0)) * factor).astype(np.float32)


def _uv_length(mesh: Mesh, material: Material) -> float:
    """The mean length of a unit of the texture coordinates on the surface; 1 where no bump map needs it."""
    if not {"bump", "disp"} & set(material.maps) or not len(mesh.uvs):
        return 1.0
    a, b, c = (mesh.vertices[mesh.faces[:, i]] for i in range(3))
    u, v, w = (mesh.uvs[mesh.faces[:, i]].astype(np.float64) for i in range(3))
    with np.errstate(all="ignore"):  # huge coordinates
        area = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()
        uv_area = np.abs(np.linalg.det(np.stack([v - u, w - u], axis=1))).sum()
        length = np.sqrt(area / uv_area)
    return float(length) if np.isfinite(length) else 1.0
