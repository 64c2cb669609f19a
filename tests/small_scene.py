"""Shared by tests of renders: one tiny scene, so that few programs are compiled, and checks of statistics."""

import numpy as np

from isonoise.statistics import Statistics

WIDTH, HEIGHT = 7, 5
PIXELS = WIDTH * HEIGHT
BUILT_IN = ["uniform", "pooled", "relative-median", "relative-mean"]


def lamp_over_floor(radiance: float = 5.0, width: int = WIDTH, height: int = HEIGHT, max_depth: int = 4) -> dict:
    """A small lamp above a floor: soft light, noise, a black background."""
    ahead = np.array([0.0, -2.4, -3.0]) / np.hypot(2.4, 3.0)
    camera = np.eye(4)
    camera[:3] = np.stack([(-1, 0, 0), np.cross(ahead, (-1, 0, 0)), ahead, (0, 2.4, 3)], axis=1)
    lamp = np.diag([0.3, 0.3, -1.0, 1.0])  # faces the floor
    lamp[:3, 3] = (0.4, 0.2, 1.0)
    emitter = {"type": "area", "radiance": {"type": "rgb", "value": [radiance, 0.8 * radiance, 0.6 * radiance]}}
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": max_depth, "rr_depth": 2},
        "sensor": {
            "type": "perspective",
            "fov": 50.0,
            "to_world": camera,
            "film": {"type": "hdrfilm", "width": width, "height": height, "rfilter": {"type": "box"}},
        },
        "floor": {"type": "rectangle", "bsdf": {"type": "diffuse", "reflectance": 0.6}},
        "lamp": {"type": "rectangle", "to_world": lamp, "emitter": emitter},
    }


def nested_triangles() -> dict:
    """`lamp_over_floor` with a BVH so deep that no form takes its smallest traversal stack."""
    corners = np.random.default_rng(9).uniform(-1, 1, (1, 3, 3)) * np.geomspace(1e-4, 1.0, 3000)[:, None, None]
    faces = np.arange(9000).reshape(-1, 3)
    mesh = {"type": "mesh", "vertices": corners.reshape(-1, 3), "faces": faces, "face_normals": True}
    return lamp_over_floor() | {"nested": {**mesh, "bsdf": {"type": "diffuse"}}}


def without(scene: dict, *names: str) -> dict:
    return {name: value for name, value in scene.items() if name not in names}


def assert_same_bits(a: Statistics, b: Statistics) -> None:
    for name in vars(a):
        plane, other = getattr(a, name), getattr(b, name)
        assert (plane is None) == (other is None), name
        if isinstance(plane, Statistics):
            assert_same_bits(plane, other)
        elif plane is not None:
            assert plane.dtype == other.dtype
            assert plane.tobytes() == other.tobytes(), f"{name} differs in {np.count_nonzero(plane != other)} values"


def assert_sound(statistics: Statistics) -> None:
    for name, plane in statistics.planes().items():
        # unknown where no neighbour has two samples
        assert np.isfinite(plane).all() or name == "neighbour_variance", name
        assert (plane >= 0).all(), name
