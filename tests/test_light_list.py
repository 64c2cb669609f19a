"""The light list: importances, probabilities and sampled lights, for single paths and in loops over lanes.

Chi-square statistics are compared as standard normal deviates at Z = 5: 6e-7 for each of about 10.
"""

import numpy as np
import pytest
from kernel_build import build_kernels
from many_lights import assert_inverts_cdf, compiled, deviate, mixed_lights, some_points

from isonoise.device.opencl import Device
from isonoise.integrator.features import features
from isonoise.scene import structs
from isonoise.scene.light import light_list
from isonoise.scene.light.light_list import build_light_list
from isonoise.scene.light.light_tree import NodeRow, build_light_tree

Z = 5.0
LANES = 64
INTENSITY_SHARE = 2.0**-10  # in kernels/light/light_list.h
KERNELS = """
#include "light/light_list.h"

__kernel void probability(__global const LightBound* bounds, uint lights, __global const float* points,
                          __global const float* normals, __global const uint* which, __global float* out, uint n)
{
    const uint i = get_global_id(0);
    if (i >= n) return;
    const LightList list = {bounds, lights};
    const Vec4 normal = vec4(normals[4 * i], normals[4 * i + 1], normals[4 * i + 2], normals[4 * i + 3]);
    out[i] = light_list_pmf(&list, which[i], LOAD3(i, points), normal);
}

__kernel void pick(__global const LightBound* bounds, uint lights, __global const float* points,
                   __global const float* normals, __global const uint2* u, __global float* out, uint n)
{
    const uint i = get_global_id(0);
    if (i >= n) return;
    const LightList list = {bounds, lights};
    const Vec4 normal = vec4(normals[4 * i], normals[4 * i + 1], normals[4 * i + 2], normals[4 * i + 3]);
    float p, x = u[i].x * 0x1p-24f;
    out[3 * i] = as_float(select_from_list(&list, LOAD3(i, points), normal, &x, u[i].y * 0x1p-24f, &p));
    out[3 * i + 1] = p;
    out[3 * i + 2] = x;
}

#if LANES > 1
void keep_all(__global const float* records, uint members, uint begin, uint count, float* lane_state)
{
    for (uint k = 0u; k < count; ++k)
        for (uint c = 0u; c < members; ++c) store_lane(records[members * (begin + k) + c], lane_state, c, k);
}

__kernel void answer_all(__global const LightBound* bounds, uint lights, __global const float* points,
                         __global const float* normals, __global const uint* which, __global float* out, uint n)
{
    const uint begin = get_global_id(0) * LANES;
    const LightList list = {bounds, lights};
    if (begin >= n) return;
    const uint count = MIN(n - begin, LANES);
    float queries[QUERY_FLOATS * LANES];
    keep_all(points, 3u, begin, count, queries + QUERY_POINT * LANES);
    keep_all(normals, 4u, begin, count, queries + QUERY_NORMAL * LANES);
    for (uint k = 0u; k < count; ++k) store_lane(as_float(which[begin + k]), queries, QUERY_LIGHT, k);
    evaluate_light_pmf_queries(&list, queries, count);
    for (uint k = 0u; k < count; ++k) out[begin + k] = load_lane(queries, QUERY_PMF, k);
}

__kernel void pick_all(__global const LightBound* bounds, uint lights, __global const float* points,
                       __global const float* normals, __global const uint2* u, __global float* out, uint n)
{
    const uint begin = get_global_id(0) * LANES;
    const LightList list = {bounds, lights};
    if (begin >= n) return;
    const uint count = MIN(n - begin, LANES);
    float at[7 * LANES], random[2 * LANES], picks[2 * LANES];
    keep_all(points, 3u, begin, count, at);
    keep_all(normals, 4u, begin, count, at + 3u * LANES);
    for (uint k = 0u; k < count; ++k) {
        store_lane(u[begin + k].x * 0x1p-24f, random, 0u, k);
        store_lane(u[begin + k].y * 0x1p-24f, random, 1u, k);
    }
    select_lights_from_list(&list, at, at + 3u * LANES, random, picks, count);
    for (uint k = 0u; k < count; ++k) {
        out[3 * (begin + k)] = load_lane(picks, 0u, k);
        out[3 * (begin + k) + 1] = load_lane(picks, 1u, k);
        out[3 * (begin + k) + 2] = load_lane(random, 0u, k);
    }
}
#endif
"""


