"""The light tree: bounds, probabilities and sampled lights. test_light_tree_images.py tests images.

Chi-square statistics and z-values are compared as standard normal deviates at Z = 5: 6e-7 for each of about 30, so
false alarms are 1e-5 for the file under other seeds.
"""

import numpy as np
import pytest
from kernel_build import build_kernels
from many_lights import compiled, deviate, grid_of_triangles, mixed_lights, some_points, unit

from isonoise.device.opencl import Device
from isonoise.scene import structs
from isonoise.scene.light.light_kinds import light_bits
from isonoise.scene.light.light_tree import BVH_WIDTH, NodeRow, build_light_tree
from isonoise.scene.light.lights import compute_light_bounds

Z = 5.0
DEFENSIVE_COSINES = 2.0**-10  # in kernels/light/light_tree.h
KERNELS = """
#include "light/light_tree.h"

#define LOAD4(i, p) vec4_from(LOAD3(0, (p) + 4 * (i)), (p)[4 * (i) + 3])

__kernel void node_probabilities(__global const float8* nodes, __global const uint* places, __global const float* cdf,
                                 uint lights, __global const float* points, __global const float* normals,
                                 __global const uint* which, __global float8* out, uint n)
{
    const uint i = get_global_id(0);
    if (i >= n) return;
    __global const float8* node = nodes + LIGHT_NODE_ROWS * which[i];
    const LightNodeWeights w = light_node_weights(node, LOAD3(i, points), LOAD4(i, normals));
    const float scale = inverse_weight_sum(w.weight.lane);
    out[i] = scale * w.weight.vector;
}

__kernel void probability(__global const float8* nodes, __global const uint* places, __global const float* cdf,
                          uint lights, __global const float* points, __global const float* normals,
                          __global const uint* which, __global float* out, uint n)
{
    const uint i = get_global_id(0);
    const LightTree tree = {nodes, places, cdf, lights};
    if (i < n) out[i] = light_tree_pmf(&tree, which[i], LOAD3(i, points), LOAD4(i, normals));
}

__kernel void pick(__global const float8* nodes, __global const uint* places, __global const float* cdf,
                   uint lights, __global const float* points, __global const float* normals,
                   __global const uint2* u, __global float* out, uint n)
{
    const uint i = get_global_id(0);
    const LightTree tree = {nodes, places, cdf, lights};
    if (i >= n) return;
    float p, x = u[i].x * 0x1p-24f;
    const uint light = select_from_tree(&tree, LOAD3(i, points), LOAD4(i, normals), &x, u[i].y * 0x1p-24f, &p);
    out[3 * i] = as_float(light);
    out[3 * i + 1] = p;
    out[3 * i + 2] = x;
}
"""


class TreeKernels:
    """Runs the kernels above on a tree."""

    def __init__(self):
        self.device = Device()
        self.kernels = build_kernels(self.device, KERNELS, ("LIGHT_TREE", "AREA_LIGHTS"))

    def run(self, kernel, tree, scene, points, normals, what, row):
        n = len(points)
        points, normals = points.astype(np.float32), normals.astype(np.float32)
        lights = np.uint32(len(scene.lights))
        given = (tree.nodes, tree.parents, scene.light_cdf, lights, points, normals, what)
        out = self.device.buffer(4 * row * n, "results")
        buffers = [self.device.buffer(a, "arguments") if a.ndim else a for a in given]
        self.device.launch(self.kernels[kernel], n, (*buffers, out, np.uint32(n)))
        return self.device.read(out, np.float32, row * n).reshape(n, row)

    def probability(self, tree, scene, points, normals, light_indices) -> np.ndarray:
        light_indices = np.asarray(light_indices, np.uint32)
        return self.run("probability", tree, scene, points, normals, light_indices, 1)[:, 0].astype(np.float64)

    def pick(self, tree, scene, point, normal, count, seed):
        """Returns sampled lights and their stated probabilities, for one point."""
        u = np.random.default_rng(seed).integers(0, 2**24, (count, 2))
        return self.pick_by(tree, scene, point, normal, u)[:2]

    def pick_by(self, tree, scene, point, normal, u):
        """The same and the rescaled random numbers, for random numbers (n, 2) of 24 bits."""
        points, normals = (np.tile(v, (len(u), 1)) for v in (point, normal))
        out = self.run("pick", tree, scene, points, normals, u.astype(np.uint32), 3)
        return out[:, 0].copy().view(np.uint32), *out[:, 1:].T.astype(np.float64)


