"""Maps from random numbers to points of area lights: stratified numbers give stratified points.

The unit square is divided into strata. Each must get its exact share of the light, an image that is compact, and
neighbours must stay neighbours. Closed forms are evaluated in float64.
"""

from functools import cache

import numpy as np
import pytest
from kernel_build import build_kernels

from isonoise.device.opencl import Device
from isonoise.scene import compile_scene, load_description
from isonoise.scene.mesh.triangle_records import triangle_records

GRID, STRATA = 256, 16
LAST = 1 - 2.0**-24  # largest random number
KERNEL = """
#include "light/light.h"

__kernel void sample(__global const Triangle* triangles, __global const Analytic* analytics,
                     __global const Shape* shapes, __global const Light* lights, __global const float* reference,
                     __global const float* numbers, __global float* out, uint n)
{
    const uint i = get_global_id(0);
    if (i >= n) return;
    SceneView scene;
    scene.triangles = triangles;
    scene.analytics = analytics;
    scene.shapes = shapes;
    scene.lights = lights;
    Surface s = empty_surface();
    const Light light = Light_at(lights, 0);
    const Vec2 u = vec2(numbers[2 * i], numbers[2 * i + 1]);
    const float density = sample_surface(&scene, &light, LOAD3(0, reference), u, &s);
    STORE3(s.position, 0, out + 4 * i);
    out[4 * i + 3] = density > 0.0f ? density : 1.0f / light.area;
}
"""
SKEWED = np.array([[0, 0, 0], [2, 0.5, 0], [2.5, 1.5, 1], [0.5, 1, 1.0]])  # a parallelogram, in order around it
SPHERE = {"type": "sphere", "radius": 0.5}


def mesh(vertices, *faces) -> dict:
    return {"type": "mesh", "vertices": np.array(vertices, float), "faces": np.array(faces), "face_normals": True}


SHAPES = {  # shape, reference point
    "triangle": (mesh([[0, 0, 0], [2, 0, 0], [0.5, 1, 0]], [0, 1, 2]), (0, 0, 3)),
    "rectangle": ({"type": "rectangle"}, (0, 0, 3)),
    "parallelogram": (mesh(SKEWED, [1, 2, 0], [3, 0, 2]), (0, 0, 3)),
    "disk": ({"type": "disk"}, (0, 0, 3)),
    "cylinder": ({"type": "cylinder"}, (3, 0, 0)),
    "sphere": (SPHERE, (0.3, 0.4, 2.0)),
    "near sphere": (SPHERE, (0.0, 0.0, 0.55)),
    "far sphere": (SPHERE, (3e3, 4e3, 1e3)),
    "sphere from within": (SPHERE | {"flip_normals": True}, (0.1, 0.0, 0.0)),
}


