"""Bounds on what lights emit: where they and their normals are, how far from these light leaves, and how much."""

from dataclasses import dataclass

import numpy as np

from isonoise.scene import structs
from isonoise.scene.accel.bounds import analytic_extents
from isonoise.scene.accel.ploc import BinaryTree
from isonoise.scene.compiled_scene import CompiledScene
from isonoise.scene.light.lights import bounding_radius, spot_solid_angle

_FAR = 16.0
"""Radii of the scene between its middle and where lights of one direction seem to stand."""


@dataclass
class LightBounds:
    """Of n lights, or nodes of a tree over them. float64 of shape (3, n) up to the axis, then (n,)."""

    lower: np.ndarray
    upper: np.ndarray
    axis: np.ndarray
    spread: np.ndarray  # half the angle of the cone of normals
    edge: np.ndarray  # angle to a normal up to which light leaves, pi / 2 at most
    intensity: np.ndarray
    radius: np.ndarray  # around the middle of the box

    def __setitem__(self, which, other: "LightBounds") -> None:
        for name, values in vars(self).items():
            values[..., which] = getattr(other, name)

    def __getitem__(self, which) -> "LightBounds":
        return LightBounds(*(values[..., which] for values in vars(self).values()))


def compute_light_bounds(scene: CompiledScene, lights: np.ndarray) -> LightBounds:
    """Bounds of lights.

    What is at infinity stands around the scene, with an intensity that makes its irradiance right: a direction as a
    small sphere far away, the sky as one around it all.
    """
    n, kind = len(lights), lights["kind"]
    position = lights["position"].T.astype(np.float64)
    axis = np.tile([[0.0], [0.0], [1.0]], n)
    all_around = np.full(n, np.pi)
    power = lights["selection_pmf"].astype(np.float64)
    made = LightBounds(
        position, position.copy(), axis, all_around, np.full(n, np.pi / 2), power / (4 * np.pi), np.zeros(n)
    )
    is_triangle = kind == structs.LIGHT_TRIANGLE
    if is_triangle.any():
        made[is_triangle] = _triangles(scene, lights["primitive"][is_triangle], power[is_triangle])
    spot = kind == structs.LIGHT_SPOT
    if spot.any():
        cutoff = lights["cutoff"][spot].astype(np.float64)
        made.axis[:, spot] = lights["axis"][spot].T
        made.spread[spot] = np.maximum(cutoff - np.pi / 2, 0)
        made.edge[spot] = np.minimum(cutoff, np.pi / 2)
        made.intensity[spot] = power[spot] / spot_solid_angle(lights[spot])
    analytic = np.isin(kind, (structs.LIGHT_SPHERE, structs.LIGHT_DISK, structs.LIGHT_CYLINDER))
    if analytic.any():
        records = scene.analytics[lights["primitive"][analytic]]
        lower, upper = analytic_extents(records)
        made.lower[:, analytic], made.upper[:, analytic] = lower.T, upper.T
        is_sphere = records["kind"] == structs.ANALYTIC_SPHERE
        made.radius[analytic] = np.where(is_sphere, records["radius"], 0.5 * np.linalg.norm(upper - lower, axis=1))
        made.intensity[kind == structs.LIGHT_CYLINDER] *= 4 / np.pi  # 2 r h of the area 2 pi r h is seen from the side
        disk = kind == structs.LIGHT_DISK
        records = scene.analytics[lights["primitive"][disk]]
        flipped = scene.shapes["flags"][records["shape"]] & structs.SHAPE_FLIP_NORMALS
        made.axis[:, disk] = np.where(flipped, -1.0, 1.0) * _unit(records["to_object"].reshape(-1, 3, 4)[:, 2, :3].T)
        made.spread[disk] = 0.0
        made.intensity[disk] *= 4
    middle, reach = scene.bounds.astype(np.float64).mean(axis=0)[:, None], bounding_radius(scene.bounds)
    sun = kind == structs.LIGHT_DIRECTIONAL
    made.lower[:, sun] = middle - _FAR * reach * lights["position"][sun].T
    made.radius[sun] = reach  # within which its direction differs from the true one
    made.intensity[sun] = power[sun] / np.pi * _FAR**2
    sky = np.isin(kind, (structs.LIGHT_CONSTANT, structs.LIGHT_ENVIRONMENT_MAP))
    made.lower[:, sky] = middle
    made.radius[sky] = 4 * reach  # all of the scene is less than half of it away: kernels/light/light_tree.h
    made.intensity[sky] = power[sky] / np.pi
    around = sun | sky
    made.upper[:, around] = made.lower[:, around] + made.radius[around]
    made.lower[:, around] -= made.radius[around]
    return made


