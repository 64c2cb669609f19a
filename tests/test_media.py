"""Media, phase functions, and boundaries that let light through unturned: integrator `volpath`.

Scenes of one section are of the same shapes and materials, some of them out of sight, so that they share a program.
"""

import math

import numpy as np
import pytest
import references
from bsdf_lobe import KERNEL, Lobe, numbers, uniform_sphere
from scalar_mitsuba import assert_same_picture
from shared_programs import share_programs

import isonoise
from isonoise.device import program
from isonoise.device.opencl import Device
from isonoise.errors import SceneError
from isonoise.integrator.features import FEATURES, features
from isonoise.integrator.generated_headers import generated_headers
from isonoise.integrator.kernel_table import CONSTANTS, PATH_STATE, STRUCTS
from isonoise.scene import compile_scene, load, structs
from isonoise.scene.material.bsdf_kinds import bsdf_bits
from isonoise.scene.material.bsdfs import Bsdfs
from isonoise.scene.material.rough_transmittance import NODES
from isonoise.scene.mesh.triangle_records import triangle_records

PLAIN = (
    *("TRIANGLES", "ANALYTICS", "SPHERES", "CYLINDERS", "DIFFUSE", "NULL", "VOLPATH", "MEDIA", "ORTHOGRAPHIC"),
    *("POINT_LIGHTS", "AREA_LIGHTS", "SPHERE_LIGHTS", "CONSTANT_LIGHT", "MANY_LIGHTS", "NEXT_EVENT"),
    "RUSSIAN_ROULETTE",
)
SHEETS_AND_LAMP = (
    *("TRIANGLES", "UVS", "TEXTURES", "CHECKERBOARDS", "ORTHOGRAPHIC", "VOLPATH"),
    *("DIFFUSE", "NULL", "DIELECTRIC", "THIN_DIELECTRIC", "MASK", "BLEND", "BUMP"),
    *("POINT_LIGHTS", "AREA_LIGHTS", "TRIANGLE_LIGHTS", "MANY_LIGHTS", "NEXT_EVENT"),
)
shared_programs = share_programs(PLAIN, SHEETS_AND_LAMP)

NULL = {"type": "null"}
LAMBERT = {"type": "diffuse", "reflectance": 0.5}


def rgb(*values: float) -> dict:
    return {"type": "rgb", "value": list(values)}


def medium(sigma_t=1.0, albedo=0.0, g: float | None = None, **more) -> dict:
    phase = {} if g is None else {"phase": {"type": "hg", "g": g}}
    return {"type": "homogeneous", "sigma_t": sigma_t, "albedo": albedo, **phase, **more}


def moved(x: float = 0.0, y: float = 0.0, z: float = 0.0, scale=1.0) -> np.ndarray:
    matrix = np.diag([*np.broadcast_to(np.asarray(scale, float), 3), 1.0])
    matrix[:3, 3] = x, y, z
    return matrix


def looking(origin, target, up=(0.0, 1.0, 0.0)) -> np.ndarray:
    ahead = np.subtract(target, origin) / np.linalg.norm(np.subtract(target, origin))
    left = np.cross(up, ahead) / np.linalg.norm(np.cross(up, ahead))
    matrix = np.eye(4)
    matrix[:3] = np.stack([left, np.cross(ahead, left), ahead, origin], axis=1)
    return matrix


def one_ray(origin, target, up=(0.0, 1.0, 0.0), **more) -> dict:
    """A camera whose single pixel is a hundred thousandth wide: all its rays are the same up to that."""
    film = {"type": "hdrfilm", "width": 1, "height": 1, "rfilter": {"type": "box"}}
    to_world = looking(origin, target, up) @ np.diag([1e-5, 1e-5, 1.0, 1.0])
    return {"type": "orthographic", "to_world": to_world, "film": film, **more}


def radiance(scene: dict, spp: int = 16, seed: int = 1) -> tuple[np.ndarray, float]:
    """RGB of a scene of one pixel, and the relative standard error of its luminance."""
    statistics = isonoise.render(scene, spp=spp, strategy="uniform", seed=seed).statistics
    mean, error = statistics.mean.item(), math.sqrt(statistics.variance.item() / statistics.count.item())
    assert statistics.rejected.sum() == 0
    return statistics.rgb[0, 0].astype(float), error / mean if mean else 0.0


# Phase functions.


class Phase(Lobe):
    """A phase function on the device; directions are of the world."""

    def __init__(self, kernels, device: Device, g: float, lit: bool = True):
        self.device, self.kernels, self.frame = device, kernels, np.eye(3)
        bsdfs = Bsdfs(lambda texture, kind: pytest.fail("no textures here"))
        bsdfs.phase({"type": "hg", "g": g}, lit)
        arrays = bsdfs.records, np.zeros(NODES, np.float32), self.frame.astype(np.float32)
        self.buffers = tuple(device.buffer(array, "the phase function") for array in arrays)


@pytest.fixture(scope="module")
def phase():
    device, source = Device(), program.kernel_source
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(program, "kernel_source", lambda name: KERNEL if name == "lobes.cl" else source(name))
        on = {name: name in ("MEDIA", "VOLPATH", "NEXT_EVENT") for name in FEATURES}
        kernels = device.build(*program.stage_source("lobes.cl", STRUCTS, CONSTANTS, on, generated_headers()))
    return lambda g, lit=True: Phase(kernels, device, g, lit)


ANISOTROPIES = (0.0, 0.3, -0.7, 0.95, -0.999, 0.9999)


