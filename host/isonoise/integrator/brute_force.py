"""Scenes with so few primitives that testing all of them is faster than a BVH: kernels/geometry/brute_force.h."""

import numpy as np

from isonoise.scene.compiled_scene import CompiledScene

MAX_PRIMITIVES = 48
"""Most primitives for which brute force is faster."""

MAX_CORNERS = 96
"""Most distinct triangle corners: the kernel keeps them in 18 KiB, which fits a CPU's level-1 cache."""


def distinct_corners(scene: CompiledScene) -> tuple[np.ndarray, np.ndarray]:
    """Distinct corners (c, 3) float32, and for every triangle the indices of its corners, (t, 3) uint32."""
    corners, indices = np.unique(scene.vertices[scene.faces].reshape(-1, 3), axis=0, return_inverse=True)
    return corners.astype(np.float32), indices.reshape(-1, 3).astype(np.uint32)


def use_brute_force(scene: CompiledScene) -> bool:
    """Whether the scene is small enough that rays can be tested against all its primitives; instances need the BVH.

    `Wavefront` decides: the device must also process several lanes per work-item.
    """
    primitives = len(scene.faces) + len(scene.analytics)
    return primitives <= MAX_PRIMITIVES and not len(scene.instances) and len(distinct_corners(scene)[0]) <= MAX_CORNERS
