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
    thickness: np.ndarray | None = None  # (n,): largest distance from the plane through the center across the axis

    def __post_init__(self):
        if self.thickness is None:
            self.thickness = self.radius.copy()

    @property
    def center(self) -> np.ndarray:
        return 0.5 * (self.lower + self.upper)

    def padded_radius(self) -> np.ndarray:
        """The radius, padded by the rounding of the center to float32."""
        return self.radius + self._padding()

    def padded_emission_radius(self) -> np.ndarray:
        """How far points of the lights reach along any normal in the cone: the radius, less if the lights are flat."""
        across = self.thickness + np.sin(np.minimum(self.spread, np.pi / 2)) * self.radius
        return np.minimum(across, self.radius) + self._padding()

    def _padding(self) -> np.ndarray:
        return 2.0**-22 * np.abs(self.center).max(axis=0)

    def __setitem__(self, index, other: "LightBounds") -> None:
        for name, values in vars(self).items():
            values[..., index] = getattr(other, name)

    def __getitem__(self, index) -> "LightBounds":
        return LightBounds(*(values[..., index] for values in vars(self).values()))


def bounding_radius(bounds: np.ndarray) -> float:
    """Radius of the sphere around a box (2, 3); 1 if it is a point."""
    return 0.5 * float(np.linalg.norm(bounds[1] - bounds[0])) or 1.0


def spot_solid_angle(spots: np.ndarray) -> np.ndarray:
    """Solid angle (n,) float64 that has the power of spots of intensity 1: the mean of that of the beam and all."""
    cutoff = spots["cutoff"].astype(np.float64)
    beam = cutoff - 1.0 / spots["inverse_transition"]
    return 2.0 * np.pi * (1.0 - 0.5 * (np.cos(beam) + np.cos(cutoff)))


def _omnidirectional(lower: np.ndarray, upper: np.ndarray, radius: np.ndarray, intensity: np.ndarray) -> LightBounds:
    """Bounds of lights within boxes (3, n) that emit in all directions."""
    count = lower.shape[1]
    axis = np.tile([[0.0], [0.0], [1.0]], count)
    return LightBounds(lower, upper, axis, np.full(count, np.pi), np.full(count, np.pi / 2), intensity, radius)


def point_bounds(scene: CompiledScene, lights: np.ndarray, power: np.ndarray) -> LightBounds:
    """Bounds of lights that emit from a point in all directions."""
    position = lights["position"].T.astype(np.float64)
    return _omnidirectional(position, position.copy(), np.zeros(len(lights)), power / (4 * np.pi))


def spot_bounds(scene: CompiledScene, lights: np.ndarray, power: np.ndarray) -> LightBounds:
    """Bounds of spot lights: their cone takes the place of the cone of normals."""
    bounds = point_bounds(scene, lights, power)
    cutoff = lights["cutoff"].astype(np.float64)
    bounds.axis = lights["axis"].T.astype(np.float64)
    bounds.spread = np.maximum(cutoff - np.pi / 2, 0)
    bounds.edge = np.minimum(cutoff, np.pi / 2)
    bounds.intensity = power / spot_solid_angle(lights)
    return bounds


def _sphere_at(center: np.ndarray, radius: np.ndarray, intensity: np.ndarray) -> LightBounds:
    return _omnidirectional(center - radius, center + radius, radius, intensity)


def directional_bounds(scene: CompiledScene, lights: np.ndarray, power: np.ndarray) -> LightBounds:
    """Bounds of directional lights: small spheres far away, with an intensity that gives the right irradiance."""
    center, scene_radius = scene.bounds.astype(np.float64).mean(axis=0)[:, None], bounding_radius(scene.bounds)
    position = center - _DIRECTIONAL_DISTANCE * scene_radius * lights["position"].T
    # the direction to it differs from the true one by as much as the radius
    return _sphere_at(position, np.full(len(lights), scene_radius), power / np.pi * _DIRECTIONAL_DISTANCE**2)


def environment_bounds(scene: CompiledScene, lights: np.ndarray, power: np.ndarray) -> LightBounds:
    """Bounds of environment lights: a sphere around the scene, with an intensity that gives the right irradiance."""
    center, scene_radius = scene.bounds.astype(np.float64).mean(axis=0)[:, None], bounding_radius(scene.bounds)
    # the whole scene is within half of it: kernels/light/light_tree.h
    radius = np.full(len(lights), 4 * scene_radius)
    return _sphere_at(np.tile(center, len(lights)), radius, power / np.pi)


