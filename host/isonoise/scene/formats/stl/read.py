"""Reads an STL file as a scene. Called by `formats/registry.py`."""

from pathlib import Path

from isonoise.scene.formats.mesh_shape import mesh_shape
from isonoise.scene.formats.report import ImportReport
from isonoise.scene.mesh.trimesh_import import read_stl


def read(path: Path, folder: Path | None, report: ImportReport) -> dict:
    """The scene dict of a file. Raises SceneError where it is invalid."""
    scene = {"type": "scene"}
    bsdf = {"type": "twosided", "bsdf": {"type": "diffuse"}}
    for number, mesh in enumerate(read_stl(path)):
        report.count("triangles", len(mesh.faces))
        report.use("triangles")
        scene[f"part_{number}"] = mesh_shape(mesh, bsdf, face_normals=True)
    return scene
