"""Builds small scenes with media, most of one pixel."""

import math

import numpy as np

import isonoise

# Features of scenes that share their programs.
PLAIN = (
    *("TRIANGLES", "ANALYTICS", "SPHERES", "CYLINDERS", "DIFFUSE", "NULL", "VOLPATH", "MEDIA", "ORTHOGRAPHIC"),
    *("POINT_LIGHTS", "AREA_LIGHTS", "SPHERE_LIGHTS", "CONSTANT_LIGHT", "MANY_LIGHTS", "NEXT_EVENT"),
    *("RUSSIAN_ROULETTE", "INSTANCES"),
)

NULL = {"type": "null"}
LAMBERT = {"type": "diffuse", "reflectance": 0.5}


def rgb(*values: float) -> dict:
    return {"type": "rgb", "value": list(values)}


def medium(sigma_t=1.0, albedo=0.0, g: float | None = None, **more) -> dict:
    phase = {} if g is None else {"phase": {"type": "hg", "g": g}}
    return {"type": "homogeneous", "sigma_t": sigma_t, "albedo": albedo, **phase, **more}


def transform(x: float = 0.0, y: float = 0.0, z: float = 0.0, scale=1.0) -> np.ndarray:
    matrix = np.diag([*np.broadcast_to(np.asarray(scale, float), 3), 1.0])
    matrix[:3, 3] = x, y, z
    return matrix


def look_at(origin, target, up=(0.0, 1.0, 0.0)) -> np.ndarray:
    forward = np.subtract(target, origin) / np.linalg.norm(np.subtract(target, origin))
    left = np.cross(up, forward) / np.linalg.norm(np.cross(up, forward))
    matrix = np.eye(4)
    matrix[:3] = np.stack([left, np.cross(forward, left), forward, origin], axis=1)
    return matrix


def one_ray(origin, target, up=(0.0, 1.0, 0.0), **more) -> dict:
    """A camera with one pixel that is 10^-5 wide: all its rays are the same up to that."""
    film = {"type": "hdrfilm", "width": 1, "height": 1, "rfilter": {"type": "box"}}
    to_world = look_at(origin, target, up) @ np.diag([1e-5, 1e-5, 1.0, 1.0])
    return {"type": "orthographic", "to_world": to_world, "film": film, **more}


def radiance(scene: dict, spp: int = 16, seed: int = 1) -> tuple[np.ndarray, float]:
    """Returns the RGB of a scene of one pixel, and the relative standard error of its luminance."""
    statistics = isonoise.render(scene, spp=spp, strategy="uniform", seed=seed).statistics
    mean, error = statistics.mean.item(), math.sqrt(statistics.variance_of_mean().item())
    assert statistics.rejected.sum() == 0
    return statistics.rgb[0, 0].astype(float), error / mean if mean else 0.0


FLOOR = {"type": "rectangle", "to_world": transform(scale=4.0), "bsdf": LAMBERT}
LIGHT = {"type": "point", "position": [0.0, 0.0, 3.0], "intensity": 9.0 * 2 * math.pi}  # 1 on the floor without layers


def lit_floor(integrator: str = "volpath", depth: int = 2, **objects) -> dict:
    """A floor under a point light; the camera looks down from just above the floor. `objects` are added."""
    return {
        "type": "scene",
        "integrator": {"type": integrator, "max_depth": depth, "rr_depth": 1000},
        "sensor": one_ray((0.0, 0.0, 0.0004), (0.0, 0.0, 0.0)) | {"near_clip": 1e-5},
        "floor": FLOOR,
        "light": LIGHT,
        **objects,
    }


def slab(low: float, high: float, sigma_t=1.0, **more) -> dict:
    to_world = transform(z=(low + high) / 2, scale=(2.0, 2.0, (high - low) / 2))
    return {"type": "cube", "to_world": to_world, "bsdf": NULL, "interior": medium(sigma_t), **more}


def henyey_greenstein(g: float, cosine: np.ndarray) -> np.ndarray:
    return (1 - g * g) / (4 * math.pi * (1 + g * g - 2 * g * cosine) ** 1.5)


HALF = {"type": "mask", "opacity": 0.5, "inner": LAMBERT}
CHECKS = {"type": "checkerboard", "color0": 0.2, "color1": 0.7, "to_uv": transform(scale=2.0)}
OUT_OF_SIGHT = {  # materials that are in all programs of `sheets`
    "mask": {"type": "mask", "opacity": CHECKS, "inner": LAMBERT},
    "blend": {"type": "blendbsdf", "weight": 0.25, "a": NULL, "b": LAMBERT},
    "pane": {"type": "thindielectric", "int_ior": 1.5, "ext_ior": 1.0},
    "bump": {"type": "bumpmap", "map": CHECKS, "inner": HALF},
}


def sheet(z: float, bsdf: dict, x: float = 0.0) -> dict:
    return {"type": "rectangle", "to_world": transform(x=x, z=z), "bsdf": bsdf}


def sheets(materials: list[dict], integrator: str = "volpath") -> dict:
    """A lit floor below sheets of these materials."""
    out_of_sight = {name: sheet(1.0, bsdf, 20.0 + 3.0 * i) for i, (name, bsdf) in enumerate(OUT_OF_SIGHT.items())}
    out_of_sight["glass"] = sheet(1.0, {"type": "dielectric"}, 50.0)
    layers = {f"sheet {i}": sheet(0.5 + 0.1 * i, bsdf) for i, bsdf in enumerate(materials)}
    # beside the seam of the rectangle's triangles and the edges of the checks
    light = LIGHT | {"position": [0.21, 0.12, 3.0]}
    scene = lit_floor(integrator, light=light, **layers, **out_of_sight)
    scene["sensor"]["to_world"] = look_at((0.21, 0.12, 0.0004), (0.21, 0.12, 0.0)) @ np.diag([1e-5, 1e-5, 1.0, 1.0])
    return scene
