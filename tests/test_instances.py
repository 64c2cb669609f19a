"""Groups of shapes and their instances: hits, surfaces, rays that leave them, pictures; the same shapes flattened, and
Mitsuba's instances, say what is right."""

import time

import numpy as np
import pytest
import references
import trimesh
from planes import as_planes, read_rows
from scalar_mitsuba import as_mitsuba, assert_same_picture, import_mitsuba
from shared_programs import SHAPES

from isonoise.device import program
from isonoise.device.opencl import Device
from isonoise.errors import SceneError
from isonoise.integrator.features import features
from isonoise.integrator.generated_headers import generated_headers
from isonoise.integrator.kernel_table import CONSTANTS, KERNELS, STRUCTS
from isonoise.integrator.stages import Stages
from isonoise.integrator.wavefront import Wavefront
from isonoise.loop import render
from isonoise.scene import compile_scene, load, structs
from isonoise.scene.accel.build import build_scene_bvh
from isonoise.scene.compiled_scene import CompiledScene
from isonoise.scene.mesh.triangle_records import corner_normals, triangle_records

NONE = structs.NONE
ANALYTIC_BIT = 0x80000000

PROBE = """
#include "path/path_state.h"
#include "geometry/surface.h"

__kernel void probe(uint n, __global const float* triangles, __global const uint* faces,
                    __global const float* corner_normals, __global const Analytic* analytics,
                    __global const Shape* shapes, __global const Instance* instances, __global const uint* instance,
                    __global const float* ray_origin, __global const float* ray_direction, __global const float* hits,
                    __global const float* towards, __global float* out)
{
    const uint i = get_global_id(0);
    if (i >= n) return;
    SceneView g;
    g.triangles = triangles;
    g.faces = faces;
    g.corner_normals = corner_normals;
    g.analytics = analytics;
    g.shapes = shapes;
    const Vec4 hit = load_planes4(hits, i, n);
    const uint primitive = as_uint(hit.w);
    if (primitive == NONE) return;
    const Vec3 origin = load_planes3(ray_origin, i, n), direction = load_planes3(ray_direction, i, n);
#if FEATURE_INSTANCES
    g.instances = instances;
    const Surface s = instanced_surface_of_hit(&g, instance[i], primitive, origin, direction, hit.x, hit.y,
                                           hit.z);
#else
    const Surface s = surface_of_hit(&g, primitive, origin, direction, hit.x, hit.y, hit.z);
#endif
    const Vec3 leaving = load_planes3(towards, i, n);
    STORE3(s.position, 5 * i, out);
    STORE3(s.error, 5 * i + 1, out);
    STORE3(s.geometric_normal, 5 * i + 2, out);
    STORE3(s.normal, 5 * i + 3, out);
    STORE3(offset_ray_origin(s.position, s.error, s.geometric_normal, leaving), 5 * i + 4, out);
}
"""


