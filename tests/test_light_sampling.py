"""Emitters on the device: samples against their pdf, irradiance against quadrature in float64 and Mitsuba 3.

A mean of samples may be off by Z standard errors; chi-square statistics are compared as standard normal deviates at Z,
one-sided. About 100 comparisons at 3e-7 each: false alarms are 3e-5 for the file under other seeds.
test_environment.py tests environment maps.
"""

import numpy as np
import pytest
from kernel_build import build_kernels
from light_patch import GRID, Patch
from PIL import Image
from test_environment import normal_deviate

from isonoise.device.opencl import Device
from isonoise.scene import compile_scene, load_description, structs
from isonoise.scene.light.light_kinds import KINDS
from isonoise.scene.material import textures
from isonoise.scene.mesh.triangle_records import triangle_records
from isonoise.scene.spectra import srgb_to_linear

Z = 5.0
SAMPLES, BINS = 2**16, 12
GEOMETRY = """__global const Triangle* triangles, __global const uint* faces, __global const float* uvs,
                      __global const Analytic* analytics, __global const Shape* shapes,
                      __global const Texture* textures, __global const uchar* bytes, __global const float* srgb,
                      __global const Light* lights, __global const Projection* projections"""
KERNEL = f"""
#include "light/light.h"

SceneView scene({GEOMETRY})
{{
    SceneView g;
    g.triangles = triangles;
    g.faces = faces;
    g.corner_normals = NULL;
    g.uvs = uvs;
    g.analytics = analytics;
    g.shapes = shapes;
    g.lights = lights;
    g.projections = projections;
    const Textures all = {{textures, bytes, NULL, srgb, NULL, faces}};
    g.textures = all;
    return g;
}}

__kernel void sample({GEOMETRY},
                     __global const float* cdf, uint count, __global const float* reference, __global const float* u,
                     __global float* out, uint n)
{{
    const uint i = get_global_id(0);
    if (i >= n) return;
    SceneView g = scene(triangles, faces, uvs, analytics, shapes, textures, bytes, srgb, lights,
                        projections);
    g.light_cdf = cdf;
    g.light_count = count;
    const Vec4 no_side = vec4(0.0f, 0.0f, 0.0f, 0.0f);
    const LightSelection pick = select_light(&g, LOAD3(i, reference), no_side, u[4 * i], u[4 * i + 2]);
    const LightSample light = sample_light(&g, pick, LOAD3(i, reference), u[4 * i + 1]);
    STORE3(light.direction, 0, out + 16 * i);
    STORE3(light.radiance, 1, out + 16 * i);
    STORE3(light.position, 2, out + 16 * i);
    STORE3(light.normal, 3, out + 16 * i);
    out[16 * i + 12] = light.pdf;
    out[16 * i + 13] = light.is_delta;
    out[16 * i + 14] = light.is_infinite;
    out[16 * i + 15] = as_float(light.primitive);
}}

__kernel void density({GEOMETRY},
                      uint index, __global const float* reference, __global const float* position,
                      __global const float* normal, __global float* out, uint n)
{{
    const uint i = get_global_id(0);
    if (i >= n) return;
    const SceneView g = scene(triangles, faces, uvs, analytics, shapes, textures, bytes, srgb, lights,
                        projections);
    const Vec3 from = LOAD3(i, reference), arm = sub3(LOAD3(i, position), from);
    const Light light = Light_at(lights, index);
    out[i] = light_pdf(&g, &light, from, normalize3(arm), SQRT(dot3(arm, arm)), LOAD3(i, normal));
}}
"""


def transform(scale, seed: int = 1, offset=(0.3, -0.2, 0.5)) -> np.ndarray:
    """Returns a matrix that scales, then rotates at random, then translates."""
    q = np.linalg.qr(np.random.default_rng(seed).standard_normal((3, 3)))[0]
    q[2] *= np.linalg.det(q)
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = q * np.broadcast_to(scale, 3), offset
    return matrix