class LightWarp:
    """Samples the light of a scene that has one."""

    def __init__(self, name: str):
        shape, self.reference = SHAPES[name]
        scene = {"type": "scene", "sensor": {"type": "perspective"}}
        scene["lamp"] = shape | {"emitter": {"type": "area", "radiance": 1.0}}
        self.scene = compile_scene(load_description(scene))
        assert len(self.scene.lights) == 1
        self.device = Device()
        area = ["AREA_LIGHTS", "TRIANGLES", "ANALYTICS", "SPHERES", "DISKS", "CYLINDERS", "NEXT_EVENT"]
        kinds = ["TRIANGLE_LIGHTS", "PARALLELOGRAM_LIGHTS", "SPHERE_LIGHTS", "DISK_LIGHTS", "CYLINDER_LIGHTS"]
        self.kernel = build_kernels(self.device, KERNEL, area + kinds)["sample"]

    def run(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points (..., 3) and pdfs (...,), in solid angle or area, of numbers (..., 2)."""
        numbers = u.astype(np.float32).reshape(-1, 2)
        arrays = (triangle_records(self.scene), self.scene.analytics, self.scene.shapes, self.scene.lights)
        arrays += (np.array(self.reference, np.float32), numbers)
        buffers = [self.device.buffer(array, "inputs") if array.size else None for array in arrays]
        out = self.device.buffer(16 * len(numbers), "results")
        self.device.launch(self.kernel, len(numbers), (*buffers, out, np.uint32(len(numbers))))
        found = self.device.read(out, np.float32, 4 * len(numbers)).astype(np.float64).reshape(*u.shape[:-1], 4)
        return found[..., :3], found[..., 3]


@cache
def light_warp(name: str) -> LightWarp:
    return LightWarp(name)


def grid(steps: np.ndarray) -> np.ndarray:
    """All pairs (n, n, 2) of numbers."""
    return np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1)


def areas(corners: np.ndarray) -> np.ndarray:
    """Areas (n, n) of the quadrilaterals between corners (n + 1, n + 1, 3), as two triangles each."""
    a, b, c, d = corners[:-1, :-1], corners[1:, :-1], corners[1:, 1:], corners[:-1, 1:]
    return 0.5 * sum(np.linalg.norm(np.cross(y - x, z - x), axis=-1) for x, y, z in ((a, b, c), (a, c, d)))


def by_stratum(cells: np.ndarray) -> np.ndarray:
    """Values (STRATA^2, cells of a stratum) of a (GRID, GRID) array."""
    side = GRID // STRATA
    return cells.reshape(STRATA, side, STRATA, side).swapaxes(1, 2).reshape(STRATA**2, side**2)


def diameters(corners: np.ndarray, strata: int) -> np.ndarray:
    """Diagonals (strata^2,) of the bounding boxes of the strata's images."""
    side, windows = GRID // strata, np.lib.stride_tricks.sliding_window_view
    blocks = windows(corners, (side + 1, side + 1), axis=(0, 1))[::side, ::side]
    return np.linalg.norm(np.ptp(blocks, axis=(3, 4)), axis=-1).ravel()


FLAT = ("triangle", "rectangle", "parallelogram", "disk", "cylinder", "sphere from within")


@pytest.mark.parametrize("name", FLAT)
def test_strata_get_their_share_of_the_area(name):
    """To 1 %, except along diagonals where a cell of the grid is folded, and where a sphere's cells are far from flat:
    the fold or the point opposite the disk's centre is in at most 1 in 16 strata.
    """
    warp = light_warp(name)
    corners, pdf = warp.run(grid(np.minimum(np.arange(GRID + 1) / GRID, LAST)))
    shares = by_stratum(areas(corners) * pdf[:-1, :-1]).sum(axis=1) * STRATA**2
    assert shares.sum() / STRATA**2 == pytest.approx(1, abs=0.01)
    assert (np.abs(shares - 1) > 0.01).sum() <= (4 * STRATA if name == "sphere from within" else STRATA)


@pytest.mark.parametrize("name", [name for name in SHAPES if "sphere" in name and "within" not in name])
def test_strata_get_their_share_of_the_cone(name):
    """The cosines at the reference point and the azimuth, in float64, are those of the map to the disk: r^2 is uniform
    in [0, 1], and the density in solid angle is constant.
    """
    warp = light_warp(name)
    u = np.random.default_rng(3).integers(0, 2**24, (20000, 2)) / 2.0**24
    points, pdf = warp.run(u)
    to_center = -np.array(warp.reference, np.float32).astype(np.float64)
    distance2 = (to_center**2).sum()
    sin2 = 0.5**2 / distance2
    cone = sin2 / (1 + np.sqrt(1 - sin2))
    np.testing.assert_allclose(pdf, 1 / (2 * np.pi * cone), rtol=1e-6)
    x, y = 2 * u.T - 1
    larger = np.maximum(np.abs(x), np.abs(y))
    r2 = larger**2
    # 1 - cos of the angle at the reference point, from the point's distance to the axis and along it
    arm = points + to_center
    along = arm @ to_center / np.sqrt(distance2)
    across2 = (np.cross(points, to_center) ** 2).sum(axis=1) / distance2
    one_minus_cos = across2 / (along**2 + across2) / (1 + along / np.sqrt(along**2 + across2))
    # a point has 2^-24 of its coordinates, which moves its distance to the axis by that of the radius
    error = 1e-6 + 2e-6 * 0.5 / np.maximum(np.sqrt(across2), 1e-9)
    assert (np.abs(one_minus_cos / cone - r2) <= 4 * error * r2 + 1e-6).all()
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), 0.5, rtol=1e-6)
    assert (points @ to_center <= 0).all()  # on the side of the reference point


@pytest.mark.parametrize("name", SHAPES)
def test_strata_are_connected_and_compact(name):
    """Where strata are halved, their mean diameter falls by 0.65 or less; within one, neighbours stay neighbours."""
    warp = light_warp(name)
    corners, _ = warp.run(grid(np.minimum(np.arange(GRID + 1) / GRID, LAST)))
    mean = np.array([diameters(corners, strata).mean() for strata in (4, 8, 16, 32)])
    assert (mean[1:] <= 0.65 * mean[:-1]).all()
    along = np.linalg.norm(np.diff(corners, axis=0), axis=-1)[:, :-1]
    across = np.linalg.norm(np.diff(corners, axis=1), axis=-1)[:-1]
    steps = by_stratum(np.maximum(along, across)).max(axis=1) / diameters(corners, STRATA)
    # at the rim of the disk that becomes a sphere, a step may be as long as half a stratum
    assert (steps > 0.6).sum() <= (4 * STRATA if name == "sphere from within" else 0)


@pytest.mark.parametrize("name", ["rectangle", "parallelogram"])
def test_a_parallelogram_is_an_affine_image_of_the_square(name):
    """To rounding, on both sides of the diagonal."""
    warp = light_warp(name)
    u = np.random.default_rng(4).integers(0, 2**24, (20000, 2)) / 2.0**24
    points, _ = warp.run(u)
    terms = np.concatenate([np.ones((len(u), 1)), u], axis=1)
    weights, *_ = np.linalg.lstsq(terms, points, rcond=None)
    assert np.abs(terms @ weights - points).max() < 1e-6
    assert np.linalg.norm(np.cross(weights[1], weights[2])) == pytest.approx(warp.scene.lights["area"][0], rel=1e-5)


def test_the_map_to_a_triangle_is_heitzs():
    """Closed form: u halved towards the diagonal."""
    warp = light_warp("triangle")
    u = np.random.default_rng(5).integers(0, 2**24, (20000, 2)) / 2.0**24
    points, _ = warp.run(u)
    x, y = u.T
    second, third = np.where(y > x, (x / 2, y - x / 2), (x - y / 2, y / 2))
    a, b, c = warp.scene.vertices[warp.scene.faces[0]].astype(float)
    expected = a + np.outer(second, b - a) + np.outer(third, c - a)
    assert np.abs(points - expected).max() < 1e-6
