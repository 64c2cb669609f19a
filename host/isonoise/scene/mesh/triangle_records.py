"""Makes the triangle records that the shading kernels read. Called by the integrator when it uploads a scene."""

import numpy as np

from isonoise.scene import structs
from isonoise.scene.compiled_scene import CompiledScene
from isonoise.scene.light import light_kinds

CHUNK_TRIANGLES = 2**17
"""Triangles processed at once: keeps the float64 temporaries of a large mesh small."""


def triangle_records(scene: CompiledScene) -> np.ndarray:
    """(T,) structs.TRIANGLE. Normals are computed in float64, so that edges of 10^-10 and of 10^10 have one."""
    records = np.zeros(len(scene.faces), structs.TRIANGLE)
    if not len(records):
        return records
    for begin in range(0, len(records), CHUNK_TRIANGLES):
        chunk = slice(begin, begin + CHUNK_TRIANGLES)
        a, b, c = scene.vertices[scene.faces[chunk]].astype(np.float64).transpose(1, 0, 2)
        record = records[chunk]
        record["corner"], record["edge1"], record["edge2"] = a, b - a, c - a
        normal = np.cross(b - a, c - a)
        length = np.linalg.norm(normal, axis=1, keepdims=True)
        record["normal"] = np.divide(normal, length, out=np.zeros_like(normal), where=length > 0)
    shape = scene.shapes[scene.triangle_shape]
    records["bsdf"], records["flags"] = shape["bsdf"], shape["flags"]
    if len(scene.reversed_winding):
        records["flags"] |= structs.TRIANGLE_REVERSED_WINDING * scene.reversed_winding.astype(np.uint32)
    records["light"] = _light_of_triangles(scene)
    records["media"] = shape["media"]
    return records


def _light_of_triangles(scene: CompiledScene) -> np.ndarray:
    """Index (T,) uint32 of the light that each triangle belongs to, NONE if it does not shine."""
    light = np.full(len(scene.faces), structs.NONE, np.uint32)
    kinds, primitive = scene.lights["kind"], scene.lights["primitive"]
    for kind in light_kinds.select(lambda kind: kind.is_mesh):
        index = np.flatnonzero(kinds == light_kinds.light_bits(kind.name))
        for offset in range(kind.triangle_count):
            light[primitive[index] + offset] = index
    return light


def corner_normals(scene: CompiledScene) -> np.ndarray:
    """Vertex normals of every triangle, (T, 3, 3) float32; (0, 3, 3) if the scene has none.

    They are stored by triangle, not by vertex, so that all data of a hit is adjacent in memory.
    """
    return scene.vertex_normals[scene.faces] if len(scene.vertex_normals) else np.zeros((0, 3, 3), np.float32)