@pytest.fixture(scope="module")
def device():
    return TreeKernels()


def reference_irradiance(node: np.ndarray, point: np.ndarray, normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cosines and the rest of the irradiance in float64: the paper's, with the mean of bound and centre as cosine."""
    node = node.astype(np.float64)
    arm = node[NodeRow.CENTER : NodeRow.CENTER + 3] - point.astype(np.float64)[:, None]
    distance = np.linalg.norm(arm, axis=0)
    theta = np.arccos(np.clip(-(node[NodeRow.AXIS : NodeRow.AXIS + 3] * arm).sum(axis=0) / distance, -1, 1))
    spread = np.arctan2(node[NodeRow.SIN_SPREAD], node[NodeRow.COS_SPREAD])
    emission = np.cos(np.maximum(theta - spread, 0))
    max_emission = emission + node[NodeRow.EMISSION_RADIUS] / distance
    incidence = (normal[:3, None] * arm).sum(axis=0) / distance + normal[3]
    max_incidence = incidence + node[NodeRow.RADIUS] / distance

    def twice_mean(cosine, max_cosine):
        return np.clip(max_cosine, 0, 1) + np.clip(cosine, 0, 1)

    is_lit = max_emission > node[NodeRow.COS_EDGE]
    irradiance = np.minimum(node[NodeRow.INTENSITY] / distance**2, node[NodeRow.MAX_IRRADIANCE])
    return is_lit * twice_mean(emission, max_emission) * twice_mean(incidence, max_incidence), irradiance


def reference_probabilities(node: np.ndarray, point: np.ndarray, normal: np.ndarray) -> np.ndarray:
    cosines, irradiance = reference_irradiance(node, point, normal)
    weights = (cosines + DEFENSIVE_COSINES) * irradiance
    return weights / weights.sum()


# The tree.


@pytest.mark.parametrize("count", [1, 2, 8, 9, 60, 500])
@pytest.mark.parametrize("beyond", [False, True])
def test_every_light_with_power_has_one_place(count, beyond):
    scene = compiled(**mixed_lights(count, beyond=beyond))
    tree, lights = build_light_tree(scene), len(scene.lights)
    references = tree.nodes[:, NodeRow.CHILD].view(np.int32)
    used = tree.nodes[:, NodeRow.LAST_LIGHT].view(np.int32) >= 0
    leaves = ~references[used & (references < 0)]
    assert sorted(leaves) == np.flatnonzero(scene.lights["power_pmf"] > 0).tolist()
    inner = references[used & (references >= 0)]
    assert sorted(inner) == list(range(1, len(tree.nodes)))
    for child in np.concatenate([leaves, lights + inner]):
        node, slot = divmod(int(tree.parents[child]), BVH_WIDTH)
        assert references[node, slot] == (child - lights if child >= lights else ~child)
    assert tree.parents[lights] == structs.NONE
    dark = np.flatnonzero(scene.lights["power_pmf"] == 0)
    assert len(dark) == 1
    assert tree.parents[dark].tolist() == [structs.NONE]


def test_children_are_in_spatial_order():
    """Light records are along a Morton curve. On a line, so are all leaves of the tree, from left to right."""
    places = np.random.default_rng(4).permutation(200)
    lamps = {
        f"lamp{i}": {"type": "point", "position": [float(x), 0, 0], "intensity": 1.0} for i, x in enumerate(places)
    }
    scene = compiled(floor={"type": "rectangle"}, **lamps)
    assert (np.diff(scene.lights["position"][:, 0]) > 0).all()
    assert _lights_below_node(build_light_tree(scene), 0) == list(range(200))


def _lights_below_node(tree, node: int) -> list[int]:
    references = tree.nodes[node, NodeRow.CHILD].view(np.int32)
    return [
        light
        for slot in np.flatnonzero(tree.nodes[node, NodeRow.LAST_LIGHT].view(np.int32) >= 0)
        for light in _lights_below(tree, references[slot])
    ]


def _lights_below(tree, reference: int) -> list[int]:
    return [~reference] if reference < 0 else _lights_below_node(tree, reference)


def _emission_of(scene, light: np.ndarray, rng, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns points of a light, normals of its emission (zero: all directions), and the cosine where it ends."""
    zero, half = np.zeros((count, 3)), np.zeros(count)
    if light["kind"] == light_bits("point"):
        return np.tile(light["position"], (count, 1)), zero, half
    if light["kind"] == light_bits("spot"):
        axis = np.tile(light["axis"], (count, 1))
        return np.tile(light["position"], (count, 1)), axis, np.full(count, np.cos(light["cutoff"]))
    if light["kind"] & light_bits("triangle", "parallelogram"):
        face = scene.faces[light["primitive"] + rng.integers(0, 1 + (light["kind"] == light_bits("parallelogram")))]
        weights = rng.dirichlet(np.ones(3), count)
        corners = scene.vertices[face].astype(np.float64)
        normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
        normals = np.tile(normal, (count, 1))
        shape = scene.shapes[scene.triangle_shape[light["primitive"]]]
        if shape["flags"] & structs.SHAPE_VERTEX_NORMALS:
            normals = weights @ scene.vertex_normals[face]
        return weights @ corners, unit(normals), half
    record = scene.analytics[light["primitive"]]
    flip = -1.0 if scene.shapes["flags"][record["shape"]] & structs.SHAPE_FLIP_NORMALS else 1.0
    if light["kind"] == light_bits("sphere"):
        out = unit(rng.normal(size=(count, 3)))
        return record["center"] + record["radius"] * out, flip * out, half
    matrix, inverse = (record[name].reshape(3, 4).astype(np.float64) for name in ("to_world", "to_object"))
    angle = rng.uniform(0, 2 * np.pi, count)
    around = np.stack([np.cos(angle), np.sin(angle), np.zeros(count)], axis=1)
    if light["kind"] == light_bits("disk"):
        on, normal = around * rng.uniform(0, 1, (count, 1)), np.tile([0.0, 0.0, 1.0], (count, 1))
    else:
        on, normal = around + np.outer(rng.uniform(0, 1, count), [0, 0, 1]), around
    return on @ matrix[:, :3].T + matrix[:, 3], flip * unit(normal @ inverse[:, :3]), half


def test_bounds_miss_no_light_that_arrives():
    """The importance of every ancestor of a light is positive at points that receive light from it."""
    rng = np.random.default_rng(11)
    scene = compiled(**mixed_lights(64, beyond=False))
    tree = build_light_tree(scene)
    points, normals = some_points(rng, 150)
    references = tree.nodes[:, NodeRow.CHILD].view(np.int32)
    checked = 0
    for node, slot in zip(*np.nonzero(tree.nodes[:, NodeRow.LAST_LIGHT].view(np.int32) >= 0), strict=True):
        below = rng.permutation(_lights_below(tree, references[node, slot]))[:4]
        for light in below:
            on, emission_normals, min_cosine = _emission_of(scene, scene.lights[light], rng, len(points))
            arm = on - points
            distance = np.linalg.norm(arm, axis=1)
            # 1e-4: records are rounded to 32 bits
            leaves = (-(emission_normals * arm).sum(axis=1) > (min_cosine + 1e-4) * distance) | ~emission_normals.any(
                axis=1
            )
            arrives = ((normals[:, :3] * arm).sum(axis=1) > 1e-4 * distance) | (normals[:, 3] == 1)
            for index in np.flatnonzero(leaves & arrives):
                assert reference_irradiance(tree.nodes[node], points[index], normals[index])[0][slot] > 0
                checked += 1
    assert checked > 5000


def test_lights_stay_within_the_emission_radius():
    """No point of a light is farther along the light's normal than its node says; a panel across an axis is flat."""
    rng = np.random.default_rng(12)
    tilt = np.eye(4)
    tilt[:3, :3] = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    panel, tilted = compiled(lamp=grid_of_triangles(16)), compiled(lamp=grid_of_triangles(16) | {"to_world": tilt})
    for scene in (compiled(**mixed_lights(64, beyond=False)), panel, tilted):
        nodes = build_light_tree(scene).nodes.astype(np.float64)
        first, last = (
            nodes[:, row].astype(np.float32).view(np.int32) for row in (NodeRow.FIRST_LIGHT, NodeRow.LAST_LIGHT)
        )
        for node, slot in zip(*np.nonzero(last >= 0), strict=True):
            center, radius = nodes[node, NodeRow.CENTER : NodeRow.CENTER + 3, slot], nodes[node, :, slot]
            for light in scene.lights[first[node, slot] : last[node, slot] + 1][:20]:
                on, normals, _ = _emission_of(scene, light, rng, 8)
                reach = np.abs(((on - center) * normals).sum(axis=1)).max()
                assert light["power_pmf"] == 0 or reach <= radius[NodeRow.EMISSION_RADIUS] + 1e-5
    assert build_light_tree(panel).nodes[:, NodeRow.EMISSION_RADIUS].max() < 1e-5


def test_intensity_is_the_largest_that_a_light_has():
    """Closed forms: A L for flat shapes, pi r^2 L for a sphere, 2 r h L for a cylinder, the intensity of points."""
    scene = compiled(
        quad={"type": "rectangle", "emitter": {"type": "area", "radiance": 3.0}},
        ball={"type": "sphere", "radius": 0.5, "emitter": {"type": "area", "radiance": 5.0}},
        disk={"type": "disk", "emitter": {"type": "area", "radiance": 7.0}},
        tube={"type": "cylinder", "radius": 0.5, "p1": [0, 0, 2.0], "emitter": {"type": "area", "radiance": 11.0}},
        point={"type": "point", "intensity": 13.0},
        spot={"type": "spot", "intensity": 17.0, "cutoff_angle": 30.0},
    )
    expected = {
        "parallelogram": 4 * 3.0,
        "sphere": np.pi / 4 * 5.0,
        "disk": np.pi * 7.0,
        "cylinder": 2 * 0.5 * 2 * 11.0,
        "point": 13.0,
        "spot": 17.0,
    }
    intensity = dict(zip(scene.lights["kind"], compute_light_bounds(scene, scene.lights).intensity, strict=True))
    found = np.array([intensity[light_bits(name)] for name in expected])
    np.testing.assert_allclose(found / found[0], np.array(list(expected.values())) / 12.0, rtol=1e-5)


# Probabilities and sampled lights.


def test_probabilities_of_a_node_are_those_of_float64(device):
    rng = np.random.default_rng(3)
    scene = compiled(**mixed_lights(200))
    tree = build_light_tree(scene)
    points, normals = some_points(rng, 4000)
    node_indices = rng.integers(0, len(tree.nodes), len(points)).astype(np.uint32)
    computed = device.run("node_probabilities", tree, scene, points, normals, node_indices, 8)
    expected = np.stack(
        [reference_probabilities(tree.nodes[w], p, n) for w, p, n in zip(node_indices, points, normals, strict=True)]
    )
    # absolute: the cosine of a sum of angles suffers from cancellation
    np.testing.assert_allclose(computed, expected, rtol=2e-5, atol=2e-6)


def test_probabilities_of_all_lights_sum_to_one(device):
    rng = np.random.default_rng(4)
    scene = compiled(**mixed_lights(90))
    tree, lights = build_light_tree(scene), len(scene.lights)
    points, normals = some_points(rng, 64)
    computed = device.probability(
        tree, scene, np.repeat(points, lights, 0), np.repeat(normals, lights, 0), np.tile(np.arange(lights), 64)
    ).reshape(64, lights)
    np.testing.assert_allclose(computed.sum(axis=1), 1.0, atol=1e-5)
    power = scene.lights["power_pmf"]
    assert ((computed > 0) == (power > 0)).all()


@pytest.mark.parametrize("seed", range(6))
def test_picks_have_the_stated_probabilities(device, seed):
    rng = np.random.default_rng(seed)
    scene = compiled(**mixed_lights(90))
    tree, lights, count = build_light_tree(scene), len(scene.lights), 1 << 18
    points, normals = some_points(rng, 2)
    point, normal = points[seed % 2], normals[seed % 2]
    sampled, stated = device.pick(tree, scene, point, normal, count, seed)
    expected = device.probability(tree, scene, np.tile(point, (lights, 1)), np.tile(normal, (lights, 1)), range(lights))
    np.testing.assert_allclose(stated, expected[sampled], rtol=1e-6)
    assert abs(deviate(np.bincount(sampled, minlength=lights), count * expected)) < Z


@pytest.mark.parametrize("seed", range(3))
def test_stratified_numbers_stay_stratified(device, seed):
    """One number in each of 2^18 strata: as many as expected select a light, and the rescaled ones are stratified.

    A light's part of [0, 1) is one interval, which is off by one stratum at each end.
    """
    scene, count = compiled(**mixed_lights(90)), 2**18
    tree = build_light_tree(scene)
    rng = np.random.default_rng(seed)
    points, normals = some_points(rng, 1)
    u = np.stack([64 * np.arange(count) + rng.integers(0, 64, count), rng.integers(0, 2**24, count)], axis=1)
    picked, stated, rescaled = device.pick_by(tree, scene, points[0], normals[0], u)
    assert rescaled.min() >= 0
    assert rescaled.max() < 1
    for light in np.unique(picked):
        chosen = picked == light
        expected = count * stated[chosen][0]
        assert abs(chosen.sum() - expected) <= 2 + 1e-5 * expected
        in_order = np.sort(rescaled[chosen])
        ideal = (np.arange(len(in_order)) + 0.5) / len(in_order)
        assert np.abs(in_order - ideal).max() <= 2 / len(in_order) + 1e-5


def test_a_hundred_thousand_lights_are_picked_evenly(device):
    """From a large distance 131,072 lights have equal probabilities; sampling uses all of the 48 bits."""
    scene = compiled(lamp=grid_of_triangles(256))
    tree, lights, count = build_light_tree(scene), len(scene.lights), 1 << 21
    point, normal = np.array([0.0, 0.0, 1e4]), np.array([0, 0, -1.0, 0])
    sampled, stated = device.pick(tree, scene, point, normal, count, seed=1)
    assert lights == 131072
    np.testing.assert_allclose(stated * lights, 1.0, rtol=0.01)
    assert abs(deviate(np.bincount(sampled, minlength=lights), np.full(lights, count / lights))) < Z


@pytest.mark.parametrize("scale", [1e-12, 1e-6, 1.0, 1e6, 1e15])
def test_scale_and_place_change_no_probability(device, scale):
    scene = compiled(**mixed_lights(40, beyond=False))
    tree, lights = build_light_tree(scene), len(scene.lights)
    points, normals = some_points(np.random.default_rng(8), 32)
    of = (np.repeat(normals, lights, 0), np.tile(np.arange(lights), 32))
    expected = device.probability(tree, scene, np.repeat(points, lights, 0), *of)
    lengths = (*range(NodeRow.CENTER, NodeRow.CENTER + 3), NodeRow.RADIUS, NodeRow.EMISSION_RADIUS, NodeRow.MIN_UNIFORM)
    for row in lengths:
        tree.nodes[:, row] *= np.float32(scale)
    tree.nodes[:, NodeRow.INTENSITY] *= np.float32(scale**2)
    scaled = device.probability(tree, scene, np.repeat(points * np.float32(scale), lights, 0), *of)
    np.testing.assert_allclose(scaled, expected, rtol=2e-4, atol=1e-6)


def test_points_on_and_in_lights_and_behind_all(device):
    """If all importances are 0, intensities decide; all probabilities are finite."""
    quads = {
        f"quad{i}": {"type": "rectangle", "emitter": {"type": "area", "radiance": float(1 + i % 3)}} for i in range(10)
    }  # coincident: 20 triangles in one place
    lamps = {f"lamp{i}": {"type": "point", "position": [1.0, 0, 0], "intensity": 2.0} for i in range(10)}
    scene = compiled(**quads, **lamps)
    tree, lights = build_light_tree(scene), len(scene.lights)
    points = np.array([[0, 0, 0], [1.0, 0, 0], [0.3, 0.3, 0.0], [0, 0, -5.0], [0, 0, 5.0], [1e17, 0, 0]])
    normals = np.array([[0, 0, 1, 0], [0, 0, 0, 1], [0, 0, -1, 0], [0, 0, -1, 0], [0, 0, 1, 0], [-1, 0, 0, 0]])
    count = len(points)
    computed = device.probability(
        tree, scene, np.repeat(points, lights, 0), np.repeat(normals, lights, 0), np.tile(np.arange(lights), count)
    ).reshape(count, lights)
    assert np.isfinite(computed).all()
    assert (computed > 0).all()
    np.testing.assert_allclose(computed.sum(axis=1), 1.0, atol=1e-5)
