"""Cases of whole paths where the numbers are stiff, against closed forms."""

import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from isonoise.selftest.core import Bench, Case
from isonoise.selftest.optics import optics_cases
from isonoise.selftest.rendered import Z, case, rendered
from isonoise.selftest.scenes import area, average, diffuse, looking, placed, rgb, scene

SKY = {"type": "constant", "radiance": rgb(0.25)}


def transport_cases(bench: Bench) -> Iterator[Case]:
    """All cases of the group."""
    yield from _furnace(bench)
    yield from _roulette(bench)
    yield from _grazing(bench)
    yield from _small_light(bench)
    yield from _near_light(bench)
    yield from _sun(bench)
    yield from optics_cases(bench)


def _furnace(bench: Bench) -> Iterator[Case]:
    """A closed shape that shines inwards with e and reflects a: e (1 - a^k) / (1 - a) at depth k."""
    depth, albedo, e = 10_000, 1 - 1e-6, 0.8
    a = float(np.float32(albedo))
    expected = e * -np.expm1(depth * np.log(a)) / (1 - a)
    camera = looking((0.3, -0.2, 0.4), (0.7, 0.5, -0.3))
    for shape in ("sphere", "cube"):
        room = {"type": shape, "flip_normals": True, "to_world": placed(2.0, (0.1, 0.2, 0.3))} | area(e, albedo)
        image = rendered(bench, scene(camera, 8, depth, 90.0, room=room), 16)
        tolerance = 1e-4 * expected
        measured = image.mean if image.rejected == 0 else float("nan")
        name = f"furnace in a {shape}, albedo 1 - 10^-6, depth 10^4"
        yield Case(
            name,
            measured,
            expected,
            tolerance,
            "10^-4: products of 10^4 roundings of 2^-24, at random, and as many sums",
        )


def _roulette(bench: Bench) -> Iterator[Case]:
    """A mirror that reflects w of a sky of 1 / w: roulette lets a path live with probability max(w, 2^-24)."""
    plane = {"type": "rectangle", "to_world": placed(50.0)}
    camera = looking((0.3, -2.0, 1.5), (0.0, 0.0, 0.0))
    n = 128 * 128 * 256
    for name, w, rr_depth in (("10^-8", 1e-8, 1_000_000), ("10^-4", 1e-4, 1), ("10^-8", 1e-8, 1)):
        mirror = {"type": "conductor", "material": "none", "specular_reflectance": rgb(w)}
        sky = {"type": "constant", "radiance": rgb(1 / w)}
        room = scene(camera, 128, 3, 1.0, plane=plane | {"bsdf": mirror}, sky=sky)
        room["integrator"]["rr_depth"] = rr_depth
        image = rendered(bench, room, 256 if rr_depth == 1 else 4)
        if rr_depth > 1:
            yield case(f"throughput {name} without roulette", image, 1.0)
            continue
        survival = max(w, 2.0**-24)
        # of n paths n * survival live, give or take; each counts 1 / (n * survival)
        lives = n * survival
        tolerance = (Z * np.sqrt(lives) + Z) / lives
        yield Case(
            f"throughput {name} with roulette", image.mean, 1.0, tolerance, "5 deviations of the number that lives"
        )


def _grazing(bench: Bench) -> Iterator[Case]:
    floor = {"type": "rectangle", "to_world": placed(50.0), "bsdf": diffuse(0.5)}
    above = looking((0.3, -2.0, 1.5), (0.0, 0.0, 0.0))
    for angle in (1e-2, 1e-4, 1e-5):
        sun = {"type": "directional", "direction": [1.0, 0.3, -angle], "irradiance": rgb(1.0)}
        expected = 0.5 / np.pi * angle / np.sqrt(1.09 + angle**2)
        image = rendered(bench, scene(above, 16, 2, floor=floor, sun=sun), 16)
        yield case(f"light that grazes a floor by {angle:g}", image, expected)
    for angle in (1e-2, 1e-4, 1e-5):
        camera = looking((-5.0, 0.0, 5.0 * angle), (0.0, 0.0, 0.0))
        fov = float(np.rad2deg(angle))
        image = rendered(bench, scene(camera, 16, 2, fov, floor=floor, sky=SKY), 256)
        yield case(f"floor seen under {angle:g} rad, sky all around", image, 0.125)


