"""The kernel `intersect` and the BVH against brute force in float64.

The checks of `isonoise selftest` (tests/test_selftest.py) cover leaks, axis-aligned rays and the boxes of the BVH.
"""

import numpy as np
import pytest
import trimesh

from isonoise.device.opencl import Device
from isonoise.scene import structs
from isonoise.scene.accel.bvh import BVH_WIDTH, build_bvh
from isonoise.selftest.tracer import Tracer, closest_hits

NO_TRIANGLES = np.zeros((0, 3, 3), np.float32)
NO_BOUNDS = np.zeros((0, 3), np.float32), np.zeros((0, 3), np.float32)
ANALYTIC_BIT = 0x80000000


def intersect(corners, origins, directions, analytics=None, t_max=np.inf):
    """Returns t and primitive of the closest hit of every ray, (n,) each; NONE without a hit."""
    return Tracer(Device(), corners, analytics).trace(origins, directions, t_max)


@pytest.mark.parametrize(("triangles", "size"), [(1, 1.0), (8, 1.0), (9, 1.0), (300, 0.3), (5000, 0.05)])
def test_closest_hit_against_brute_force(triangles, size):
    random = np.random.default_rng(triangles)
    corners = (random.uniform(-1, 1, (triangles, 1, 3)) + size * random.standard_normal((triangles, 3, 3))).astype("f4")
    origins = random.uniform(-2, 2, (2000, 3)).astype(np.float32)
    directions = random.standard_normal((2000, 3)).astype(np.float32)
    t, primitive = intersect(corners, origins, directions)
    expected_t, expected = closest_hits(corners, origins, directions)
    # rays within float32's rounding of an edge may differ; so may the order of two surfaces nearly as far
    same = primitive == expected
    assert same.mean() >= 0.998
    assert np.array_equal(np.isinf(t[same]), expected[same] == structs.NONE)
    hit = same & (expected != structs.NONE)
    assert hit.any()
    assert t[hit] == pytest.approx(expected_t[hit], rel=1e-4)
    assert np.median(np.abs(t[hit] / expected_t[hit] - 1)) < 1e-6


def test_node_and_block_tests_are_counted():
    """Nine triangles apart from each other: a block holds eight, so a ray tests the root and one of two blocks."""
    near = np.array([[0, 0, 5], [1, 0, 5], [0, 1, 5]], np.float32)
    corners = near + np.array([[4 * i, 0, 0] for i in range(9)], np.float32)[:, None]
    tracer = Tracer(Device(), corners, count_tests=True)
    origins = np.array([[0.1, 0.1, 0], [0.1, 0.1, 9]], np.float32)
    _, primitive = tracer.trace(origins, np.array([[0, 0, 1], [0, 0, 1]], np.float32))
    assert primitive.tolist() == [0, structs.NONE]
    assert tracer.tests.tolist() == [[1, 1], [1, 0]]


def test_hits_respect_the_length_of_the_ray():
    triangle = np.array([[[-9, -9, 5], [9, -9, 5], [0, 9, 5]]], np.float32)
    ray = np.zeros((2, 3), np.float32), np.array([[0, 0, 1], [0, 0, 2]], np.float32)
    t, primitive = intersect(triangle, *ray, t_max=4.0)
    assert primitive.tolist() == [structs.NONE, 0]
    assert t[1] == 2.5


def analytic(kind, to_world=None, center=(0, 0, 0), radius=1.0):
    record = np.zeros(1, structs.ANALYTIC)
    matrix = np.eye(4) if to_world is None else np.asarray(to_world, np.float64)
    record["kind"], record["center"], record["radius"] = kind, center, radius
    record["to_world"], record["to_object"] = matrix[:3].ravel(), np.linalg.inv(matrix)[:3].ravel()
    return record


def random_rays(n, seed, spread=3.0):
    random = np.random.default_rng(seed)
    return random.uniform(-spread, spread, (n, 3)).astype(np.float32), random.standard_normal((n, 3)).astype(np.float32)


def test_spheres_against_float64():
    centers = np.random.default_rng(3).uniform(-2, 2, (20, 3)).astype(np.float32)
    records = np.concatenate(
        [analytic(structs.ANALYTIC_SPHERE, center=c, radius=0.2 + 0.02 * i) for i, c in enumerate(centers)]
    )
    origins, directions = random_rays(5000, 4)
    t, primitive = intersect(NO_TRIANGLES, origins, directions, records)
    o, d = origins.astype(np.float64)[:, None], directions.astype(np.float64)[:, None]
    f, r = o - records["center"], records["radius"].astype(np.float64)
    a, b, c = (d * d).sum(-1), (f * d).sum(-1), (f * f).sum(-1) - r * r
    root = np.sqrt(np.where(b * b - a * c >= 0, b * b - a * c, np.nan))
    near, far = (-b - root) / a, (-b + root) / a
    expected = np.where(near > 0, near, np.where(far > 0, far, np.inf))  # nan compares false: a miss
    best = expected.min(axis=1)
    hit = np.isfinite(best)
    assert hit.sum() > 500
    assert np.array_equal(np.isfinite(t), hit)
    assert np.array_equal(primitive[hit], ANALYTIC_BIT | expected.argmin(axis=1)[hit].astype(np.uint32))
    assert t[hit] == pytest.approx(best[hit], rel=1e-4)


