"""Scales small scenes up for Mitsuba 3. Called by `convert.py`.

Mitsuba's rays start 9e-5 (1 + coordinate) off a surface (1500 float32 epsilons; `RayEpsilon` in its math.h), and miss
whatever is nearer. isonoise's image does not depend on the scale.
"""

import math

import numpy as np

from isonoise.scene.mesh.mesh import used_vertices
from isonoise.scene.placement import UNPLACED, Placement, place_scene
from isonoise.scene.transforms import transform_points

SCALING_REASON = "Mitsuba's rays start 0.0001 off surfaces and miss what is nearer"
_MIN_SIZE = 0.5
"""Median size of meshes below which a scene is scaled up: there the offset is 2e-4 of the size or more."""

_MIN_SCALED_SIZE = 1e-12  # smaller ones are damaged files


def scale_up(description: dict, ids: dict[int, str]) -> tuple[dict, float]:
    """(scene, factor): lengths times a power of ten, so that meshes have a size of 10 to 100; else 1.

    `ids` gets the objects of the returned scene.
    """
    sizes = [size for shape in description.values() if isinstance(shape, dict) and (size := _mesh_size(shape))]
    median = float(np.median(sizes)) if sizes else _MIN_SIZE
    if not _MIN_SCALED_SIZE < median < _MIN_SIZE:
        return description, 1.0
    factor = 10.0 ** (1 - math.floor(math.log10(median)))
    groups = {id(part): UNPLACED for part in _shape_groups(description)}
    return place_scene(description, Placement(np.zeros(3), factor), groups, ids), factor


def _shape_groups(description: dict) -> list[dict]:
    parts = [part for part in description.values() if isinstance(part, dict)]
    return [part["shape"] for part in parts if part["type"] == "instance"]


def _mesh_size(shape: dict) -> float:
    """The longest side of a mesh's box in the world, or of all in the group of an instance; 0 for other objects."""
    if shape["type"] == "instance":
        linear = shape.get("to_world", np.eye(4))[:3, :3]
        sizes = [_mesh_size(part) for part in shape["shape"].values() if isinstance(part, dict)]
        return max(sizes, default=0.0) * float(np.cbrt(abs(np.linalg.det(linear))))
    if shape["type"] != "mesh":
        return 0.0
    vertices = used_vertices(shape["vertices"], shape["faces"])
    return float(np.ptp(transform_points(shape.get("to_world", np.eye(4)), vertices), axis=0).max())
