"""Renders scenes whose radiance is known in closed form.

Every pixel and the image mean must lie within Z standard errors, taken from the render's own statistics, plus 1e-5
relative for float32. A pixel's expected value is the closed form averaged over the pixel by Gauss-Legendre quadrature
in float64, so that the size of a pixel is no error.

False-alarm rate: Z = 5.2 leaves 2.0e-7 per comparison by the normal distribution, and there are about 2,000 of them:
4e-4 for the whole file under other seeds.
"""

from dataclasses import dataclass

import numpy as np
import pytest
from shared_programs import LIGHTS, SHAPES, share_programs

import isonoise
from isonoise.luminance import luminance
from isonoise.selftest.scenes import area_light, diffuse, look_at, rgb, transform

shared_programs = share_programs((*SHAPES, *LIGHTS, "DIFFUSE", "DIELECTRIC", "TWOSIDED"))

Z = 5.2
ROUNDING = 1e-5
SIDE = 4  # pixels along a side of the image
SPP = 4096

RGB = np.array([1.0, 0.6, 0.3])
"""Colour of all lights: the channels differ, so that swapped channels fail."""
ALBEDO = np.array([0.4, 0.7, 0.9])


@dataclass(frozen=True)
class Camera:
    """A pinhole camera without roll; `tangent` is that of half its square field of view."""

    origin: tuple[float, float, float]
    target: tuple[float, float, float]
    tangent: float = 0.02

    def to_world(self) -> np.ndarray:
        return look_at(self.origin, self.target)

    def sensor(self) -> dict:
        return {
            "type": "perspective",
            "fov": float(np.rad2deg(2 * np.arctan(self.tangent))),
            "near_clip": 1e-4,
            "to_world": self.to_world(),
            "film": {"type": "hdrfilm", "width": SIDE, "height": SIDE, "rfilter": {"type": "box"}},
        }

    def directions(self, nodes: int = 8) -> tuple[np.ndarray, np.ndarray]:
        """Returns directions through the nodes of every pixel, (side, side, nodes^2, 3), and weights (nodes^2,)."""
        x, w = np.polynomial.legendre.leggauss(nodes)
        positions = (np.arange(SIDE)[:, None] + (x + 1) / 2) / SIDE
        plane = (1 - 2 * positions) * self.tangent
        rows, columns = plane[:, None, :, None], plane[None, :, None, :]
        shape = (SIDE, SIDE, nodes, nodes)
        local = np.stack([np.broadcast_to(a, shape) for a in (columns, rows, 1.0)], axis=-1)
        world = local.reshape(SIDE, SIDE, -1, 3) @ self.to_world()[:3, :3].T
        return world, np.outer(w, w).ravel() / 4

    def average_over_floor(self, radiance) -> np.ndarray:
        """Returns pixel means (side, side) of a radiance that is a function of the point in the plane z = 0."""
        directions, weights = self.directions()
        origin = np.array(self.origin)
        assert (directions[..., 2] * origin[2] < 0).all(), "some pixel does not see the plane"
        points = origin - directions * (origin[2] / directions[..., 2:])
        return radiance(points) @ weights


ABOVE = Camera((0.3, -2.0, 1.5), (0.0, 0.0, 0.0))
OBLIQUE = Camera((4.0, 1.0, 0.5), (0.5, -0.2, 0.0), tangent=0.05)
WIDE = Camera((0.0, 0.5, 0.4), (0.0, 0.0, 0.0), tangent=0.25)
CAMERAS = pytest.mark.parametrize("camera", [ABOVE, OBLIQUE, WIDE], ids=["above", "oblique", "wide"])


def coloured_light(radiance: float) -> dict:
    """The emitter and the black bsdf of a light of the colour RGB."""
    return area_light(radiance * RGB)


FLOOR = {"type": "rectangle", "to_world": transform(50.0), "bsdf": diffuse(ALBEDO)}


def render(camera: Camera, max_depth: int, **objects) -> isonoise.Statistics:
    scene = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": max_depth, "rr_depth": 100_000},
        "sensor": camera.sensor(),
        **objects,
    }
    return isonoise.render(scene, spp=SPP, strategy=f"uniform:wave_spp={SPP}", seed=1, sampler="independent").statistics


