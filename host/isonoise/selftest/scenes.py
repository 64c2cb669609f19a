"""Builds the small scenes that the checks and some tests render, in Mitsuba 3's vocabulary."""

import numpy as np


def rgb(value) -> dict:
    """Returns a colour of one number or three."""
    return {"type": "rgb", "value": [float(v) for v in np.broadcast_to(value, 3)]}


def diffuse(albedo) -> dict:
    return {"type": "diffuse", "reflectance": rgb(albedo)}


def area_light(radiance, albedo=0.0) -> dict:
    """Returns the emitter and the bsdf of a shape that is a light."""
    return {"bsdf": diffuse(albedo), "emitter": {"type": "area", "radiance": rgb(radiance)}}


def transform(scale=1.0, translation=(0.0, 0.0, 0.0), x_angle_deg: float = 0.0) -> np.ndarray:
    """Returns the 4x4 matrix that scales, then rotates about x, then translates."""
    c, s = np.cos(np.deg2rad(x_angle_deg)), np.sin(np.deg2rad(x_angle_deg))
    matrix = np.eye(4)
    matrix[:3, :3] = np.array([[1, 0, 0], [0, c, -s], [0, s, c]]) * np.broadcast_to(scale, 3)
    matrix[:3, 3] = translation
    return matrix


def look_at(origin, target) -> np.ndarray:
    """Returns a camera-to-world matrix without roll: up is +z, or +y if the camera looks along z."""
    origin, target = np.array(origin, float), np.array(target, float)
    forward = (target - origin) / np.linalg.norm(target - origin)
    up = np.array([0.0, 1.0, 0.0]) if abs(forward[2]) > 0.999 else np.array([0.0, 0.0, 1.0])
    left = np.cross(up, forward)
    left /= np.linalg.norm(left)
    matrix = np.eye(4)
    matrix[:3] = np.stack([left, np.cross(forward, left), forward, origin], axis=1)
    return matrix


def mean_over_floor(camera: np.ndarray, fov_deg: float, radiance) -> float:
    """Integrates over a square image a radiance that is a function of the point (..., 3) seen in the plane z = 0.

    Gauss-Legendre quadrature with 16 x 16 nodes, in float64.
    """
    x, w = np.polynomial.legendre.leggauss(16)
    plane = x * np.tan(np.deg2rad(fov_deg) / 2)
    local = np.stack(np.broadcast_arrays(plane[:, None], plane[None, :], 1.0), axis=-1)
    directions, origin = local @ camera[:3, :3].T, camera[:3, 3]
    points = origin - directions * (origin[2] / directions[..., 2:])
    return float(w @ radiance(points) @ w) / 4


def make_scene(
    camera: np.ndarray, side: int, max_depth: int, fov_deg: float = 40.0, sensor: dict | None = None, **objects
) -> dict:
    """Returns a scene of `side` x `side` pixels, box filter, no roulette. `sensor` overrides camera parameters."""
    film = {"type": "hdrfilm", "width": side, "height": side, "rfilter": {"type": "box"}}
    perspective = {"type": "perspective", "fov": fov_deg, "near_clip": 1e-4, "far_clip": 1e30}
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": max_depth, "rr_depth": 1_000_000},
        "sensor": perspective | {"to_world": camera, "film": film} | (sensor or {}),
        **objects,
    }
