"""Checks of rays that start on surfaces: none hits the surface that it leaves, none gets to its other side.

Rays are counted in the wavefront itself, bounce by bounce. On a convex body, seen from outside, the second ray of a
path hits nothing; that is read from the hits, because a path that ends at a hit does not appear in the next bounce.
Inside a closed body every path reaches the maximum depth: a path that ends earlier has leaked out.
"""

import warnings
from collections.abc import Iterator

import numpy as np

from isonoise.errors import SceneError
from isonoise.integrator.wavefront import Wavefront
from isonoise.scene import compile_scene, load_description, structs
from isonoise.scene.accel.build import build_scene_bvh
from isonoise.selftest.cases import Case, Context, count_case
from isonoise.selftest.scenes import diffuse, look_at, make_scene, transform
from isonoise.selftest.tracer import icosphere

SIDE, SPP = 64, 32  # as many paths as the pool has: all paths start in the first bounce
DEPTH = 6
SIZES = (("size 1", 1.0, 0.0), ("size 10^-6", 1e-6, 0.0), ("size 10^6", 1e6, 0.0))
"""Name, scale and offset of a body."""
FAR_BODY, FAR_ROOM = ("size 1 at 10^6", 1.0, 1e6), ("size 10^3 at 10^6", 1e3, 1e6)
MAX_LOST = 2.0**-17
"""Share of the rays that may end early in a room of triangles: see `closed_bodies`."""
MESH = "mesh of 1,280 triangles"


