"""Cases of glass, rough metal and cameras, against closed forms.

Under the same light L from everywhere, glass neither takes nor gives: what is refracted in comes out again, so that a
body of it has radiance L, and n^2 L within (the radiance over the square of the index is what stays the same).
"""

from collections.abc import Iterator

import numpy as np

from isonoise.selftest.core import Bench, Case
from isonoise.selftest.rendered import case, rendered
from isonoise.selftest.scenes import area, looking, placed, rgb, scene

L = 0.25
SKY = {"type": "constant", "radiance": rgb(L)}
ALPHAS = (1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 0.1, 0.3, 1.0)


def optics_cases(bench: Bench) -> Iterator[Case]:
    """All cases of the file."""
    yield from _glass(bench)
    yield from _roughness(bench)
    yield from _cameras(bench)
    yield from _focus(bench)


def _ball(index: float, radius: float = 1.0, kind: str = "dielectric", outside: float = 1.0, **parameters) -> dict:
    glass = {"type": kind, "int_ior": index, "ext_ior": outside} | parameters
    return {"type": "sphere", "radius": radius, "bsdf": glass}


def _glass(bench: Bench) -> Iterator[Case]:
    camera = looking((0.0, -3.0, 0.2), (0.1, 0.0, 0.1))
    nested = {}
    for k in range(8):  # shells of glass and of air in turn, one within the other
        inner, outer = (1.0, 1.5) if k % 2 else (1.5, 1.0)
        nested[f"shell{k}"] = _ball(inner, 1 - 0.1 * k, outside=outer)
    image = rendered(bench, scene(camera, 16, 200, 12.0, sky=SKY, **nested), 64)
    yield case("8 shells of glass, one in the other, depth 200", image, L)
    for index, depth in ((1.0, 100), (1.0001, 100), (4.0, 200)):
        image = rendered(bench, scene(camera, 16, depth, 30.0, sky=SKY, ball=_ball(index)), 64)
        yield case(f"ball of int_ior {index:g}, ext_ior 1", image, L)
    image = rendered(bench, scene(camera, 16, 100, 30.0, sky=SKY, ball=_ball(1.5, outside=1.5)), 64)
    yield case("ball of int_ior = ext_ior = 1.5", image, L)
    inside = looking((0.1, 0.2, -0.1), (1.0, 0.3, 0.2))  # so near the centre that nothing is reflected totally
    image = rendered(bench, scene(inside, 16, 100, 90.0, sky=SKY, ball=_ball(1.5)), 64)
    yield case("camera inside of glass of index 1.5", image, 1.5**2 * L)
    grazing = looking((-100.0, 1.0 - 1e-5, 0.0), (0.0, 1.0 - 1e-5, 0.0))
    image = rendered(bench, scene(grazing, 16, 200, 1e-5, sky=SKY, ball=_ball(1.5)), 64)
    yield case("ball of glass, seen at its very rim", image, L)


def metal_albedo(cosine: float, alpha: float) -> float:
    """What a rough mirror without loss reflects of an even light: the mean of G1(o) (w.h) G1(w) / (w.z h.z) over
    normals h with density D cos, o above the surface. GGX, Smith's G1; Walter et al. 2007, (33) to (35); float64."""
    n = 1000
    u, phi = np.meshgrid((np.arange(n) + 0.5) / n, 2 * np.pi * (np.arange(n) + 0.5) / n)
    slope = alpha * np.sqrt(u / (1 - u))
    h = np.stack([slope * np.cos(phi), slope * np.sin(phi), np.ones_like(u)], axis=-1)
    h /= np.linalg.norm(h, axis=-1, keepdims=True)
    w = np.array([np.sqrt(1 - cosine**2), 0.0, cosine])
    cos_h = h @ w
    z = 2 * cos_h * h[..., 2] - cosine

    def seen(c):
        return 2 / (1 + np.sqrt(1 + alpha**2 * (1 / np.maximum(c, 1e-30) ** 2 - 1)))

    return float(np.where((cos_h > 0) & (z > 0), seen(cosine) * seen(z) * cos_h / (cosine * h[..., 2]), 0).mean())


