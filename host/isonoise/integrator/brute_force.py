"""Scenes of so few primitives that testing them all is faster than a hierarchy: kernels/geometry/brute_force.h."""

import numpy as np

from isonoise.scene.compiled_scene import CompiledScene

MOST = 48
"""Primitives up to which that is so."""

MAX_CORNERS = 96
"""Corners of triangles for which kernels/geometry/brute_force.h has room: 18 KiB, that stay in a CPU's first cache."""


def distinct_corners(scene: CompiledScene) -> tuple[np.ndarray, np.ndarray]:
    """Corners (c, 3) float32, each once, and those of every triangle, (t, 3) uint32, by their numbers."""
    corners, numbers = np.unique(scene.vertices[scene.faces].reshape(-1, 3), axis=0, return_inverse=True)
    return corners.astype(np.float32), numbers.reshape(-1, 3).astype(np.uint32)


def use_brute_force(scene: CompiledScene) -> bool:
    """Whether kernels/geometry/brute_force.h does for the scene; it knows nothing of instances."""
    primitives = len(scene.faces) + len(scene.analytics)
    return primitives <= MOST and not len(scene.instances) and len(distinct_corners(scene)[0]) <= MAX_CORNERS
