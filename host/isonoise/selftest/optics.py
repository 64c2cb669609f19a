"""Checks of glass, rough metal and cameras, against closed forms.

Under the same radiance L from all directions, glass neither absorbs nor emits: a body of it has radiance L, and n^2 L
inside (the radiance over the square of the index is what stays the same).
"""

from collections.abc import Iterator

import numpy as np

from isonoise.selftest.cases import Case, Context
from isonoise.selftest.image_mean import image_case, render_mean
from isonoise.selftest.scenes import area_light, look_at, make_scene, rgb, transform

L = 0.25
SKY = {"type": "constant", "radiance": rgb(L)}
ALPHAS = (1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 0.1, 0.3, 1.0)
MIRROR = {"type": "conductor", "material": "none"}
PLANE = {"type": "rectangle", "to_world": transform(50.0)}
OUTSIDE = look_at((0.0, -3.0, 0.2), (0.1, 0.0, 0.1))
"""A camera that sees a ball of radius 1 around the origin."""


def _ball(int_ior: float, radius: float = 1.0, bsdf: str = "dielectric", ext_ior: float = 1.0, **parameters) -> dict:
    glass = {"type": bsdf, "int_ior": int_ior, "ext_ior": ext_ior} | parameters
    return {"type": "sphere", "radius": radius, "bsdf": glass}


def glass(context: Context) -> Iterator[Case]:
    """Balls of glass under an even sky."""

    def render(camera: np.ndarray, max_depth: int, fov_deg: float, **objects):
        return render_mean(context, make_scene(camera, 16, max_depth, fov_deg, sky=SKY, **objects), 64)

    shells = {}
    for k in range(8):  # shells of glass and of air in turn, each inside the one before
        inner, outer = (1.0, 1.5) if k % 2 else (1.5, 1.0)
        shells[f"shell{k}"] = _ball(inner, 1 - 0.1 * k, ext_ior=outer)
    yield image_case("8 nested shells of glass, depth 200", render(OUTSIDE, 200, 12.0, **shells), L)
    for ior, depth in ((1.0, 100), (1.0001, 100), (4.0, 200)):
        yield image_case(f"ball of int_ior {ior:g}, ext_ior 1", render(OUTSIDE, depth, 30.0, ball=_ball(ior)), L)
    image = render(OUTSIDE, 100, 30.0, ball=_ball(1.5, ext_ior=1.5))
    yield image_case("ball of int_ior = ext_ior = 1.5", image, L)
    # so near the centre that there is no total reflection
    inside = look_at((0.1, 0.2, -0.1), (1.0, 0.3, 0.2))
    yield image_case("camera inside of glass of index 1.5", render(inside, 100, 90.0, ball=_ball(1.5)), 1.5**2 * L)
    grazing = look_at((-100.0, 1.0 - 1e-5, 0.0), (0.0, 1.0 - 1e-5, 0.0))
    yield image_case("ball of glass, seen at its very rim", render(grazing, 200, 1e-5, ball=_ball(1.5)), L)


def metal_albedo(cosine: float, alpha: float) -> float:
    """Returns the albedo of a rough mirror without absorption, in float64.

    The mean of G1(o) (w.h) G1(w) / (w.z h.z) over normals h with density D cos, where o is above the surface.
    GGX with Smith's G1; Walter et al. 2007, (33) to (35).
    """
    n = 1000
    u, phi = np.meshgrid((np.arange(n) + 0.5) / n, 2 * np.pi * (np.arange(n) + 0.5) / n)
    slope = alpha * np.sqrt(u / (1 - u))
    h = np.stack([slope * np.cos(phi), slope * np.sin(phi), np.ones_like(u)], axis=-1)
    h /= np.linalg.norm(h, axis=-1, keepdims=True)
    w = np.array([np.sqrt(1 - cosine**2), 0.0, cosine])
    cos_h = h @ w
    z = 2 * cos_h * h[..., 2] - cosine

    def smith_g1(c):
        return 2 / (1 + np.sqrt(1 + alpha**2 * (1 / np.maximum(c, 1e-30) ** 2 - 1)))

    weight = smith_g1(cosine) * smith_g1(z) * cos_h / (cosine * h[..., 2])
    return float(np.where((cos_h > 0) & (z > 0), weight, 0).mean())


