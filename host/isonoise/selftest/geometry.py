"""Checks of single rays: closed meshes do not leak and hits are exact, at any scale, with both intersection methods.

A distance comes from three edge functions and three depths along the ray; each rounds by some 2^-24 of the largest
coordinate relative to the ray's origin. The tolerance of a distance is 16 such roundings.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import wraps

import numpy as np

from isonoise.scene import structs
from isonoise.selftest.cases import Case, Check, Context, array_case, count_case
from isonoise.selftest.tracer import BRUTE_FORCE, BVH, Tracer, closest_hits, icosphere, methods, unique_edges

NONE = structs.NONE
STEP = 2.0**-24
RAYS, THOROUGH_RAYS, RAYS_PER_LAUNCH = 2**21, 10**8, 2**19
SMALL_RAYS = 2**19
"""Rays through the edges of tiny and of huge meshes."""
NO_LEAK = "no ray may get through a closed mesh"


def _by_each_method(check: Callable[[Context, str], Iterator[Case]]) -> Check:
    """Runs a check with each intersection method of the device."""

    @wraps(check)
    def run(context: Context) -> Iterator[Case]:
        for method in methods(context.device):
            yield from check(context, method)

    return run


@_by_each_method
def leaks(context: Context, method: str) -> Iterator[Case]:
    """Rays from inside a rough ball towards vertices, points of edges, and points near them by rounding."""
    rays = THOROUGH_RAYS if context.thorough else RAYS
    for scale, size_name, n in ((1.0, "", rays), (1e-6, ", size 10^-6", SMALL_RAYS), (1e6, ", size 10^6", SMALL_RAYS)):
        random = np.random.default_rng(11)
        vertices, faces = icosphere(0 if method == BRUTE_FORCE else 4)
        vertices = vertices * random.uniform(0.97, 1.03, (len(vertices), 1)) + 0.3
        vertices = (scale * vertices).astype(np.float32)
        tracer, edges = Tracer(context.device, vertices[faces], method=method), unique_edges(faces)
        missed = off = 0
        for begin in range(0, n, RAYS_PER_LAUNCH):
            origins, targets = _rays_to_edges(random, vertices, edges, min(RAYS_PER_LAUNCH, n - begin), scale)
            t, primitive = tracer.trace(origins, targets - origins)
            missed += np.count_nonzero(primitive == NONE)
            off += np.count_nonzero(~(np.abs(t - 1) < 1e-4))
        name = f"{n:,} rays to edges and vertices of {len(faces):,} triangles, {method}{size_name}"
        yield count_case(f"{name}: leaked", missed, NO_LEAK)
        yield count_case(f"{name}: ended more than 10^-4 off the edge", off, "none: the surface is closed")


def _rays_to_edges(random, vertices, edges, n: int, scale: float) -> tuple[np.ndarray, np.ndarray]:
    """Returns origins and targets (n, 3); a third of the targets are vertices, a third are random points of edges."""
    origins = (scale * (0.3 + random.uniform(-0.3, 0.3, (n, 3)))).astype(np.float32)
    edge = edges[random.integers(len(edges), size=n)]
    weight = random.choice([0.0, 1.0, 0.5, -1.0], (n, 1)).astype(np.float32)
    weight = np.where(weight < 0, random.uniform(size=(n, 1)).astype(np.float32), weight)
    return origins, weight * vertices[edge[:, 0]] + (1 - weight) * vertices[edge[:, 1]]


def _random_rotation(random) -> np.ndarray:
    """Returns a matrix (3, 3)."""
    return np.linalg.qr(random.standard_normal((3, 3)))[0]


@_by_each_method
def needles(context: Context, method: str) -> Iterator[Case]:
    """A strip of 8 needles, 1 long and 10^-6 wide, at random angles; rays through it, also on the edges between them.

    No ray may miss. But the weights of a needle's corners are areas that round by 2^-24, over its own area: along the
    needle, whose depth may change by its length, the hit is off by 2^-24 / 10^-6 of that. A limit of float32.
    """
    random = np.random.default_rng(12)
    missed, distances, n = 0, [], 20_000
    for _ in range(4):
        rotation, width = _random_rotation(random), 1e-6
        left = np.stack([np.arange(5) * 2 * width, np.zeros(5), np.zeros(5)], axis=1)
        right = left + np.array([width, 1.0, 0.0])
        strip = []
        for k in range(4):
            strip += [(left[k], left[k + 1], right[k]), (right[k], left[k + 1], right[k + 1])]
        corners = (np.array(strip) @ rotation.T).astype(np.float32)
        tracer = Tracer(context.device, corners, method=method)
        # at least half a needle from the strip's border; the rounding of corners moves that by a tenth of one
        y = random.uniform(0.05, 0.95, n)
        x = width * (y + random.choice([1.0, 2, 3, 4, 5, 6, 7, -1], n))
        x = np.where(x < width * y, width * (y + random.uniform(0.5, 7.5, n)), x)
        targets = np.stack([x, y, np.zeros(n)], axis=1) @ rotation.T
        directions = (rotation @ (0.2, 0.1, -1.0)).astype(np.float32)
        origins = (targets - directions.astype(float)).astype(np.float32)
        t, primitive = tracer.trace(origins, np.broadcast_to(directions, origins.shape))
        missed += np.count_nonzero(primitive == NONE)
        distances.append(t[primitive != NONE])
    name, basis = f"80,000 rays through needles 1:10^6, {method}", "2^-24 over the needle's area, 10^-6"
    yield count_case(f"{name}: missed", missed, "no ray may get between neighbours")
    yield array_case(f"{name}: distance (a limit)", np.concatenate(distances), 1, STEP / 1e-6, basis)


@_by_each_method
def degenerate_triangles(context: Context, method: str) -> Iterator[Case]:
    """Triangles without area, alone and among others, and duplicate triangles."""
    random, n = np.random.default_rng(13), 20_000
    soup = random.uniform(-1, 1, (8, 3, 3)).astype(np.float32)
    points, lines, doubled_corners = np.repeat(soup[:, :1], 3, axis=1), soup.copy(), soup.copy()
    lines[:, 2] = 0.5 * (lines[:, 0] + lines[:, 1])
    doubled_corners[:, 1] = doubled_corners[:, 0]
    origins = random.uniform(-2, 2, (n, 3)).astype(np.float32)
    weights = random.dirichlet((1, 1, 1), n)
    targets = (weights[:, None] @ soup[random.integers(8, size=n)].astype(float))[:, 0]
    targets[: n // 4] = (weights[: n // 4, None] @ lines[random.integers(8, size=n // 4)].astype(float))[:, 0]
    directions = (targets - origins).astype(np.float32)

    def trace(*triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return Tracer(context.device, np.concatenate(triangles), method=method).trace(origins, directions)

    _, primitive = trace(points, lines, doubled_corners)
    # a line of three rounded points has some area: 2^-24 of its length wide
    hit = (primitive < 8) | ((primitive >= 16) & (primitive < 24))
    yield count_case(f"20,000 rays at points and doubled corners, {method}: hits", hit, "they have no area")
    t, primitive = trace(soup)
    mixed_t, mixed_primitive = trace(points, soup, doubled_corners)
    changed = (mixed_t != t) | (mixed_primitive != np.where(primitive == NONE, NONE, primitive + 8))
    name = f"20,000 rays at triangles, {method}: hits that triangles without area change"
    yield count_case(name, changed, "exact")
    twice_t, twice_primitive = trace(soup, soup)
    same = (twice_t == t) & ((twice_primitive == NONE) == (primitive == NONE))
    same &= (primitive == NONE) | (twice_primitive % 8 == primitive)
    yield count_case(f"20,000 rays at duplicate triangles, {method}: hits that differ from single ones", ~same, "exact")
    expected, _ = closest_hits(soup, origins, directions)
    differing = np.count_nonzero((np.isfinite(expected) != np.isfinite(t))[n // 4 :])  # the others are aimed at edges
    basis = "10^-4 of the rays: so many are within rounding of an edge"
    yield Case(f"20,000 rays at triangles, {method}: hits that differ from float64", differing, 0, n * 1e-4, basis)


@_by_each_method
def coplanar_triangles(context: Context, method: str) -> Iterator[Case]:
    """Two triangles that overlap in one plane and share no corner: either may be hit, at the plane's distance."""
    random, n = np.random.default_rng(15), 20_000
    corners = np.array([[-1, -1], [1, -1], [0, 1], [-1, 1], [0, -1], [1, 1]], float)
    rotation = _random_rotation(random)
    plane = np.concatenate([corners, np.zeros((6, 1))], axis=1) @ rotation.T
    tracer = Tracer(context.device, plane.reshape(2, 3, 3), method=method)
    points = np.concatenate([random.uniform(-0.2, 0.2, (n, 2)), np.zeros((n, 1))], axis=1)
    targets = points @ rotation.T
    origins = (targets + rotation @ (0.3, -0.2, 2.0)).astype(np.float32)
    t, primitive = tracer.trace(origins, (targets - origins).astype(np.float32))
    yield count_case(f"20,000 rays at coplanar overlap, {method}: missed", primitive == NONE, "no ray may get through")
    yield array_case(f"20,000 rays at coplanar overlap, {method}: distance", t, 1, 16 * STEP, "16 roundings")


