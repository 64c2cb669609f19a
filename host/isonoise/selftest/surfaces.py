"""Cases of rays that leave surfaces: none meets the surface that it left, none gets to its other side.

Counted in the wavefront itself, bounce by bounce. On a convex body, seen from outside, the second ray of a path meets
nothing; that is read from the hits, because a path that ends where it met something is not to be seen in the next
bounce. Within a closed body every path goes on to the depth that is allowed: any that ends before has got out.
"""

from collections.abc import Iterator

import numpy as np

from isonoise.errors import SceneError
from isonoise.integrator.wavefront import Wavefront
from isonoise.scene import compile_scene, load, structs
from isonoise.scene.accel.build import build_scene_bvh
from isonoise.selftest.core import Bench, Case, count
from isonoise.selftest.rays import icosphere
from isonoise.selftest.scenes import diffuse, looking, placed, scene

SIDE, SPP = 64, 32  # as many paths as the pool has: no path begins later than the others
DEPTH = 6
SIZES = (("size 1", 1.0, 0.0), ("size 10^-6", 1e-6, 0.0), ("size 10^6", 1e6, 0.0))
FAR_BODIES, FAR_ROOMS = ("size 1 at 10^6", 1.0, 1e6), ("size 10^3 at 10^6", 1e3, 1e6)
LOST = 2.0**-17
"""Share of the rays that end early in a room of triangles: see `_closed`."""


def surface_cases(bench: Bench) -> Iterator[Case]:
    """All cases of the file."""
    for place in (*SIZES, FAR_BODIES):
        yield from _convex(bench, *place)
    for place in (*SIZES, FAR_ROOMS):
        yield from _closed(bench, *place)
    yield from _instances(bench)


def rays_by_bounce(bench: Bench, description: dict, spp: int = SPP) -> list[tuple[int, int]]:
    """How many rays there are in each bounce, and how many of them meet something."""
    compiled = compile_scene(load(description))
    wavefront = Wavefront(bench.device, compiled, build_scene_bvh(compiled), seed=1, pool_size=2**17)
    of, bounces = wavefront.stages.arguments, []

    def read(paths: int) -> None:
        primitive = bench.device.read(of["hit"], np.uint32, paths, offset=3 * int(of["plane_stride"]))
        bounces.append((paths, np.count_nonzero(primitive != structs.NONE)))

    wavefront.on_bounce = read
    wavefront.trace(np.full((compiled.height, compiled.width), spp, np.uint32))
    return bounces


def _mesh(level: int, scale: float, offset: float) -> dict:
    vertices, faces = icosphere(level)
    return {"type": "mesh", "vertices": scale * vertices + offset, "faces": faces, "face_normals": True}


def _bodies(scale: float, offset: float) -> dict[str, dict]:
    """Convex ones around (offset, offset, offset)."""
    at = placed(scale, (offset,) * 3, 20)
    return {
        "sphere": {"type": "sphere", "center": [offset] * 3, "radius": scale},
        "cube": {"type": "cube", "to_world": placed(0.6 * scale, (offset,) * 3, 20)},
        "mesh of 1,280 triangles": _mesh(3, scale, offset),
        "rectangle": {"type": "rectangle", "to_world": at},
        "disk": {"type": "disk", "to_world": at},
        "cylinder, its ends out of sight": {
            "type": "cylinder",
            "p0": [0.0, 0.0, -9.0],
            "p1": [0.0, 0.0, 9.0],
            "radius": 0.5,
            "to_world": at,
        },
    }


def _convex(bench: Bench, name: str, scale: float, offset: float) -> Iterator[Case]:
    origin = offset + scale * np.array([0.5, -3.0, 1.0])
    camera = looking(origin, (offset,) * 3)
    for what, body in _bodies(scale, offset).items():
        lens = {"near_clip": 1e-4 * scale}
        body = body | {"bsdf": {"type": "twosided", "bsdf": diffuse(1.0)}}
        rays = rays_by_bounce(bench, scene(camera, SIDE, 4, sensor=lens, body=body))
        again = rays[1][1]
        yield count(f"{what}, {name}: rays that leave it and meet it again", again, "none may: it is convex")


