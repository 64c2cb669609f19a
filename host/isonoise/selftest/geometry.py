"""Cases of rays and surfaces: nothing leaks, nothing is met that is not there, at any scale, by both traversals.

A distance comes from three edge functions and three depths along the ray; each rounds by some 2^-24 of the largest
coordinate as seen from the ray's origin. Where a tolerance is that of a distance it is 16 such roundings.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from isonoise.scene import structs
from isonoise.selftest.core import Bench, Case, count, worst
from isonoise.selftest.rays import FEW, HIERARCHY, Tracer, closest, edges_of, icosphere, traversals
from isonoise.selftest.surfaces import surface_cases

NONE = structs.NONE
STEP = 2.0**-24
RAYS, ALL_RAYS, AT_ONCE = 2**21, 10**8, 2**19
NOTHING_LEAKS = "none may get through a closed mesh"


def geometry_cases(bench: Bench) -> Iterator[Case]:
    """All cases of the group."""
    for by in traversals(bench.device):
        yield from _leaks(bench, by)
        yield from _needles(bench, by)
        yield from _degenerate(bench, by)
        yield from _scales(bench, by)
        yield from _axis_aligned(bench, by)
    yield from _boxes(bench)
    yield from surface_cases(bench)


def _leaks(bench: Bench, by: str) -> Iterator[Case]:
    """From inside of a rough ball towards vertices, points of edges, and points that rounding puts near them."""
    random = np.random.default_rng(11)
    level = 0 if by == FEW else 4
    vertices, faces = icosphere(level)
    vertices = (vertices * random.uniform(0.97, 1.03, (len(vertices), 1)) + 0.3).astype(np.float32)
    tracer, pairs = Tracer(bench.device, vertices[faces], by=by), edges_of(faces)
    rays = ALL_RAYS if bench.thorough else RAYS
    missed = off = traced = 0
    while traced < rays:
        n = min(AT_ONCE, rays - traced)
        origins = 0.3 + random.uniform(-0.3, 0.3, (n, 3)).astype(np.float32)
        pair = pairs[random.integers(len(pairs), size=n)]
        weight = random.choice([0.0, 1.0, 0.5, -1.0], (n, 1)).astype(np.float32)
        weight = np.where(weight < 0, random.uniform(size=(n, 1)).astype(np.float32), weight)
        targets = weight * vertices[pair[:, 0]] + (1 - weight) * vertices[pair[:, 1]]
        t, primitive = tracer.trace(origins, targets - origins)
        missed += np.count_nonzero(primitive == NONE)
        off += np.count_nonzero(~(np.abs(t - 1) < 1e-4))
        traced += n
    what = f"{rays:,} rays to edges and vertices of {len(faces):,} triangles, {by}"
    yield count(f"{what}: leaked", missed, NOTHING_LEAKS)
    yield count("... ended more than 10^-4 off the edge", off, "none: the surface is closed and seen from within")


def _turned(random) -> np.ndarray:
    """A random rotation (3, 3)."""
    return np.linalg.qr(random.standard_normal((3, 3)))[0]


def _needles(bench: Bench, by: str) -> Iterator[Case]:
    """A strip of 8 needles, 1 long and 10^-6 wide, turned anyhow; rays through it, on the edges between them too.

    Nothing may slip through. But the weights of a needle's corners are areas that round by 2^-24, over its own area:
    along the needle, whose depth may change by its length, the hit is off by 2^-24 / 10^-6 of that. A limit of float32.
    """
    random = np.random.default_rng(12)
    missed, off, n = 0, [], 20_000
    for _ in range(4):
        turn, width = _turned(random), 1e-6
        left = np.stack([np.arange(5) * 2 * width, np.zeros(5), np.zeros(5)], axis=1)
        right = left + np.array([width, 1.0, 0.0])
        strip = []
        for k in range(4):
            strip += [(left[k], left[k + 1], right[k]), (right[k], left[k + 1], right[k + 1])]
        corners = (np.array(strip) @ turn.T).astype(np.float32)
        tracer = Tracer(bench.device, corners, by=by)
        # at least half a needle from the strip's border; the rounding of corners moves that by a tenth of one
        y = random.uniform(0.05, 0.95, n)
        x = width * (y + random.choice([1.0, 2, 3, 4, 5, 6, 7, -1], n))
        x = np.where(x < width * y, width * (y + random.uniform(0.5, 7.5, n)), x)
        targets = np.stack([x, y, np.zeros(n)], axis=1) @ turn.T
        directions = (turn @ (0.2, 0.1, -1.0)).astype(np.float32)
        origins = (targets - directions.astype(float)).astype(np.float32)
        t, primitive = tracer.trace(origins, np.broadcast_to(directions, origins.shape))
        missed += np.count_nonzero(primitive == NONE)
        off.append(t[primitive != NONE])
    yield count(f"80,000 rays through needles 1:10^6, {by}: missed", missed, "none may slip between neighbours")
    yield worst("... distance (a limit)", np.concatenate(off), 1, STEP / 1e-6, "2^-24 over the needle's area, 10^-6")


def _degenerate(bench: Bench, by: str) -> Iterator[Case]:
    random = np.random.default_rng(13)
    soup = random.uniform(-1, 1, (8, 3, 3)).astype(np.float32)
    points, lines = np.repeat(soup[:, :1], 3, axis=1), soup.copy()
    lines[:, 2] = 0.5 * (lines[:, 0] + lines[:, 1])
    twice = soup.copy()
    twice[:, 1] = twice[:, 0]
    n = 20_000
    origins = random.uniform(-2, 2, (n, 3)).astype(np.float32)
    weights = random.dirichlet((1, 1, 1), n)
    aims = (weights[:, None] @ soup[random.integers(8, size=n)].astype(float))[:, 0]
    aims[: n // 4] = (weights[: n // 4, None] @ lines[random.integers(8, size=n // 4)].astype(float))[:, 0]
    directions = (aims - origins).astype(np.float32)
    flat = np.concatenate([points, lines, twice])
    flat_tracer = Tracer(bench.device, flat, by=by)
    _, primitive = flat_tracer.trace(origins, directions)
    # a line of three rounded points has some area: 2^-24 of its length wide
    yield count(
        f"20,000 rays at points and doubled corners, {by}: met",
        (primitive < 8) | ((primitive >= 16) & (primitive < 24)),
        "there is no area to meet",
    )
    mixed = Tracer(bench.device, np.concatenate([points, soup, twice]), by=by)
    plain = Tracer(bench.device, soup, by=by)
    t, primitive = plain.trace(origins, directions)
    with_t, with_primitive = mixed.trace(origins, directions)
    expected = np.where(primitive == NONE, NONE, primitive + 8)
    yield count(
        "... rays that zero-area triangles among others turn astray",
        (with_t != t) | (with_primitive != expected),
        "exact",
    )
    doubled = Tracer(bench.device, np.concatenate([soup, soup]), by=by)
    twice_t, twice_primitive = doubled.trace(origins, directions)
    same = (twice_t == t) & ((twice_primitive == NONE) == (primitive == NONE))
    same &= (primitive == NONE) | (twice_primitive % 8 == primitive)
    yield count(f"20,000 rays at duplicate triangles, {by}: not met as if there was one", ~same, "exact")
    reference = closest(soup, origins, directions)
    differ = (np.isfinite(reference) != np.isfinite(t))[n // 4 :]  # the others are aimed at edges
    basis = "10^-4 of the rays: so many are within rounding of an edge"
    yield Case("... hits against float64 that differ", np.count_nonzero(differ), 0, n * 1e-4, basis)
    # two triangles that overlap in one plane, of different corners: either may be met, at the plane's distance
    square = np.array([[-1, -1], [1, -1], [0, 1], [-1, 1], [0, -1], [1, 1]], float)
    turn = _turned(random)
    plane = np.concatenate([square, np.zeros((6, 1))], axis=1) @ turn.T
    overlap = Tracer(bench.device, plane.reshape(2, 3, 3), by=by)
    at = np.concatenate(
        [random.uniform(-0.2, 0.2, (n, 1)), random.uniform(-0.2, 0.2, (n, 1)), np.zeros((n, 1))], axis=1
    )
    targets = at @ turn.T
    origins = (targets + turn @ (0.3, -0.2, 2.0)).astype(np.float32)
    t, primitive = overlap.trace(origins, (targets - origins).astype(np.float32))
    yield count(f"20,000 rays at coplanar overlap, {by}: missed", primitive == NONE, "none may get through")
    yield worst("... distance", t, 1, 16 * STEP, "16 roundings")


def _scales(bench: Bench, by: str) -> Iterator[Case]:
    """A closed mesh and a sphere, scaled and far from the origin, against float64 on the rounded corners."""
    random = np.random.default_rng(14)
    ball, faces = icosphere(0 if by == FEW else 2)
    n = 20_000 if by == FEW else 5_000
    for name, scale, offset in (
        ("size 10^-6", 1e-6, 0.0),
        ("size 10^6", 1e6, 0.0),
        ("10^6 from the origin", 1.0, 1e6),
        ("size 10^-6 at 1", 1e-6, 1.0),
    ):
        vertices = (scale * ball + offset).astype(np.float32)
        record = np.zeros(1, structs.ANALYTIC)
        record["kind"], record["center"], record["radius"] = structs.ANALYTIC_SPHERE, offset, scale
        origins = (offset + scale * random.uniform(-0.3, 0.3, (n, 3))).astype(np.float32)
        directions = random.standard_normal((n, 3))
        directions = (scale * directions / np.linalg.norm(directions, axis=1, keepdims=True)).astype(np.float32)
        t, primitive = Tracer(bench.device, vertices[faces], by=by).trace(origins, directions)
        yield count(f"{name}, {by}: rays that leak out of a mesh", primitive == NONE, NOTHING_LEAKS)
        expected = closest(vertices[faces], origins, directions)
        met = np.isfinite(expected)  # float64 itself misses edges
        basis = "16 roundings: coordinates are taken from the ray's origin before they are multiplied"
        yield worst("... distance, relative", t[met] / expected[met], 1, 64 * STEP, basis)
        t, primitive = Tracer(bench.device, np.zeros((0, 3, 3)), record, by=by).trace(origins, directions)
        yield count("... rays that leak out of a sphere", primitive == NONE, "none may")
        f, d = origins.astype(float) - record["center"].astype(float), directions.astype(float)
        a, b = (d * d).sum(axis=1), (f * d).sum(axis=1)
        c = (f * f).sum(axis=1) - float(record["radius"][0]) ** 2
        yield worst(
            "... distance to the sphere, relative", t / ((-b + np.sqrt(b * b - a * c)) / a), 1, 64 * STEP, basis
        )


def _axis_aligned(bench: Bench, by: str) -> Iterator[Case]:
    """A cube whose corners lie on a grid; rays along the axes and in its planes, with zeros of both signs."""
    x, y, z = np.meshgrid([-1.0, 1.0], [-1.0, 1.0], [-1.0, 1.0], indexing="ij")
    v = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    corners = np.array([[v[q[i]] for i in t] for q in quads for t in ((0, 1, 2), (0, 2, 3))])
    tracer = Tracer(bench.device, corners, by=by)
    across = np.array([-1.0, -0.999, -0.5, -0.25, 0.0, 1 / 3, 0.5, 1.0], np.float32)
    off = t_off = rays = 0
    for zero in (0.0, -0.0, 1e-42, -1e-30):
        inside = across if zero == 0 else across[np.abs(across) < 1]  # those in a side's plane would leave it
        a, b = (g.ravel() for g in np.meshgrid(inside, inside))
        for axis in range(3):
            for sign in (1, -1):
                origins, directions = np.empty((len(a), 3), np.float32), np.full((len(a), 3), zero, np.float32)
                origins[:, axis], origins[:, (axis + 1) % 3], origins[:, (axis + 2) % 3] = -3 * sign, a, b
                directions[:, axis] = sign
                t, primitive = tracer.trace(origins, directions)
                rays += 2 * len(a)
                off += np.count_nonzero(primitive == NONE)
                t_off += np.count_nonzero(t != 2)
                origins[:, (axis + 1) % 3] = 1.01
                off += np.count_nonzero(tracer.trace(origins, directions)[1] != NONE)
    yield count(
        f"{rays:,} rays along the axes, {by}: wrongly met or missed", off, "edges, corners and planes count as the box"
    )
    yield count("... distances other than 2", t_off, "exact on this grid")


def _boxes(bench: Bench) -> Iterator[Case]:
    """The boxes of the hierarchy lose no hit: against the same triangles in boxes without end, and in flat ones."""
    random = np.random.default_rng(5)
    ball, faces = icosphere(3)
    corners = (np.round(8 * ball) / 8).astype(np.float32)[faces]  # flat boxes, and rays in the planes of boxes
    n = 50_000
    directions = random.standard_normal((n, 3)) * random.choice([1, 1, 1, 0, 1e-20, 1e-42], (n, 3))
    directions[:, 0] += np.where((np.abs(directions) < 1e-3).all(axis=1), 1, 0)
    directions = directions.astype(np.float32)
    targets = np.round(8 * random.uniform(-1.1, 1.1, (n, 3))) / 8
    tracer = Tracer(bench.device, corners, by=HIERARCHY)
    own, found = tracer.bvh, {}
    for distance in (0.0, 1.0, 1e4, 1e7):
        found[distance] = tracer.trace((targets - distance * directions).astype(np.float32), directions)[0]
    for name, end in (("3 * 10^38", 3e38), ("infinity", np.inf)):
        nodes = own.nodes.copy()
        used = nodes[:, 0:3] <= nodes[:, 3:6]
        nodes[:, 0:3][used], nodes[:, 3:6][used] = -end, end
        tracer.use(replace(own, nodes=nodes))
        lost = 0
        for distance, t in found.items():
            expected = tracer.trace((targets - distance * directions).astype(np.float32), directions)[0]
            lost += np.count_nonzero(t != expected)
        yield count(f"200,000 rays, boxes against those up to {name}: hits that differ", lost, "exact")