class Traced:
    """The stage `intersect` over a scene, and the surfaces that it finds."""

    def __init__(self, description: dict | CompiledScene, monkeypatch):
        scene = description if isinstance(description, CompiledScene) else compile_scene(load(description))
        self.scene = scene
        self.device = device = Device()
        # all shapes, so that the scenes share their programs
        self.features = features(scene) | dict.fromkeys((*SHAPES, "VERTEX_NORMALS"), True)
        bvh = build_scene_bvh(scene)

        self.stages = Stages(device, {"intersect": KERNELS["intersect"]}, self.features, structs.CONSTANTS, STRUCTS)
        source = program.kernel_source
        monkeypatch.setattr(program, "kernel_source", lambda name: PROBE if name == "probe.cl" else source(name))
        self.probe = device.build(
            *program.stage_source("probe.cl", STRUCTS, CONSTANTS, self.features, generated_headers())
        )["probe"]
        monkeypatch.setattr(program, "kernel_source", source)

        def table(array):
            return device.buffer(array, "table") if array.size else None

        analytics, instances = table(scene.analytics), table(scene.instances)
        self.stages.arguments.update(
            nodes=table(bvh.nodes),
            blocks=table(bvh.blocks),
            analytics=analytics,
            instances=instances,
            first_analytic=np.uint32(bvh.first_analytic),
            first_instance=np.uint32(bvh.first_analytic + len(scene.analytics)),
        )
        self.surfaces = (
            *map(table, (triangle_records(scene), scene.faces, corner_normals(scene))),
            *(analytics, table(scene.shapes), instances),
        )

    def __call__(self, origins, directions, skip=NONE, start=NONE, towards=None) -> dict[str, np.ndarray]:
        """Hits of rays (n, 3) that start on the primitives `skip` of the instances `start`, and where rays `towards`
        would leave from."""
        n, device = len(origins), self.device
        rays = np.zeros((4, n, 4), np.float32)
        rays[0, :, :3], rays[0, :, 3], rays[1, :, :3] = origins, np.inf, directions
        rays[2, :, :3] = rays[1, :, :3] if towards is None else towards
        path = np.zeros((4, n), np.uint32)
        path[1] = skip
        origin, direction, leaving, hit = (device.buffer(as_planes(ray), "rays") for ray in rays)
        instance = device.buffer(np.full(n, start, np.uint32), "instance")
        self.stages.launch(
            "intersect",
            n,
            **dict.fromkeys(("path_count", "plane_stride"), np.uint32(n)),
            rays_per_item=np.uint32(1),
            ray_origin=origin,
            ray_direction=direction,
            path=device.buffer(path, "path"),
            hit=hit,
            instance=instance,
        )
        out = device.buffer(60 * n, "surfaces")
        device.launch(self.probe, n, (np.uint32(n), *self.surfaces, instance, origin, direction, hit, leaving, out))
        found = read_rows(device, hit, n, 4)
        of_surface = device.read(out, np.float32, 15 * n).reshape(n, 5, 3).transpose(1, 0, 2)
        return {
            **{"t": found[:, 0], "uv": found[:, 1:3], "primitive": found[:, 3].copy().view(np.uint32)},
            "instance": device.read(instance, np.uint32, n),
            **dict(zip(("position", "error", "geometric", "shading", "leaves"), of_surface, strict=True)),
        }


def placed(scale=(1, 1, 1), offset=(0, 0, 0), seed: int | None = None) -> np.ndarray:
    """Scaled, then turned at random (or not), then moved."""
    matrix = np.diag([*np.broadcast_to(np.asarray(scale, float), 3), 1.0])
    if seed is not None:
        turn, _ = np.linalg.qr(np.random.default_rng(seed).standard_normal((3, 3)))
        matrix[:3, :3] = turn * np.sign(np.linalg.det(turn)) @ matrix[:3, :3]
    matrix[:3, 3] = offset
    return matrix


def with_instances(group: dict, *matrices: np.ndarray, **more) -> dict:
    reference = {"type": "ref", "id": "group"}
    return {
        "type": "scene",
        "sensor": {"type": "perspective"},
        "group": {"type": "shapegroup", **group},
        **{f"at{i}": {"type": "instance", "to_world": m, "group": reference} for i, m in enumerate(matrices)},
        **more,
    }


def flattened(group: dict, *matrices: np.ndarray, **more) -> dict:
    return {
        "type": "scene",
        "sensor": {"type": "perspective"},
        **{
            f"{name}{i}": {**shape, "to_world": matrix @ shape.get("to_world", np.eye(4))}
            for name, shape in group.items()
            for i, matrix in enumerate(matrices)
        },
        **more,
    }


def ball(subdivisions: int = 3, smooth: bool = False) -> dict:
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions)
    return {
        "type": "mesh",
        "vertices": np.array(mesh.vertices),
        "faces": np.array(mesh.faces),
        "face_normals": not smooth,
    }