def _small_light(bench: Bench) -> Iterator[Case]:
    """A sphere of radius R, radiance L, at distance d: irradiance pi L R^2 cos / d^2; here L R^2 = 1."""
    floor = {"type": "rectangle", "to_world": placed(50.0), "bsdf": diffuse(0.5)}
    origin, fov = (0.3, -2.0, 1.5), 4.0
    camera = looking(origin, (0.0, 0.0, 0.0))
    center = np.array([0.4, 0.3, 2.0])

    def radiance(points: np.ndarray) -> np.ndarray:
        away = center - points
        return 0.5 * away[..., 2] / np.linalg.norm(away, axis=-1) ** 3

    expected = average(camera, fov, radiance)
    ball = {"type": "sphere", "center": center.tolist(), "radius": 1e-5} | area(1e10)
    yield case(
        "sphere of 10^-5 with radiance 10^10",
        rendered(bench, scene(camera, 16, 2, fov, floor=floor, lamp=ball), 64),
        expected,
    )
    # a disk of the same area that faces the floor: its own cosine comes in
    disk = {"type": "disk", "to_world": placed(1e-5, center, 180)} | area(1e10)

    def from_disk(points: np.ndarray) -> np.ndarray:
        away = center - points
        return radiance(points) * away[..., 2] / np.linalg.norm(away, axis=-1)

    image = rendered(bench, scene(camera, 16, 2, fov, floor=floor, lamp=disk), 64)
    yield case("disk of 10^-5 with radiance 10^10", image, average(camera, fov, from_disk))


def _near_light(bench: Bench) -> Iterator[Case]:
    """A lamp 10^-6 above a floor, both 2 wide; the camera is between them. Nearly all that the floor sees is lamp."""
    for height in (0.0, 0.3):
        gap = 1e-6
        floor = {"type": "rectangle", "to_world": placed(1.0, (0.0, 0.0, height)), "bsdf": diffuse(0.5)}
        lamp = {"type": "rectangle", "to_world": placed(1.0, (0.0, 0.0, height + gap), 180)} | area(3.0)
        camera = looking((0.1, 0.2, height + 0.5 * gap), (0.1, 0.2, height - 1.0))
        described = scene(camera, 16, 2, 60.0, {"near_clip": 1e-9}, floor=floor, lamp=lamp)
        yield case(f"lamp 10^-6 above a floor at height {height:g}", rendered(bench, described, 64), 1.5)


def _sun(bench: Bench) -> Iterator[Case]:
    """A floor under a map whose texels are 1 but for one of 10^6; its irradiance by quadrature over the texels."""
    height, width = 33, 64
    texels = np.ones((height, width))
    texels[6, 20] = 1e6
    nodes, weights = np.polynomial.legendre.leggauss(8)
    at, weights = (nodes + 1) / 2, weights / 2
    theta = (np.arange(height - 1)[:, None] + at) * np.pi / (height - 1)  # (cell, node)
    step = np.pi / (height - 1) * 2 * np.pi / width
    # bilinear over cells: of the angle around only the mean counts, of the height the weights of two rows
    rows = texels.mean(axis=1) * width * step
    bilinear = rows[:-1, None] * (1 - at) + rows[1:, None] * at
    irradiance = float((bilinear * np.maximum(np.cos(theta), 0) * np.sin(theta)) @ weights @ np.ones(height - 1))
    from isonoise.film.exr import write_exr

    with tempfile.TemporaryDirectory(prefix="isonoise-selftest-") as folder:
        path = Path(folder) / "sky.exr"
        write_exr(path, {c: texels.astype(np.float32) for c in "RGB"}, {})
        sky = {"type": "envmap", "filename": str(path)}
        floor = {"type": "rectangle", "to_world": placed(50.0, x_angle=-90), "bsdf": diffuse(0.5)}
        camera = looking((0.3, 1.5, -2.0), (0.0, 0.0, 0.0))
        image = rendered(bench, scene(camera, 16, 2, 4.0, floor=floor, sky=sky), 256)
    yield case(
        "sun of 10^6 in an environment map", image, 0.5 / np.pi * irradiance, 1e-4, "2^-24 in the tables of the map"
    )
