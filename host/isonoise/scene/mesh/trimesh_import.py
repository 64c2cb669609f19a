"""Reads STL with trimesh. Called by `formats/stl/read.py`."""

import io
import logging
import warnings
from pathlib import Path

import numpy as np

from isonoise.errors import SceneError
from isonoise.scene.files import read_bytes
from isonoise.scene.mesh.mesh import Mesh


def read_stl(path: Path) -> list[Mesh]:
    """The solids of a file, which has no vertex normals. Raises SceneError if trimesh cannot read it or it has none."""
    import trimesh

    data = read_bytes(path)
    logging.getLogger("trimesh").addHandler(logging.NullHandler())  # without a handler it prints tracebacks
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")  # the end of this function checks what matters
            loaded = trimesh.load_scene(io.BytesIO(data), file_type="stl", process=False, maintain_order=True)
            solids = [loaded.geometry[loaded.graph.get(name)[1]] for name in sorted(loaded.graph.nodes_geometry)]
            meshes = [
                Mesh(np.asarray(solid.vertices, float), np.asarray(solid.faces, np.int64), np.zeros((0, 3)))
                for solid in solids
                if len(solid.faces)
            ]
    except Exception as error:  # trimesh raises errors of any type for an invalid file
        reason = str(error).splitlines()[0][:100] if str(error) else type(error).__name__
        raise SceneError(f"{path}: not a readable STL file ({reason})") from None
    if not meshes:
        raise SceneError(f"{path}: it has no triangles")
    for mesh in meshes:
        if mesh.faces.min() < 0 or mesh.faces.max() >= len(mesh.vertices) or not np.isfinite(mesh.vertices).all():
            raise SceneError(f"{path}: a vertex is not a finite number, or a face uses a vertex that does not exist")
    return meshes
