"""Bounds of the emission of lights, from which the light list and the light tree compute selection probabilities.

The bounds are those of Conty Estevez and Kulla 2018: position (a box and a sphere), orientation (a cone of normals and
the largest angle between normal and emission), and intensity.
"""

from dataclasses import dataclass

import numpy as np

from isonoise.scene import structs
from isonoise.scene.accel.bounds import analytic_extents
from isonoise.scene.accel.ploc import BinaryTree
from isonoise.scene.compiled_scene import CompiledScene
from isonoise.scene.light.lights import bounding_radius, spot_solid_angle

_DIRECTIONAL_DISTANCE = 16.0
"""Distance of the sphere that stands for a directional light, in radii of the scene."""


@dataclass
class LightBounds:
    """Bounds of n lights, or of n nodes of a tree over them, in float64."""

    lower: np.ndarray  # (3, n)
    upper: np.ndarray  # (3, n)
    axis: np.ndarray  # (3, n): of the cone of normals
    spread: np.ndarray  # (n,): half the angle of that cone
    edge: np.ndarray  # (n,): largest angle between a normal and emitted light, pi / 2 at most
    intensity: np.ndarray  # (n,): upper bound, along the normals
    radius: np.ndarray  # (n,): of the sphere around the center of the box

    @property
    def center(self) -> np.ndarray:
        return 0.5 * (self.lower + self.upper)

    def padded_radius(self) -> np.ndarray:
        """The radius, padded by the rounding of the center to float32."""
        return self.radius + 2.0**-22 * np.abs(self.center).max(axis=0)

    def __setitem__(self, index, other: "LightBounds") -> None:
        for name, values in vars(self).items():
            values[..., index] = getattr(other, name)

    def __getitem__(self, index) -> "LightBounds":
        return LightBounds(*(values[..., index] for values in vars(self).values()))


def compute_light_bounds(scene: CompiledScene, lights: np.ndarray) -> LightBounds:
    """Bounds of structs.LIGHT records of the scene.

    Lights at infinity become spheres with the intensity that gives the correct irradiance: a directional light a small
    sphere far away, the environment a sphere around the scene.
    """
    n, kind = len(lights), lights["kind"]
    position = lights["position"].T.astype(np.float64)
    power = lights["selection_pmf"].astype(np.float64)
    # a point light
    bounds = LightBounds(
        lower=position,
        upper=position.copy(),
        axis=np.tile([[0.0], [0.0], [1.0]], n),
        spread=np.full(n, np.pi),
        edge=np.full(n, np.pi / 2),
        intensity=power / (4 * np.pi),
        radius=np.zeros(n),
    )
    is_triangle = kind == structs.LIGHT_TRIANGLE
    if is_triangle.any():
        bounds[is_triangle] = _bound_triangles(scene, lights["primitive"][is_triangle], power[is_triangle])
    is_spot = kind == structs.LIGHT_SPOT
    if is_spot.any():
        cutoff = lights["cutoff"][is_spot].astype(np.float64)
        bounds.axis[:, is_spot] = lights["axis"][is_spot].T
        bounds.spread[is_spot] = np.maximum(cutoff - np.pi / 2, 0)
        bounds.edge[is_spot] = np.minimum(cutoff, np.pi / 2)
        bounds.intensity[is_spot] = power[is_spot] / spot_solid_angle(lights[is_spot])
    if np.isin(kind, (structs.LIGHT_SPHERE, structs.LIGHT_DISK, structs.LIGHT_CYLINDER)).any():
        _bound_analytic_lights(scene, lights, bounds)
    _bound_distant_lights(scene, lights, power, bounds)
    return bounds


def _bound_triangles(scene: CompiledScene, triangles: np.ndarray, power: np.ndarray) -> LightBounds:
    """Bounds of emissive triangles. Their normals are the shading normals.

    Boxes and spheres are centered at the centroids, because the tight boxes of the two triangles of a rectangle are
    equal.
    """
    faces = scene.faces[triangles]
    a, b, c = corners = scene.vertices[faces].astype(np.float64).transpose(1, 2, 0)
    centroid = corners.mean(axis=0)
    half, radius = np.abs(corners - centroid).max(axis=0), np.linalg.norm(corners - centroid, axis=1).max(axis=0)
    axis, spread = _unit(np.cross(b - a, c - a, axis=0)), np.zeros(len(triangles))
    is_smooth = scene.shapes["flags"][scene.triangle_shape[triangles]] & structs.SHAPE_VERTEX_NORMALS != 0
    if is_smooth.any():
        normals = scene.vertex_normals[faces[is_smooth]].astype(np.float64).transpose(1, 2, 0)
        mean_normal = _unit(normals.sum(axis=0))
        angle = np.arccos(np.clip((normals * mean_normal).sum(axis=1), -1, 1)).max(axis=0)
        axis[:, is_smooth] = mean_normal
        # within a hemisphere, interpolated normals stay in the cone around the vertex normals
        spread[is_smooth] = np.where(angle < np.pi / 2, angle + 1e-6, np.pi)
    edge = np.full(len(triangles), np.pi / 2)
    return LightBounds(centroid - half, centroid + half, axis, spread, edge, power / np.pi, radius)