PATCHES = """
v 0 0 0
v 2 0.2 0
v 0.3 1 0.5
v 2 2 1
vt 0.1 0.2
vt 0.9 0.1
vt 0.2 0.8
vt 0.7 0.9
f 1/1 2/2 3/3
f 3/3 2/2 4/4
"""
SHAPES = {  # shape and reference points
    "rectangle": ({"type": "rectangle", "to_world": transform((1.0, 0.4, 1.0))}, [(0.5, 1.0, 1.5), (0.3, -0.2, 0.8)]),
    "patches": ({"type": "obj", "face_normals": True}, [(1.0, 1.0, 2.0), (1.0, 0.6, 0.6)]),
    "cube": ({"type": "cube", "to_world": transform((0.5, 1.0, 0.3))}, [(2.0, 1.0, 2.0)]),
    "sphere": (
        {"type": "sphere", "to_world": transform(0.7)},
        [(2.0, 1.0, -1.0), (0.3, -0.2, 1.21), (50.0, 20.0, 9.0)],
    ),
    "sphere from within": (
        {"type": "sphere", "radius": 2.0, "flip_normals": True},
        [(0.3, 0.1, -1.0), (0.0, 1.9, 0.1)],
    ),
    "disk": ({"type": "disk", "to_world": transform((1.5, 0.5, 1.0))}, [(0.5, 1.0, 1.5), (0.3, -0.2, 0.9)]),
    "cylinder": (
        {"type": "cylinder", "p0": [0.0, 0.0, -1.0], "p1": [0.0, 0.5, 1.0], "radius": 0.4},
        [(2.0, 1.0, 0.3), (0.0, -0.5, 0.0)],
    ),
    "cylinder from within": (
        {"type": "cylinder", "p0": [0.0, 0.0, -1.0], "p1": [0.0, 0.0, 1.0], "flip_normals": True},
        [(0.2, 0.1, -0.5)],
    ),
}
VIEWS = [(name, number) for name, (_, views) in SHAPES.items() for number in range(len(views))]
RGB = {"type": "rgb", "value": [3.0, 1.0, 0.5]}


class Lit:
    """The emitters of a scene on the device."""

    def __init__(self, device: Device, kernels, **objects):
        self.device, self.kernels = device, kernels
        self.scene = scene = compile_scene(
            load_description({"type": "scene", "sensor": {"type": "perspective"}, **objects})
        )
        arrays = (triangle_records(scene), scene.faces, scene.uvs, scene.analytics, scene.shapes)
        arrays += (scene.textures, scene.texel_bytes, textures.SRGB, scene.lights, scene.projections)
        self.buffers = tuple(device.buffer(a, "the scene") if a.size else None for a in arrays)
        self.table = device.buffer(scene.light_cdf, "the lights"), np.uint32(len(scene.lights))

    def _run(self, kernel: str, first, arrays, columns: int) -> np.ndarray:
        n = len(arrays[0])
        out = self.device.buffer(np.zeros(columns * n, np.float32), "results")
        inputs = [self.device.buffer(np.ascontiguousarray(a, np.float32), "inputs") for a in arrays]
        self.device.launch(self.kernels[kernel], n, (*self.buffers, *first, *inputs, out, np.uint32(n)))
        return self.device.read(out, np.float32, columns * n).reshape(n, columns)

    def sample(self, reference, count: int = SAMPLES) -> dict[str, np.ndarray]:
        """Returns light samples at reference points (3,) or (count, 3); radiance in units of the scene."""
        u = np.random.default_rng(2).integers(0, 2**24, (count, 4)) / 2**24
        out = self._run("sample", self.table, (np.broadcast_to(reference, (count, 3)), u), 16)
        names = ("direction", "radiance", "position", "normal")
        found = {name: out[:, 3 * i : 3 * i + 3].astype(np.float64) for i, name in enumerate(names)}
        found["radiance"] /= self.scene.radiance_scale
        found["primitive"] = np.ascontiguousarray(out[:, 15]).view(np.uint32)
        return found | {"pdf": out[:, 12].astype(np.float64), "delta": out[:, 13] != 0, "infinite": out[:, 14] != 0}

    def density(self, light: int, reference, position, normal) -> np.ndarray:
        """Returns the solid-angle pdf times the probability of the light."""
        places = np.broadcast_to(reference, position.shape)
        found = self._run("density", (np.uint32(light),), (places, position, normal), 1)[:, 0].astype(np.float64)
        return found * self.scene.lights["power_pmf"][light]


