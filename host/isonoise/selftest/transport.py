"""Checks of whole paths in extreme scenes, against closed forms."""

import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from isonoise.film.exr import write_exr
from isonoise.selftest.cases import Case, Context
from isonoise.selftest.image_mean import Z, image_case, render_mean
from isonoise.selftest.scenes import area_light, diffuse, look_at, make_scene, mean_over_floor, rgb, transform

FLOOR = {"type": "rectangle", "to_world": transform(50.0), "bsdf": diffuse(0.5)}
ABOVE = look_at((0.3, -2.0, 1.5), (0.0, 0.0, 0.0))


def furnace(context: Context) -> Iterator[Case]:
    """A closed shape that emits e inwards and reflects a: the radiance is e (1 - a^k) / (1 - a) at depth k."""
    depth, albedo, e = 10_000, 1 - 1e-6, 0.8
    a = float(np.float32(albedo))
    expected = e * -np.expm1(depth * np.log(a)) / (1 - a)
    camera = look_at((0.3, -0.2, 0.4), (0.7, 0.5, -0.3))
    basis = "10^-4 for products of 10^4 roundings of 2^-24, at random, and as many sums"
    for shape in ("sphere", "cube"):
        room = {"type": shape, "flip_normals": True, "to_world": transform(2.0, (0.1, 0.2, 0.3))}
        scene = make_scene(camera, 8, depth, 90.0, room=room | area_light(e, albedo))
        name = f"furnace in a {shape}, albedo 1 - 10^-6, depth 10^4"
        yield image_case(name, render_mean(context, scene, 16), expected, 1e-4, basis)


def roulette(context: Context) -> Iterator[Case]:
    """A mirror reflects w of a sky of 1 / w: with roulette a path survives with probability max(w, 2^-24)."""
    plane = {"type": "rectangle", "to_world": transform(50.0)}
    camera = look_at((0.3, -2.0, 1.5), (0.0, 0.0, 0.0))
    paths = 128 * 128 * 256
    for name, w, rr_depth in (("10^-8", 1e-8, 1_000_000), ("10^-4", 1e-4, 1), ("10^-8", 1e-8, 1)):
        mirror = {"type": "conductor", "material": "none", "specular_reflectance": rgb(w)}
        sky = {"type": "constant", "radiance": rgb(1 / w)}
        scene = make_scene(camera, 128, 3, 1.0, plane=plane | {"bsdf": mirror}, sky=sky)
        scene["integrator"]["rr_depth"] = rr_depth
        image = render_mean(context, scene, 256 if rr_depth == 1 else 4)
        if rr_depth > 1:
            yield image_case(f"throughput {name} without roulette", image, 1.0)
            continue
        survivors = paths * max(w, 2.0**-24)  # the expected number; each counts 1 / survivors
        tolerance = (Z * np.sqrt(survivors) + Z) / survivors
        basis = "5 deviations of the number that survives"
        yield Case(f"throughput {name} with roulette", image.mean, 1.0, tolerance, basis)


def grazing_angles(context: Context) -> Iterator[Case]:
    """Light and camera rays nearly parallel to a floor."""
    for angle in (1e-2, 1e-4, 1e-5):
        sun = {"type": "directional", "direction": [1.0, 0.3, -angle], "irradiance": rgb(1.0)}
        expected = 0.5 / np.pi * angle / np.sqrt(1.09 + angle**2)
        image = render_mean(context, make_scene(ABOVE, 16, 2, floor=FLOOR, sun=sun), 16)
        yield image_case(f"light that grazes a floor by {angle:g}", image, expected)
    sky = {"type": "constant", "radiance": rgb(0.25)}
    for angle in (1e-2, 1e-4, 1e-5):
        camera = look_at((-5.0, 0.0, 5.0 * angle), (0.0, 0.0, 0.0))
        fov_deg = float(np.rad2deg(angle))
        image = render_mean(context, make_scene(camera, 16, 2, fov_deg, floor=FLOOR, sky=sky), 256)
        yield image_case(f"floor seen under {angle:g} rad, sky all around", image, 0.125)