def assert_radiance(statistics, colour: np.ndarray, pattern=1.0) -> None:
    """Asserts that the image is colour (3,) times pattern (side, side).

    The standard error of a channel is not in the statistics: in each of these scenes a channel is a multiple of the
    luminance, sample by sample or nearly so, and channels are compared by the image mean with the luminance's error.
    """
    pattern = np.broadcast_to(pattern, statistics.shape)
    assert (statistics.count == SPP).all()
    assert (statistics.rejected == 0).all()
    expected = luminance(colour) * pattern
    se = np.sqrt(statistics.variance_of_mean())
    deviation = np.abs(statistics.mean - expected)
    assert (deviation <= Z * se + ROUNDING * expected).all(), (
        f"{statistics.mean} for {expected}: off by {np.max(deviation / np.maximum(se, 1e-30)):.1f} standard errors"
    )
    relative_error = np.sqrt((se**2).sum()) / expected.sum()
    ratio = statistics.rgb.mean(axis=(0, 1), dtype=np.float64) / (colour * pattern.mean())
    assert (np.abs(ratio - 1) <= Z * relative_error + ROUNDING).all(), f"{ratio} of the expected image mean"


# Furnace: a closed shape that emits e inwards and reflects a: e (1 - a^k) / (1 - a) at max_depth k.

FURNACE = [(0.0, 3), (0.5, 1), (0.5, 2), (0.5, 6), (0.9, 4), (0.9, 30), (0.99, 12), (1.0, 5)]


@pytest.mark.usefixtures("one_lane")
@pytest.mark.parametrize(("albedo", "depth"), FURNACE)
@pytest.mark.parametrize("shape", ["sphere", "cube"])
def test_furnace(shape, albedo, depth):
    camera = Camera((0.3, -0.2, 0.4), (0.7, 0.5, -0.3), tangent=1.0)
    light = {"type": shape, "flip_normals": True, "to_world": transform(2.0, (0.1, 0.2, 0.3))} | coloured_light(0.8)
    light["bsdf"] = diffuse(albedo * np.array([1.0, 0.9, 0.5]))
    statistics = render(camera, depth, light=light)
    powers = (albedo * np.array([1.0, 0.9, 0.5]))[:, None] ** np.arange(depth)
    assert_radiance(statistics, 0.8 * RGB * powers.sum(axis=1))


# Polygons: Lambert's formula.


def clip(polygon: np.ndarray) -> np.ndarray:
    """Returns the part of a polygon above the plane z = 0 (Sutherland and Hodgman 1974)."""
    result = []
    for a, b in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        if a[2] >= 0:
            result.append(a)
        if (a[2] >= 0) != (b[2] >= 0):
            result.append(a + (b - a) * a[2] / (a[2] - b[2]))
    return np.array(result)


