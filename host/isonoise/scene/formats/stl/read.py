"""Reads an STL file as a scene. Called by `formats/registry.py`."""

from pathlib import Path

import numpy as np

from isonoise.scene.formats.mesh_shape import mesh_shape
from isonoise.scene.formats.report import ImportReport
from isonoise.scene.formats.stl.stl_file import read_stl
from isonoise.scene.mesh.mesh import Mesh


def read(path: Path, folder: Path | None, report: ImportReport) -> dict:
    """The scene dict of a file: one mesh with flat shading. Raises SceneError where it is invalid."""
    stl = read_stl(path)
    count = len(stl.corners)
    report.use("triangles")
    report.count("triangles", count)
    report.count("solids", stl.solids)
    mesh = Mesh(stl.corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3), np.zeros((0, 3)))
    reflectance: dict | float = 0.5
    if len(stl.colours):
        report.use("vertex_colours")
        mesh.attributes["face_color"] = stl.colours.astype(np.float32)
        reflectance = {"type": "mesh_attribute", "name": "face_color"}
    if stl.has_ascii_colours:
        report.limit("vertex_colours", "colours in ASCII files are left out: export a binary file")
    bsdf = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": reflectance}}
    return {"type": "scene", "mesh": mesh_shape(mesh, bsdf, face_normals=True)}