@pytest.mark.parametrize("kind", [structs.ANALYTIC_DISK, structs.ANALYTIC_CYLINDER])
def test_disk_and_cylinder_agree_with_their_tessellation(kind):
    """Under a transform with rotation, mirror and non-uniform scale, against 4096 flat pieces."""
    matrix = np.eye(4)
    matrix[:3, :3] = np.array([[0.8, -0.6, 0], [0.6, 0.8, 0], [0, 0, 1]]) @ np.diag([1.5, -0.7, 1.2])
    matrix[:3, 3] = 0.3, -0.2, 0.1
    angle = np.linspace(0, 2 * np.pi, 4097)
    ring = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)
    a, b, up = ring[:-1], ring[1:], np.array([0, 0, 1.0])
    if kind == structs.ANALYTIC_DISK:
        corners = np.stack([np.zeros_like(a), a, b], axis=1)
    else:
        corners = np.concatenate([np.stack([a, b, b + up], axis=1), np.stack([a, b + up, a + up], axis=1)])
    corners = (corners @ matrix[:3, :3].T + matrix[:3, 3]).astype(np.float32)
    record = analytic(kind, matrix)
    origins, directions = random_rays(20000, 5, spread=2.0)
    smooth, _ = intersect(NO_TRIANGLES, origins, directions, record)
    flat, _ = intersect(corners, origins, directions)
    assert np.isfinite(flat).sum() > 500
    # the tessellation lies inside by 1 - cos(pi / 4096) = 3e-7 of the radius: only grazing rays can tell
    same = np.isfinite(smooth) == np.isfinite(flat)
    assert same.mean() > 0.9995
    both = np.isfinite(smooth) & np.isfinite(flat)
    assert (np.abs(smooth[both] / flat[both] - 1) < 1e-3).mean() > 0.9995


def test_the_nearer_of_triangle_and_sphere_is_hit():
    triangle = np.array([[[-9, -9, 5], [9, -9, 5], [0, 9, 5]]], np.float32)
    record = analytic(structs.ANALYTIC_SPHERE, center=(0, 0, 10), radius=1)
    origins = np.array([[0, 0, 0], [0, 0, 20], [0, 0, 10]], np.float32)
    directions = np.array([[0, 0, 1], [0, 0, -1], [0, 0, -1]], np.float32)
    t, primitive = intersect(triangle, origins, directions, record)
    assert primitive.tolist() == [0, ANALYTIC_BIT, ANALYTIC_BIT]
    assert t == pytest.approx([5, 9, 1])


def test_an_empty_scene_has_no_hits():
    t, primitive = intersect(NO_TRIANGLES, *random_rays(100, 6))
    assert (primitive == structs.NONE).all()
    assert np.isinf(t).all()


@pytest.mark.parametrize("corners", ["equal", "line", "nested", "flat"])
def test_bvh_of_degenerate_geometry_holds_every_triangle(corners):
    random = np.random.default_rng(9)
    n = 5000
    soup = random.uniform(size=(n, 3, 3)).astype(np.float32)
    if corners == "equal":
        soup[:] = soup[0]
    elif corners == "line":
        soup = np.zeros((n, 3, 3), np.float32)
        soup[:, :, 0] = np.geomspace(1e-30, 1e30, n)[:, None]
    elif corners == "nested":
        soup = (random.uniform(-1, 1, (1, 3, 3)) * np.geomspace(1e-6, 1e6, n)[:, None, None]).astype(np.float32)
    else:
        soup[:, :, 2] = 0
    bvh = build_bvh(soup, *NO_BOUNDS)
    ids = bvh.blocks[:, 9].view(np.uint32).ravel()
    assert np.array_equal(np.sort(ids[ids != structs.NONE]), np.arange(n))
    assert bvh.stack <= 256


def test_bvh_of_a_fine_mesh_is_full_and_shallow():
    mesh = trimesh.creation.icosphere(subdivisions=6)
    bvh = build_bvh(np.asarray(mesh.triangles, np.float32), *NO_BOUNDS)
    filled = len(mesh.faces) / (BVH_WIDTH * len(bvh.blocks))
    assert filled > 0.6
    assert bvh.depth <= 10