def polygon_irradiance(polygon: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Irradiance of points (..., 3) in the plane z = 0 from a polygon above it with radiance 1 that faces them.

    Lambert 1760: half the sum, over the edges, of the angle under which the edge is seen times the cosine between the
    floor's normal and the normal of the plane through edge and point.
    """
    total = np.zeros(points.shape[:-1])
    for a, b in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        u, v = a - points, b - points
        cross = np.cross(u, v)
        length = np.linalg.norm(cross, axis=-1)
        angle = np.arctan2(length, (u * v).sum(axis=-1))
        total += angle * cross[..., 2] / length
    return np.abs(total) / 2


TRIANGLES = {
    "overhead": [(-1.0, -0.8, 2.0), (1.2, -0.5, 2.0), (0.1, 1.0, 2.0)],
    "slanted": [(-1.0, 2.0, 0.5), (1.5, 1.5, 1.0), (0.2, 1.2, 3.0)],
    "across-the-floor": [(-2.0, 2.0, -1.0), (2.0, 2.5, -0.5), (0.3, 1.5, 2.0)],
    "thin": [(-3.0, 0.8, 1.2), (3.0, 0.9, 1.2), (3.0, 0.91, 1.2)],
    "far": [(-40.0, 60.0, 90.0), (45.0, 70.0, 80.0), (3.0, 100.0, 95.0)],
}


@CAMERAS
@pytest.mark.parametrize("name", TRIANGLES)
def test_triangle_light(name, camera, tmp_path):
    corners = np.array(TRIANGLES[name])
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    if normal @ (corners[0] - camera.target) > 0:
        corners = corners[::-1]  # area lights shine on the side of their normal
    mesh = tmp_path / "triangle.obj"
    mesh.write_text("".join(f"v {x!r} {y!r} {z!r}\n" for x, y, z in corners.tolist()) + "f 1 2 3\n")
    light = {"type": "obj", "filename": str(mesh), "face_normals": True} | coloured_light(5.0)
    statistics = render(camera, 2, floor=FLOOR, light=light)
    pattern = camera.average_over_floor(lambda points: polygon_irradiance(clip(corners), points))
    assert_radiance(statistics, 5.0 * RGB * ALBEDO / np.pi, pattern)


@CAMERAS
@pytest.mark.parametrize(
    ("scale", "height", "angle"), [(0.5, 1.0, 180), (3.0, 2.0, 180), (1.0, 2.5, 150), (1, 0.7, 90)]
)
def test_rectangle_light(scale, height, angle, camera):
    to_world = transform((scale, 0.5 * scale, 1.0), (0.2, 0.9, height), angle)
    corners = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)]) @ to_world[:3, :3].T + to_world[:3, 3]
    statistics = render(camera, 2, floor=FLOOR, light={"type": "rectangle", "to_world": to_world} | coloured_light(2.0))
    pattern = camera.average_over_floor(lambda points: polygon_irradiance(clip(corners), points))
    assert_radiance(statistics, 2.0 * RGB * ALBEDO / np.pi, pattern)


# Disks and spheres. On the axis of a disk the irradiance is pi L r^2 / (r^2 + h^2).


def disk_irradiance(radius: float, height: float, points: np.ndarray) -> np.ndarray:
    """Irradiance in the plane z = 0 from a disk of radiance 1 in the plane z = height around the z axis, facing it.

    View factor from an element to a disk in a parallel plane: J. R. Howell, "A Catalog of Radiation Heat Transfer
    Configuration Factors", B-13; on the axis it is r^2 / (r^2 + h^2).
    """
    off_axis = (points[..., :2] ** 2).sum(axis=-1)
    s = height**2 + off_axis
    return np.pi / 2 * (1 - (s - radius**2) / np.sqrt((s + radius**2) ** 2 - 4 * radius**2 * off_axis))


@CAMERAS
@pytest.mark.parametrize(("radius", "height"), [(1.0, 2.0), (0.05, 2.0), (5.0, 2.0), (30.0, 3.0)])
def test_disk_light(radius, height, camera):
    to_world = transform(radius, (0.0, 0.0, height), 180)
    statistics = render(camera, 2, floor=FLOOR, light={"type": "disk", "to_world": to_world} | coloured_light(3.0))
    pattern = camera.average_over_floor(lambda points: disk_irradiance(radius, height, points))
    assert_radiance(statistics, 3.0 * RGB * ALBEDO / np.pi, pattern)


@CAMERAS
@pytest.mark.parametrize(
    ("radius", "center"),
    [
        (1.0, (0.0, 0.0, 2.0)),
        (0.01, (0.5, 0.5, 5.0)),
        (0.2, (-1.0, 2.0, 0.3)),
        (100.0, (50.0, 20.0, 150.0)),
        (0.05, (9.2, -7.1, 12.3)),  # so far that rounding moves points of it behind others
    ],
)
def test_sphere_light(radius, center, camera):
    """A sphere of radiance L, all of it above the horizon: pi L R^2 / d^2 cos(theta)."""

    def irradiance(points):
        to_center = np.array(center) - points
        distance = np.linalg.norm(to_center, axis=-1)
        return np.pi * radius**2 * to_center[..., 2] / distance**3

    light = {"type": "sphere", "center": list(center), "radius": radius} | coloured_light(4.0)
    statistics = render(camera, 2, floor=FLOOR, light=light)
    assert_radiance(statistics, 4.0 * RGB * ALBEDO / np.pi, camera.average_over_floor(irradiance))


# Lights without surface.


@CAMERAS
@pytest.mark.parametrize("position", [(0.0, 0.0, 1.0), (0.0, 0.0, 30.0), (3.0, -1.0, 0.5), (-20.0, 5.0, 0.2)])
def test_point_light(position, camera):
    """I cos(theta) / d^2."""

    def irradiance(points):
        to_light = np.array(position) - points
        return to_light[..., 2] / np.linalg.norm(to_light, axis=-1) ** 3

    light = {"type": "point", "position": list(position), "intensity": rgb(7.0 * RGB)}
    statistics = render(camera, 2, floor=FLOOR, light=light)
    assert_radiance(statistics, 7.0 * RGB * ALBEDO / np.pi, camera.average_over_floor(irradiance))


@pytest.mark.parametrize("direction", [(0.0, 0.0, -1.0), (1.0, 2.0, -3.0), (5.0, -3.0, -0.1)])
def test_directional_light(direction):
    """E cos(theta), the same in every pixel."""
    light = {"type": "directional", "direction": list(direction), "irradiance": rgb(2.0 * RGB)}
    cosine = -direction[2] / np.linalg.norm(direction)
    assert_radiance(render(OBLIQUE, 2, floor=FLOOR, light=light), 2.0 * RGB * ALBEDO * cosine / np.pi)


CONVEX = {
    "rectangle": {"to_world": transform(2.0, x_angle_deg=20)},
    "disk": {"to_world": transform(2.0, x_angle_deg=20)},
    "cube": {"to_world": transform(0.5, x_angle_deg=30)},
    "sphere": {"radius": 0.7},
    "cylinder": {"p0": [0.0, 0.4, -3.0], "p1": [0.0, 0.4, 3.0], "radius": 0.5},
}


@pytest.mark.parametrize("albedo", [0.3, 1.0])
@pytest.mark.parametrize("shape", CONVEX)
def test_constant_environment(shape, albedo):
    """A convex diffuse surface under the same radiance from all directions: a L, at any depth."""
    light = {"type": "constant", "radiance": rgb(0.25 * RGB)}
    body = {"type": shape, "bsdf": diffuse(albedo * np.array([1.0, 0.5, 0.2]))} | CONVEX[shape]
    camera = Camera((0.2, -3.0, 0.9), (0.0, 0.0, 0.0))
    statistics = render(camera, 6, body=body, light=light)
    assert_radiance(statistics, 0.25 * RGB * albedo * np.array([1.0, 0.5, 0.2]))


@pytest.mark.parametrize("ior", [1.0001, 1.5, 2.4])
def test_glass_under_an_even_sky(ior):
    """A glass ball under the same radiance from all directions has that radiance: it neither absorbs nor emits."""
    light = {"type": "constant", "radiance": rgb(0.25 * RGB)}
    glass = {"type": "dielectric", "int_ior": ior, "ext_ior": 1.0}
    camera = Camera((0.0, -3.0, 0.2), (0.1, 0.0, 0.1), tangent=0.1)
    # Seen this steeply at most 20 % stay inside at each bounce: after 100 nothing is left.
    assert_radiance(render(camera, 100, ball={"type": "sphere", "bsdf": glass}, light=light), 0.25 * RGB)


# Sides: a diffuse surface reflects on its front, twosided also on its back; an area light emits from its front.

SUN_UP = {"type": "directional", "direction": [0.3, 0.2, 1.0], "irradiance": rgb(RGB)}
SUN_DOWN = {"type": "directional", "direction": [0.3, 0.2, -1.0], "irradiance": rgb(RGB)}
BELOW = Camera((0.3, -2.0, -1.5), (0.0, 0.0, 0.0))
LIT = RGB * ALBEDO / np.pi / np.linalg.norm([0.3, 0.2, 1.0])


@pytest.mark.parametrize("twosided", [False, True])
@pytest.mark.parametrize("camera", [ABOVE, BELOW], ids=["above", "below"])
@pytest.mark.parametrize("sun", [SUN_UP, SUN_DOWN], ids=["from-below", "from-above"])
def test_sides_of_a_diffuse_surface(twosided, camera, sun):
    bsdf = {"type": "twosided", "bsdf": diffuse(ALBEDO)} if twosided else diffuse(ALBEDO)
    statistics = render(camera, 4, floor=FLOOR | {"bsdf": bsdf}, sun=sun)
    if (camera is ABOVE) != (sun is SUN_DOWN) or (camera is BELOW and not twosided):
        assert (statistics.rgb == 0).all()
    else:
        assert_radiance(statistics, LIT)


@pytest.mark.parametrize("flip", [False, True])
@pytest.mark.parametrize("camera", [ABOVE, BELOW], ids=["above", "below"])
@pytest.mark.parametrize("twosided", [False, True])
def test_sides_of_an_area_light(flip, camera, twosided):
    light = {"type": "rectangle", "flip_normals": flip} | coloured_light(3.0)
    if twosided:
        light["bsdf"] = {"type": "twosided", "bsdf": diffuse(0.0)}
    statistics = render(camera, 2, light=light)
    if (camera is ABOVE) != flip:
        assert_radiance(statistics, 3.0 * RGB)
    else:
        assert (statistics.rgb == 0).all()