def _rays_by_bounce(context: Context, description: dict, spp: int = SPP) -> list[tuple[int, int]]:
    """Returns for each bounce the number of rays and the number of hits."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of bodies that are coarse where they are
        compiled = compile_scene(load_description(description))
    wavefront = Wavefront(context.device, compiled, build_scene_bvh(compiled), seed=1, pool_size=2**17)
    arguments, bounces = wavefront.stages.arguments, []

    def count_hits(paths: int) -> None:
        offset = 3 * int(arguments["plane_stride"])
        primitive = context.device.read(arguments["hit"], np.uint32, paths, offset=offset)
        bounces.append((paths, np.count_nonzero(primitive != structs.NONE)))

    wavefront.on_bounce = count_hits
    wavefront.trace(np.full((compiled.height, compiled.width), spp, np.uint32))
    return bounces


def _mesh(level: int, scale: float, offset: float) -> dict:
    vertices, faces = icosphere(level)
    return {"type": "mesh", "vertices": scale * vertices + offset, "faces": faces, "face_normals": True}


def _white(body: dict) -> dict:
    return body | {"bsdf": {"type": "twosided", "bsdf": diffuse(1.0)}}


def _convex_bodies(scale: float, offset: float) -> dict[str, dict]:
    """Returns bodies around (offset, offset, offset)."""
    center = (offset,) * 3
    to_world = transform(scale, center, 20)
    return {
        "sphere": {"type": "sphere", "center": list(center), "radius": scale},
        "cube": {"type": "cube", "to_world": transform(0.6 * scale, center, 20)},
        MESH: _mesh(3, scale, offset),
        "rectangle": {"type": "rectangle", "to_world": to_world},
        "disk": {"type": "disk", "to_world": to_world},
        "cylinder, its ends out of sight": {
            "type": "cylinder",
            "p0": [0.0, 0.0, -9.0],
            "p1": [0.0, 0.0, 9.0],
            "radius": 0.5,
            "to_world": to_world,
        },
    }


def _with_copies_at_the_origin(body_name: str, scale: float, offset: float) -> dict[str, dict]:
    """Returns the body. If it is far away, two copies at the origin, out of sight, keep the scene from being moved."""
    body = _white(_convex_bodies(scale, offset)[body_name])
    copy = _white(_convex_bodies(scale, 0.0)[body_name])
    return {"body": body, **({"copy": copy, "second copy": copy} if offset else {})}


def convex_bodies(context: Context) -> Iterator[Case]:
    """Rays leave convex bodies and do not hit them again."""
    for size_name, scale, offset in (*SIZES, FAR_BODY):
        for body_name in _convex_bodies(scale, offset):
            yield convex_body(context, body_name, size_name, scale, offset)


def convex_body(context: Context, body_name: str, size_name: str, scale: float, offset: float) -> Case:
    """Returns the case of one body of one size."""
    bodies = _with_copies_at_the_origin(body_name, scale, offset)
    camera = look_at(offset + scale * np.array([0.5, -3.0, 1.0]), (offset,) * 3)
    scene = make_scene(camera, SIDE, 4, sensor={"near_clip": 1e-4 * scale}, **bodies)
    hits = _rays_by_bounce(context, scene)[1][1]
    return count_case(f"{body_name}, {size_name}: rays that leave it and hit it again", hits, "none: it is convex")


def closed_bodies(context: Context) -> Iterator[Case]:
    """No ray gets out of a closed body.

    In a mesh a ray that starts within some 20 roundings of another triangle's plane ends (kernels/path/path_vertex.h).
    Far from the world's origin roundings are large: this limits how far from it meshes can be.
    """
    paths = SIDE * SIDE * SPP // 2
    for size_name, scale, offset in (*SIZES, FAR_ROOM):
        camera = look_at((offset,) * 3, offset + scale * np.array([1.0, 0.4, -0.3]))
        for body_name in ("sphere", "cube", MESH):
            bodies = _with_copies_at_the_origin(body_name, scale, offset)
            lens = {"near_clip": 1e-4 * scale}
            scene = make_scene(camera, SIDE, DEPTH, 90.0, lens, **bodies)
            bounces = _rays_by_bounce(context, scene, SPP // 2)
            missing = DEPTH * paths - sum(rays for rays, _ in bounces)
            name = f"in a {body_name}, {size_name}: of {DEPTH * paths:,} rays, missing"
            if body_name == "sphere":
                yield count_case(name, missing, "none allowed: it is closed")
                continue
            maximum = MAX_LOST * (4 + offset / scale) * (DEPTH - 1) * paths
            basis = "2^-17 of the rays, over size / distance from the origin: false coplanar hits beside an edge"
            yield Case(name, missing, 0, maximum, basis)


def _instance(matrix: np.ndarray) -> dict:
    """A camera inside of a closed mesh, which is an instance with the given transform."""
    inside = (matrix @ (0.1, 0.1, 0.05, 1.0))[:3]
    camera = look_at(inside, inside + np.array([1.0, 0.3, 0.1]))
    group = {"type": "shapegroup", "ball": _white(_mesh(2, 1.0, 0.0))}
    body = {"type": "instance", "to_world": matrix, "group": group}
    return make_scene(camera, SIDE, DEPTH, 90.0, {"near_clip": 1e-9}, body=body)


def instances(context: Context) -> Iterator[Case]:
    """A closed body under mirrored, flattened and tiny transforms."""
    rotated = transform(1.0, (0.1, 0.2, 0.3), 40)
    paths = SIDE * SIDE * SPP // 2
    for name, matrix in {
        "mirrored": rotated @ np.diag([-1.0, 1.0, 1.0, 1.0]),
        "mirrored in all axes": rotated @ np.diag([-1.0, -1.0, -1.0, 1.0]),
        "flattened 1:10^-3": rotated @ np.diag([1.0, 1.0, 1e-3, 1.0]),
        "of size 10^-6": np.diag([1e-6, 1e-6, 1e-6, 1.0]),
        "of size 10^6": np.diag([1e6, 1e6, 1e6, 1.0]),
    }.items():
        missing = DEPTH * paths - sum(count for count, _ in _rays_by_bounce(context, _instance(matrix), SPP // 2))
        name = f"in an instance {name}: of {DEPTH * paths:,} rays, missing"
        yield Case(name, missing, 0, 4 * MAX_LOST * (DEPTH - 1) * paths, "4 * 2^-17 of the rays: as in a mesh")


def singular_instances(context: Context) -> Iterator[Case]:
    """Transforms without an inverse are refused."""
    singular = {
        "flat": np.diag([1.0, 1.0, 0.0, 1.0]),
        "a line": np.diag([1.0, 0.0, 0.0, 1.0]),
        "a point": np.diag([0.0, 0.0, 0.0, 1.0]),
        "sheared flat": np.array([[1, 1, 0, 0], [1, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]]),
    }
    accepted = 0
    for matrix in singular.values():
        try:
            compile_scene(load_description(_instance(matrix)))
            accepted += 1
        except SceneError:
            pass
    yield count_case(f"instances with {len(singular)} singular transforms: accepted", accepted, "none allowed")


CHECKS = (convex_bodies, closed_bodies, instances, singular_instances)
