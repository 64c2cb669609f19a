"""Loads the triangles of a shape: from its file, or those of a rectangle or cube. Called by `surfaces.py`."""

from pathlib import Path

import numpy as np

from isonoise.scene.mesh.mesh import Mesh

_NO_NORMALS = np.zeros((0, 3))
_UNIT_SQUARE = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)
_RECTANGLE = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float)
_RECTANGLE_FACES = np.array([[0, 1, 2], [2, 3, 0]])
# Four vertices a side, because each side has its own texture coordinates. Order and coordinates are Mitsuba 3's.
_CUBE = np.array(
    [
        *([1, -1, -1], [1, -1, 1], [-1, -1, 1], [-1, -1, -1]),
        *([1, 1, -1], [-1, 1, -1], [-1, 1, 1], [1, 1, 1]),
        *([1, -1, -1], [1, 1, -1], [1, 1, 1], [1, -1, 1]),
        *([1, -1, 1], [1, 1, 1], [-1, 1, 1], [-1, -1, 1]),
        *([-1, -1, 1], [-1, 1, 1], [-1, 1, -1], [-1, -1, -1]),
        *([1, 1, -1], [1, -1, -1], [-1, -1, -1], [-1, 1, -1]),
    ],
    float,
)
_CUBE_FACES = (4 * np.arange(6)[:, None, None] + [[0, 1, 2], [3, 0, 2]]).reshape(-1, 3)
_CUBE_UVS = np.tile(_UNIT_SQUARE[[3, 2, 1, 0]], (6, 1))


def load_mesh(shape: dict) -> Mesh:
    """The triangles of a shape of the description. Raises SceneError where its file is invalid."""
    if shape["type"] == "rectangle":
        return Mesh(_RECTANGLE, _RECTANGLE_FACES, _NO_NORMALS, _UNIT_SQUARE)
    if shape["type"] == "cube":
        return Mesh(_CUBE, _CUBE_FACES, _NO_NORMALS, _CUBE_UVS)
    if shape["type"] == "mesh":
        optional = {"uvs": shape.get("texcoords"), "attributes": shape.get("attributes")}
        optional = {name: value for name, value in optional.items() if value is not None}
        return Mesh(shape["vertices"], shape["faces"], shape.get("normals", _NO_NORMALS), **optional)
    path = Path(shape["filename"])
    if shape["type"] == "obj":
        from isonoise.scene.mesh.obj import read_obj

        return read_obj(path, shape["flip_tex_coords"]).mesh
    if shape["type"] == "serialized":
        from isonoise.scene.mesh.serialized import read_serialized

        return read_serialized(path, shape["shape_index"])
    from isonoise.scene.mesh.ply import read_ply

    return read_ply(path, shape["flip_tex_coords"])