def rough_metal(context: Context) -> Iterator[Case]:
    """A mirror without absorption under an even sky, at two angles, from the roughest to smooth."""
    for cosine in (0.7, 0.1):
        sine = np.sqrt(1 - cosine**2)
        camera = look_at((7.0, 3.0 - 2 * sine, 2 * cosine), (7.0, 3.0, 0.0))
        for alpha in ALPHAS:
            metal = {"type": "roughconductor", "material": "none", "distribution": "ggx", "alpha": alpha}
            image = render_mean(context, make_scene(camera, 16, 2, 0.01, sky=SKY, plane=PLANE | {"bsdf": metal}), 128)
            name, expected = f"rough metal, alpha {alpha:g}, cosine {cosine}", L * metal_albedo(cosine, alpha)
            yield image_case(name, image, expected, 2e-4, "2 * 10^-4 of quadrature")
        image = render_mean(context, make_scene(camera, 16, 2, 0.01, sky=SKY, plane=PLANE | {"bsdf": MIRROR}), 16)
        yield image_case(f"smooth metal, cosine {cosine}", image, L)


def mirror_diagonal(context: Context) -> Iterator[Case]:
    """A limit: paths lost along the edge between two triangles of a mirror.

    In a plane through the origin the offset of ray origins is zero, and beside the edge that two triangles share a ray
    may hit the other triangle, a rounding of its extent away. Such paths end.
    """
    camera = look_at((0.0, -1.43, 1.4), (0.0, 0.0, 0.0))
    image = render_mean(context, make_scene(camera, 16, 2, 0.01, sky=SKY, plane=PLANE | {"bsdf": MIRROR}), 256)
    width = 2 * 2.0 * np.tan(np.deg2rad(0.01) / 2)
    name, basis = (
        "smooth metal 100 wide, along its diagonal: share lost (a limit)",
        ("2^-24 of the extent, over the width of the image, 3.5 * 10^-4"),
    )
    yield Case(name, 1 - image.mean / L, 0, 100 * 2.0**-24 / width, basis)


def rough_glass(context: Context) -> Iterator[Case]:
    """Nearly smooth balls of rough glass under an even sky."""
    for alpha in (1e-4, 1e-3):
        ball = _ball(1.5, bsdf="roughdielectric", alpha=alpha, distribution="ggx")
        image = render_mean(context, make_scene(OUTSIDE, 16, 100, 12.0, sky=SKY, ball=ball), 64)
        basis = "10^-4, and masking of facets, some alpha^2"
        yield image_case(f"rough glass, alpha {alpha:g}", image, L, 1e-4 + 10 * alpha**2, basis)


def _lamp_in_view(fov_deg: float, distance: float) -> dict:
    """Returns a square lamp of radiance 1 that fills a quarter of the image."""
    half_width = 0.5 * distance * np.tan(np.deg2rad(fov_deg) / 2)
    return {"type": "rectangle", "to_world": transform(half_width, (0.0, 0.0, distance), 180)} | area_light(1.0)


def fields_of_view(context: Context) -> Iterator[Case]:
    """A lamp whose border is that of pixels: rounding moves a few samples of the pixels beside it."""
    for fov_deg, distance in ((0.01, 1e3), (40.0, 1.0), (179.0, 1.0)):
        scene = make_scene(np.eye(4), 16, 1, fov_deg, {"near_clip": 1e-3}, lamp=_lamp_in_view(fov_deg, distance))
        name = f"field of view of {fov_deg:g} degrees: a lamp a quarter as large"
        yield image_case(name, render_mean(context, scene, 256), 0.25, 1e-4)


def camera_on_surface(context: Context) -> Iterator[Case]:
    """A camera on a mirror that looks away from it sees the sky alone."""
    rotated = transform(10.0, x_angle_deg=20)
    for name, body, position, normal in (
        ("plane", {"type": "rectangle", "to_world": rotated}, np.zeros(3), transform(x_angle_deg=20)[:3, 2]),
        ("sphere", {"type": "sphere"}, np.array([0.6, 0.0, 0.8]), np.array([0.6, 0.0, 0.8])),
    ):
        camera, lens = look_at(position, position + normal), {"near_clip": 1e-6}
        scene = make_scene(camera, 16, 3, 170.0, lens, sky=SKY, body=body | {"bsdf": MIRROR})
        yield image_case(f"camera on a {name}, looking away from it", render_mean(context, scene, 64), L)


def focus_distances(context: Context) -> Iterator[Case]:
    """A lamp in focus is sharp, at any distance."""
    for focus, aperture, near in ((1e-4, 1e-5, 1e-6), (1e-4, 1.0, 1e-6), (1e6, 10.0, 1.0)):
        lens = {"type": "thinlens", "focus_distance": focus, "aperture_radius": aperture, "near_clip": near}
        scene = make_scene(np.eye(4), 16, 1, 40.0, lens, lamp=_lamp_in_view(40.0, focus))
        name, basis = f"focal distance {focus:g}, aperture {aperture:g}", "10^-3: rounding at the lamp's rim"
        yield image_case(name, render_mean(context, scene, 256), 0.25, 1e-3, basis)


CHECKS = (
    glass,
    rough_metal,
    mirror_diagonal,
    rough_glass,
    fields_of_view,
    camera_on_surface,
    focus_distances,
)
