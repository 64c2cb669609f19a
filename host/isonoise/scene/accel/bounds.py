"""Bounding boxes of analytic primitives and instances: exact in float64, and padded in float32 for the BVH."""

import numpy as np

from isonoise.scene.structs import ANALYTIC_CYLINDER, ANALYTIC_SPHERE

_RELATIVE_PADDING = 2.0**-21  # float32 has 24 bits: kernels compute surfaces to a few units in the last place


def analytic_extents(analytics: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper corners (A, 3) float64 of the boxes around (A,) structs.ANALYTIC records."""
    matrix = analytics["to_world"].astype(np.float64).reshape(-1, 3, 4)
    # the half extent of an ellipse along an axis is the length of the row of its two radii
    radius = np.hypot(matrix[:, :, 0], matrix[:, :, 1])
    base = matrix[:, :, 3]
    top = base + np.where((analytics["kind"] == ANALYTIC_CYLINDER)[:, None], matrix[:, :, 2], 0)
    is_sphere = (analytics["kind"] == ANALYTIC_SPHERE)[:, None]
    center = analytics["center"].astype(np.float64)
    sphere_radius = analytics["radius"][:, None].astype(np.float64)
    lower = np.where(is_sphere, center - sphere_radius, np.minimum(base, top) - radius)
    upper = np.where(is_sphere, center + sphere_radius, np.maximum(base, top) + radius)
    return lower, upper


def analytic_bounds(analytics: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The boxes of `analytic_extents` in float32, padded for the BVH."""
    lower, upper = analytic_extents(analytics)
    max_coordinate = np.maximum(np.abs(lower), np.abs(upper)).max(axis=1, initial=0, keepdims=True)
    padding = _RELATIVE_PADDING * max_coordinate
    return (lower - padding).astype(np.float32), (upper + padding).astype(np.float32)


def instance_extents(instances: np.ndarray, boxes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper corners (I, 3) float64 of the boxes around (I,) structs.INSTANCE records.

    `boxes` (I, 2, 3) are the boxes of their groups, in group space.
    """
    matrix = instances["to_world"].astype(np.float64).reshape(-1, 3, 4)
    center, half = 0.5 * (boxes[:, 0] + boxes[:, 1]), 0.5 * (boxes[:, 1] - boxes[:, 0])
    center = np.einsum("kij,kj->ki", matrix[:, :, :3], center) + matrix[:, :, 3]
    half = np.einsum("kij,kj->ki", np.abs(matrix[:, :, :3]), half)
    return center - half, center + half


def instance_bounds(instances: np.ndarray, boxes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The boxes of `instance_extents` in float32, padded by more than the rounding of the kernels' transforms.

    The ray origin is transformed to group space by a sum of 4 products. Its error is a few units in the last place of
    the sum of their magnitudes, which the matrix transforms back to world space.
    """
    lower, upper = instance_extents(instances, boxes)
    matrix = np.abs(instances["to_world"]).astype(np.float64).reshape(-1, 3, 4)
    inverse = np.abs(instances["to_object"]).astype(np.float64).reshape(-1, 3, 4)
    max_world = np.maximum(np.abs(lower), np.abs(upper))
    max_object = np.einsum("kij,kj->ki", inverse[:, :, :3], max_world) + inverse[:, :, 3]
    padding = _RELATIVE_PADDING * (max_world + np.einsum("kij,kj->ki", matrix[:, :, :3], max_object))
    return (lower - padding).astype(np.float32), (upper + padding).astype(np.float32)