def henyey_greenstein(g: float, cosine: np.ndarray) -> np.ndarray:
    return (1 - g * g) / (4 * math.pi * (1 + g * g - 2 * g * cosine) ** 1.5)


@pytest.mark.parametrize("g", ANISOTROPIES)
def test_phase_function_is_henyey_and_greensteins(phase, g):
    """To 2e-5, at uniform directions and at those that it samples; where 1 - |g| is 1e-4 these are within 1e-4 of the
    axis, and the rounding of their components is 1e-3 of that."""
    random = np.random.default_rng(1)
    wi = uniform_sphere(random, 4000).astype(np.float32)
    sampled, weight, pdf, eta = phase(g).sample(wi, numbers(random, 4000))
    wo = np.where(np.arange(4000)[:, None] % 2, sampled, uniform_sphere(random, 4000)).astype(np.float32)
    value, density = phase(g).evaluate(wi, wo)
    a, b = (v.astype(float) / np.linalg.norm(v.astype(float), axis=1, keepdims=True) for v in (wi, wo))
    expected = henyey_greenstein(g, -(a * b).sum(axis=1))
    near = 1e-3 if abs(g) > 0.99 else 2e-5
    assert density == pytest.approx(expected, rel=near)
    assert (value == density[:, None]).all()
    assert (weight == 1).all()
    assert (eta == 1).all()
    assert np.linalg.norm(sampled, axis=1) == pytest.approx(1, abs=3e-7)
    assert pdf == pytest.approx(phase(g).evaluate(wi, sampled)[1], rel=3e-3 if abs(g) > 0.99 else 1e-4)


@pytest.mark.parametrize("g", ANISOTROPIES)
def test_phase_function_is_sampled_by_its_density(phase, g):
    """Chi-square over 32 x 8 cells of equal probability about the axis (the cosine's distribution inverted, in
    float64): false alarms 1 % for all six at once (Sidak). The mean cosine is g."""
    random, n = np.random.default_rng(2), 2**17
    axis = np.array([0.48, -0.6, 0.64])
    wo = phase(g).sample(np.broadcast_to(-axis, (n, 3)), numbers(random, n))[0].astype(float)
    side = -1.0 if g < 0 else 1.0
    from_axis = 0.5 * ((wo - side * axis) ** 2).sum(axis=1)  # 1 - cosine, without cancellation
    a = abs(g)
    root = np.sqrt((1 - a) ** 2 + 2 * a * from_axis)
    u = ((1 - a * a) / root - (1 - a)) / (2 * a) if a else 1 - from_axis / 2
    x = np.cross(axis, (0, 0, 1)) / np.linalg.norm(np.cross(axis, (0, 0, 1)))
    turn = np.arctan2(wo @ np.cross(axis, x), wo @ x) % (2 * math.pi) / (2 * math.pi)
    cells = np.minimum((u * 32).astype(int), 31) * 8 + np.minimum((turn * 8).astype(int), 7)
    counts, expected = np.bincount(cells, minlength=256), n / 256
    chi, freedom = ((counts - expected) ** 2 / expected).sum(), 255
    z = ((chi / freedom) ** (1 / 3) - 1 + 2 / (9 * freedom)) / math.sqrt(2 / (9 * freedom))  # Wilson and Hilferty 1931
    assert z < 2.93, (chi, counts)
    cosine = wo @ axis
    assert cosine.mean() == pytest.approx(g, abs=5 * cosine.std() / math.sqrt(n) + 1e-6)


@pytest.mark.parametrize("g", [0.0, 1 - 2**-30, -(1 - 2**-24), 0.999999, 1e-30])
def test_edges_of_phase_functions_stay_finite(phase, g):
    """An axis along an axis, the least and largest random numbers; what is nearly 1 is not 1 on the device."""
    ends = [0.0, 2.0**-24, 0.25, 0.5, 1 - 2.0**-23, 1 - 2.0**-24]
    u = np.stack(np.meshgrid([0.0], ends, ends, indexing="ij"), axis=-1).reshape(-1, 3)
    for wi in ((0, 0, 1), (0, 0, -1), (1, 0, 0), (0.6, 0, 0.8)):
        wo, weight, pdf, _ = phase(g).sample(np.broadcast_to(np.array(wi, float), (len(u), 3)), u)
        assert np.isfinite(wo).all()
        assert np.linalg.norm(wo, axis=1) == pytest.approx(1, abs=3e-7)
        assert (weight == 1).all()
        assert np.isfinite(pdf).all()
        assert (pdf > 0).all()
        density = phase(g).evaluate(np.array(wi, float), np.concatenate([wo, [wi], [-np.array(wi)]]))[1]
        assert np.isfinite(density).all()
        assert (density >= 0).all()


def test_a_phase_function_without_emitter_sampling_is_a_delta_function(phase):
    """To next-event estimation: it is not evaluated, and lights that it meets count in full."""
    random = np.random.default_rng(3)
    wi = uniform_sphere(random, 100)
    assert (phase(0.5, lit=False).sample(wi, numbers(random, 100))[2] == -1).all()
    assert (phase(0.5, lit=False).evaluate(wi, -wi)[1] == 0).all()