@_by_each_method
def scales(context: Context, method: str) -> Iterator[Case]:
    """A closed mesh and a sphere, scaled and far from the origin, against float64 on the rounded corners."""
    random = np.random.default_rng(14)
    ball, faces = icosphere(0 if method == BRUTE_FORCE else 2)
    n = 20_000 if method == BRUTE_FORCE else 5_000
    for size_name, scale, offset in (
        ("size 10^-6", 1e-6, 0.0),
        ("size 10^6", 1e6, 0.0),
        ("10^6 from the origin", 1.0, 1e6),
        ("size 10^-6 at 1", 1e-6, 1.0),
    ):
        name, basis = f"{size_name}, {method}", "16 roundings: coordinates are relative to the ray's origin"
        vertices = (scale * ball + offset).astype(np.float32)
        record = np.zeros(1, structs.ANALYTIC)
        record["kind"], record["center"], record["radius"] = structs.ANALYTIC_SPHERE, offset, scale
        origins = (offset + scale * random.uniform(-0.3, 0.3, (n, 3))).astype(np.float32)
        directions = random.standard_normal((n, 3))
        directions = (scale * directions / np.linalg.norm(directions, axis=1, keepdims=True)).astype(np.float32)
        t, primitive = Tracer(context.device, vertices[faces], method=method).trace(origins, directions)
        yield count_case(f"{name}: rays that leak out of a mesh", primitive == NONE, NO_LEAK)
        expected, _ = closest_hits(vertices[faces], origins, directions)
        hit = np.isfinite(expected)  # float64 itself misses edges
        yield array_case(f"{name}: distance to the mesh, relative", t[hit] / expected[hit], 1, 64 * STEP, basis)
        t, primitive = Tracer(context.device, np.zeros((0, 3, 3)), record, method).trace(origins, directions)
        yield count_case(f"{name}: rays that leak out of a sphere", primitive == NONE, "none allowed")
        f, d = origins.astype(float) - record["center"].astype(float), directions.astype(float)
        a, b = (d * d).sum(axis=1), (f * d).sum(axis=1)
        c = (f * f).sum(axis=1) - float(record["radius"][0]) ** 2
        expected = (-b + np.sqrt(b * b - a * c)) / a
        yield array_case(f"{name}: distance to the sphere, relative", t / expected, 1, 64 * STEP, basis)


