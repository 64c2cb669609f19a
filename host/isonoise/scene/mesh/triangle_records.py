"""The triangles of a compiled scene as the shading kernels read them."""

import numpy as np

from isonoise.scene import structs
from isonoise.scene.compiled_scene import CompiledScene

CHUNK = 2**17
"""Triangles at a time."""


def triangle_records(scene: CompiledScene) -> np.ndarray:
    """(T,) TRIANGLE records. Normals are computed in float64: edges of 10^-10 and of 10^10 have one too."""
    records = np.zeros(len(scene.faces), structs.TRIANGLE)
    if not len(records):
        return records
    for begin in range(0, len(records), CHUNK):  # so that the float64 copies of a large mesh stay small
        part = slice(begin, begin + CHUNK)
        a, b, c = scene.vertices[scene.faces[part]].astype(np.float64).transpose(1, 0, 2)
        record = records[part]
        record["corner"], record["edge1"], record["edge2"] = a, b - a, c - a
        normal = np.cross(b - a, c - a)
        length = np.linalg.norm(normal, axis=1, keepdims=True)
        record["normal"] = np.divide(normal, length, out=np.zeros_like(normal), where=length > 0)
    shape = scene.shapes[scene.triangle_shape]
    records["bsdf"], records["flags"] = shape["bsdf"], shape["flags"]
    if len(scene.reversed_winding):
        records["flags"] |= structs.TRIANGLE_REWOUND * scene.reversed_winding.astype(np.uint32)
    in_shape = np.arange(len(records), dtype=np.uint32) - shape["first_primitive"]
    shines = shape["first_light"] != structs.NONE
    records["light"] = np.where(shines, shape["first_light"] + in_shape, structs.NONE)
    records["media"] = shape["media"]
    return records


def corner_normals(scene: CompiledScene) -> np.ndarray:
    """Normals of the vertices of every triangle (T, 3, 3) float32; (0, 3, 3) in scenes without any.

    By triangle, not by vertex, so that what a hit needs lies together.
    """
    return scene.vertex_normals[scene.faces] if len(scene.vertex_normals) else np.zeros((0, 3, 3), np.float32)