def test_phase_function_is_mitsubas(phase):
    mitsuba = pytest.importorskip("mitsuba", reason="needs Mitsuba 3: pip install mitsuba")
    mitsuba.set_variant("scalar_rgb")
    random = np.random.default_rng(4)
    wi, wo = (uniform_sphere(random, 200).astype(np.float32) for _ in range(2))
    for g in (-0.8, 0.0, 0.6):
        theirs, context = mitsuba.load_dict({"type": "hg", "g": g}), mitsuba.PhaseFunctionContext(None)
        at = mitsuba.MediumInteraction3f()
        ours = phase(g).evaluate(wi, wo)[1]
        for a, b, pdf in zip(wi.tolist(), wo.tolist(), ours, strict=True):
            at.wi, at.sh_frame = a, mitsuba.Frame3f(a)
            assert pdf == pytest.approx(theirs.eval_pdf(context, at, b)[1], rel=1e-4)


# Light that comes to a floor straight through layers: a point light above, a camera below them. Nothing is random, so
# that transmittance is seen to rounding.

FLOOR = {"type": "rectangle", "to_world": moved(scale=4.0), "bsdf": LAMBERT}
LIGHT = {"type": "point", "position": [0.0, 0.0, 3.0], "intensity": 9.0 * 2 * math.pi}  # 1 on the floor without layers


def lit_floor(integrator: str = "volpath", depth: int = 2, **objects) -> dict:
    return {
        "type": "scene",
        "integrator": {"type": integrator, "max_depth": depth, "rr_depth": 1000},
        "sensor": one_ray((0.0, 0.0, 0.0004), (0.0, 0.0, 0.0)) | {"near_clip": 1e-5},
        "floor": FLOOR,
        "light": LIGHT,
        **objects,
    }


def slab(low: float, high: float, sigma_t=1.0, **more) -> dict:
    to_world = moved(z=(low + high) / 2, scale=(2.0, 2.0, (high - low) / 2))
    return {"type": "cube", "to_world": to_world, "bsdf": NULL, "interior": medium(sigma_t), **more}


THIN, FOG = 2.0**-20, medium(0.25)
LAYERS = {  # (shapes, optical depth)
    "one": ({"a": slab(1, 2, rgb(0.0, 0.5, 1.0))}, [0.0, 0.5, 1.0]),
    "scaled": ({"a": slab(1, 2, interior=medium(2.0, scale=1.5))}, [3.0] * 3),
    "hardly any": ({"a": slab(1, 2, 1e-6)}, [1e-6] * 3),
    "none": ({"a": slab(1, 2, 0.0)}, [0.0] * 3),
    "dense": ({"a": slab(1, 2, 12.0)}, [12.0] * 3),
    "denser than 32-bit exponentials": ({"a": slab(1, 2, rgb(1.0, 300.0, 1e30))}, [1.0, np.inf, np.inf]),
    "a thin layer of a dense one": ({"a": slab(1e-3, 1e-3 + THIN, 1e6)}, [1e6 * THIN] * 3),
    "apart": ({"a": slab(1, 1.5), "b": slab(2, 2.5, rgb(0.1, 0.2, 0.3))}, [0.55, 0.6, 0.65]),
    "within one another": ({"a": slab(0.5, 2.5, 0.25), "b": slab(1, 2, 0.75, exterior=FOG)}, [1.0] * 3),
    "within, its outside not named": ({"a": slab(0.5, 2.5, 0.25), "b": slab(1, 2, 0.75)}, [0.75 + 0.125] * 3),
    "more than are kept at a time": (
        {f"slab {i}": slab(0.2 + 0.2 * i, 0.3 + 0.2 * i, 0.1 * (1 + i)) for i in range(13)},
        [0.1 * 0.1 * 91] * 3,
    ),
    "light within": ({"a": slab(2.0, 4.0, 0.7)}, [0.7] * 3),
    "floor within": ({"a": slab(-1.0, 2.0, 0.7), "floor": FLOOR | {"exterior": medium(0.7)}}, [1.4] * 3),
    "floor within, not named": (
        {
            "a": slab(-1.0, 2.0, 0.7),
            "sensor": one_ray((0, 0, 4e-4), (0, 0, 0), medium=medium(0.7)) | {"near_clip": 1e-5},
        },
        [1.4] * 3,
    ),
}
ELSEWHERE = {"elsewhere": {"type": "sphere", "center": [50.0, 0.0, 0.0], "bsdf": NULL}}


@pytest.mark.parametrize("name", LAYERS)
def test_light_through_layers(name):
    """exp(-depth) to 2e-5, as the shadow ray is reckoned; the thin layer's distances are good to 1e-3 of it. Where the
    camera stands in a medium, its own ray gets through 4e-4 of it but for 3e-4 of the samples."""
    shapes, depth = LAYERS[name]
    seen, _ = radiance(lit_floor(**shapes, **ELSEWHERE), spp=1024 if "not named" in name else 16)
    within = 5 * math.sqrt(3e-4 / 1024) + 3e-4 if name == "floor within, not named" else 2e-5
    assert seen == pytest.approx(np.exp(-np.array(depth)), rel=1e-3 if "thin" in name else within, abs=1e-30)


def test_light_through_balls_and_pipes():
    """Analytic shapes are met twice: into them and out of them. The other way round with flip_normals."""
    sphere = {"type": "sphere", "center": [0.0, 0.0, 1.5], "radius": 0.5, "bsdf": NULL, "interior": medium(0.8)}
    pipe = {"type": "cylinder", "p0": [-1.0, 0.0, 0.5], "p1": [1.0, 0.0, 0.5], "radius": 0.25, "bsdf": NULL}
    objects = {"a": sphere, "b": pipe | {"interior": medium(0.4)}}
    assert radiance(lit_floor(**objects))[0] == pytest.approx([math.exp(-1.0)] * 3, rel=2e-5)
    turned = {"flip_normals": True, "exterior": sphere["interior"]}
    objects["a"] = {key: value for key, value in sphere.items() if key != "interior"} | turned
    assert radiance(lit_floor(**objects))[0] == pytest.approx([math.exp(-1.0)] * 3, rel=2e-5)


