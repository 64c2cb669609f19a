"""Scenes of so few primitives that a ray meets them all sooner than it walks through a hierarchy: kernels/few.h."""

import numpy as np

from isonoise.scene.compiled import CompiledScene

MOST = 48
"""Primitives up to which that is so."""

MOST_CORNERS = 96
"""Corners of triangles for which kernels/few.h has room: 18 KiB, that stay in a CPU's first cache."""


def distinct_corners(scene: CompiledScene) -> tuple[np.ndarray, np.ndarray]:
    """Corners (c, 3) float32, each once, and those of every triangle, (t, 3) uint32, by their numbers."""
    corners, numbers = np.unique(scene.vertices[scene.faces].reshape(-1, 3), axis=0, return_inverse=True)
    return corners.astype(np.float32), numbers.reshape(-1, 3).astype(np.uint32)


def are_few(scene: CompiledScene) -> bool:
    """Whether kernels/few.h does for the scene; it knows nothing of instances."""
    primitives = len(scene.faces) + len(scene.analytics)
    return primitives <= MOST and not len(scene.instances) and len(distinct_corners(scene)[0]) <= MOST_CORNERS
