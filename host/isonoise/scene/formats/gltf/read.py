"""Reads a glTF file as a scene. Called by `formats/registry.py`."""

from pathlib import Path

import numpy as np

from isonoise.errors import SceneError
from isonoise.scene.formats.gltf import cameras, lights
from isonoise.scene.formats.gltf.accessors import Accessors
from isonoise.scene.formats.gltf.document import Document
from isonoise.scene.formats.gltf.extensions import check_extensions
from isonoise.scene.formats.gltf.materials import Materials
from isonoise.scene.formats.gltf.nodes import placed_nodes, world_transforms
from isonoise.scene.formats.gltf.shapes import Shapes, unique_name
from isonoise.scene.formats.report import ImportReport


def read(path: Path, folder: Path | None, report: ImportReport) -> dict:
    """The scene dict of a file: shapes, sensors and emitters. Raises SceneError where it is invalid."""
    with np.errstate(all="ignore"):  # numbers are checked where they matter
        return _read(Document(path, folder), report)


def _read(document: Document, report: ImportReport) -> dict:
    check_extensions(document, report)
    if any("uri" in one for kind in ("buffers", "images") for one in document.all(kind)):
        report.use("includes")
    matrices = world_transforms(document)
    placed = placed_nodes(document, matrices, report)
    shapes = Shapes(document, Accessors(document), Materials(document, report), report)
    shapes.add_nodes(placed, matrices)
    if not shapes.shapes:
        rest = ", only lines and points, which are not rendered" if "lines_points" in report.used else ""
        raise SceneError(f"{document.path}: its scene has no triangles{rest}")
    scene, name_counts = {"type": "scene"}, {}
    for one in placed:
        camera = document.referenced(one.node, "camera", "cameras")
        if camera is not None:
            name = one.node.string("name", "") or camera.string("name", "") or str(report.counts.get("cameras", 0))
            scene[unique_name(f"camera_{name}", name_counts)] = cameras.sensor(camera, one, report)
        emitter = lights.emitter(one, document, report) if one.is_visible else None
        if emitter is not None:
            scene[unique_name(f"light_{one.name}", name_counts)] = emitter
    if animations := document.all("animations"):
        report.use("animation")
        report.count("animations", len(animations))
    return scene | shapes.shapes