def test_instances_have_the_media_of_their_group():
    """Distances are the world's, however the group was scaled."""
    group = {"type": "shapegroup", "shape": slab(-1, 1, 0.3), "hole": {"type": "sphere", "radius": 0.1, "bsdf": NULL}}
    at = moved(z=1.5, scale=(0.5, -0.7, 0.25))
    scene = lit_floor(group=group, one={"type": "instance", "to_world": at, "shape": {"type": "ref", "id": "group"}})
    assert radiance(scene)[0] == pytest.approx([math.exp(-0.15)] * 3, rel=3e-5)


def test_path_sees_no_media_and_is_blocked_by_boundaries():
    shapes = LAYERS["one"][0]
    assert (radiance(lit_floor("path", **shapes))[0] == 0).all()
    compiled = compile_scene(load(lit_floor("path", **shapes)))
    assert len(compiled.media) == 0
    assert compiled.sensor_medium == structs.MEDIUM_NONE
    assert not features(compiled)["VOLPATH"]


# The same light through masks and panes.

HALF = {"type": "mask", "opacity": 0.5, "inner": LAMBERT}
CHECKS = {"type": "checkerboard", "color0": 0.2, "color1": 0.7, "to_uv": moved(scale=2.0)}
STAND_BY = {  # out of sight: their materials are in the program
    "mask": {"type": "mask", "opacity": CHECKS, "inner": LAMBERT},
    "blend": {"type": "blendbsdf", "weight": 0.25, "a": NULL, "b": LAMBERT},
    "pane": {"type": "thindielectric", "int_ior": 1.5, "ext_ior": 1.0},
    "bump": {"type": "bumpmap", "map": CHECKS, "inner": HALF},
}


def sheet(z: float, bsdf: dict, x: float = 0.0) -> dict:
    return {"type": "rectangle", "to_world": moved(x=x, z=z), "bsdf": bsdf}


def pane_share(eta: float) -> float:
    once = ((eta - 1) / (eta + 1)) ** 2
    return 1 - 2 * once / (1 + once)


SHEETS = {  # (materials from below, what they let through)
    "half": ([HALF], [0.5] * 3),
    "two": ([HALF, HALF | {"opacity": 0.25}], [0.375] * 3),
    "twelve": ([HALF | {"opacity": 0.1}] * 12, [0.9**12] * 3),
    "opaque": ([HALF | {"opacity": 1.0}], [0.0] * 3),
    "clear": ([HALF | {"opacity": 0.0}], [1.0] * 3),
    "beyond 1": ([HALF | {"opacity": {"type": "checkerboard", "color0": 1.0, "color1": 1.0}}], [0.0] * 3),
    "checks": ([STAND_BY["mask"]], [0.3] * 3),
    "mask of a mask": ([{"type": "mask", "opacity": 0.8, "inner": HALF}], [0.6] * 3),
    "mask of nothing": ([{"type": "mask", "opacity": 0.8, "inner": NULL}], [1.0] * 3),
    "blend": ([STAND_BY["blend"]], [0.75] * 3),
    "blend the other way": ([{"type": "blendbsdf", "weight": 0.25, "a": LAMBERT, "b": HALF}], [0.125] * 3),
    "blend of two": ([{"type": "blendbsdf", "weight": 0.25, "a": HALF, "b": STAND_BY["blend"]}], [0.5625] * 3),
    "mask of a blend": ([{"type": "mask", "opacity": 0.5, "inner": STAND_BY["blend"]}], [0.875] * 3),
    "bump of a mask": ([STAND_BY["bump"]], [0.5] * 3),
    "pane": ([STAND_BY["pane"]], [pane_share(1.5)] * 3),
    "tinted pane": (
        [STAND_BY["pane"] | {"specular_transmittance": rgb(1.0, 0.5, 0.0)}],
        [pane_share(1.5), pane_share(1.5) / 2, 0.0],
    ),
    "glass stops it": ([{"type": "dielectric"}], [0.0] * 3),
}


def sheets(materials: list[dict], integrator: str = "volpath") -> dict:
    out_of_sight = {name: sheet(1.0, bsdf, 20.0 + 3.0 * i) for i, (name, bsdf) in enumerate(STAND_BY.items())}
    out_of_sight["glass"] = sheet(1.0, {"type": "dielectric"}, 50.0)
    layers = {f"sheet {i}": sheet(0.5 + 0.1 * i, bsdf) for i, bsdf in enumerate(materials)}
    # beside the seam of the rectangle's triangles and the edges of the checks
    light = LIGHT | {"position": [0.21, 0.12, 3.0]}
    scene = lit_floor(integrator, light=light, **layers, **out_of_sight)
    scene["sensor"]["to_world"] = looking((0.21, 0.12, 0.0004), (0.21, 0.12, 0.0)) @ np.diag([1e-5, 1e-5, 1.0, 1.0])
    return scene


@pytest.mark.parametrize("name", SHEETS)
def test_light_through_sheets(name):
    materials, share = SHEETS[name]
    assert radiance(sheets(materials))[0] == pytest.approx(share, rel=2e-5, abs=1e-7)