class OnDevice:
    """Runs the kernels above on a list; loops over lanes are a separate program."""

    def __init__(self):
        self.device = Device()
        self.kernels = {}
        for lanes in (LANES, 1):
            on = ("LIGHT_LIST", "AREA_LIGHTS")
            most = light_list.MAX_LISTED_LIGHTS
            self.kernels |= build_kernels(self.device, KERNELS, on, LANES=lanes, MAX_LISTED_LIGHTS=most)

    def run(self, kernel, bounds, points, normals, what, row):
        n = len(points)
        given = (bounds, np.uint32(len(bounds)), points.astype(np.float32), normals.astype(np.float32), what)
        out = self.device.buffer(4 * row * n, "results")
        buffers = [self.device.buffer(a, "arguments") if a.ndim else a for a in given]
        self.device.launch(self.kernels[kernel], n, (*buffers, out, np.uint32(n)))
        return self.device.read(out, np.float32, row * n).reshape(n, row)

    def probability(self, bounds, points, normals, which, kernel="probability") -> np.ndarray:
        return self.run(kernel, bounds, points, normals, np.asarray(which, np.uint32), 1)[:, 0].astype(np.float64)

    def pick(self, bounds, point, normal, u, kernel="pick"):
        """Returns sampled lights, their stated probabilities and the rescaled random numbers, for one point and random
        numbers (n, 2) of 24 bits."""
        points, normals = (np.tile(v, (len(u), 1)) for v in (point, normal))
        out = self.run(kernel, bounds, points, normals, u.astype(np.uint32), 3)
        return out[:, 0].copy().view(np.uint32), *out[:, 1:].T.astype(np.float64)


@pytest.fixture(scope="module")
def device():
    return OnDevice()


def all_probabilities(device, bounds, points, normals, kernel="probability") -> np.ndarray:
    """Returns (points, lights)."""
    lights, count = len(bounds), len(points)
    repeated = (np.repeat(points, lights, 0), np.repeat(normals, lights, 0), np.tile(np.arange(lights), count))
    return device.probability(bounds, *repeated, kernel).reshape(count, lights)


