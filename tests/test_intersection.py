"""The intersect stage and the hierarchy against brute force in float64, and rays that must not leak."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from planes import as_planes, read_rows

from isonoise.device.opencl import Device
from isonoise.integrator.kernel_table import KERNELS, STRUCTS
from isonoise.integrator.stages import Stages
from isonoise.scene import structs
from isonoise.scene.accel.bounds import analytic_bounds
from isonoise.scene.accel.bvh import BVH_WIDTH, build_bvh

FEATURES = dict.fromkeys(("TRIANGLES", "ANALYTICS", "SPHERES", "DISKS", "CYLINDERS"), True)
FEATURES |= dict.fromkeys(("INSTANCES", "COUNT_TESTS"), False)
ANALYTIC_BIT = 0x80000000


def intersect(bvh, origins, directions, analytics=None, t_max=np.inf):
    """t and primitive of the closest hit of every ray, (n,) each; NONE where there is none."""
    return traced(bvh, origins, directions, analytics, t_max)[:2]


def traced(bvh, origins, directions, analytics=None, t_max=np.inf, count_tests=False):
    """The same, and the nodes and blocks that each ray was tested against, (n, 2), where they are to be counted."""
    device = Device()
    features = FEATURES | {"COUNT_TESTS": count_tests}
    stages = Stages(device, {"intersect": KERNELS["intersect"]}, features, structs.CONSTANTS, STRUCTS)
    n = len(origins)
    rays = np.empty((2, n, 4), np.float32)
    rays[0, :, :3], rays[0, :, 3] = origins, t_max
    rays[1, :, :3], rays[1, :, 3] = directions, 0
    buffers = {
        "nodes": bvh.nodes,
        "blocks": bvh.blocks,
        "analytics": np.zeros(0, structs.ANALYTIC) if analytics is None else analytics,
        "ray_origin": as_planes(rays[0]),
        "ray_direction": as_planes(rays[1]),
        "path": np.full((4, n), structs.NONE, np.uint32),  # no ray starts on a primitive
        "hit": np.zeros((4, n), np.float32),
        "tests": np.zeros((n, 2), np.uint32),
    }
    b = {name: device.buffer(array, name) if array.size else None for name, array in buffers.items()}
    counts = {"path_count": n, "plane_stride": n, "rays_per_item": 7, "first_analytic": bvh.first_analytic}
    stages.launch("intersect", n, **b, **{name: np.uint32(value) for name, value in counts.items()})
    found = read_rows(device, b["hit"], n, 4)
    return found[:, 0], found[:, 3].copy().view(np.uint32), device.read(b["tests"], np.uint32, 2 * n).reshape(n, 2)


def no_analytics():
    return np.zeros((0, 3), np.float32), np.zeros((0, 3), np.float32)


def brute_force(corners, origins, directions):
    """Moeller and Trumbore in float64, every ray against every triangle: t and triangle of the closest hit."""
    a, b, c = corners.astype(np.float64).transpose(1, 0, 2)
    best, which = np.full(len(origins), np.inf), np.full(len(origins), structs.NONE, np.uint32)
    with np.errstate(divide="ignore", invalid="ignore"):
        for i, (o, d) in enumerate(zip(origins.astype(np.float64), directions.astype(np.float64), strict=True)):
            p = np.cross(d, c - a)
            det = np.einsum("ij,ij->i", b - a, p)
            s = o - a
            u = np.einsum("ij,ij->i", s, p) / det
            q = np.cross(s, b - a)
            v = q @ d / det
            t = np.einsum("ij,ij->i", c - a, q) / det
            t = np.where((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0), t, np.inf)
            if len(t) and t.min() < np.inf:
                best[i], which[i] = t.min(), t.argmin()
    return best, which


@pytest.mark.parametrize(("triangles", "size"), [(1, 1.0), (8, 1.0), (9, 1.0), (300, 0.3), (5000, 0.05)])
def test_closest_hit_against_brute_force(triangles, size):
    random = np.random.default_rng(triangles)
    corners = (random.uniform(-1, 1, (triangles, 1, 3)) + size * random.standard_normal((triangles, 3, 3))).astype("f4")
    origins = random.uniform(-2, 2, (2000, 3)).astype(np.float32)
    directions = random.standard_normal((2000, 3)).astype(np.float32)
    t, which = intersect(build_bvh(corners, *no_analytics()), origins, directions)
    expected_t, expected = brute_force(corners, origins, directions)
    # rays within float32's rounding of an edge may differ; so may the order of two surfaces nearly as far
    same = which == expected
    assert same.mean() >= 0.998
    assert np.array_equal(np.isinf(t[same]), expected[same] == structs.NONE)
    hit = same & (expected != structs.NONE)
    assert hit.any()
    assert t[hit] == pytest.approx(expected_t[hit], rel=1e-4)
    assert np.median(np.abs(t[hit] / expected_t[hit] - 1)) < 1e-6


def test_axis_aligned_rays_and_rays_in_the_planes_of_boxes():
    box = np.asarray(trimesh.creation.box((2, 2, 2)).triangles, np.float32)
    bvh = build_bvh(box, *no_analytics())
    directions = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], np.float32)
    for offset in (0.0, 0.25, -0.999, 1.0):
        origins = np.where(directions == 0, np.float32(offset), -3 * directions)
        t, which = intersect(bvh, origins, directions)
        assert t == pytest.approx(2, rel=1e-6)
        assert (which < len(box)).all()
    t, _ = intersect(bvh, np.where(directions == 0, np.float32(1.01), -3 * directions), directions)
    assert np.isinf(t).all()


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize("offset", [0.0, 1.0])
def test_no_ray_leaks_through_edges_and_vertices_of_a_closed_mesh(scale, offset):
    """From inside, towards every vertex, along every edge and at random: each ray has to hit."""
    mesh = trimesh.creation.icosphere(subdivisions=4)
    vertices = ((mesh.vertices + offset) * scale).astype(np.float32)
    corners = vertices[mesh.faces]
    random = np.random.default_rng(11)
    center = np.float32(offset * scale)
    pairs = vertices[mesh.edges_unique]
    weight = random.uniform(size=(len(pairs), 1)).astype(np.float32)
    targets = np.concatenate([vertices, weight * pairs[:, 0] + (1 - weight) * pairs[:, 1], corners.mean(axis=1)])
    inside = center + 0.5 * scale * random.uniform(-1, 1, (10, 3)).astype(np.float32)
    bvh = build_bvh(corners, *no_analytics())
    for origin in inside.astype(np.float32):
        t, which = intersect(bvh, np.broadcast_to(origin, targets.shape), targets - origin)
        assert (which != structs.NONE).all()
        assert t == pytest.approx(1, rel=1e-3)


@pytest.mark.parametrize("distance", [0.0, 1.0, 1e4, 1e7])
def test_boxes_lose_no_hit(distance):
    """Against the same triangles in boxes without end. Corners on a grid and directions with components of zero and
    nearly so: rays start on, and run in, the planes of boxes."""
    random = np.random.default_rng(5)
    mesh = trimesh.creation.icosphere(subdivisions=4)
    bvh = build_bvh((np.round(8 * mesh.vertices) / 8).astype(np.float32)[mesh.faces], *no_analytics())
    nodes = bvh.nodes.copy()
    nodes[:, 0:3][np.isfinite(nodes[:, 0:3])] = -3e38
    nodes[:, 3:6][np.isfinite(nodes[:, 3:6])] = 3e38
    directions = random.standard_normal((20000, 3))
    directions *= random.choice([1, 1, 1, 0, 1e-20, 1e-42], directions.shape)
    directions[:, 0] += np.where((np.abs(directions) < 1e-3).all(axis=1), 1, 0)
    directions = directions.astype(np.float32)
    targets = np.round(8 * random.uniform(-1.1, 1.1, (20000, 3))) / 8
    origins = (targets - distance * directions).astype(np.float32)
    t, _ = intersect(bvh, origins, directions)
    expected, _ = intersect(replace(bvh, nodes=nodes), origins, directions)
    assert 0.2 < np.isfinite(expected).mean() < 0.99
    assert np.array_equal(t, expected)


def test_tests_are_counted():
    """Nine triangles apart from each other: one block holds eight, so a ray through the root and one of two blocks."""
    near = np.array([[0, 0, 5], [1, 0, 5], [0, 1, 5]], np.float32)
    corners = near + np.array([[4 * i, 0, 0] for i in range(9)], np.float32)[:, None]
    bvh = build_bvh(corners, *no_analytics())
    origins = np.array([[0.1, 0.1, 0], [0.1, 0.1, 9]], np.float32)
    _, which, tests = traced(bvh, origins, np.array([[0, 0, 1], [0, 0, 1]], np.float32), count_tests=True)
    assert which.tolist() == [0, structs.NONE]
    assert tests.tolist() == [[1, 1], [1, 0]]


def test_hits_respect_the_length_of_the_ray():
    triangle = np.array([[[-9, -9, 5], [9, -9, 5], [0, 9, 5]]], np.float32)
    bvh = build_bvh(triangle, *no_analytics())
    ray = np.zeros((2, 3), np.float32), np.array([[0, 0, 1], [0, 0, 2]], np.float32)
    t, which = intersect(bvh, *ray, t_max=4.0)
    assert which.tolist() == [structs.NONE, 0]
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
    t, which = intersect(
        build_bvh(np.zeros((0, 3, 3), np.float32), *analytic_bounds(records)), origins, directions, records
    )
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
    assert np.array_equal(which[hit], ANALYTIC_BIT | expected.argmin(axis=1)[hit].astype(np.uint32))
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
    smooth, _ = intersect(
        build_bvh(np.zeros((0, 3, 3), np.float32), *analytic_bounds(record)), origins, directions, record
    )
    flat, _ = intersect(build_bvh(corners, *no_analytics()), origins, directions)
    assert np.isfinite(flat).sum() > 500
    # the tessellation lies inside by 1 - cos(pi / 4096) = 3e-7 of the radius: only grazing rays can tell
    same = np.isfinite(smooth) == np.isfinite(flat)
    assert same.mean() > 0.9995
    both = np.isfinite(smooth) & np.isfinite(flat)
    assert (np.abs(smooth[both] / flat[both] - 1) < 1e-3).mean() > 0.9995


def test_mixed_scene_finds_the_nearer_of_both_kinds():
    triangle = np.array([[[-9, -9, 5], [9, -9, 5], [0, 9, 5]]], np.float32)
    record = analytic(structs.ANALYTIC_SPHERE, center=(0, 0, 10), radius=1)
    bvh = build_bvh(triangle, *analytic_bounds(record))
    origins = np.array([[0, 0, 0], [0, 0, 20], [0, 0, 10]], np.float32)
    directions = np.array([[0, 0, 1], [0, 0, -1], [0, 0, -1]], np.float32)
    t, which = intersect(bvh, origins, directions, record)
    assert which.tolist() == [0, ANALYTIC_BIT, ANALYTIC_BIT]
    assert t == pytest.approx([5, 9, 1])


def test_empty_scene_is_missed():
    bvh = build_bvh(np.zeros((0, 3, 3), np.float32), *no_analytics())
    t, which = intersect(bvh, *random_rays(100, 6))
    assert (which == structs.NONE).all()
    assert np.isinf(t).all()


@pytest.mark.parametrize("corners", ["equal", "line", "nested", "flat"])
def test_hierarchy_of_degenerate_geometry_holds_every_triangle(corners):
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
    bvh = build_bvh(soup, *no_analytics())
    ids = bvh.blocks[:, 9].view(np.uint32).ravel()
    assert np.array_equal(np.sort(ids[ids != structs.NONE]), np.arange(n))
    assert bvh.stack <= 256


def test_hierarchy_of_a_fine_mesh_is_full_and_shallow():
    mesh = trimesh.creation.icosphere(subdivisions=6)
    bvh = build_bvh(np.asarray(mesh.triangles, np.float32), *no_analytics())
    filled = len(mesh.faces) / (BVH_WIDTH * len(bvh.blocks))
    assert filled > 0.6
    assert bvh.depth <= 10