def _roughness(bench: Bench) -> Iterator[Case]:
    """A rough mirror without loss under an even sky, at two angles, from the roughest to where it is smooth."""
    plane = {"type": "rectangle", "to_world": placed(50.0)}
    for cosine in (0.7, 0.1):
        sine = np.sqrt(1 - cosine**2)
        camera = looking((7.0, 3.0 - 2 * sine, 2 * cosine), (7.0, 3.0, 0.0))
        for alpha in ALPHAS:
            metal = {"type": "roughconductor", "material": "none", "distribution": "ggx", "alpha": alpha}
            image = rendered(bench, scene(camera, 16, 2, 0.01, sky=SKY, plane=plane | {"bsdf": metal}), 128)
            expected = L * metal_albedo(cosine, alpha)
            yield case(
                f"rough metal, alpha {alpha:g}, cosine {cosine}", image, expected, 2e-4, "2 * 10^-4 of quadrature"
            )
        metal = {"type": "conductor", "material": "none"}
        image = rendered(bench, scene(camera, 16, 2, 0.01, sky=SKY, plane=plane | {"bsdf": metal}), 16)
        yield case(f"smooth metal, cosine {cosine}", image, L)
    yield from _diagonal(bench, plane | {"bsdf": metal})
    camera = looking((0.0, -3.0, 0.2), (0.1, 0.0, 0.1))
    for alpha in (1e-4, 1e-3):
        ball = _ball(1.5, kind="roughdielectric", alpha=alpha, distribution="ggx")
        image = rendered(bench, scene(camera, 16, 100, 12.0, sky=SKY, ball=ball), 64)
        lost = 10 * alpha**2
        yield case(f"rough glass, alpha {alpha:g}", image, L, 1e-4 + lost, "10^-4, and what facets hide, some alpha^2")


def _diagonal(bench: Bench, mirror: dict) -> Iterator[Case]:
    """A limit: in a plane of coordinates the offset of origins is zero, and beside the edge that two triangles share a
    ray may meet the other one, a rounding of its extent away. Such paths end; the cases above look elsewhere."""
    camera = looking((0.0, -1.43, 1.4), (0.0, 0.0, 0.0))
    image = rendered(bench, scene(camera, 16, 2, 0.01, sky=SKY, plane=mirror), 256)
    width = 2 * 2.0 * np.tan(np.deg2rad(0.01) / 2)
    most = 100 * 2.0**-24 / width
    name = "smooth metal 100 wide, along its diagonal: share lost (a limit)"
    yield Case(name, 1 - image.mean / L, 0, most, "2^-24 of the extent, over the width of the image, 3.5 * 10^-4")


def _lamp_in_view(fov: float, distance: float) -> dict:
    """A square lamp of radiance 1 that fills half the width and half the height of the view: a quarter of the image."""
    half = 0.5 * distance * np.tan(np.deg2rad(fov) / 2)
    return {"type": "rectangle", "to_world": placed(half, (0.0, 0.0, distance), 180)} | area(1.0)


def _cameras(bench: Bench) -> Iterator[Case]:
    """The lamp's border is that of pixels: what rounding moves is a few samples of those beside it."""
    for fov, distance in ((0.01, 1e3), (40.0, 1.0), (179.0, 1.0)):
        lens = {"near_clip": 1e-3}
        view = scene(np.eye(4), 16, 1, fov, lens, lamp=_lamp_in_view(fov, distance))
        yield case(
            f"field of view of {fov:g} degrees: a lamp a quarter as large", rendered(bench, view, 256), 0.25, 1e-4
        )
    glossy = {"type": "conductor", "material": "none"}
    for name, body, on in (
        ("plane", {"type": "rectangle", "to_world": placed(10.0, x_angle=20)}, placed(x_angle=20)[:3, 2] * 0),
        ("sphere", {"type": "sphere"}, np.array([0.6, 0.0, 0.8])),
    ):
        normal = placed(x_angle=20)[:3, 2] if name == "plane" else on
        camera = looking(on, on + normal)
        image = rendered(
            bench, scene(camera, 16, 3, 170.0, {"near_clip": 1e-6}, sky=SKY, body=body | {"bsdf": glossy}), 64
        )
        yield case(f"camera on a {name}, looking away from it", image, L)


def _focus(bench: Bench) -> Iterator[Case]:
    """What is in focus is sharp, at any distance."""
    for focus, aperture, near in ((1e-4, 1e-5, 1e-6), (1e-4, 1.0, 1e-6), (1e6, 10.0, 1.0)):
        lens = {"type": "thinlens", "focus_distance": focus, "aperture_radius": aperture, "near_clip": near}
        view = scene(np.eye(4), 16, 1, 40.0, lens, lamp=_lamp_in_view(40.0, focus))
        image = rendered(bench, view, 256)
        yield case(
            f"focal distance {focus:g}, aperture {aperture:g}", image, 0.25, 1e-3, "10^-3: rounding at the lamp's rim"
        )