FLAT = {
    "box": {"type": "cube", "to_world": placed(0.4, (0.8, 0, 0), seed=1)},
    "plate": {"type": "disk", "to_world": placed((0.5, 0.7, 1), (-0.6, 0.5, 0.1), seed=2)},
    "wall": {"type": "rectangle", "to_world": placed(0.6, (0, -0.8, 0), seed=3)},
    "ball": {**ball(), "to_world": placed(0.3, (-0.2, 0.1, 0.9))},
}
ROUND = {
    "globe": {"type": "sphere", "to_world": placed(0.5, (0.6, 0.2, 0))},
    "tube": {"type": "cylinder", "radius": 0.3, "p1": (0.2, 0.4, 0.9)},
}
PLACES = {  # of a group whose radius is about 1.5
    "as it is": placed(),
    "turned": placed(seed=4),
    "moved far": placed(1, (100, -50, 20), seed=5),
    "tiny": placed(1e-3, (3, 1, 2), seed=6),
    "huge": placed(1e3, (-200, 30, 100), seed=7),
    "stretched": placed((0.3, 1.0, 4.0), (1, 2, 3), seed=8),
    "mirrored": placed((-1, 1, 1), (1, 2, 3), seed=9),
    "stretched and mirrored": placed((2.0, -0.1, 1.0), (-1, 0, 0), seed=10),
    "sheared": np.array([[1.2, 0.3, 0, 1], [0, 0.7, 0.2, 2], [0.1, 0, 1.5, 3], [0, 0, 0, 1.0]]),
}
SIMILAR = ("as it is", "turned", "moved far", "tiny", "huge", "mirrored")  # a sphere stays a sphere


