"""Scenes with lights of every kind, points among them, and a chi-square test of sampled lights."""

import numpy as np

from isonoise.scene import compile_scene, load_description


def four(v: np.ndarray, w: float) -> np.ndarray:
    return np.concatenate([v, np.full((len(v), 1), w)], axis=1).astype(np.float32)


def unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def _placed(rng, scale: float) -> np.ndarray:
    """Returns a random rotation, scale and translation."""
    matrix = np.eye(4)
    matrix[:3, :3] = np.linalg.qr(rng.normal(size=(3, 3)))[0] * scale * rng.uniform(0.3, 1.0)
    matrix[:3, 3] = rng.uniform(-4, 4, 3)
    return matrix


def mixed_lights(count: int = 60, seed: int = 5, beyond: bool = True) -> dict:
    """Returns lights of every kind at random positions, some dark, some smooth meshes."""
    rng = np.random.default_rng(seed)
    scene, kinds = {}, ("rectangle", "smooth", "sphere", "disk", "cylinder", "point", "spot", "flipped")
    for index in range(count):
        kind = kinds[index % len(kinds)]
        colour = {"type": "rgb", "value": (rng.lognormal(0, 1) * rng.uniform(0.2, 1.0, 3)).tolist()}
        matrix = _placed(rng, 0.5)
        shape = {"to_world": matrix, "emitter": {"type": "area", "radiance": colour}}
        if kind == "point":
            light = {"type": "point", "position": matrix[:3, 3], "intensity": colour}
        elif kind == "spot":
            rigid = matrix.copy()
            rigid[:3, :3] = np.linalg.qr(matrix[:3, :3])[0]
            light = {"type": "spot", "to_world": rigid, "intensity": colour, "cutoff_angle": float(rng.uniform(5, 60))}
        elif kind == "smooth":
            corners = rng.normal(size=(4, 3)) * 0.3 + matrix[:3, 3]
            light = {"type": "mesh", "vertices": corners, "faces": np.array([[0, 1, 2], [2, 1, 3]]), **shape}
            light.pop("to_world")
        elif kind in ("sphere", "flipped"):
            light = {"type": "sphere", "center": matrix[:3, 3], "radius": float(rng.uniform(0.05, 0.3)), **shape}
            light.pop("to_world")
            light["flip_normals"] = kind == "flipped"
        else:
            light = {"type": kind, **shape}
        scene[f"light{index}"] = light
    scene["dark"] = {"type": "disk", "emitter": {"type": "area", "radiance": 0.0}}
    if beyond:
        scene["sun"] = {"type": "directional", "direction": [0.3, -0.2, -1.0], "irradiance": 0.05}
        scene["sky"] = {"type": "constant", "radiance": 0.02}
    return scene


def compiled(**objects):
    return compile_scene(load_description({"type": "scene", "sensor": {"type": "perspective"}, **objects}))


def some_points(rng, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns points among the lights, and normals; every fourth has no normal."""
    points, normals = rng.uniform(-5, 5, (count, 3)), four(unit(rng.normal(size=(count, 3))), 0)
    normals[::4] = (0, 0, 0, 1)
    return points.astype(np.float32), normals


def deviate(counts: np.ndarray, expected: np.ndarray) -> float:
    """Returns the chi-square of counts, rare ones merged, as a standard normal deviate (Wilson and Hilferty)."""
    order = np.argsort(expected)
    cells = np.minimum(np.cumsum(expected[order]) // 10, np.cumsum(expected[order] >= 10) + 1e9).astype(int)
    cells = np.unique(cells, return_inverse=True)[1]
    observed, wanted = np.bincount(cells, counts[order]), np.bincount(cells, expected[order])
    chi2, freedom = ((observed - wanted) ** 2 / wanted).sum(), len(wanted) - 1
    return ((chi2 / freedom) ** (1 / 3) - (1 - 2 / (9 * freedom))) / np.sqrt(2 / (9 * freedom))


def assert_inverts_cdf(picked, rescaled, u, before, pmf, tolerance: float):
    """Whether 48-bit numbers u (n, 2) in order select lights by the inverse CDF and are rescaled within them.

    `before` (lights,) are the sums of the probabilities `pmf` (lights,) before each; they are off by `tolerance`.
    """
    x = (u[:, 0] + u[:, 1] * 2.0**-24) * 2.0**-24
    assert (before[picked] - tolerance <= x).all()
    assert (x <= before[picked] + pmf[picked] + tolerance).all()
    assert (np.diff(before[picked]) >= 0).all()
    exact = np.clip((x - before[picked]) / pmf[picked], 0, 1)
    assert (np.abs(rescaled - exact) <= 1e-6 + 2 * tolerance / pmf[picked]).all()
    assert (np.diff(rescaled)[np.diff(picked.astype(int)) == 0] > 0).all()


def grid_of_triangles(side: int) -> dict:
    """A square of 2 side^2 emissive triangles that face upwards; those that follow each other share no side."""
    x, y = np.meshgrid(np.linspace(-1, 1, side + 1), np.linspace(-1, 1, side + 1), indexing="ij")
    first = (np.arange(side)[:, None] * (side + 1) + np.arange(side)).ravel()
    faces = np.stack([[first, first + side + 1, first + side + 2], [first, first + side + 2, first + 1]]).reshape(
        2, 3, -1
    )
    return {
        "type": "mesh",
        "vertices": np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1),
        "faces": faces.transpose(0, 2, 1).reshape(-1, 3),
        "face_normals": True,
        "emitter": {"type": "area", "radiance": 1.0},
    }
