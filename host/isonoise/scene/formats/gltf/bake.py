"""Copies of glTF geometry in world space. Called by `shapes.py`."""

from dataclasses import replace

import numpy as np

from isonoise.scene import transforms
from isonoise.scene.formats.gltf.deform import normal_matrices
from isonoise.scene.formats.gltf.primitives import Geometry


def bake_copies(geometry: Geometry, matrices: np.ndarray) -> Geometry | None:
    """All copies of a geometry, with transforms (n, 4, 4), as one in world space; None if they have no extent.

    Vertices that no triangle uses are left out. The winding of mirrored copies is reversed, so that their fronts are
    the mirrored fronts.
    """
    geometry, copies = _used_vertices(geometry), len(matrices)
    vertices = transforms.transform_points(matrices, geometry.vertices.astype(float))
    if not np.ptp(vertices, axis=-2).any():
        return None
    is_mirror = np.linalg.det(matrices[:, :3, :3]) < 0
    faces = np.where(is_mirror[:, None, None], geometry.faces[:, ::-1], geometry.faces)
    faces += len(geometry.vertices) * np.arange(copies)[:, None, None]
    normals = geometry.normals
    if normals is not None:
        normals = np.einsum("vj,nij->nvi", normals.astype(float), normal_matrices(matrices[:, :3, :3])).reshape(-1, 3)
    return replace(
        geometry,
        vertices=vertices.reshape(-1, 3),
        faces=faces.reshape(-1, 3),
        normals=normals,
        uv_sets=[_repeat(uvs, copies) for uvs in geometry.uv_sets],
        colours=_repeat(geometry.colours, copies),
        alphas=_repeat(geometry.alphas, copies),
    )


def _used_vertices(geometry: Geometry) -> Geometry:
    """The geometry without vertices that no triangle uses: primitives often share one large array."""
    is_used = np.zeros(len(geometry.vertices), bool)
    is_used[geometry.faces] = True
    if is_used.all():
        return geometry
    return replace(
        geometry,
        vertices=geometry.vertices[is_used],
        faces=(np.cumsum(is_used) - 1)[geometry.faces],
        normals=_select(geometry.normals, is_used),
        uv_sets=[uvs[is_used] for uvs in geometry.uv_sets],
        colours=_select(geometry.colours, is_used),
        alphas=_select(geometry.alphas, is_used),
    )


def _select(values: np.ndarray | None, is_selected: np.ndarray) -> np.ndarray | None:
    return None if values is None else values[is_selected]


def _repeat(values: np.ndarray | None, times: int) -> np.ndarray | None:
    return values if values is None or times == 1 else np.tile(values, (times, 1))