def rays_at(matrix: np.ndarray, n: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Rays from around an instance through it."""
    random = np.random.default_rng(seed)
    start, end = random.standard_normal((2, n, 3))
    start *= 3 / np.linalg.norm(start, axis=1, keepdims=True)
    end *= 0.7
    start, end = (points @ matrix[:3, :3].T + matrix[:3, 3] for points in (start, end))
    return start.astype(np.float32), (end - start).astype(np.float32)


@pytest.mark.parametrize("name", PLACES)
def test_hits_are_those_of_the_flattened_scene(name, monkeypatch):
    """Two instances of each group.

    Coordinates are rounded to 2^-24 of their size, a share `rounding` of the group's where that is small or far away;
    rays that graze an edge within it may differ: 0.3 % at 0, and a few such widths of edges more.
    """
    group = {**FLAT, **ROUND} if name in SIMILAR else FLAT
    matrix = PLACES[name]
    other = matrix @ placed(0.5, (0.5, 1.0, -1.0))
    origins, directions = rays_at(matrix, 4000, seed=1)
    ours = Traced(with_instances(group, matrix, other), monkeypatch)(origins, directions)
    flat = Traced(flattened(group, matrix, other), monkeypatch)(origins, directions)
    size = np.linalg.svd(matrix[:3, :3], compute_uv=False)
    rounding = 2.0**-24 * np.abs(origins).max() / size.min()
    hit = flat["primitive"] != NONE
    assert 0.2 < hit.mean() < 0.9
    most = 0.997 - 100 * rounding
    assert (hit == (ours["primitive"] != NONE)).mean() > most
    both = hit & (ours["primitive"] != NONE)
    same = np.abs(ours["t"][both] / flat["t"][both] - 1) < 1e-3
    assert same.mean() > most
    ours, flat = ({key: value[both][same] for key, value in hits.items()} for hits in (ours, flat))
    assert np.median(np.abs(ours["t"] / flat["t"] - 1)) < 1e-6 + 2 * rounding
    assert set(ours["instance"]) == {0, 1}
    np.testing.assert_allclose(ours["position"], flat["position"], atol=1e-2 * size.max())
    # flattened, mirrored spheres, cylinders and meshes without normals are inside out (in Mitsuba 3 too); others not
    kept = (ours["primitive"] < 14) | (ours["primitive"] == ANALYTIC_BIT)  # box and wall; plate
    for normal in ("geometric", "shading"):
        across = np.einsum("ij,ij->i", ours[normal], flat[normal])
        assert (np.where(kept, across, np.abs(across)) > 0.999).mean() > most
        assert np.linalg.norm(ours[normal], axis=1) == pytest.approx(1, abs=1e-6)


@pytest.mark.parametrize("name", PLACES)
def test_hits_are_mitsubas(name, monkeypatch):
    """Also where spheres and cylinders are stretched, and which side is the front."""
    mitsuba = import_mitsuba()
    matrix = PLACES[name]
    group = {**{key: shape for key, shape in FLAT.items() if key != "ball"}, **ROUND}
    description = with_instances(group, matrix, matrix @ placed((0.5, 0.5, -0.5), (0.5, 1.0, -1.0)))
    theirs = mitsuba.load_dict(as_mitsuba(mitsuba, {**description, "sensor": {"type": "perspective"}}))
    origins, directions = rays_at(matrix, 500, seed=2)
    ours = Traced(description, monkeypatch)(origins, directions)
    agree = []
    for i, (origin, direction) in enumerate(zip(origins, directions, strict=True)):
        si = theirs.ray_intersect(mitsuba.Ray3f(origin, direction))
        if not si.is_valid() or ours["primitive"][i] == NONE:
            agree.append(si.is_valid() == (ours["primitive"][i] != NONE))
            continue
        normals = np.array(si.n) @ ours["geometric"][i], np.array(si.sh_frame.n) @ ours["shading"][i]
        agree.append(abs(ours["t"][i] / si.t - 1) < 1e-3 and min(normals) > 0.999)
    assert np.mean(agree) > 0.99


@pytest.mark.parametrize("shape", ["ball", "box", "globe", "tube", "plate"])
@pytest.mark.parametrize("name", PLACES)
def test_positions_lie_within_their_stated_errors(name, shape, monkeypatch):
    """Triangles: from the barycentric coordinates, in float64; others: how far the point is off the surface."""
    group = {shape: {**FLAT, **ROUND}[shape]}
    traced = Traced(with_instances(group, PLACES[name]), monkeypatch)
    hits = traced(*rays_at(PLACES[name], 2000, seed=3))
    hit = hits["primitive"] != NONE
    hits = {key: value[hit] for key, value in hits.items()}
    assert len(hits["t"]) > 30
    record = traced.scene.instances[0]
    matrix, inverse = (record[key].reshape(3, 4).astype(float) for key in ("to_world", "to_object"))
    if shape in ("ball", "box"):
        corners = traced.scene.vertices[traced.scene.faces[hits["primitive"]]].astype(float)
        u, v = hits["uv"].astype(float).T[..., None]
        on_object = (1 - u - v) * corners[:, 0] + u * corners[:, 1] + v * corners[:, 2]
        off = np.abs(on_object @ matrix[:, :3].T + matrix[:, 3] - hits["position"])
        assert (off <= hits["error"]).all()
        return
    # the offset along the normal is what rays ask for: the error's share of it, in object space
    analytic = traced.scene.analytics[0]
    own = analytic["to_object"].reshape(3, 4).astype(float)
    inverse = np.linalg.inv(np.vstack([matrix, [0, 0, 0, 1]]))
    point = hits["position"].astype(float) @ inverse[:3, :3].T + inverse[:3, 3]
    if shape == "globe":
        off = np.linalg.norm(point - analytic["center"], axis=1) - analytic["radius"]
        along = (point - analytic["center"]) / analytic["radius"]
    else:
        local = point @ own[:, :3].T + own[:, 3]
        axes = (local * (1, 1, 0)) if shape == "tube" else np.tile([0.0, 0, 1], (len(local), 1))
        off = np.linalg.norm(local[:, :2], axis=1) - 1 if shape == "tube" else local[:, 2]
        along = axes @ own[:, :3]
    gradient = along @ inverse[:3, :3]  # how fast the distance grows in the world
    assert (np.abs(off) <= (np.abs(gradient) * hits["error"]).sum(axis=1)).all()


@pytest.mark.parametrize("shape", ["ball", "box", "globe"])
@pytest.mark.parametrize("name", PLACES)
def test_rays_leave_a_convex_instance_and_stay_inside_it(name, shape, monkeypatch):
    """Outwards none meets it again, inwards each does, also at grazing angles. No tolerance outwards; inwards, a ray
    that starts within rounding of an edge may be on the other side of it: 2e-3 of them at most."""
    group = {shape: {**FLAT, **ROUND}[shape]}
    traced = Traced(with_instances(group, PLACES[name]), monkeypatch)
    origins, directions = rays_at(PLACES[name], 4000, seed=4)
    first = traced(origins, directions)
    hit = first["primitive"] != NONE
    first = {key: value[hit] for key, value in first.items()}
    random = np.random.default_rng(5)
    normal = first["geometric"].astype(float)
    side = random.standard_normal(normal.shape)
    side -= np.einsum("ij,ij->i", side, normal)[:, None] * normal
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    height = np.geomspace(1e-3, 1, len(normal))[:, None]
    for sign in (1, -1):
        towards = (sign * height * normal + np.sqrt(1 - height**2) * side).astype(np.float32)
        left = traced(origins[hit], directions[hit], towards=towards)["leaves"]
        again = traced(left, towards, skip=first["primitive"], start=first["instance"])
        met = (again["primitive"] != NONE).mean()
        assert met == 0 if sign > 0 else met > 0.998


@pytest.mark.parametrize("name", PLACES)
def test_no_ray_leaks_out_of_a_closed_mesh(name, monkeypatch):
    """From inside towards every vertex and points on every edge."""
    mesh = trimesh.creation.icosphere(subdivisions=3)
    matrix = PLACES[name]
    traced = Traced(with_instances({"ball": ball()}, matrix), monkeypatch)
    random = np.random.default_rng(11)
    pairs = mesh.vertices[mesh.edges_unique]
    weight = random.uniform(size=(len(pairs), 1))
    targets = np.concatenate([mesh.vertices, weight * pairs[:, 0] + (1 - weight) * pairs[:, 1]])
    targets = targets @ matrix[:3, :3].T + matrix[:3, 3]
    for inside in random.uniform(-0.4, 0.4, (5, 3)):
        origin = matrix[:3, :3] @ inside + matrix[:3, 3]
        hits = traced(np.broadcast_to(origin, targets.shape), targets - origin)
        assert (hits["primitive"] != NONE).all()


def test_what_a_ray_starts_on_is_left_out_in_its_own_instance_alone(monkeypatch):
    """Three plates in a row, the last of them in the world; from the first the second is seen, and so on."""
    wall = {"type": "rectangle"}
    description = with_instances(
        {"wall": wall}, placed(), placed(1, (0, 0, 2)), last={**wall, "to_world": placed(1, (0, 0, 5))}
    )
    traced = Traced(description, monkeypatch)
    origins = np.array([[0.1, 0.2, -1], [0.1, 0.2, 0], [0.1, 0.2, 2], [0.1, 0.2, 5]])
    directions = np.tile([0.0, 0, 1], (4, 1))
    hits = traced(origins, directions)
    primitives = hits["primitive"][[0, 0, 0]].tolist()
    # the world's shapes come first
    skip = np.array([NONE, primitives[0], primitives[0], 0])
    start = np.array([NONE, 0, 1, NONE])
    hits = traced(origins, directions, skip, start)
    assert hits["t"].tolist() == [1, 2, 3, np.inf]
    assert hits["instance"].tolist() == [0, 1, NONE, NONE]
    # as if a ray started a rounding before the surface: seen unless it is what the ray starts on
    before = np.array([[0.1, 0.2, -1e-7], [0.1, 0.2, 2 - 1e-6]])
    own = traced(before, directions[:2], skip[1:3], start[1:3])
    assert own["t"] == pytest.approx([2, 3], rel=1e-6)
    others = traced(before, directions[:2], skip[1:3], start[[2, 1]])
    assert (others["t"] < 1e-5).all()


def room(**more) -> dict:
    """A lamp above a floor, seen from the front."""
    floor = placed(3, (0, -1, -3)) @ np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
    lamp = placed(0.7, (0, 2.5, -2.5)) @ np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
    radiance = {"type": "rgb", "value": [6.0, 5.0, 4.0]}
    return {
        "integrator": {"type": "path", "max_depth": 5, "rr_depth": 6},
        "sensor": {
            "type": "perspective",
            "fov": 55.0,
            "to_world": np.diag([-1.0, 1.0, -1.0, 1.0]),
            "film": {"type": "hdrfilm", "width": 32, "height": 32, "rfilter": {"type": "box"}},
        },
        "floor": {"type": "rectangle", "to_world": floor},
        "lamp": {"type": "rectangle", "to_world": lamp, "emitter": {"type": "area", "radiance": radiance}},
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": [0.1, 0.2, 0.4]}},
        **more,
    }


def coloured(group: dict) -> dict:
    """The shapes in different materials; two of them turn with the surface's coordinates."""
    brushed = {"type": "roughconductor", "alpha_u": 0.1, "alpha_v": 0.5, "specular_reflectance": 0.9}
    materials = [
        {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.7, 0.2, 0.1]}},
        brushed,
        {"type": "diffuse", "reflectance": {"type": "checkerboard", "color0": 0.1, "color1": 0.8}},
        {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.2, 0.3, 0.8]}},
        brushed,
    ]
    return {
        name: {**shape, "bsdf": {"type": "twosided", "bsdf": bsdf}}
        for (name, shape), bsdf in zip(group.items(), materials, strict=False)
    }


