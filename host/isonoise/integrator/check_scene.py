"""Tiny scenes whose image has a closed form: a grey floor under one light. Called by `driver_check`."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from isonoise.scene.compile import compile_scene
from isonoise.scene.compiled_scene import CompiledScene
from isonoise.scene.image.image import Image
from isonoise.scene.light.envmap import build_environment_map
from isonoise.scene.light.light_kinds import light_bits
from isonoise.scene.load import load_description

SIDE = 64
"""Pixels per side of the image."""
_ALBEDO = 0.5
_FOV_DEG, _CAMERA_HEIGHT = 40.0, 0.5
_FLOOR_SIZE = 3.0  # half of it
_BLOCKER_HEIGHT, _BLOCKER_EDGE = 0.9, 0.27


def _rgb(value: float) -> dict:
    return {"type": "rgb", "value": [value] * 3}


_DIFFUSE = {"type": "diffuse", "reflectance": _rgb(_ALBEDO)}
_MIRROR = {"type": "conductor", "material": "none", "specular_reflectance": _rgb(_ALBEDO)}


@dataclass(frozen=True)
class CheckScene:
    """A light over the floor z = 0."""

    light: dict
    irradiance: Callable[[np.ndarray], np.ndarray]
    """Irradiance of the floor at points (..., 3), in float64."""
    is_map: bool = False
    """Whether the constant light is turned into an environment map."""
    is_mirror: bool = False
    """Whether the floor reflects like a mirror. Under a sky of one radiance it then has that of a diffuse floor."""
    has_blocker: bool = False
    """Whether a surface at the height `_BLOCKER_HEIGHT` keeps light off the floor where x > `_BLOCKER_EDGE`."""

    def image(self) -> np.ndarray:
        """The radiance at the centres of the pixels, (SIDE, SIDE)."""
        offsets = (2 * (np.arange(SIDE) + 0.5) / SIDE - 1) * np.tan(np.deg2rad(_FOV_DEG / 2)) * _CAMERA_HEIGHT
        x, y = np.meshgrid(offsets, -offsets)
        points = np.stack([x, y, np.zeros_like(x)], axis=-1)
        return _ALBEDO / np.pi * np.broadcast_to(self.irradiance(points), (SIDE, SIDE))

    def compile(self, grid_size: int, sampler: str, has_filter: bool, hide_emitters: bool) -> CompiledScene:
        """The scene as arrays.

        Parameters
        ----------
        grid_size : the floor has 2 `grid_size`^2 triangles
        has_filter : whether the pixel filter is no box
        """
        film = {"width": SIDE, "height": SIDE, "rfilter": {"type": "gaussian" if has_filter else "box"}}
        to_world = np.diag([-1.0, 1.0, -1.0, 1.0])  # looks down
        to_world[2, 3] = _CAMERA_HEIGHT
        description = {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 2, "rr_depth": 1_000_000, "hide_emitters": hide_emitters},
            "sensor": {
                "type": "perspective",
                "fov": _FOV_DEG,
                "to_world": to_world,
                "film": {"type": "hdrfilm", **film},
            },
            "floor": _floor(grid_size) | {"bsdf": _MIRROR if self.is_mirror else _DIFFUSE},
            "light": self.light,
        }
        if self.has_blocker:
            description["blocker"] = _rectangle(_BLOCKER_EDGE, _FLOOR_SIZE, _FLOOR_SIZE, _BLOCKER_HEIGHT)
        scene = compile_scene(load_description(description), sampler=sampler)
        return _with_environment_map(scene) if self.is_map else scene


def check_scenes() -> Iterator[CheckScene]:
    """All of them; they use different features."""
    radiance = {"emitter": {"type": "area", "radiance": _rgb(2.0)}}
    corners = np.array([(0.8, -0.4, 1.0), (-0.2, -0.4, 1.0), (-0.2, 0.6, 1.0), (0.8, 0.6, 1.0)])
    to_world = np.diag([0.5, 0.5, -1.0, 1.0])  # faces the floor
    to_world[:3, 3] = corners.mean(axis=0)
    lamp = {"type": "rectangle", "to_world": to_world, **radiance}
    yield CheckScene(lamp, lambda p: 2.0 * _form_factor(_unblocked(corners, p), p), has_blocker=True)
    triangle = _mesh(corners[:3], [(0, 1, 2)])
    yield CheckScene(triangle | radiance, lambda p: 2.0 * _form_factor(corners[:3], p))
    center, radius = np.array([0.3, 0.2, 1.5]), 0.25
    sphere = {"type": "sphere", "center": center.tolist(), "radius": radius, **radiance}
    yield CheckScene(sphere, lambda p: 2.0 * np.pi * radius**2 * _cosine_over_square(center - p))
    disk = {"type": "disk", "to_world": to_world, **radiance}
    yield CheckScene(disk, lambda p: 2.0 * np.pi * _disk_form_factor(corners.mean(axis=0), 0.5, p))
    point = {"type": "point", "position": center.tolist(), "intensity": _rgb(2.0)}
    yield CheckScene(point, lambda p: 2.0 * _cosine_over_square(center - p))
    turned = to_world.copy()
    turned[:3, :3], turned[:3, 3] = np.diag([1.0, -1.0, -1.0]), center  # shines down
    spot = {"type": "spot", "to_world": turned, "intensity": _rgb(2.0), "cutoff_angle": 60.0, "beam_width": 50.0}
    yield CheckScene(spot, lambda p: 2.0 * _cosine_over_square(center - p))
    direction = np.array([0.3, 0.2, -1.0])
    sun = {"type": "directional", "direction": direction.tolist(), "irradiance": _rgb(2.0)}
    yield CheckScene(sun, lambda p: 2.0 / np.linalg.norm(direction))
    sky = {"type": "constant", "radiance": _rgb(2.0)}
    yield CheckScene(sky, lambda p: 2.0 * np.pi)
    for is_map, is_mirror in ((True, False), (False, True), (True, True)):
        yield CheckScene(sky, lambda p: 2.0 * np.pi, is_map, is_mirror)


def _mesh(vertices: np.ndarray, faces: list[tuple[int, int, int]]) -> dict:
    return {"type": "mesh", "vertices": vertices, "faces": np.array(faces), "face_normals": True}


def _floor(grid_size: int) -> dict:
    """A square of 2 `grid_size`^2 triangles that face up."""
    edge = np.linspace(-_FLOOR_SIZE, _FLOOR_SIZE, grid_size + 1)
    x, y = np.meshgrid(edge, edge)
    vertices = np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3)
    row = grid_size + 1
    corners = [row * i + j for i in range(grid_size) for j in range(grid_size)]
    faces = [face for k in corners for face in ((k, k + 1, k + row + 1), (k, k + row + 1, k + row))]
    return _mesh(vertices, faces)


def _rectangle(x_min: float, x_max: float, y_max: float, z: float) -> dict:
    vertices = np.array([(x_min, -y_max, z), (x_max, -y_max, z), (x_max, y_max, z), (x_min, y_max, z)])
    return _mesh(vertices, [(0, 1, 2), (0, 2, 3)])


def _unblocked(corners: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Corners of what points (..., 3) of the floor see of a rectangle at z = 1, (..., corners, 3)."""
    x_max = (_BLOCKER_EDGE - (1 - _BLOCKER_HEIGHT) * points[..., :1]) / _BLOCKER_HEIGHT
    visible = np.broadcast_to(corners, (*points.shape[:-1], *corners.shape)).copy()
    visible[..., 0] = np.minimum(visible[..., 0], x_max)
    return visible