def _analytic_bounds(scene: CompiledScene, lights: np.ndarray, power: np.ndarray) -> LightBounds:
    lower, upper = analytic_extents(scene.analytics[lights["primitive"]])
    radius = 0.5 * np.linalg.norm(upper - lower, axis=1)
    return _omnidirectional(lower.T.astype(np.float64), upper.T.astype(np.float64), radius, power / (4 * np.pi))


def sphere_bounds(scene: CompiledScene, lights: np.ndarray, power: np.ndarray) -> LightBounds:
    """Bounds of emissive spheres."""
    bounds = _analytic_bounds(scene, lights, power)
    bounds.radius = scene.analytics["radius"][lights["primitive"]].astype(np.float64)
    return bounds


def cylinder_bounds(scene: CompiledScene, lights: np.ndarray, power: np.ndarray) -> LightBounds:
    """Bounds of emissive cylinders: from the side, 2 r h of the area 2 pi r h is visible."""
    bounds = _analytic_bounds(scene, lights, power)
    bounds.intensity *= 4 / np.pi
    return bounds


def disk_bounds(scene: CompiledScene, lights: np.ndarray, power: np.ndarray) -> LightBounds:
    """Bounds of emissive disks, which have one normal."""
    bounds = _analytic_bounds(scene, lights, power)
    records = scene.analytics[lights["primitive"]]
    is_flipped = scene.shapes["flags"][records["shape"]] & structs.SHAPE_FLIP_NORMALS
    bounds.axis = np.where(is_flipped, -1.0, 1.0) * _unit(records["to_object"].reshape(-1, 3, 4)[:, 2, :3].T)
    bounds.spread, bounds.thickness = np.zeros(len(lights)), np.zeros(len(lights))
    bounds.intensity *= 4
    return bounds


def triangle_bounds(scene: CompiledScene, lights: np.ndarray, power: np.ndarray) -> LightBounds:
    """Bounds of emissive triangles."""
    return _mesh_bounds(scene, lights, scene.faces[lights["primitive"]], power)


def parallelogram_bounds(scene: CompiledScene, lights: np.ndarray, power: np.ndarray) -> LightBounds:
    """Bounds of emissive parallelograms. The corners on the diagonal are there twice; the mean is still the center."""
    first = lights["primitive"]
    return _mesh_bounds(scene, lights, np.hstack([scene.faces[first], scene.faces[first + 1]]), power)


def _mesh_bounds(scene: CompiledScene, lights: np.ndarray, vertices: np.ndarray, power: np.ndarray) -> LightBounds:
    """Bounds of flat lights with the corners `vertices` (n, k). Their normals are the shading normals.

    Boxes and spheres are centered at the centroids, because the tight boxes of two triangles that form a rectangle are
    equal.
    """
    corners = scene.vertices[vertices].astype(np.float64).transpose(1, 2, 0)
    centroid = corners.mean(axis=0)
    half, radius = np.abs(corners - centroid).max(axis=0), np.linalg.norm(corners - centroid, axis=1).max(axis=0)
    axis, spread = _unit(np.cross(corners[1] - corners[0], corners[2] - corners[0], axis=0)), np.zeros(len(lights))
    flags = scene.shapes["flags"][scene.triangle_shape[lights["primitive"]]]
    is_smooth = flags & structs.SHAPE_VERTEX_NORMALS != 0
    if is_smooth.any():
        normals = scene.vertex_normals[vertices[is_smooth]].astype(np.float64).transpose(1, 2, 0)
        mean_normal = _unit(normals.sum(axis=0))
        angle = np.arccos(np.clip((normals * mean_normal).sum(axis=1), -1, 1)).max(axis=0)
        axis[:, is_smooth] = mean_normal
        # within a hemisphere, interpolated normals stay in the cone around the vertex normals
        spread[is_smooth] = np.where(angle < np.pi / 2, angle + 1e-6, np.pi)
    edge = np.full(len(lights), np.pi / 2)
    thickness = np.abs(((corners - centroid) * axis).sum(axis=1)).max(axis=0)
    return LightBounds(centroid - half, centroid + half, axis, spread, edge, power / np.pi, radius, thickness)


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
        merged = LightBounds(lower, upper, axis, spread, edge, a.intensity + b.intensity, radius)
        merged.thickness = np.minimum(radius, np.maximum(_thickness_across(merged, a), _thickness_across(merged, b)))
        bounds[begin:end] = merged
    return bounds


def _thickness_across(parent: LightBounds, child: LightBounds) -> np.ndarray:
    """Largest distance (n,) of the lights of a child from the parent's plane."""
    offset = np.abs((parent.axis * (child.center - parent.center)).sum(axis=0))
    tilt = np.linalg.norm(np.cross(parent.axis, child.axis, axis=0), axis=0)
    return offset + np.minimum(child.thickness + tilt * child.radius, child.radius)


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