SEEN = (
    placed(0.6, (-0.9, -0.2, -3.5), seed=20),
    placed((0.5, 0.8, -0.4), (0.9, 0.1, -4.0), seed=21),
    placed((0.1, 0.1, 0.5), (0.0, -0.7, -2.5), seed=22),
)


def test_the_picture_is_that_of_the_flattened_scene(tmp_path):
    """False alarms: below 1 % for the pixels, at most 0.8 % for the means."""
    group = coloured(FLAT)
    estimates = []
    for seed, make in enumerate((with_instances, flattened)):
        batches = [
            render(make(group, *SEEN, **room()), spp=16, strategy="uniform:wave_spp=16", seed=50 * seed + batch)
            for batch in range(16)
        ]
        assert not any(batch.statistics.rejected.any() for batch in batches)
        estimates.append(references.from_batches(np.stack([batch.statistics.rgb for batch in batches])))
    references.assert_agree(*estimates, tmp_path)
    references.assert_means_agree(*estimates)


def test_the_picture_is_mitsubas(tmp_path):
    """False alarms: below 1 % for the pixels, at most 0.8 % for the means."""
    group = coloured({**{key: shape for key, shape in FLAT.items() if key != "ball"}, **ROUND})
    assert_same_picture(with_instances(group, *SEEN, **room()), tmp_path, spp=32)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_a_white_instance_in_a_white_furnace_cannot_be_seen(scale):
    """Reflectance 1 in light of radiance 1 from everywhere: 1 in every pixel, whatever the roundings."""
    matrix = placed((scale, -0.5 * scale, 0.7 * scale), (0.3 * scale, 0.1 * scale, -4 * scale), seed=30)
    group = {
        "globe": {**ball(smooth=False), "bsdf": {"type": "diffuse", "reflectance": 1.0}},
        "box": {"type": "cube", "to_world": placed(0.8, (0.5, 0, 0)), "bsdf": {"type": "diffuse", "reflectance": 1.0}},
    }
    sky = {"type": "constant", "radiance": {"type": "rgb", "value": [1.0, 1.0, 1.0]}}
    sensor = {**room()["sensor"], "near_clip": 0.01 * scale, "far_clip": 1e4 * scale}
    sensor["film"] = {**sensor["film"], "width": 16, "height": 16}
    integrator = {"type": "path", "max_depth": 200, "rr_depth": 300}
    scene = with_instances(group, matrix, sensor=sensor, integrator=integrator, sky=sky)
    statistics = render(scene, spp=64, strategy="uniform:wave_spp=64").statistics
    # next-event estimation and the direction's own sample weigh 1 together only on average
    noise = np.sqrt(statistics.variance / statistics.count)
    assert (np.abs(statistics.mean - 1) <= 5 * noise + 1e-4).all()
    assert statistics.mean.mean() == pytest.approx(1, abs=2e-3)