def reference_probabilities(bounds: np.ndarray, point: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """In float64, from the angles."""
    b = {name: bounds[name].astype(np.float64) for name in bounds.dtype.names}
    arm = b["center"] - point.astype(np.float64)
    distance2 = (arm**2).sum(axis=1)
    distance = np.sqrt(distance2)
    theta = np.arccos(np.clip(-(b["axis"] * arm).sum(axis=1) / distance, -1, 1))
    emission = np.cos(np.maximum(theta - np.arctan2(b["sin_spread"], b["cos_spread"]), 0))
    incidence = (normal[:3] * arm).sum(axis=1) / distance + normal[3]
    apparent = b["radius"] / distance

    def likely(cosine):
        return np.clip(cosine + apparent, 0, 1) + np.clip(cosine, 0, 1)

    weights = likely(emission) * likely(incidence) * np.minimum(b["intensity"] / distance2, b["max_irradiance"])
    weights[emission + apparent <= b["cos_edge"]] = 0
    total = weights.sum()
    return (
        b["power_fraction"]
        if total == 0
        else (1 - INTENSITY_SHARE) * weights / total + INTENSITY_SHARE * b["power_fraction"]
    )


@pytest.mark.parametrize("kernel", ["probability", "answer_all"])
def test_probabilities_are_those_of_float64(device, kernel):
    """They sum to 1, and only lights without power have 0."""
    scene = compiled(**mixed_lights(18))
    bounds = build_light_list(scene)
    points, normals = some_points(np.random.default_rng(3), 500)
    found = all_probabilities(device, bounds, points, normals, kernel)
    expected = np.stack([reference_probabilities(bounds, p, n) for p, n in zip(points, normals, strict=True)])
    # 5e-6 from the roots, and cancellation in the cosine of a sum of angles
    np.testing.assert_allclose(found, expected, rtol=5e-5, atol=5e-6)
    np.testing.assert_allclose(found.sum(axis=1), 1.0, atol=2e-6)
    assert ((found > 0) == (scene.lights["power_pmf"] > 0)).all()
    assert (scene.lights["power_pmf"] == 0).any()


def test_lanes_and_single_paths_agree(device):
    """Bit-identical; the last work-item has unused lanes."""
    rng = np.random.default_rng(7)
    bounds = build_light_list(compiled(**mixed_lights(20)))
    points, normals = some_points(rng, 3 * LANES + 5)
    which, u = rng.integers(0, len(bounds), len(points)).astype(np.uint32), rng.integers(0, 2**24, (len(points), 2))
    alone = device.probability(bounds, points, normals, which)
    assert (alone == device.probability(bounds, points, normals, which, "answer_all")).all()
    u = u.astype(np.uint32)
    assert (
        device.run("pick", bounds, points, normals, u, 3).view(np.uint32)
        == device.run("pick_all", bounds, points, normals, u, 3).view(np.uint32)
    ).all()


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("kernel", ["pick", "pick_all"])
def test_picks_have_the_stated_probabilities(device, kernel, seed):
    rng = np.random.default_rng(seed)
    bounds = build_light_list(compiled(**mixed_lights(20)))
    points, normals = some_points(rng, 2)
    point, normal = points[seed % 2], normals[seed % 2]
    u = rng.integers(0, 2**24, (1 << 17, 2))
    picked, stated, _ = device.pick(bounds, point, normal, u, kernel)
    expected = all_probabilities(device, bounds, point[None], normal[None])[0]
    np.testing.assert_allclose(stated, expected[picked], rtol=1e-6)
    assert abs(deviate(np.bincount(picked, minlength=len(bounds)), len(u) * expected)) < Z


@pytest.mark.parametrize("kernel", ["pick", "pick_all"])
def test_stratified_numbers_stay_stratified(device, kernel):
    """One number in each of 2^14 strata, in order: lights and rescaled numbers are those of the inverse CDF."""
    rng = np.random.default_rng(2)
    bounds = build_light_list(compiled(**mixed_lights(20)))
    points, normals = some_points(rng, 1)
    u = np.stack([1024 * np.arange(2**14) + rng.integers(0, 1024, 2**14), rng.integers(0, 2**24, 2**14)], axis=1)
    picked, _, rescaled = device.pick(bounds, points[0], normals[0], u, kernel)
    pmf = all_probabilities(device, bounds, points, normals)[0]
    assert_inverts_cdf(picked, rescaled, u, np.cumsum(pmf) - pmf, pmf, tolerance=2e-6)
    assert rescaled.min() >= 0
    assert rescaled.max() < 1


@pytest.mark.parametrize("kernel", ["pick", "pick_all"])
def test_all_48_bits_count(device, kernel):
    """A light of probability 2^-30 first, in the middle and last; all importances are 0, so intensities decide."""
    bounds = np.zeros(4, structs.LIGHT_BOUND)
    low = np.random.default_rng(1).integers(0, 2**24, 1 << 14)
    for tiny in range(4):
        bounds["power_fraction"] = 1 / 3
        bounds["power_fraction"][tiny] = 2.0**-30
        before = bounds["power_fraction"][:tiny].astype(np.float64).sum()
        high = int(before * 2**24)  # the 24-bit number whose interval contains the light
        u = np.stack([np.full(len(low), high), low], axis=1)
        picked, stated, _ = device.pick(bounds, np.zeros(3), np.array([0, 0, 1.0, 0]), u, kernel)
        values = (high + low * 2.0**-24) * 2.0**-24
        inside = (values >= before) & (values < before + 2.0**-30)
        if tiny < 3:  # a remainder by rounding at the end goes to a likely light
            assert inside.any()
            np.testing.assert_array_equal(picked == tiny, inside)
        assert (stated[picked == tiny] == np.float32(2.0**-30)).all()
    bounds["power_fraction"] = (0.5, 0, 0.5, 0)
    picked, _, _ = device.pick(
        bounds, np.zeros(3), np.array([0, 0, 1.0, 0]), np.array([[0, 0], [2**24 - 1] * 2]), kernel
    )
    assert picked.tolist() == [0, 2]


def test_as_the_node_of_a_tree():
    """Seven lights fit in one node: list and tree have the same bounds and intensities."""
    scene = compiled(**mixed_lights(5, beyond=False))
    bounds, tree = build_light_list(scene), build_light_tree(scene)
    assert len(tree.nodes) == 1
    references = tree.nodes[0, NodeRow.CHILD].view(np.int32)
    lights = ~references[references < 0]
    for name in ("radius", "intensity", "max_irradiance", "cos_spread", "sin_spread", "cos_edge"):
        of_node = tree.nodes[0, NodeRow[name.upper()]][references < 0]
        np.testing.assert_allclose(bounds[name][lights], of_node, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("scale", [1e-12, 1e-6, 1.0, 1e6, 1e15])
def test_scale_changes_no_probability(device, scale):
    bounds = build_light_list(compiled(**mixed_lights(20, beyond=False)))
    points, normals = some_points(np.random.default_rng(8), 32)
    expected = all_probabilities(device, bounds, points, normals)
    bounds["center"] *= np.float32(scale)
    bounds["radius"] *= np.float32(scale)
    bounds["intensity"] *= np.float32(scale) ** 2  # a share times the scene's size squared; max_irradiance has no unit
    found = all_probabilities(device, bounds, points * np.float32(scale), normals)
    np.testing.assert_allclose(found, expected, rtol=2e-4, atol=1e-6)


def test_points_on_and_in_lights_and_behind_all(device):
    """If all importances are 0, intensities decide; all probabilities are finite."""
    emitter = {"type": "area", "radiance": 2.0}
    quads = {f"quad{i}": {"type": "rectangle", "emitter": emitter} for i in range(5)}  # coincident
    lamps = {f"lamp{i}": {"type": "point", "position": [1.0, 0, 0], "intensity": 2.0} for i in range(5)}
    bounds = build_light_list(compiled(**quads, **lamps))
    points = np.array([[0, 0, 0], [1.0, 0, 0], [0.3, 0.3, 0.0], [0, 0, -5.0], [0, 0, 5.0], [1e17, 0, 0]])
    normals = np.array([[0, 0, 1, 0], [0, 0, 0, 1], [0, 0, -1, 0], [0, 0, -1, 0], [0, 0, 1, 0], [-1, 0, 0, 0]])
    found = all_probabilities(device, bounds, points, normals)
    assert np.isfinite(found).all()
    assert (found > 0).all()
    np.testing.assert_allclose(found.sum(axis=1), 1.0, atol=2e-6)


def test_some_lights_are_listed_and_more_make_a_tree():
    floor = {"floor": {"type": "rectangle"}}
    some, more = compiled(**floor, **mixed_lights(12)), compiled(**floor, **mixed_lights(60))
    assert len(more.lights) > light_list.MAX_LISTED_LIGHTS
    for scene, kind in ((some, "LIGHT_LIST"), (more, "LIGHT_TREE")):
        assert [name for name in ("LIGHT_LIST", "LIGHT_TREE") if features(scene)[name]] == [kind]