@_by_each_method
def axis_aligned_rays(context: Context, method: str) -> Iterator[Case]:
    """A cube whose corners lie on a grid; rays along the axes and in its planes, with zeros of both signs."""
    x, y, z = np.meshgrid([-1.0, 1.0], [-1.0, 1.0], [-1.0, 1.0], indexing="ij")
    v = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    corners = np.array([[v[q[i]] for i in t] for q in quads for t in ((0, 1, 2), (0, 2, 3))])
    tracer = Tracer(context.device, corners, method=method)
    grid = np.array([-1.0, -0.999, -0.5, -0.25, 0.0, 1 / 3, 0.5, 1.0], np.float32)
    wrong = wrong_distances = rays = 0
    for zero in (0.0, -0.0, 1e-42, -1e-30):
        inside = grid if zero == 0 else grid[np.abs(grid) < 1]  # those in a side's plane would leave it
        a, b = (g.ravel() for g in np.meshgrid(inside, inside))
        for axis in range(3):
            for sign in (1, -1):
                origins, directions = np.empty((len(a), 3), np.float32), np.full((len(a), 3), zero, np.float32)
                origins[:, axis], origins[:, (axis + 1) % 3], origins[:, (axis + 2) % 3] = -3 * sign, a, b
                directions[:, axis] = sign
                t, primitive = tracer.trace(origins, directions)
                rays += 2 * len(a)
                wrong += np.count_nonzero(primitive == NONE)
                wrong_distances += np.count_nonzero(t != 2)
                origins[:, (axis + 1) % 3] = 1.01
                wrong += np.count_nonzero(tracer.trace(origins, directions)[1] != NONE)
    name = f"{rays:,} rays along the axes, {method}"
    yield count_case(f"{name}: wrong hits and misses", wrong, "edges, corners and planes belong to the box")
    yield count_case(f"{name}: distances other than 2", wrong_distances, "exact on this grid")