def _closed(bench: Bench, name: str, scale: float, offset: float) -> Iterator[Case]:
    """None gets out. A ray that starts within some 20 roundings of another triangle's plane ends (kernels/path/
    path_vertex.h), and far from the world's origin these are wide: the limit of how far from it meshes can stand."""
    begun = SIDE * SIDE * SPP // 2
    camera = looking((offset,) * 3, offset + scale * np.array([1.0, 0.4, -0.3]))
    bodies = _bodies(scale, offset)
    for what in ("sphere", "cube", "mesh of 1,280 triangles"):
        body = bodies[what] | {"bsdf": {"type": "twosided", "bsdf": diffuse(1.0)}}
        lens = {"near_clip": 1e-4 * scale}
        rays = rays_by_bounce(bench, scene(camera, SIDE, DEPTH, 90.0, lens, body=body), SPP // 2)
        missing = DEPTH * begun - sum(paths for paths, _ in rays)
        if what == "sphere":
            yield count(f"in a {what}, {name}: of {DEPTH * begun:,} rays, missing", missing, "none may: it is closed")
            continue
        most = LOST * (4 + offset / scale) * (DEPTH - 1) * begun
        basis = "2^-17 of the rays, over size / distance from the origin: `in_plane`, 20 roundings beside an edge"
        yield Case(f"in a {what}, {name}: of {DEPTH * begun:,} rays, missing", missing, 0, most, basis)


def _instances(bench: Bench) -> Iterator[Case]:
    """A closed body in spaces that are mirrored, flattened and tiny; and transforms that have no inverse."""
    singular = {
        "flat": np.diag([1.0, 1.0, 0.0, 1.0]),
        "a line": np.diag([1.0, 0.0, 0.0, 1.0]),
        "a point": np.diag([0.0, 0.0, 0.0, 1.0]),
        "sheared flat": np.array([[1, 1, 0, 0], [1, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]]),
    }
    taken = 0
    for matrix in singular.values():
        try:
            compile_scene(load(_instance(matrix)))
            taken += 1
        except SceneError:
            pass
    yield count(
        f"instances by {len(singular)} singular transforms: taken", taken, "all have to be refused, with a message"
    )
    turned = placed(1.0, (0.1, 0.2, 0.3), 40)
    for name, matrix in {
        "mirrored": turned @ np.diag([-1.0, 1.0, 1.0, 1.0]),
        "turned inside out": turned @ np.diag([-1.0, -1.0, -1.0, 1.0]),
        "flattened 1:10^-3": turned @ np.diag([1.0, 1.0, 1e-3, 1.0]),
        "of size 10^-6": np.diag([1e-6, 1e-6, 1e-6, 1.0]),
        "of size 10^6": np.diag([1e6, 1e6, 1e6, 1.0]),
    }.items():
        rays = rays_by_bounce(bench, _instance(matrix), SPP // 2)
        missing = DEPTH * SIDE * SIDE * SPP // 2 - sum(paths for paths, _ in rays)
        yield count(
            f"in an instance {name}: of {DEPTH * SIDE * SIDE * SPP // 2:,} rays, missing",
            missing,
            "none may: it is closed",
        )


def _instance(matrix: np.ndarray) -> dict:
    """Within a closed mesh that stands where the transform puts it."""
    ball = _mesh(2, 1.0, 0.0) | {"bsdf": {"type": "twosided", "bsdf": diffuse(1.0)}}
    inside = (matrix @ (0.1, 0.1, 0.05, 1.0))[:3]
    camera = looking(inside, inside + np.array([1.0, 0.3, 0.1]))
    lens = {"near_clip": 1e-9}
    group = {"type": "shapegroup", "ball": ball}
    return scene(camera, SIDE, DEPTH, 90.0, lens, body={"type": "instance", "to_world": matrix, "group": group})
