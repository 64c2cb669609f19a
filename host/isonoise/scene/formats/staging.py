"""Completes the scene of a model: a camera that frames it, and lights if it has none. Called by `load`."""

import math

import numpy as np

from isonoise.errors import SceneError
from isonoise.scene import transforms
from isonoise.scene.mesh.mesh import used_vertices

_IMAGE_SIZE = 512
_FOV_DEGREES = 35.0
_CAMERA_DIRECTION = (0.55, 0.4, 1.0)  # from the mesh to the camera: three-quarter view from above, y up
_KEY_LIGHT_DIRECTION = (-0.6, 1.0, 0.5)  # from the mesh to the key light
_MARGIN = 1.05
_MAX_DEPTH, _SAMPLE_COUNT = 8, 64


def stage(scene: dict, file: str) -> dict:
    """The scene with what it lacks: integrator, sensor, lights. `file` names it in errors."""
    meshes = [shape for shape in scene.values() if isinstance(shape, dict) and shape["type"] == "mesh"]
    points = np.concatenate([used_vertices(mesh["vertices"], mesh["faces"]) for mesh in meshes])
    low, high = points.min(axis=0), points.max(axis=0)
    with np.errstate(over="ignore"):
        radius = 0.5 * float(np.linalg.norm(high - low))
    if not (math.isfinite(radius) and radius > 0):
        raise SceneError(f"{file}: the mesh has no extent")
    center = 0.5 * (low + high)
    staged = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": _MAX_DEPTH},
        "sensor": _sensor(points - center, center, radius),
        **scene,
    }
    if not any("emitter" in mesh for mesh in meshes):
        staged["environment"] = {"type": "constant", "radiance": 0.25}
        staged["key_light"] = _key_light(center, radius)
    return staged


def _sensor(points: np.ndarray, center: np.ndarray, radius: float) -> dict:
    """A camera with a square image, at the smallest distance from which every point is visible, plus a margin.

    `points` are relative to `center`.
    """
    to_camera = np.array(_CAMERA_DIRECTION) / np.linalg.norm(_CAMERA_DIRECTION)
    axes = transforms.look_at(to_camera, (0, 0, 0), (0, 1, 0))[:3, :3]
    left, up, forward = np.einsum("ij,jk->ki", points, axes)
    half_extent = np.maximum(np.abs(left), np.abs(up))
    distance = float((half_extent * _MARGIN / math.tan(math.radians(_FOV_DEGREES / 2)) - forward).max())
    distance = max(distance, 1.5 * radius)
    return {
        "type": "perspective",
        "fov": _FOV_DEGREES,
        "near_clip": 1e-3 * radius,
        "far_clip": 1e3 * radius,
        "to_world": transforms.look_at(center + distance * to_camera, center, (0, 1, 0)),
        "film": {"type": "hdrfilm", "width": _IMAGE_SIZE, "height": _IMAGE_SIZE, "rfilter": {"type": "gaussian"}},
        "sampler": {"type": "multijitter", "sample_count": _SAMPLE_COUNT},
    }


def _key_light(center: np.ndarray, radius: float) -> dict:
    """A soft square light above and to the left, outside the image, facing the mesh."""
    direction = np.array(_KEY_LIGHT_DIRECTION) / np.linalg.norm(_KEY_LIGHT_DIRECTION)
    to_world = transforms.look_at(center + 4.0 * radius * direction, center, (0, 0, 1))
    return {
        "type": "rectangle",
        "to_world": to_world @ transforms.scale(1.2 * radius),
        "bsdf": {"type": "diffuse", "reflectance": 0.0},
        "emitter": {"type": "area", "radiance": 8.0},
    }