def bvh_boxes(context: Context) -> Iterator[Case]:
    """The boxes of the BVH lose no hit: against the same triangles in boxes that every ray enters."""
    random = np.random.default_rng(5)
    ball, faces = icosphere(2)
    corners = (np.round(8 * ball) / 8).astype(np.float32)[faces]  # flat boxes, and rays in the planes of boxes
    n = 20_000
    directions = random.standard_normal((n, 3)) * random.choice([1, 1, 1, 0, 1e-20, 1e-42], (n, 3))
    directions[:, 0] += np.where((np.abs(directions) < 1e-3).all(axis=1), 1, 0)
    directions = directions.astype(np.float32)
    targets = np.round(8 * random.uniform(-1.1, 1.1, (n, 3))) / 8
    tracer = Tracer(context.device, corners, method=BVH)
    bvh = tracer.bvh

    def trace() -> np.ndarray:
        origins = [(targets - distance * directions).astype(np.float32) for distance in (0.0, 1.0, 1e4, 1e7)]
        return np.stack([tracer.trace(o, directions)[0] for o in origins])

    t = trace()
    hits, basis = np.isfinite(t).mean(), "most rays aim at the ball"
    yield Case("80,000 rays at a ball of flat boxes: share that hits", hits, 0.6, 0.35, basis)
    for name, bound in (("3 * 10^38", 3e38), ("infinity", np.inf)):
        nodes = bvh.nodes.copy()
        used = nodes[:, 0:3] <= nodes[:, 3:6]
        nodes[:, 0:3][used], nodes[:, 3:6][used] = -bound, bound
        tracer.use_bvh(replace(bvh, nodes=nodes))
        yield count_case(f"80,000 rays, boxes against those up to {name}: hits that differ", t != trace(), "exact")


CHECKS = (leaks, needles, degenerate_triangles, coplanar_triangles, scales, axis_aligned_rays, bvh_boxes)
