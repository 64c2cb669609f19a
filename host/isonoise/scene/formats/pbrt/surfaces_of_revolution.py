"""pbrt's quadrics: Mitsuba's analytic shapes where they are whole, otherwise fine meshes. Called by `shapes.py`."""

import math

import numpy as np

from isonoise.scene import transforms
from isonoise.scene.formats.pbrt.parameters import Parameters
from isonoise.scene.formats.report import ImportReport
from isonoise.scene.mesh.mesh import Mesh

QUADRICS = ("sphere", "disk", "cylinder", "cone", "paraboloid")
_SEGMENTS = 256  # of a full turn
_PROFILE_POINTS = 129  # of a curved profile
_FULL_TURN_DEGREES = 360.0
_MAX_STRETCH = 1e-4  # relative deviation from a uniform scale


class Quadric:
    """A quadric of pbrt: a profile curve that turns about the z axis by `phi_max`."""

    def __init__(self, kind: str, parameters: Parameters):
        self.kind = kind
        self.radius = parameters.number("radius", 1.0)
        if not 0 < self.radius < 1e18:
            parameters.position_of("radius").raise_error(
                f"the radius has to be above 0 and below 1e18, got {self.radius:g}"
            )
        self.phi_max = math.radians(min(max(parameters.number("phimax", _FULL_TURN_DEGREES), 0.0), _FULL_TURN_DEGREES))
        self.height = parameters.number("height", 1.0 if kind == "cone" else 0.0) if kind in ("disk", "cone") else 0.0
        self.inner_radius = parameters.number("innerradius", 0.0) if kind == "disk" else 0.0
        low, high = {"sphere": (-self.radius, self.radius), "cylinder": (-1.0, 1.0)}.get(kind, (0.0, 1.0))
        self.z_min, self.z_max = low, high
        if kind in ("sphere", "cylinder", "paraboloid"):
            ends = parameters.number("zmin", low), parameters.number("zmax", high)
            self.z_min, self.z_max = min(ends), max(ends)
        if kind == "sphere":
            self.z_min, self.z_max = (min(max(z, low), high) for z in (self.z_min, self.z_max))
        if kind == "paraboloid":
            self.z_min = max(self.z_min, 0.0)
        is_flat = self.z_min == self.z_max or (kind == "disk" and not 0 <= self.inner_radius < self.radius)
        if is_flat or not self.phi_max or (kind == "cone" and self.height <= 0):
            parameters.position.raise_error(f"this {kind} has no area")

    @property
    def is_whole(self) -> bool:
        """Whether it is one of Mitsuba's shapes: nothing is cut off."""
        if self.phi_max < math.radians(_FULL_TURN_DEGREES) or self.kind in ("cone", "paraboloid"):
            return False
        if self.kind == "sphere":
            return self.z_max - self.z_min >= 2 * self.radius
        return self.inner_radius == 0

    def analytic_shape(self, to_world: np.ndarray, flip_normals: bool) -> dict:
        """The scene dict of a whole one, without its material."""
        shape = {"type": self.kind, "to_world": to_world, "flip_normals": flip_normals}
        if self.kind == "sphere":  # Mitsuba turns the normals of mirrored spheres inwards
            return shape | {"radius": self.radius, "flip_normals": flip_normals != is_mirroring(to_world)}
        if self.kind == "cylinder":
            return shape | {"p0": (0.0, 0.0, self.z_min), "p1": (0.0, 0.0, self.z_max), "radius": self.radius}
        local = transforms.translate((0.0, 0.0, self.height)) @ transforms.scale((self.radius, self.radius, 1.0))
        return shape | {"to_world": to_world @ local}

    def area(self, to_world: np.ndarray) -> float:
        """Area of a whole one, under a transform that scales uniformly."""
        scale = abs(np.linalg.det(to_world[:3, :3])) ** (2 / 3)
        if self.kind == "sphere":
            return 4 * math.pi * self.radius**2 * scale
        if self.kind == "cylinder":
            return 2 * math.pi * self.radius * (self.z_max - self.z_min) * scale
        return math.pi * self.radius**2 * scale

    def mesh(self) -> Mesh:
        """Triangles in object space; u is the angle, v goes along the profile, as in pbrt."""
        profile, normals = self._profile()
        turns = np.linspace(0.0, self.phi_max, 1 + math.ceil(_SEGMENTS * self.phi_max / (2 * math.pi)))
        circle = np.stack([np.cos(turns), np.sin(turns)], axis=1)
        rows, columns = len(profile), len(turns)

        def revolve(radial_and_z: np.ndarray) -> np.ndarray:
            points = np.empty((rows, columns, 3))
            points[..., :2] = radial_and_z[:, None, :1] * circle
            points[..., 2] = radial_and_z[:, 1:]
            return points.reshape(-1, 3)

        u, v = np.meshgrid(np.linspace(0, 1, columns), np.linspace(0, 1, rows))
        uvs = np.stack([u, 1 - v], axis=2).reshape(-1, 2).astype(np.float32)
        return Mesh(revolve(profile), grid_faces(rows, columns), revolve(normals), uvs)

    def _profile(self) -> tuple[np.ndarray, np.ndarray]:
        """(distance from the axis, z) of points in the order of v, and their normals, both (n, 2)."""
        t = np.linspace(0.0, 1.0, _PROFILE_POINTS if self.kind in ("sphere", "paraboloid") else 2)
        if self.kind == "sphere":
            theta = np.arccos(np.clip([self.z_min / self.radius, self.z_max / self.radius], -1, 1))
            angles = theta[0] + t * (theta[1] - theta[0])
            normals = np.stack([np.sin(angles), np.cos(angles)], axis=1)
            return self.radius * normals, normals
        if self.kind == "cylinder":
            z = self.z_min + t * (self.z_max - self.z_min)
            return np.stack([np.full_like(z, self.radius), z], axis=1), np.tile((1.0, 0.0), (len(t), 1))
        if self.kind == "cone":
            normal = np.array([self.height, self.radius]) / math.hypot(self.height, self.radius)
            points = np.stack([self.radius * (1 - t), self.height * t], axis=1)
            return points, np.tile(normal, (len(t), 1))
        if self.kind == "paraboloid":
            z = self.z_min + t * (self.z_max - self.z_min)
            radial = self.radius * np.sqrt(z / self.z_max)
            normals = np.stack([2 * radial * self.z_max, np.full_like(z, -(self.radius**2))], axis=1)
            return np.stack([radial, z], axis=1), normals / np.linalg.norm(normals, axis=1)[:, None]
        radial = self.radius + t * (self.inner_radius - self.radius)
        return np.stack([radial, np.full_like(t, self.height)], axis=1), np.tile((0.0, 1.0), (len(t), 1))