def _form_factor(corners: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Irradiance at points with the normal +z from a polygon of radiance 1 above them.

    Lambert's formula, as in Arvo, "Applications of Irradiance Tensors to the Simulation of Non-Lambertian Phenomena",
    1995, equation 1: half the sum over the edges of the angle times the component along the normal of the unit normal
    of the plane through edge and point.
    """
    directions = corners - points[..., None, :]
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    following = np.roll(directions, -1, axis=-2)
    angles = np.arccos(np.clip((directions * following).sum(axis=-1), -1.0, 1.0))
    normals = np.cross(directions, following)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    return np.abs(0.5 * (angles * normals[..., 2]).sum(axis=-1))


def _disk_form_factor(center: np.ndarray, radius: float, points: np.ndarray) -> np.ndarray:
    """Form factor from points with the normal +z to a disk above them that is parallel to the floor.

    Howell, "A Catalog of Radiation Configuration Factors", 1982.
    """
    aside, above, size = ((center - points)[..., :2] ** 2).sum(axis=-1), center[2] ** 2, radius**2
    return 0.5 * (1 - (above + aside - size) / np.sqrt((above + aside + size) ** 2 - 4 * aside * size))


def _cosine_over_square(to_light: np.ndarray) -> np.ndarray:
    return to_light[..., 2] / np.linalg.norm(to_light, axis=-1) ** 3


def _with_environment_map(scene: CompiledScene) -> CompiledScene:
    """The scene with a map of the radiance of its constant light in place of this light."""
    lights = scene.lights.copy()
    radiance = lights["radiance"][0, 0]
    lights["kind"] = light_bits("environment_map")
    pixels = np.full((3, 4, 3), radiance, np.float32)
    return replace(scene, lights=lights, environment=build_environment_map(Image(pixels), np.eye(4), 1.0, "the map"))
