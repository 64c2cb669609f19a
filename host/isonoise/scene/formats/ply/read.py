"""Reads a PLY file as a scene. Called by `formats/registry.py`."""

from pathlib import Path

import numpy as np

from isonoise.errors import SceneError
from isonoise.scene.formats.bitmaps import Bitmaps
from isonoise.scene.formats.mesh_shape import mesh_shape
from isonoise.scene.formats.named_files import find_file
from isonoise.scene.formats.report import ImportReport
from isonoise.scene.mesh.mesh import Mesh
from isonoise.scene.mesh.ply import PlyFile, read_ply_file
from isonoise.scene.spectra import srgb_to_linear

_TEXTURE_COMMENT = "texturefile"  # MeshLab's and others' convention


def read(path: Path, folder: Path | None, report: ImportReport) -> dict:
    """The scene dict of a file. Raises SceneError where it is invalid."""
    ply = read_ply_file(path, flip_tex_coords=True, cut_concave=True)
    mesh = _split_at_seams(ply)
    report.use("triangles")
    report.count("triangles", len(mesh.faces))
    for feature, is_used in (
        ("polygons", len(mesh.faces) != ply.counts["face"]),
        ("normals", len(mesh.normals)),
        ("uvs", len(mesh.uvs)),
        ("lines_points", ply.counts.get("edge")),
        ("strips_fans", ply.counts.get("tristrips")),
    ):
        if is_used:
            report.use(feature)
    texture, colours = _texture(path, ply, folder, report), _colours(mesh, report)
    if texture and colours and (mesh.attributes.pop(colours["name"]) != 1).any():
        report.limit("vertex_colours", "left out: there is a texture too")
    reflectance = texture or colours or 0.5
    bsdf = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": reflectance}}
    return {"type": "scene", "mesh": mesh_shape(mesh, bsdf)}


def _split_at_seams(ply: PlyFile) -> Mesh:
    """The mesh, with a vertex for each distinct pair of vertex and texture coordinates of a corner."""
    mesh = ply.mesh
    if not len(ply.corner_uvs):
        return mesh
    corners = np.zeros(mesh.faces.size, [("vertex", "i8"), ("uv", "f4", 2)])
    corners["vertex"], corners["uv"] = mesh.faces.reshape(-1), ply.corner_uvs.reshape(-1, 2) + np.float32(0)  # no -0
    _, first, inverse = np.unique(corners.view("V16"), return_index=True, return_inverse=True)
    used = corners[first]
    attributes = {
        name: values[used["vertex"]] if name.startswith("vertex_") else values
        for name, values in mesh.attributes.items()
    }
    normals = mesh.normals[used["vertex"]] if len(mesh.normals) else mesh.normals
    return Mesh(mesh.vertices[used["vertex"]], inverse.reshape(-1, 3), normals, used["uv"].copy(), attributes)


def _texture(path: Path, ply: PlyFile, folder: Path | None, report: ImportReport) -> dict | None:
    """The texture that a comment names; None without one."""
    words = (comment.split(None, 1) for comment in ply.comments)
    names = [pair[1] for pair in words if len(pair) == 2 and pair[0].lower() == _TEXTURE_COMMENT]
    if not names:
        return None
    report.use("textures")
    if not (len(ply.mesh.uvs) or len(ply.corner_uvs)):
        report.limit("textures", "left out: there are no texture coordinates", names[0])
        return None
    if len(names) > 1:
        report.limit("textures", "only the first texture is used", names[1])
    file = find_file(path, names[0], folder)
    if file is None:
        report.limit("textures", "there is no such file", names[0])
        return None
    bitmaps = Bitmaps()
    try:
        return bitmaps.texture(bitmaps.read(file))
    except SceneError as error:
        report.limit("textures", str(error).removeprefix(f"{file}: "), names[0])
        return None


def _colours(mesh: Mesh, report: ImportReport) -> dict | None:
    """The texture of the vertex or face colours; None if there are none. Removes other attributes from the mesh."""
    given = {name: mesh.attributes[name] for name in ("vertex_color", "face_color") if name in mesh.attributes}
    mesh.attributes = {}
    if not given:
        return None
    report.use("vertex_colours")
    name, colours = next(iter(given.items()))
    if colours.shape[1] == 4 and (colours[:, 3] != 1).any():
        report.limit("opacity", "the alpha of colours is left out")
    if len(given) > 1:
        report.limit("vertex_colours", "face colours are left out: there are vertex colours too")
    colours = np.nan_to_num(colours[:, :3], posinf=0.0, neginf=0.0)
    if colours.max() > 1:  # floats from 0 to 255
        colours = srgb_to_linear(np.clip(colours / 255.0, 0.0, 1.0))
    mesh.attributes = {name: np.clip(colours, 0.0, 1.0).astype(np.float32)}
    return {"type": "mesh_attribute", "name": name}