def grid_faces(rows: int, columns: int) -> np.ndarray:
    """Two triangles (n, 3) for each cell of a grid of vertices; counter-clockwise with columns as x, rows as y."""
    first = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    return np.concatenate(
        [
            np.stack([first, first + 1, first + columns + 1], axis=1),
            np.stack([first, first + columns + 1, first + columns], axis=1),
        ]
    )


def scales_uniformly(to_world: np.ndarray) -> bool:
    """Whether a transform only rotates, mirrors, translates and scales by one factor."""
    linear = to_world[:3, :3]
    gram = linear.T @ linear
    size = np.trace(gram) / 3
    return bool(np.abs(gram - size * np.eye(3)).max() <= _MAX_STRETCH * size)


def is_mirroring(to_world: np.ndarray) -> bool:
    """Whether a transform swaps left and right."""
    return bool(np.linalg.det(to_world[:3, :3]) < 0)


def report_mesh(quadric: Quadric, is_distorted: bool, parameters: Parameters, report: ImportReport) -> None:
    """Say that a quadric becomes a mesh, and why."""
    is_always_a_mesh = quadric.kind in ("cone", "paraboloid")
    why = "" if is_always_a_mesh else "non-uniformly scaled " if is_distorted else "partial or textured "
    report.limit("quadrics", f"{why}{quadric.kind}s become fine meshes", parameters.position.place)