def test_ten_thousand_instances(monkeypatch):
    """Memory: 100 bytes an instance and its share of the hierarchy, and the group once. Set-up: seconds."""
    mesh = trimesh.creation.icosphere(subdivisions=3)
    random = np.random.default_rng(8)
    count = 10_000
    matrices = [placed(0.01, random.uniform(-1, 1, 3)) for _ in range(count)]
    begun = time.process_time()
    scene = compile_scene(load(with_instances({"ball": ball()}, *matrices)))
    bvh = build_scene_bvh(scene)
    seconds = time.process_time() - begun
    assert len(scene.faces) == len(mesh.faces) == 1280
    assert len(scene.instances) == count
    size = sum(array.nbytes for array in (*vars(scene).values(), *vars(bvh).values()) if isinstance(array, np.ndarray))
    once = compile_scene(load(with_instances({"ball": ball()}, matrices[0])))
    group = sum(array.nbytes for array in vars(once).values() if isinstance(array, np.ndarray))
    assert size < 3 * group + 200 * count
    assert seconds < 15  # about 1.5
    traced = Traced(scene, monkeypatch)
    centers = np.stack([matrix[:3, 3] for matrix in matrices])
    directions = random.standard_normal((2000, 3))
    hits = traced(centers[:2000], directions)
    assert (hits["instance"] == np.arange(2000)).mean() > 0.99  # some overlap
    assert (hits["primitive"] != NONE).all()