def tiny_lights(context: Context) -> Iterator[Case]:
    """A sphere of radius R, radiance L, at distance d: irradiance pi L R^2 cos / d^2; here L R^2 = 1."""
    fov_deg, center = 4.0, np.array([0.4, 0.3, 2.0])

    def sphere_radiance(points: np.ndarray) -> np.ndarray:
        to_light = center - points
        return 0.5 * to_light[..., 2] / np.linalg.norm(to_light, axis=-1) ** 3

    def disk_radiance(points: np.ndarray) -> np.ndarray:
        """A disk of the same area that faces the floor: times its own cosine."""
        to_light = center - points
        return sphere_radiance(points) * to_light[..., 2] / np.linalg.norm(to_light, axis=-1)

    sphere = {"type": "sphere", "center": center.tolist(), "radius": 1e-5}
    disk = {"type": "disk", "to_world": transform(1e-5, center, 180)}
    for name, lamp, radiance in (("sphere", sphere, sphere_radiance), ("disk", disk, disk_radiance)):
        scene = make_scene(ABOVE, 16, 2, fov_deg, floor=FLOOR, lamp=lamp | area_light(1e10))
        expected = mean_over_floor(ABOVE, fov_deg, radiance)
        yield image_case(f"{name} of 10^-5 with radiance 10^10", render_mean(context, scene, 64), expected)


def near_light(context: Context) -> Iterator[Case]:
    """A lamp 10^-6 above a floor, both 2 wide; the camera is between them and the lamp fills the floor's sky."""
    gap = 1e-6
    for height in (0.0, 0.3):
        floor = {"type": "rectangle", "to_world": transform(1.0, (0.0, 0.0, height)), "bsdf": diffuse(0.5)}
        lamp = {"type": "rectangle", "to_world": transform(1.0, (0.0, 0.0, height + gap), 180)} | area_light(3.0)
        camera = look_at((0.1, 0.2, height + 0.5 * gap), (0.1, 0.2, height - 1.0))
        scene = make_scene(camera, 16, 2, 60.0, {"near_clip": 1e-9}, floor=floor, lamp=lamp)
        yield image_case(f"lamp 10^-6 above a floor at height {height:g}", render_mean(context, scene, 64), 1.5)


def sun_in_environment_map(context: Context) -> Iterator[Case]:
    """A floor under a map whose texels are 1, except for one of 10^6; its irradiance by quadrature over the texels."""
    height, width = 33, 64
    texels = np.ones((height, width))
    texels[6, 20] = 1e6
    nodes, weights = np.polynomial.legendre.leggauss(8)
    fraction, weights = (nodes + 1) / 2, weights / 2
    theta = (np.arange(height - 1)[:, None] + fraction) * np.pi / (height - 1)  # (cell, node)
    cell = np.pi / (height - 1) * 2 * np.pi / width
    # the map is bilinear over cells: along phi only the mean counts, along theta the weights of two rows
    rows = texels.mean(axis=1) * width * cell
    bilinear = rows[:-1, None] * (1 - fraction) + rows[1:, None] * fraction
    irradiance = float((bilinear * np.maximum(np.cos(theta), 0) * np.sin(theta)) @ weights @ np.ones(height - 1))
    with tempfile.TemporaryDirectory(prefix="isonoise-selftest-") as folder:
        path = Path(folder) / "sky.exr"
        write_exr(path, {c: texels.astype(np.float32) for c in "RGB"}, {})
        sky = {"type": "envmap", "filename": str(path)}
        floor = {"type": "rectangle", "to_world": transform(50.0, x_angle_deg=-90), "bsdf": diffuse(0.5)}
        camera = look_at((0.3, 1.5, -2.0), (0.0, 0.0, 0.0))
        image = render_mean(context, make_scene(camera, 16, 2, 4.0, floor=floor, sky=sky), 256)
    name, basis = "sun of 10^6 in an environment map", "2^-24 in the tables of the map"
    yield image_case(name, image, 0.5 / np.pi * irradiance, 1e-4, basis)


CHECKS = (furnace, roulette, grazing_angles, tiny_lights, near_light, sun_in_environment_map)