def test_path_casts_full_shadows_of_masks():
    assert (radiance(sheets([HALF], "path"))[0] == 0).all()


def test_what_is_seen_through_sheets_is_seen_in_full():
    """A lamp behind a mask of opacity 1/4, at max_depth 1: passing is no bounce. Under `path` it is one. The mask's own
    light and its mirror image do not count: it is lit from behind alone."""
    lamp = {"type": "rectangle", "to_world": moved(z=2.0) @ np.diag([1, 1, -1, 1]), "emitter": {"type": "area"}}
    scene = sheets([HALF | {"opacity": 0.25}]) | {"lamp": lamp}
    del scene["floor"]
    scene["sensor"] = one_ray((0.21, 0.12, 0.1), (0.21, 0.12, 1.0))
    scene["integrator"] = {"type": "volpath", "max_depth": 1}
    seen, error = radiance(scene, spp=4096)
    assert seen == pytest.approx([0.75] * 3, rel=5 * error)
    assert radiance(scene | {"integrator": {"type": "path", "max_depth": 1}}, spp=64)[0].max() == 0


# Free flights: a bright sky around, an index-matched ball and cube.

SKY = {"type": "constant", "radiance": 1.0}


def under_sky(sensor: dict, ball: dict, cube: dict | None = None, depth: int = -1, rr_depth: int = 5, **more) -> dict:
    return {
        "type": "scene",
        "integrator": {"type": "volpath", "max_depth": depth, "rr_depth": rr_depth},
        "sensor": sensor,
        "sky": SKY,
        "ball": {"type": "sphere", "center": [0.0, 0.0, -3.0], "bsdf": NULL, "interior": ball},
        "cube": {"type": "cube", "bsdf": NULL, "interior": cube or ball},
        **more,
    }


FRONT = one_ray((0.1, 0.2, 5.0), (0.1, 0.2, 0.0))


@pytest.mark.parametrize(
    ("sigma_t", "g"),
    [(0.5, None), (6.0, 0.9), pytest.param(6.0, -0.9, marks=pytest.mark.long), (rgb(0.1, 1.0, 3.0), 0.5)],
)
def test_white_furnace(sigma_t, g):
    """What only scatters is not seen against a sky of one colour, to five standard errors; of one colour, to those of
    the luminance times three."""
    seen, error = radiance(under_sky(FRONT, medium(sigma_t, 1.0, g), rr_depth=10**6), spp=4096)
    assert error < 0.02
    assert seen == pytest.approx([1.0] * 3, abs=5 * error * (3 if isinstance(sigma_t, dict) else 1))


def test_absorption_without_scattering():
    """Through the cube and the ball: exp(-2 sigma). Three times 5 standard errors of the luminance for one colour."""
    seen, error = radiance(under_sky(FRONT, medium(rgb(0.1, 0.5, 1.0)), medium(rgb(0.2, 0.0, 0.3))), spp=2**16)
    through_ball = 2 * math.sqrt(1 - 0.1**2 - 0.2**2)
    expected = np.exp(-through_ball * np.array([0.1, 0.5, 1.0]) - 2 * np.array([0.2, 0.0, 0.3]))
    assert seen == pytest.approx(expected, rel=15 * error)


def h_function(albedo: float, mu: float) -> float:
    """Chandrasekhar's H for isotropic scattering: H(m) = 1 / (sqrt(1 - w) + w/2 integral n H(n) / (m + n) dn)."""
    nodes, weights = np.polynomial.legendre.leggauss(64)
    nodes, weights = (nodes + 1) / 2, weights / 2

    def step(at):
        return 1 / (math.sqrt(1 - albedo) + albedo / 2 * (weights * nodes * h / (at[:, None] + nodes)).sum(axis=1))

    h = np.ones(64)
    for _ in range(500):
        h = step(nodes)
    return step(np.array([mu])).item()


@pytest.mark.parametrize(
    ("sigma_t", "place"),
    [
        pytest.param(1e2, 0.0, marks=pytest.mark.long),
        (1e4, 0.0),
        (1e6, 0.0),
        pytest.param(1e4, 60.0, marks=pytest.mark.long),
    ],
    ids=["100", "1e4", "1e6", "1e4 far away"],
)
@pytest.mark.parametrize("shape", ["cube", "ball"])
def test_dense_media_reflect_as_half_spaces(shape, sigma_t, place):
    """Under a sky of radiance 1 a half space sends 1 - H(mu) sqrt(1 - w) back (S. Chandrasekhar, Radiative Transfer,
    1950, by reciprocity from its plane albedo). Where free flights come down to the steps of the float grid, paths
    begin deeper by the error of the surface: the loss, five steps of flight length at most, is what 32-bit floats cost.
    Nothing may become brighter, by light that leaks. The ball's curvature adds 1 / sigma_t."""
    albedo = 0.8
    center = np.array([0.1, 0.2, 0.0 if shape == "cube" else -3.0]) + place
    mu = 1.0
    sensor = one_ray(center + np.array([0.0, 0.0, 30.0]), center)
    dense, gone = medium(sigma_t, albedo), medium(0.0)
    scene = under_sky(sensor, dense if shape == "ball" else gone, dense if shape == "cube" else gone)
    scene["cube"]["to_world"] = moved(place, place, place)
    scene["ball"]["center"] = [place, place, place - 3.0]
    if shape == "ball":
        mu = math.sqrt(1 - 0.1**2 - 0.2**2)
    seen, error = radiance(scene, spp=2**15)
    expected = 1 - h_function(albedo, mu) * math.sqrt(1 - albedo)
    lost = 5 * 2**-23 * (abs(scene["ball"]["center"][2]) + 1 if shape == "ball" else place + 1) * sigma_t
    noise = 5 * error + 2 / sigma_t * (shape == "ball")
    assert expected * (1 - lost - noise) < seen[0] < expected * (1 + noise)