def _bound_analytic_lights(scene: CompiledScene, lights: np.ndarray, bounds: LightBounds) -> None:
    """Set the bounds of spheres, disks and cylinders."""
    kind = lights["kind"]
    is_analytic = np.isin(kind, (structs.LIGHT_SPHERE, structs.LIGHT_DISK, structs.LIGHT_CYLINDER))
    records = scene.analytics[lights["primitive"][is_analytic]]
    lower, upper = analytic_extents(records)
    bounds.lower[:, is_analytic], bounds.upper[:, is_analytic] = lower.T, upper.T
    is_sphere = records["kind"] == structs.ANALYTIC_SPHERE
    half_diagonal = 0.5 * np.linalg.norm(upper - lower, axis=1)
    bounds.radius[is_analytic] = np.where(is_sphere, records["radius"], half_diagonal)
    # of the area 2 pi r h of a cylinder, 2 r h is visible from the side
    bounds.intensity[kind == structs.LIGHT_CYLINDER] *= 4 / np.pi
    is_disk = kind == structs.LIGHT_DISK
    disks = scene.analytics[lights["primitive"][is_disk]]
    is_flipped = scene.shapes["flags"][disks["shape"]] & structs.SHAPE_FLIP_NORMALS
    normal = _unit(disks["to_object"].reshape(-1, 3, 4)[:, 2, :3].T)
    bounds.axis[:, is_disk] = np.where(is_flipped, -1.0, 1.0) * normal
    bounds.spread[is_disk] = 0.0
    bounds.intensity[is_disk] *= 4


def _bound_distant_lights(scene: CompiledScene, lights: np.ndarray, power: np.ndarray, bounds: LightBounds) -> None:
    """Set the bounds of directional lights and of the environment."""
    center = scene.bounds.astype(np.float64).mean(axis=0)[:, None]
    scene_radius = bounding_radius(scene.bounds)
    is_directional = lights["kind"] == structs.LIGHT_DIRECTIONAL
    bounds.lower[:, is_directional] = (
        center - _DIRECTIONAL_DISTANCE * scene_radius * lights["position"][is_directional].T
    )
    bounds.radius[is_directional] = scene_radius  # the direction to it differs from the true one by as much
    bounds.intensity[is_directional] = power[is_directional] / np.pi * _DIRECTIONAL_DISTANCE**2
    is_environment = np.isin(lights["kind"], (structs.LIGHT_CONSTANT, structs.LIGHT_ENVIRONMENT_MAP))
    bounds.lower[:, is_environment] = center
    # the whole scene is within half of it: see kernels/light/light_tree.h
    bounds.radius[is_environment] = 4 * scene_radius
    bounds.intensity[is_environment] = power[is_environment] / np.pi
    is_distant = is_directional | is_environment
    bounds.upper[:, is_distant] = bounds.lower[:, is_distant] + bounds.radius[is_distant]
    bounds.lower[:, is_distant] -= bounds.radius[is_distant]


def _unit(v: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(v, axis=0)
    return np.divide(v, length, out=np.zeros_like(v, np.float64), where=length > 0)


def bound_tree_nodes(tree: BinaryTree, leaves: LightBounds) -> LightBounds:
    """Bounds of all nodes of a binary tree over lights."""
    count = len(tree.left)
    bounds = LightBounds(*(np.zeros((*values.shape[:-1], count)) for values in vars(leaves).values()))
    bounds[: tree.leaf_count] = leaves
    for begin, end in tree.rounds():
        a, b = bounds[tree.left[begin:end]], bounds[tree.right[begin:end]]
        lower, upper = np.minimum(a.lower, b.lower), np.maximum(a.upper, b.upper)
        axis, spread = _cone_union(a, b)
        edge, radius = np.maximum(a.edge, b.edge), 0.5 * np.linalg.norm(upper - lower, axis=0)
        bounds[begin:end] = LightBounds(lower, upper, axis, spread, edge, a.intensity + b.intensity, radius)
    return bounds


def _cone_union(a: LightBounds, b: LightBounds) -> tuple[np.ndarray, np.ndarray]:
    """Axis and half angle of the smallest cone around two cones (Conty Estevez and Kulla, algorithm 1)."""
    a_is_wider = a.spread >= b.spread
    axis, other = np.where(a_is_wider, a.axis, b.axis), np.where(a_is_wider, b.axis, a.axis)
    wide, narrow = np.maximum(a.spread, b.spread), np.minimum(a.spread, b.spread)
    between = 2 * np.arcsin(np.clip(0.5 * np.linalg.norm(axis - other, axis=0), 0, 1))
    spread = 0.5 * (wide + between + narrow)
    rotation = spread - wide  # of the wide cone's axis towards the other one
    is_inside = rotation <= 0
    middle = _unit(np.sin(between - rotation) * axis + np.sin(rotation) * other)
    is_opposite = ~is_inside & ~middle.any(axis=0)
    spread = np.where(is_inside, wide, np.where((spread >= np.pi) | is_opposite, np.pi, spread))
    return np.where(is_inside | is_opposite, axis, middle), spread
