"""Boxes around analytic primitives and instances."""

import numpy as np

from isonoise.scene.structs import ANALYTIC_CYLINDER, ANALYTIC_SPHERE


def analytic_extents(analytics: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper corners of the boxes around the (A,) ANALYTIC records, (A, 3) float64."""
    matrix = analytics["to_world"].astype(np.float64).reshape(-1, 3, 4)
    # the extent of an ellipse along an axis: length of the row of its two radii
    radius = np.hypot(matrix[:, :, 0], matrix[:, :, 1])
    base = matrix[:, :, 3]
    top = base + np.where((analytics["kind"] == ANALYTIC_CYLINDER)[:, None], matrix[:, :, 2], 0)
    sphere = (analytics["kind"] == ANALYTIC_SPHERE)[:, None]
    center, arm = analytics["center"].astype(np.float64), analytics["radius"][:, None].astype(np.float64)
    lower = np.where(sphere, center - arm, np.minimum(base, top) - radius)
    upper = np.where(sphere, center + arm, np.maximum(base, top) + radius)
    return lower, upper


def analytic_bounds(analytics: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same in float32 for the hierarchy, a few roundings wider than the surfaces."""
    lower, upper = analytic_extents(analytics)
    # float32 keeps 24 bits: the surface as the kernels compute it may stand a few units in the last place outside
    margin = 2.0**-21 * np.maximum(np.abs(lower), np.abs(upper)).max(axis=1, initial=0, keepdims=True)
    return (lower - margin).astype(np.float32), (upper + margin).astype(np.float32)


def instance_extents(instances: np.ndarray, boxes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper corners of the boxes around (I,) INSTANCE records, (I, 3) float64.

    `boxes` (I, 2, 3) are those around their groups, in the groups' spaces.
    """
    matrix = instances["to_world"].astype(np.float64).reshape(-1, 3, 4)
    middle, half = 0.5 * (boxes[:, 0] + boxes[:, 1]), 0.5 * (boxes[:, 1] - boxes[:, 0])
    middle = np.einsum("kij,kj->ki", matrix[:, :, :3], middle) + matrix[:, :, 3]
    half = np.einsum("kij,kj->ki", np.abs(matrix[:, :, :3]), half)
    return middle - half, middle + half


def instance_bounds(instances: np.ndarray, boxes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same in float32 for the hierarchy, wider than what the kernels' transforms round away.

    The ray's origin is taken to the group's space by a product of 4 terms: off by a few units in the last place of the
    sum of their magnitudes, which the matrix takes back to the world.
    """
    lower, upper = instance_extents(instances, boxes)
    matrix = np.abs(instances["to_world"]).astype(np.float64).reshape(-1, 3, 4)
    inverse = np.abs(instances["to_object"]).astype(np.float64).reshape(-1, 3, 4)
    farthest = np.maximum(np.abs(lower), np.abs(upper))
    on_object = np.einsum("kij,kj->ki", inverse[:, :, :3], farthest) + inverse[:, :, 3]
    margin = 2.0**-21 * (farthest + np.einsum("kij,kj->ki", matrix[:, :, :3], on_object))
    return (lower - margin).astype(np.float32), (upper + margin).astype(np.float32)