def test_a_camera_within_a_medium():
    """The ball is left for a sky of 1: exp(-sigma d). The medium that the sensor names, not the ball's, counts."""
    sensor = one_ray((0.0, 0.0, -3.0), (0.0, 0.0, -9.0)) | {"medium": medium(1.5)}
    seen, error = radiance(under_sky(sensor, medium(0.0)), spp=2**16)
    assert seen == pytest.approx([math.exp(-1.5)] * 3, rel=5 * error)


def test_thin_media_scatter_as_often_as_they_should():
    """Optical depth 2e-5 scatters one sample in 50,000: what is lost when all of that is absorbed."""
    sensor = one_ray((0.1, 0.2, 0.0), (0.1, 0.2, 5.0))  # within the cube: a depth of sigma_t
    scene = under_sky(sensor | {"medium": medium(2e-5)}, medium(0.0), medium(2e-5))
    samples = 2**20
    statistics = isonoise.render(scene, spp=samples, strategy="uniform", seed=3).statistics
    lost = (1 - statistics.mean.astype(float).item()) * samples
    assert lost == pytest.approx(2e-5 * samples, abs=5 * math.sqrt(2e-5 * samples) + 1)


# Single scattering.


@pytest.mark.parametrize("g", [0.0, 0.7])
def test_single_scattering(g):
    """A ball of a medium, a point light beside it, max_depth 2: the integral of sigma_s p(theta) I / d^2 times the
    transmittance there and back, by 4,096 points of float64. Three times 5 standard errors for one colour."""
    sigma_t, albedo, radius, light = (
        np.array([0.4, 0.8, 1.6]),
        np.array([0.9, 0.6, 0.3]),
        1.0,
        np.array([1.5, 0.0, 1.0]),
    )
    inside = medium(rgb(*(sigma_t / 2)), rgb(*albedo), g, scale=2.0)
    ball = {"type": "sphere", "bsdf": NULL, "interior": inside}
    scene = {
        "type": "scene",
        "integrator": {"type": "volpath", "max_depth": 2},
        "sensor": one_ray((0.0, 0.0, 4.0), (0.0, 0.0, 0.0)),
        "light": {"type": "point", "position": light.tolist(), "intensity": 2.0},
        "ball": ball,
    }
    seen, error = radiance(scene, spp=2**16)
    t = (np.arange(4096) + 0.5) / 4096 * 2 * radius
    points = np.stack([0 * t, 0 * t, radius - t], axis=1)
    arm = light - points
    distance = np.linalg.norm(arm, axis=1)
    to_light = arm / distance[:, None]
    b = (points * to_light).sum(axis=1)
    out = -b + np.sqrt(b * b - (points**2).sum(axis=1) + radius**2)
    through = np.exp(-np.outer(t + np.minimum(out, distance), sigma_t))
    phase = henyey_greenstein(g, -to_light @ np.array([0.0, 0.0, 1.0]))  # from the light's way to that to the camera
    integrand = through * (phase * 2.0 / distance**2)[:, None]
    expected = sigma_t * albedo * integrand.sum(axis=0) * (2 * radius / 4096)
    assert seen == pytest.approx(expected, rel=15 * error)


# Multiple importance sampling across boundaries.


def lamp_over_ball(integrator: str, **more) -> dict:
    lamp = {"type": "sphere", "center": [0.0, 0.0, 1.2], "radius": 0.4, "emitter": {"type": "area", "radiance": 5.0}}
    return {
        "type": "scene",
        "integrator": {"type": integrator, "max_depth": 2},
        "sensor": one_ray((0.8, 0.0, 0.3), (0.4, 0.0, 0.0)),
        "floor": {"type": "rectangle", "bsdf": LAMBERT},
        "lamp": lamp,
        **more,
    }


@pytest.mark.parametrize("boundary", [0.1, 0.5, 1.1])
def test_weights_hold_across_boundaries(boundary):
    """Boundaries around a lamp, however far away, change nothing: the density of a light's point is that from the last
    vertex, not from the boundary. Five standard errors of the difference."""
    empty, error = radiance(lamp_over_ball("path"), spp=2**15)
    around = {"type": "sphere", "center": [0.0, 0.0, 1.2], "radius": 0.4 + boundary, "bsdf": NULL}
    cover = {"type": "rectangle", "to_world": moved(z=0.02, scale=3.0), "bsdf": NULL}
    with_boundaries, other = radiance(lamp_over_ball("volpath", around=around, cover=cover), spp=2**15, seed=2)
    assert with_boundaries == pytest.approx(empty, rel=5 * math.hypot(error, other))


# Against Mitsuba 3.