def _triangles(scene: CompiledScene, triangles: np.ndarray, power: np.ndarray) -> LightBounds:
    """Bounds of triangles that shine: their normals are those by which they are shaded.

    Boxes and spheres stand around their centroids: the tight boxes of two that make a rectangle are the same.
    """
    faces = scene.faces[triangles]
    a, b, c = corners = scene.vertices[faces].astype(np.float64).transpose(1, 2, 0)
    centroid = corners.mean(axis=0)
    half, radius = np.abs(corners - centroid).max(axis=0), np.linalg.norm(corners - centroid, axis=1).max(axis=0)
    axis, spread = _unit(np.cross(b - a, c - a, axis=0)), np.zeros(len(triangles))
    smooth = scene.shapes["flags"][scene.triangle_shape[triangles]] & structs.SHAPE_VERTEX_NORMALS != 0
    if smooth.any():
        normals = scene.vertex_normals[faces[smooth]].astype(np.float64).transpose(1, 2, 0)
        middle = _unit(normals.sum(axis=0))
        angle = np.arccos(np.clip((normals * middle).sum(axis=1), -1, 1)).max(axis=0)
        axis[:, smooth] = middle
        spread[smooth] = np.where(angle < np.pi / 2, angle + 1e-6, np.pi)  # what lies between normals is no farther
    edge = np.full(len(triangles), np.pi / 2)
    return LightBounds(centroid - half, centroid + half, axis, spread, edge, power / np.pi, radius)


def _unit(v: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(v, axis=0)
    return np.divide(v, length, out=np.zeros_like(v, np.float64), where=length > 0)


def joined(tree: BinaryTree, leaves: LightBounds) -> LightBounds:
    """Bounds of all nodes of a binary tree."""
    count = len(tree.left)
    bounds = LightBounds(*(np.zeros((*values.shape[:-1], count)) for values in vars(leaves).values()))
    bounds[: tree.leaf_count] = leaves
    for begin, end in tree.rounds():
        a, b = bounds[tree.left[begin:end]], bounds[tree.right[begin:end]]
        lower, upper = np.minimum(a.lower, b.lower), np.maximum(a.upper, b.upper)
        axis, spread = _cone_around(a, b)
        edge, radius = np.maximum(a.edge, b.edge), 0.5 * np.linalg.norm(upper - lower, axis=0)
        bounds[begin:end] = LightBounds(lower, upper, axis, spread, edge, a.intensity + b.intensity, radius)
    return bounds


def _cone_around(a: LightBounds, b: LightBounds) -> tuple[np.ndarray, np.ndarray]:
    """Axis and half angle of the smallest cones around two (Conty Estevez and Kulla, algorithm 1)."""
    wider = a.spread >= b.spread
    axis, other = np.where(wider, a.axis, b.axis), np.where(wider, b.axis, a.axis)
    wide, narrow = np.maximum(a.spread, b.spread), np.minimum(a.spread, b.spread)
    between = 2 * np.arcsin(np.clip(0.5 * np.linalg.norm(axis - other, axis=0), 0, 1))
    spread = 0.5 * (wide + between + narrow)
    turned = spread - wide
    inside = turned <= 0
    middle = _unit(np.sin(between - turned) * axis + np.sin(turned) * other)
    opposite = ~inside & ~middle.any(axis=0)
    spread = np.where(inside, wide, np.where((spread >= np.pi) | opposite, np.pi, spread))
    return np.where(inside | opposite, axis, middle), spread
