"""Reads a PLY file as a scene. Called by `formats/registry.py`."""

from pathlib import Path

from isonoise.scene.formats.mesh_shape import mesh_shape
from isonoise.scene.formats.report import ImportReport
from isonoise.scene.mesh.ply import read_ply


def read(path: Path, folder: Path | None, report: ImportReport) -> dict:
    """The scene dict of a file. Raises SceneError where it is invalid."""
    mesh = read_ply(path)
    report.count("triangles", len(mesh.faces))
    report.use("triangles")
    return {"type": "scene", "mesh": mesh_shape(mesh, {"type": "twosided", "bsdf": {"type": "diffuse"}})}