PICTURE = {"type": "hdrfilm", "width": 8, "height": 8, "rfilter": {"type": "box"}, "pixel_format": "rgb"}
CAMERA = {"type": "perspective", "fov": 40.0, "to_world": looking((0.0, 1.0, 5.0), (0, 0, 0)), "film": PICTURE}
TILT = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
GROUND = {"type": "rectangle", "to_world": moved(y=-1.2) @ TILT @ moved(scale=4.0), "bsdf": LAMBERT}
LAMP = {
    "type": "rectangle",
    "to_world": moved(y=2.5) @ np.linalg.inv(TILT) @ moved(scale=0.7),
    "emitter": {"type": "area", "radiance": rgb(9.0, 8.0, 6.0)},
}
LAMPS = {"point": {"type": "point", "position": [1.5, 2.0, 1.0], "intensity": 8.0}, "lamp": LAMP}
SUN = {"type": "directional", "direction": [0.3, -1.0, -0.4], "irradiance": 2.0}
BLUE_SKY = {"type": "constant", "radiance": rgb(0.5, 0.7, 1.0)}
TINTED = medium(rgb(0.2, 0.6, 1.0), rgb(0.9, 0.5, 0.2), 0.5, scale=2.0)
MIST = medium(0.5, 0.9, 0.4)


def ball(radius: float = 1.0, **more) -> dict:
    return {"type": "sphere", "radius": radius, "bsdf": NULL, **more}


GLASS = {"type": "dielectric", "int_ior": 1.5}
PICTURES = {  # depth, objects
    "tinted fog": (6, {**LAMPS, "ball": ball(interior=TINTED)}),
    "glass with fog": (10, {"sky": BLUE_SKY, "ball": ball(bsdf=GLASS, interior=TINTED)}),
    "glass with fog, lights unsampled": (
        8,
        {"sky": BLUE_SKY, "ball": ball(bsdf=GLASS, interior=TINTED | {"sample_emitters": False})},
    ),
    "fog cube, sun and sky": (
        6,
        {
            "sun": SUN,
            "sky": BLUE_SKY,
            "cube": {"type": "cube", "to_world": moved(scale=(0.8, 0.5, 0.9)), "bsdf": NULL, "interior": TINTED},
        },
    ),
    "balls within one another": (
        6,
        {**LAMPS, "mist": ball(1.2, interior=MIST), "ball": ball(0.5, interior=TINTED, exterior=MIST)},
    ),
    "its outside not named": (6, {**LAMPS, "mist": ball(1.2, interior=MIST), "ball": ball(0.5, interior=TINTED)}),
    "glass in mist": (
        8,
        {**LAMPS, "mist": ball(1.3, interior=MIST), "ball": ball(0.5, bsdf=GLASS, exterior=MIST)},
    ),
    "a lamp in fog": (
        6,
        {
            "ball": ball(interior=MIST),
            "lamp": {"type": "sphere", "radius": 0.3, "exterior": MIST, "emitter": {"type": "area", "radiance": 6.0}},
        },
    ),
    "camera in fog": (6, {**LAMPS, "sensor": CAMERA | {"medium": MIST}, "ball": ball(8.0, interior=MIST)}),
    "fog without end": (6, {"sun": SUN, "sensor": CAMERA | {"medium": medium(0.2, 0.8)}}),
    "mask before lamps": (
        6,
        {**LAMPS, "mask": {"type": "disk", "to_world": moved(y=1.5) @ TILT, "bsdf": HALF}},
    ),
    "panes": (
        8,
        {
            **LAMPS,
            "sky": BLUE_SKY,
            "pane": ball(bsdf=STAND_BY["pane"] | {"specular_transmittance": rgb(0.9, 0.5, 0.3)}, interior=MIST),
        },
    ),
    "lights hidden": (5, {**LAMPS, "sky": BLUE_SKY, "ball": ball(interior=MIST)}),
}
QUICK = ("tinted fog",)


@pytest.mark.parametrize(
    "name", [name if name in QUICK else pytest.param(name, marks=pytest.mark.long) for name in PICTURES]
)
def test_pictures_are_mitsubas(name, tmp_path):
    depth, objects = PICTURES[name]
    hidden = name == "lights hidden"
    integrator = {"type": "volpath", "max_depth": depth, "rr_depth": 5, "hide_emitters": hidden}
    scene = {"type": "scene", "integrator": integrator, "sensor": CAMERA, "ground": GROUND, **objects}
    assert_same_picture(scene, tmp_path, spp=64 if name in QUICK else 512)


@pytest.mark.long
@pytest.mark.parametrize("name", ["test_homo_null_envmap", "test_homo_area_light"])
def test_mitsubas_own_scenes_of_media(public_scenes, name, tmp_path):
    """Against the means that Mitsuba stores with its tests. As there, their own error counts for nothing: by the stored
    variances of single samples, and another render, it is that of some 10,000."""
    from isonoise.film.exr import read_exr

    folder = public_scenes / "mitsuba-tests" / "tests" / "scenes" / "participating_media"
    mean = read_exr(folder / "refs" / f"{name}_ref_rgb.exr")[0]
    theirs = np.stack([mean[c] for c in "RGB"], axis=-1).astype(float)
    batches = [
        isonoise.render(folder / f"{name}_volpath.xml", spp=64, strategy="uniform", seed=seed).statistics.rgb
        for seed in range(16)
    ]
    references.assert_agree(
        references.from_batches(np.stack(batches)), references.Estimate(theirs, 0 * theirs, 1e6), tmp_path
    )


# The description.


def inside_ball(inside: str, integrator: str = "volpath") -> str:
    return f'<integrator type="{integrator}"/><shape type="sphere"><bsdf type="null"/>{inside}</shape>'