def test_bounds_are_those_of_what_stands_in_the_world():
    group = {"box": {"type": "cube", "to_world": placed(1, (10, 0, 0))}}
    scene = compile_scene(load(with_instances(group, placed(2, (0, 0, 5)))))
    np.testing.assert_allclose(scene.bounds, [[18, -2, 3], [22, 2, 7]])
    scene = compile_scene(load(with_instances(group, placed(), wall={"type": "rectangle"})))
    np.testing.assert_allclose(scene.bounds, [[-1, -1, -1], [11, 1, 1]])


def test_a_group_without_instances_is_not_there():
    wall = {"wall": {"type": "rectangle"}}
    with_group = compile_scene(load({**with_instances({"ball": ball()}), **wall}))
    without = compile_scene(load({"type": "scene", "sensor": {"type": "perspective"}, **wall}))
    assert with_group.hash == without.hash
    assert not features(with_group)["INSTANCES"]


def test_groups_share_primitives_in_the_order_of_their_first_instance():
    """A group may also stand in the instance itself."""
    scene = {
        "type": "scene",
        "sensor": {"type": "perspective"},
        "late": {"type": "shapegroup", "a": {"type": "sphere"}, "b": {"type": "cube"}},
        "first": {"type": "instance", "own": {"type": "shapegroup", "a": {"type": "rectangle"}}},
        "second": {"type": "instance", "it": {"type": "ref", "id": "late"}},
        "third": {"type": "instance", "it": {"type": "ref", "id": "late"}},
        "disk": {"type": "disk"},
    }
    compiled = compile_scene(load(scene))
    assert compiled.group_offsets.tolist() == [[0, 1], [2, 1], [14, 2]]
    assert compiled.instances["root"].tolist() == [1, 2, 2]
    assert compiled.shapes["first_primitive"].tolist() == [0, 0, 1, 2]
    assert compiled.analytics["kind"].tolist() == [structs.ANALYTIC_DISK, structs.ANALYTIC_SPHERE]


def test_deep_hierarchies_fit_the_stack(monkeypatch):
    """Shells within shells, a thousand of them, in a thousand instances that shrink."""
    random = np.random.default_rng(9)
    corners = (random.uniform(-1, 1, (1, 3, 3)) * np.geomspace(1e-6, 1e3, 1000)[:, None, None]).reshape(-1, 3)
    nested = {"type": "mesh", "vertices": corners, "faces": np.arange(3000).reshape(-1, 3), "face_normals": True}
    matrices = [placed(scale) for scale in np.geomspace(1e-3, 1e3, 1000)]
    scene = compile_scene(load(with_instances({"nested": nested}, *matrices)))
    assert build_scene_bvh(scene).stack <= 256


