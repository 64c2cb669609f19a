"""Shape groups, transforms and scenes with instances, for tests of instances."""

import numpy as np
import trimesh


def make_transform(scale=(1, 1, 1), offset=(0, 0, 0), seed: int | None = None) -> np.ndarray:
    """Scale, then random rotation if there is a seed, then translation."""
    matrix = np.diag([*np.broadcast_to(np.asarray(scale, float), 3), 1.0])
    if seed is not None:
        rotation, _ = np.linalg.qr(np.random.default_rng(seed).standard_normal((3, 3)))
        matrix[:3, :3] = rotation * np.sign(np.linalg.det(rotation)) @ matrix[:3, :3]
    matrix[:3, 3] = offset
    return matrix


def with_instances(group: dict, *matrices: np.ndarray, **more) -> dict:
    reference = {"type": "ref", "id": "group"}
    return {
        "type": "scene",
        "sensor": {"type": "perspective"},
        "group": {"type": "shapegroup", **group},
        **{f"at{i}": {"type": "instance", "to_world": m, "group": reference} for i, m in enumerate(matrices)},
        **more,
    }


def flattened(group: dict, *matrices: np.ndarray, **more) -> dict:
    return {
        "type": "scene",
        "sensor": {"type": "perspective"},
        **{
            f"{name}{i}": {**shape, "to_world": matrix @ shape.get("to_world", np.eye(4))}
            for name, shape in group.items()
            for i, matrix in enumerate(matrices)
        },
        **more,
    }


def icosphere(subdivisions: int = 3, smooth: bool = False) -> dict:
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions)
    return {
        "type": "mesh",
        "vertices": np.array(mesh.vertices),
        "faces": np.array(mesh.faces),
        "face_normals": not smooth,
    }


FLAT_SHAPES = {
    "box": {"type": "cube", "to_world": make_transform(0.4, (0.8, 0, 0), seed=1)},
    "plate": {"type": "disk", "to_world": make_transform((0.5, 0.7, 1), (-0.6, 0.5, 0.1), seed=2)},
    "wall": {"type": "rectangle", "to_world": make_transform(0.6, (0, -0.8, 0), seed=3)},
    "ball": {**icosphere(), "to_world": make_transform(0.3, (-0.2, 0.1, 0.9))},
}
ROUND_SHAPES = {
    "globe": {"type": "sphere", "to_world": make_transform(0.5, (0.6, 0.2, 0))},
    "tube": {"type": "cylinder", "radius": 0.3, "p1": (0.2, 0.4, 0.9)},
}
TRANSFORMS = {  # of a group with a radius of about 1.5
    "identity": make_transform(),
    "rotated": make_transform(seed=4),
    "far away": make_transform(1, (100, -50, 20), seed=5),
    "tiny": make_transform(1e-3, (3, 1, 2), seed=6),
    "huge": make_transform(1e3, (-200, 30, 100), seed=7),
    "non-uniform": make_transform((0.3, 1.0, 4.0), (1, 2, 3), seed=8),
    "mirrored": make_transform((-1, 1, 1), (1, 2, 3), seed=9),
    "non-uniform and mirrored": make_transform((2.0, -0.1, 1.0), (-1, 0, 0), seed=10),
    "sheared": np.array([[1.2, 0.3, 0, 1], [0, 0.7, 0.2, 2], [0.1, 0, 1.5, 3], [0, 0, 0, 1.0]]),
}
SIMILARITIES = ("identity", "rotated", "far away", "tiny", "huge", "mirrored")  # a sphere stays a sphere