def test_media_of_a_file(scene_of):
    compiled = compile_scene(
        scene_of(
            """<integrator type="volpath"/>
            <medium type="homogeneous" id="fog"><rgb name="sigma_t" value="0.1 0.2 0.3"/><float name="scale" value="2"/>
                <boolean name="has_spectral_extinction" value="true"/></medium>
            <phase type="hg" id="onwards"/>
            <shape type="sphere"><bsdf type="null"/><ref name="exterior" id="fog"/>
                <medium name="interior" type="homogeneous"><ref id="onwards"/>
                <boolean name="sample_emitters" value="false"/>
                <volume name="albedo" type="constvolume"><rgb name="value" value="0.1 0.2 0.3"/></volume>
                </medium></shape>
            <shape type="cube"><bsdf type="null"/><ref name="interior" id="fog"/></shape>
            <shape type="rectangle"/>
            <emitter type="point"><ref id="fog"/></emitter>
            <sensor type="perspective"><ref id="fog"/></sensor>"""
        )
    )
    assert compiled.volumetric
    fog, own = compiled.media[compiled.sensor_medium], compiled.media[compiled.shapes["media"][0] & 0xFFFF]
    assert len(compiled.media) == 2
    assert fog["sigma_t"] == pytest.approx([0.2, 0.4, 0.6])
    assert fog["albedo"] == pytest.approx([0.75] * 3)
    assert own["sigma_t"] == pytest.approx([1.0] * 3)
    assert own["albedo"] == pytest.approx([0.1, 0.2, 0.3])
    phases = compiled.bsdfs[[fog["phase"], own["phase"]]]
    assert (phases["kind"] == bsdf_bits("hg")).all()
    assert phases["constants"][:, 0] == pytest.approx([0.0, 0.8])
    assert (phases["flags"] & structs.BSDF_NO_LIGHT_SAMPLING).astype(bool).tolist() == [False, True]
    sphere, cube, plain = compiled.shapes["media"]
    assert sphere >> 16 == compiled.sensor_medium
    assert (cube & 0xFFFF, cube >> 16) == (compiled.sensor_medium, structs.MEDIUM_NONE)
    assert plain == structs.NONE
    seen_through = (compiled.shapes["flags"] & structs.SHAPE_PASS_THROUGH) != 0
    assert seen_through.tolist() == [True, True, False]
    records = triangle_records(compiled)
    assert set(records["media"]) == {cube, plain}


@pytest.mark.parametrize(
    ("inside", "problem"),
    [
        ('<medium type="homogeneous"/>', "has to be named interior or exterior"),
        ('<medium name="inside" type="homogeneous"/>', "has to be named interior or exterior, got 'inside'"),
        ('<medium name="interior" type="homogeneous"/>' * 2, "'interior' is given twice"),
        ('<medium name="interior" type="heterogeneous"/>', "medium 'heterogeneous' is not supported.*'homogeneous'"),
        *(
            (f'<medium name="interior" type="homogeneous">{inner}</medium>', problem)
            for inner, problem in (
                ('<phase type="hg"><float name="g" value="1"/></phase>', r"'g' has to be in \(-1, 1\)"),
                ('<phase type="hg"/><phase type="isotropic"/>', "only one phase"),
                ('<phase type="rayleigh"/>', "phase 'rayleigh' is not supported"),
                ('<float name="sigma_t" value="-1"/>', "cannot be negative"),
                ('<float name="albedo" value="1.5"/>', "at most 1"),
                ('<rgb name="albedo" value="0.5 0.5 1.5"/>', "at most 1"),
                ('<volume name="albedo" type="constvolume"><float name="value" value="2"/></volume>', "at most 1"),
                ('<volume name="albedo" type="gridvolume"/>', "volume 'gridvolume' is not supported"),
                ('<texture name="albedo" type="checkerboard"/>', "cannot contain a texture"),
                ('<float name="scale" value="-1"/>', "scale"),
                ('<float name="sigma_t" value="1e20"/><float name="scale" value="1e20"/>', "overflow"),
                ('<float name="sigma_s" value="1"/>', "no parameter 'sigma_s'"),
            )
        ),
    ],
)
def test_media_that_are_wrong(scene_of, inside, problem):
    with pytest.raises(SceneError, match=problem):
        scene_of(inside_ball(inside))


def test_blends_of_what_is_seen_through_have_a_limit(scene_of):
    def nested(depth: int) -> str:
        inner = '<bsdf type="null"/>' if depth == 0 else nested(depth - 1)
        return f'<bsdf type="blendbsdf"><float name="weight" value="0.5"/>{inner}<bsdf type="null"/></bsdf>'

    def scene(depth: int):
        return compile_scene(scene_of(f'<integrator type="volpath"/><shape type="sphere">{nested(depth)}</shape>'))

    scene(7)
    with pytest.raises(SceneError, match="more than 8 deep"):
        scene(8)


# What it costs.


def test_scenes_without_media_do_not_pay_for_them():
    """The same features under `volpath` as under `path`; so the same programs and buffers."""
    path, volpath = (
        features(compile_scene(load(lit_floor(integrator) | {"light": LIGHT}))) for integrator in ("path", "volpath")
    )
    assert path == volpath
    assert not path["VOLPATH"]
    assert not path["MEDIA"]
    cornell = features(compile_scene(load("cornell")))
    assert not cornell["VOLPATH"]
    assert not cornell["MEDIA"]


def test_masks_pay_for_no_media(scene_of):
    on = features(compile_scene(load(sheets([HALF]))))
    assert on["VOLPATH"]
    assert not on["MEDIA"]
    assert PATH_STATE["medium"].planes == 1
