"""Reads a glTF file as a scene. Called by `formats/registry.py`."""

from pathlib import Path

from isonoise.scene.formats.mesh_shape import mesh_shape, rgb
from isonoise.scene.formats.report import ImportReport
from isonoise.scene.mesh.trimesh_import import read_parts


def read(path: Path, folder: Path | None, report: ImportReport) -> dict:
    """The scene dict of a file. Raises SceneError where it is invalid."""
    scene = {"type": "scene"}
    for number, part in enumerate(read_parts(path, folder)):
        report.count("triangles", len(part.mesh.faces))
        report.use("triangles")
        bsdf = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": rgb(part.reflectance)}}
        scene[f"part_{number}"] = mesh_shape(part.mesh, bsdf, part.face_normals)
        if part.radiance:
            scene[f"part_{number}"]["emitter"] = {"type": "area", "radiance": rgb(part.radiance)}
    return scene