@pytest.fixture(scope="module")
def lit():
    device = Device()
    on = {kind.feature for kind in KINDS.values()} - {"ENVIRONMENT_MAP"}
    on |= {"AREA_LIGHTS", "TRIANGLES", "ANALYTICS", "SPHERES", "DISKS", "CYLINDERS"}
    on |= {"TEXTURES", "TEXTURED_LIGHTS", "BITMAPS", "UVS", "MANY_LIGHTS", "NEXT_EVENT"}
    kernels = build_kernels(device, KERNEL, on)
    return lambda **objects: Lit(device, kernels, **objects)


@pytest.fixture(scope="module")
def pixels():
    return np.random.default_rng(3).integers(0, 256, (8, 8, 3), dtype=np.uint8)


@pytest.fixture(scope="module")
def image(tmp_path_factory, pixels):
    path = tmp_path_factory.mktemp("images") / "radiance.png"
    Image.fromarray(pixels).save(path)
    return {"type": "bitmap", "filename": str(path), "filter_type": "nearest"}


@pytest.mark.parametrize(("name", "view"), VIEWS)
def test_surfaces(lit, image, pixels, name, view, tmp_path):
    """Sampled directions follow the pdf that the light has for a given direction.

    The mean over that pdf is the irradiance of planes that face along the axes. The radiance is an image, which must
    have the right orientation. The midpoint rule is off by at most 1e-3, where the light turns away inside of a cell.
    """
    shape, views = SHAPES[name]
    reference = np.array(views[view])
    if shape["type"] == "obj":
        shape = shape | {"filename": str(tmp_path / "patches.obj")}
        (tmp_path / "patches.obj").write_text(PATCHES)
    on = lit(lamp=shape | {"emitter": {"type": "area", "radiance": image}})
    found, flipped = on.sample(reference), shape.get("flip_normals", False)
    used = (found["pdf"] > 0) & (found["radiance"].max(axis=1) > 0)
    assert not found["delta"].any()
    assert not found["infinite"].any()
    linear, expected, masses, counts = srgb_to_linear(pixels / 255), 0.0, [], []
    for light in range(len(on.scene.lights)):
        patch = Patch(on.scene, light)
        grid = patch.grid(reference, flipped)
        mass = grid["solid"] * on.density(light, reference, grid["position"], grid["normal"])
        masses.append(mass.reshape(BINS, GRID // BINS, BINS, -1).sum(axis=(1, 3)).ravel())
        texel = np.minimum((8 * grid["uv"]).astype(int), 7)
        radiance = linear[texel[:, 1], texel[:, 0]] * grid["solid"][:, None]
        expected = (
            expected + np.maximum(np.concatenate([grid["direction"], -grid["direction"]], axis=1), 0).T @ radiance
        )
        # lights that emit inwards are excluded: their front side may be behind their back side
        here = used & np.isin(found["primitive"], (patch.primitive, structs.NONE))
        x, y = (np.clip((BINS * a).astype(int), 0, BINS - 1) for a in patch.parameters(found["position"][here]))
        counts.append(np.bincount(x * BINS + y, minlength=BINS**2))
        again = on.density(light, reference, found["position"][here], found["normal"][here])
        np.testing.assert_allclose(found["pdf"][here], again, rtol=2e-4)
    masses, counts = np.concatenate(masses), np.concatenate(counts)
    assert counts.sum() == used.sum()
    assert abs(masses.sum() - used.mean()) < Z * np.sqrt(0.25 / SAMPLES) + 1e-3
    assert normal_deviate(counts.astype(float), used.sum() * masses / masses.sum()) < Z
    faced = np.maximum(np.concatenate([found["direction"], -found["direction"]], axis=1), 0)
    weight = np.where(used, 1 / np.where(used, found["pdf"], 1), 0)
    estimate = faced[:, :, None] * (found["radiance"] * weight[:, None])[:, None, :]
    se = estimate.std(axis=0) / np.sqrt(SAMPLES)
    assert (np.abs(estimate.mean(axis=0) - expected) <= Z * se + 1e-3 * expected.max()).all(), (
        estimate.mean(axis=0),
        expected,
    )


# Emitters without a surface.


def places(count: int, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(count, 3)) * 3


SPOTS = [
    {},
    {"cutoff_angle": 60.0, "beam_width": 10.0},
    {"cutoff_angle": 80.0, "beam_width": 79.9},
    {"cutoff_angle": 5.0},
    {"cutoff_angle": 30.0, "beam_width": 0.0},
]
POINTS = [
    {"type": "point", "position": [1.0, -2.0, 0.5], "intensity": RGB},
    {"type": "point", "to_world": transform(1.0), "intensity": RGB},
    *({"type": "spot", "to_world": transform(1.0, seed), "intensity": RGB} | s for seed, s in enumerate(SPOTS)),
]


def assert_mitsubas_irradiance(lit, mitsuba, emitter: dict, reference: np.ndarray) -> None:
    """Irradiance and direction at the points are Mitsuba's, to 1e-4 of the largest irradiance at that distance.

    Near the axis Mitsuba computes the angle of a spot from its cosine, with no more digits.
    """
    found = lit(lamp=emitter).sample(reference, len(reference))
    theirs = dict(emitter)
    if "to_world" in theirs:
        theirs["to_world"] = mitsuba.ScalarTransform4f(theirs["to_world"])
    loaded, si = mitsuba.load_dict(theirs), mitsuba.SurfaceInteraction3f()
    assert found["delta"].all()
    for i, place in enumerate(reference.astype(np.float32)):
        si.p = place
        expected, value = loaded.sample_direction(si, (0.5, 0.5))
        brightest = 3 / float(expected.dist) ** 2
        np.testing.assert_allclose(found["radiance"][i], np.array(value), rtol=1e-4, atol=1e-4 * brightest)
        np.testing.assert_allclose(found["direction"][i], np.array(expected.d), atol=2e-6)
    assert (found["radiance"].max(axis=1) > 0).sum() > 80
    np.testing.assert_allclose(found["pdf"], 1)


def places_in_the_cone(matrix: np.ndarray, tangent: float) -> np.ndarray:
    """Returns 400 points; half of them are in the square cone around a light's axis."""
    reference = places(400, 5)
    inside = np.random.default_rng(6).uniform(-1, 1, (200, 3)) * [tangent, tangent, 0] + [0, 0, 1]
    reference[::2] = inside @ matrix[:3, :3].T * np.abs(places(200, 7)[:, :1]) + matrix[:3, 3]
    return reference


@pytest.mark.parametrize("emitter", POINTS, ids=range(len(POINTS)))
def test_point_and_spot_are_mitsubas(lit, mitsuba, emitter):
    tangent = np.tan(np.radians(emitter.get("cutoff_angle", 20.0)))
    matrix = emitter.get("to_world", np.eye(4))
    reference = places_in_the_cone(matrix, tangent) if emitter["type"] == "spot" else places(400, 5)
    assert_mitsubas_irradiance(lit, mitsuba, emitter, reference)


PROJECTING = {
    "spot": {"type": "spot", "intensity": RGB, "cutoff_angle": 50.0, "to_world": transform(1.0)},
    "projector": {"type": "projector", "scale": 0.7, "fov": 60.0, "to_world": transform(1.0, 3)},
    "tall fov": {"type": "projector", "fov": 50.0, "fov_axis": "y", "to_world": transform(1.0, 4)},
    "scaled projector": {"type": "projector", "focal_length": "35mm", "to_world": transform(2.0, 5)},
}


@pytest.mark.parametrize("name", PROJECTING)
def test_projected_textures_are_mitsubas(lit, mitsuba, tmp_path, name):
    """An image of 5 x 8 pixels, which has the right orientation and proportions."""
    values = np.random.default_rng(8).integers(0, 256, (8, 5, 3), dtype=np.uint8)
    Image.fromarray(values).save(tmp_path / "image.png")
    texture = {"type": "bitmap", "filename": str(tmp_path / "image.png"), "wrap_mode": "clamp"}
    emitter, parameter = PROJECTING[name], "texture" if name == "spot" else "irradiance"
    reference = places_in_the_cone(emitter["to_world"], 0.5)
    assert_mitsubas_irradiance(lit, mitsuba, emitter | {parameter: texture}, reference)


def test_a_projector_lights_a_plane_evenly(lit):
    """Its irradiance is pi / d² at the distance d, for an image of 1: a white plane has radiance 1 at distance 1."""
    x, y = np.random.default_rng(9).uniform(-0.3, 0.3, (2, 100))
    for distance in (1.0, 3.0):
        reference = distance * np.stack([x, y, np.ones(100)], axis=1)
        found = lit(lamp={"type": "projector", "irradiance": 1.0, "fov": 40.0}).sample(reference, 100)
        irradiance = found["radiance"] * -found["direction"][:, 2:]
        np.testing.assert_allclose(irradiance, np.pi / distance**2, rtol=1e-5)


def test_directional(lit):
    matrix = transform(1.0)
    for given, along in (
        ({"direction": [1.0, 2.0, -2.0]}, [1 / 3, 2 / 3, -2 / 3]),
        ({"to_world": matrix}, matrix[:3, 2]),
    ):
        found = lit(sun={"type": "directional", "irradiance": RGB, **given}).sample((1.0, 2.0, 3.0), 10)
        np.testing.assert_allclose(found["direction"], np.broadcast_to(-np.array(along), (10, 3)), atol=1e-6)
        np.testing.assert_allclose(found["radiance"], np.broadcast_to(RGB["value"], (10, 3)), rtol=1e-6)
        assert found["delta"].all()
        assert found["infinite"].all()
        assert (found["pdf"] == 1).all()


def test_constant(lit):
    """Uniform over the sphere: bins of cosine and azimuth of equal solid angle."""
    found = lit(sky={"type": "constant", "radiance": RGB}).sample((1.0, 2.0, 3.0))
    np.testing.assert_allclose(found["pdf"], 1 / (4 * np.pi), rtol=1e-6)
    np.testing.assert_allclose(found["radiance"], np.broadcast_to(RGB["value"], (SAMPLES, 3)), rtol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(found["direction"], axis=1), 1, atol=1e-6)
    x, y, z = found["direction"].T
    row = np.minimum((10 * (z + 1)).astype(int), 19)
    column = np.minimum((np.arctan2(y, x) / (2 * np.pi) % 1 * 20).astype(int), 19)
    counts = np.bincount(20 * row + column, minlength=400).astype(float)
    assert normal_deviate(counts, np.full(400, SAMPLES / 400)) < Z


def test_several_emitters_share_the_picks(lit):
    """The pdf includes the probability of the light: the irradiance of all is the sum over single lights."""
    lamps = {
        "point": POINTS[0],
        "sky": {"type": "constant", "radiance": 0.2},
        "ball": SHAPES["sphere"][0] | {"emitter": {"type": "area", "radiance": 5.0}},
        "plate": SHAPES["disk"][0] | {"emitter": {"type": "area", "radiance": RGB}},
    }
    reference, total, variance = (2.0, 1.0, -1.0), 0.0, 0.0
    for objects in (*({name: lamp} for name, lamp in lamps.items()), lamps):
        found = lit(**objects).sample(reference)
        used = (found["pdf"] > 0) & (found["radiance"].max(axis=1) > 0)
        estimate = np.where(used, np.abs(found["direction"][:, 0]) / np.where(used, found["pdf"], 1), 0)
        estimate = estimate[:, None] * found["radiance"]
        mean, spread = estimate.mean(axis=0), estimate.var(axis=0) / SAMPLES
        if len(objects) == 1:
            total, variance = total + mean, variance + spread
    assert (np.abs(mean - total) < Z * np.sqrt(variance + spread)).all(), (mean, total)
