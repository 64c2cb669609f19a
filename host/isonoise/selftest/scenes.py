"""Pieces of the scenes that the cases render, in Mitsuba 3's vocabulary."""

import numpy as np


def rgb(value) -> dict:
    """A colour of one number or three."""
    return {"type": "rgb", "value": [float(v) for v in np.broadcast_to(value, 3)]}


def diffuse(albedo) -> dict:
    return {"type": "diffuse", "reflectance": rgb(albedo)}


def area(radiance, albedo=0.0) -> dict:
    """What makes a shape a light."""
    return {"bsdf": diffuse(albedo), "emitter": {"type": "area", "radiance": rgb(radiance)}}


def placed(scale=1.0, offset=(0.0, 0.0, 0.0), x_angle: float = 0.0) -> np.ndarray:
    """Scale, then rotate about x (degrees), then translate."""
    c, s = np.cos(np.deg2rad(x_angle)), np.sin(np.deg2rad(x_angle))
    matrix = np.eye(4)
    matrix[:3, :3] = np.array([[1, 0, 0], [0, c, -s], [0, s, c]]) * np.broadcast_to(scale, 3)
    matrix[:3, 3] = offset
    return matrix


def looking(origin, target) -> np.ndarray:
    """Camera-to-world matrix without roll: up is +z, or +y where it looks along z."""
    origin, target = np.array(origin, float), np.array(target, float)
    ahead = (target - origin) / np.linalg.norm(target - origin)
    up = np.array([0.0, 1.0, 0.0]) if abs(ahead[2]) > 0.999 else np.array([0.0, 0.0, 1.0])
    left = np.cross(up, ahead)
    left /= np.linalg.norm(left)
    matrix = np.eye(4)
    matrix[:3] = np.stack([left, np.cross(ahead, left), ahead, origin], axis=1)
    return matrix


def average(camera: np.ndarray, fov: float, radiance) -> float:
    """Mean over a square image of a radiance that is a function of the point (..., 3) seen in the plane z = 0.

    Gauss and Legendre's quadrature of 16 x 16 nodes, in float64.
    """
    x, w = np.polynomial.legendre.leggauss(16)
    plane = x * np.tan(np.deg2rad(fov) / 2)
    local = np.stack(np.broadcast_arrays(plane[:, None], plane[None, :], 1.0), axis=-1)
    directions, origin = local @ camera[:3, :3].T, camera[:3, 3]
    points = origin - directions * (origin[2] / directions[..., 2:])
    return float(w @ radiance(points) @ w) / 4


def scene(
    camera: np.ndarray, side: int, max_depth: int, fov: float = 40.0, sensor: dict | None = None, **objects
) -> dict:
    """A scene of `side` x `side` pixels, without roulette. `sensor`: parameters of the camera in place of these."""
    film = {"type": "hdrfilm", "width": side, "height": side, "rfilter": {"type": "box"}}
    perspective = {"type": "perspective", "fov": fov, "near_clip": 1e-4, "far_clip": 1e30}
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": max_depth, "rr_depth": 1_000_000},
        "sensor": perspective | {"to_world": camera, "film": film} | (sensor or {}),
        **objects,
    }


def lamp_over_floor(factor: float) -> dict:
    """Soft light, noise and a black background; the lamp's radiance is `factor` times (5, 4, 3)."""
    lamp = placed((0.3, 0.3, 1.0), (0.4, 0.2, 1.0), 180)
    radiance = factor * np.array([5.0, 4.0, 3.0])
    return scene(
        looking((0.0, -3.0, 2.4), (0.0, 0.0, 0.0)),
        24,
        4,
        floor={"type": "rectangle", "bsdf": diffuse(0.6)},
        lamp={"type": "rectangle", "to_world": lamp} | area(radiance),
    )