MALFORMED = [
    ('<shape type="instance"/>', "shape 'instance' needs a nested shapegroup"),
    ('<shape type="instance"><ref id="nobody"/></shape>', "there is no object with the id 'nobody'"),
    ('<shape type="shapegroup"/>', "shape 'shapegroup' needs a nested shape"),
    ('<shape type="instance"><shape type="sphere"/></shape>', "instance cannot contain a shape 'sphere' .*shapegroup"),
    (
        '<shape type="shapegroup" id="g"><shape type="sphere"/></shape><shape type="instance"><ref id="g"/>'
        '<ref id="g"/></shape>',
        "instance can contain only one shape",
    ),
    (
        '<shape type="shapegroup" id="g"><shape type="sphere"/></shape>'
        '<shape type="shapegroup"><shape type="instance"><ref id="g"/></shape></shape>',
        "shapegroup cannot contain a shape 'instance'",
    ),
    (
        '<shape type="shapegroup"><shape type="shapegroup"><shape type="sphere"/></shape></shape>',
        "shapegroup cannot contain a shape 'shapegroup'",
    ),
    (
        '<shape type="shapegroup"><shape type="sphere"><emitter type="area"/></shape></shape>',
        "a shape of a shapegroup cannot shine",
    ),
    ('<shape type="shapegroup"><bsdf type="diffuse"/></shape>', "'shapegroup' cannot contain a bsdf"),
    ('<shape type="instance"><bsdf type="diffuse"/></shape>', "'instance' cannot contain a bsdf"),
    ('<shape type="shapegroup" id="g"><ref id="g"/></shape>', "refers to itself"),
]
GROUP = '<shape type="shapegroup" id="g"><shape type="{}"/></shape>'
PLACED = '<shape type="instance"><transform name="to_world">{}</transform><ref id="g"/></shape>'
MALFORMED += [
    (GROUP.format("sphere") + PLACED.format('<scale x="0"/>'), "to_world cannot be inverted"),
    (GROUP.format("sphere") + PLACED.format('<scale value="1e-42"/>'), "leaves the range of 32-bit floats"),
    (GROUP.format("sphere") + PLACED.format('<translate x="1e30"/>'), "instance .* extends beyond 1e.18"),
    (
        GROUP.format("sphere")
        + PLACED.format('<rotate z="1" angle="3"/><scale x="1e-8" y="1e8"/><rotate z="1" angle="9"/>'),
        "instance .* leaves the range of 32-bit floats",
    ),
]


@pytest.mark.parametrize(("inside", "message"), MALFORMED)
def test_malformed_groups_and_instances(inside, message, scene_of):
    with pytest.raises(SceneError, match=message):
        compile_scene(scene_of(inside))


def test_a_file_with_instances(scene_of):
    """As Mitsuba's documentation writes them."""
    scene = scene_of(
        '<shape type="shapegroup" id="trees"><shape type="cube"><bsdf type="diffuse"/></shape>'
        '<shape type="sphere"><transform name="to_world"><translate y="20"/></transform></shape></shape>'
        '<shape type="instance"><ref id="trees"/></shape>'
        '<shape type="instance"><ref id="trees"/><transform name="to_world"><translate z="10"/></transform></shape>'
    )
    compiled = compile_scene(scene)
    assert len(compiled.instances) == 2
    assert compiled.bounds.tolist() == [[-1, -1, -1], [1, 21, 11]]


def test_no_buffer_and_no_code_without_instances(monkeypatch):
    """The program texts are the same as ever once they are preprocessed (tests/test_program.py); so are the buffers."""
    what = []
    buffer = Device.buffer
    monkeypatch.setattr(Device, "build", lambda self, text, options: {})
    monkeypatch.setattr(Device, "buffer", lambda self, size, name: (what.append(name), buffer(self, size, name))[1])
    for description, present in (
        ({"type": "scene", "sensor": {"type": "perspective"}, "ball": {"type": "sphere"}}, False),
        (with_instances({"ball": {"type": "sphere"}}, placed()), True),
    ):
        what.clear()
        scene = compile_scene(load(description), size=(4, 4))
        Wavefront(Device(), scene, build_scene_bvh(scene), pool_size=64)
        assert ("the instances" in what) == present
