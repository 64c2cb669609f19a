"""What materials scatter, on the device: against Mitsuba 3, and against themselves.

Every material of `LOBES` is given as a scene gives it, so that names and defaults are tested with it. Directions are of
the surface's frame, z its normal. Statistical tests look at fixed numbers; their false alarms are stated for one run of
the file with other ones.
"""

import math
from statistics import NormalDist

import numpy as np
import pytest

from isonoise.device import program
from isonoise.device.opencl import Device
from isonoise.integrator.features import FEATURES
from isonoise.integrator.wavefront import STRUCTS
from isonoise.scene import load, structs
from isonoise.scene.boundaries import NODES, inner_reflectance, rough_boundary
from isonoise.scene.bsdfs import Bsdfs

KERNEL = """
#include "bsdf.h"

Shading shading(__global const Bsdf* bsdf, __global const float* tables, __global const float* frame, float3 wi)
{
    Shading at;
    at.bsdf = bsdf;
    at.normal = LOAD3(2, frame);
    at.wi = wi;
    at.cos_i = dot3(at.normal, wi);
#if HAS_FRAMES
    at.s = LOAD3(0, frame);
    at.t = LOAD3(1, frame);
#endif
#if FEATURE_ROUGH_PLASTIC
    at.tables = tables;
#endif
    return at;
}

__kernel void evaluate(__global const Bsdf* bsdf, __global const float* tables, __global const float* frame,
                       __global const float* wi, __global const float* wo, __global float* out, uint n)
{
    const uint i = get_global_id(0);
    if (i >= n) return;
    const Shading at = shading(bsdf, tables, frame, LOAD3(i, wi));
    float pdf = 0.0f;
    float3 value = (float3)(0.0f);
    if (bsdf_is_smooth(&at)) value = bsdf_eval(&at, LOAD3(i, wo), &pdf);
    store3(value, 2 * i, out);
    out[6 * i + 3] = pdf;
}

__kernel void draw(__global const Bsdf* bsdf, __global const float* tables, __global const float* frame,
                   __global const float* wi, __global const float* u, __global float* out, uint n)
{
    const uint i = get_global_id(0);
    if (i >= n) return;
    const Shading at = shading(bsdf, tables, frame, LOAD3(i, wi));
    const BsdfSample sample = bsdf_sample(&at, LOAD3(i, u));
    if (sample.weight.x + sample.weight.y + sample.weight.z == 0.0f) return;
    store3(sample.direction, 3 * i, out);
    store3(sample.weight, 3 * i + 1, out);
    out[9 * i + 6] = sample.pdf;
    out[9 * i + 7] = sample.eta;
}
"""

GOLD = {"eta": {"type": "rgb", "value": [0.14, 0.38, 1.44]}, "k": {"type": "rgb", "value": [3.98, 2.39, 1.6]}}
RED = {"type": "rgb", "value": [0.9, 0.3, 0.1]}


def rough(type_: str, alpha, distribution: str = "ggx", **more) -> dict:
    """A rough material; `alpha` is a number or one for u and one for v."""
    two = isinstance(alpha, tuple)
    alphas = {"alpha_u": alpha[0], "alpha_v": alpha[1]} if two else {"alpha": alpha}
    return {"type": type_, "distribution": distribution, **alphas, **more}


GLASS = {"int_ior": 1.5, "ext_ior": 1.0}
LOBES = {
    "diffuse": {"type": "diffuse", "reflectance": RED},
    "roughconductor": {"type": "roughconductor", **GOLD},
    "roughconductor ggx": rough("roughconductor", 0.3, **GOLD, specular_reflectance=RED),
    "roughconductor ggx stretched": rough("roughconductor", (0.08, 0.6)),
    "roughconductor beckmann stretched": rough("roughconductor", (0.5, 0.06), "beckmann", material="Cu"),
    "roughconductor beckmann 1": rough("roughconductor", 1.0, "beckmann"),
    "roughconductor all normals": rough("roughconductor", (0.1, 0.4), sample_visible=False),
    "roughconductor beckmann all normals": rough("roughconductor", 0.2, "beckmann", sample_visible=False),
    "roughdielectric": {"type": "roughdielectric"},
    "roughdielectric ggx": rough("roughdielectric", 0.25, **GLASS, specular_reflectance=RED),
    "roughdielectric ggx stretched": rough("roughdielectric", (0.5, 0.1), specular_transmittance=RED),
    "roughdielectric beckmann stretched": rough("roughdielectric", (0.1, 0.3), "beckmann", int_ior=2.4),
    "roughdielectric thinner within": rough("roughdielectric", 0.2, int_ior=1.0, ext_ior=1.33),
    "roughdielectric all normals": rough("roughdielectric", (0.1, 0.2), sample_visible=False),
    "roughdielectric beckmann all normals": rough("roughdielectric", 0.3, "beckmann", sample_visible=False),
    "plastic": {"type": "plastic"},
    "plastic nonlinear": {"type": "plastic", "diffuse_reflectance": RED, "nonlinear": True, "int_ior": 1.9},
    "plastic tinted": {"type": "plastic", "diffuse_reflectance": RED, "specular_reflectance": 0.3},
    "roughplastic": {"type": "roughplastic", "diffuse_reflectance": RED},
    "roughplastic ggx nonlinear": rough("roughplastic", 0.3, diffuse_reflectance=RED, nonlinear=True, int_ior=1.7),
    "roughplastic all normals": rough("roughplastic", 0.2, "beckmann", sample_visible=False, specular_reflectance=RED),
    "principled": {"type": "principled", "base_color": RED},
    "principled metal": {"type": "principled", "base_color": RED, "metallic": 0.9, "roughness": 0.4, "anisotropic": 0.8},
    "principled coated": {
        "type": "principled",
        **{"base_color": RED, "roughness": 0.7, "clearcoat": 1.0, "clearcoat_gloss": 0.2, "spec_tint": 0.6},
        **{"sheen": 0.8, "sheen_tint": 0.5, "flatness": 0.7, "specular": 0.8},
        **{"clearcoat_sampling_rate": 2.0, "diffuse_reflectance_sampling_rate": 0.5, "main_specular_sampling_rate": 1.5},
    },
    "principled glass": {"type": "principled", "base_color": RED, "spec_trans": 1.0, "roughness": 0.5, "eta": 1.4},
    "principled all": {
        "type": "principled",
        **{"base_color": RED, "roughness": 0.6, "metallic": 0.3, "spec_trans": 0.6, "anisotropic": 0.5, "eta": 0.8},
        **{"clearcoat": 0.6, "spec_tint": 0.3, "sheen": 0.4, "flatness": 0.3},
    },
}
NARROW = {  # alpha below 0.05: compared on the scale of the lobe's peak
    "roughconductor 0.01": rough("roughconductor", 0.01, **GOLD),
    "roughconductor beckmann 0.002": rough("roughconductor", (0.002, 0.02), "beckmann"),
    "roughdielectric 0.01": rough("roughdielectric", 0.01),
    "roughdielectric beckmann 0.005": rough("roughdielectric", 0.005, "beckmann"),
    "roughplastic 0.01": rough("roughplastic", 0.01),
    "principled 0.1": {"type": "principled", "roughness": 0.1, "spec_trans": 0.5},
    "principled coat": {"type": "principled", "clearcoat": 1.0, "clearcoat_gloss": 0.8},
}
DELTA = {
    "dielectric": {"type": "dielectric", **GLASS},
    "thindielectric": {"type": "thindielectric", **GLASS},
    "conductor": {"type": "conductor"},
}
BOTH_SIDES = [name for name in (*LOBES, *NARROW) if "dielectric" in name or "glass" in name or "principled all" in name]


def smallest_alpha(bsdf: dict) -> float:
    return min(bsdf.get(key, 1.0) for key in ("alpha", "alpha_u", "alpha_v"))


def description(bsdf: dict) -> dict:
    """As a scene gives it, defaults filled in."""
    scene = {"type": "scene", "sensor": {"type": "perspective"}, "ball": {"type": "sphere", "material": bsdf}}
    return load(scene)["ball"]["bsdf"]


class Lobe:
    """One material on the device. Directions are (n, 3) of its frame; `frame` is that frame in the world, by rows."""

    def __init__(self, kernels, device: Device, bsdf: dict, frame=None):
        self.device, self.kernels = device, kernels
        bsdfs = Bsdfs(lambda texture, kind: pytest.fail("no textures here"))
        index = bsdfs.index(description(bsdf))
        self.record = bsdfs.records[index : index + 1]
        tables = bsdfs.tables if bsdfs.tables.size else np.zeros(NODES, np.float32)
        self.frame = np.eye(3) if frame is None else frame
        arrays = self.record, tables, self.frame.astype(np.float32)
        self.buffers = tuple(device.buffer(array, "the material") for array in arrays)

    def _run(self, kernel: str, wi, other, columns: int) -> np.ndarray:
        n = len(wi)
        out = self.device.buffer(4 * columns * n, "results")
        inputs = (self.device.buffer(np.asarray(array, np.float32), "directions") for array in (wi, other))
        self.device.launch(self.kernels[kernel], n, (*self.buffers, *inputs, out, np.uint32(n)))
        return self.device.read(out, np.float32, columns * n).reshape(n, columns)

    def evaluate(self, wi, wo) -> tuple[np.ndarray, np.ndarray]:
        """(bsdf times cosine (n, 3), pdf (n,))."""
        wi, wo = np.broadcast_arrays(wi, wo)
        out = self._run("evaluate", wi @ self.frame, wo @ self.frame, 6)
        return out[:, :3], out[:, 3]

    def sample(self, wi, u) -> tuple[np.ndarray, ...]:
        """(direction (n, 3), weight (n, 3), pdf (n,), eta (n,)); all zero where the path ends."""
        wi, u = np.broadcast_arrays(wi, u)
        out = self._run("draw", wi @ self.frame, u, 9)
        return out[:, :3] @ self.frame.T, out[:, 3:6], out[:, 6], out[:, 7]


@pytest.fixture(scope="module")
def device():
    return Device()


def build(device: Device, off: tuple[str, ...] = ()) -> dict:
    """The kernels, with all that materials can be but textures."""
    on = {name.removeprefix("BSDF_") for name in structs.CONSTANTS if name.startswith("BSDF_")}
    on |= {"NEXT_EVENT", "BECKMANN", "ALL_NORMALS"}
    source = program.kernel_source
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(program, "kernel_source", lambda name: KERNEL if name == "lobes.cl" else source(name))
        features = {name: name in on and name not in off for name in FEATURES}
        return device.build(*program.stage_source("lobes.cl", STRUCTS, structs.CONSTANTS, features))


@pytest.fixture(scope="module")
def kernels(device):
    return build(device)


@pytest.fixture(scope="module")
def lobe(device, kernels):
    """A material by its name, or by its dict."""
    made = {}

    def get(name) -> Lobe:
        if isinstance(name, dict):
            return Lobe(kernels, device, name)
        if name not in made:
            made[name] = Lobe(kernels, device, (LOBES | NARROW | DELTA)[name])
        return made[name]

    return get


def direction(theta: float, phi: float = 0.7) -> np.ndarray:
    return np.array([math.sin(theta) * math.cos(phi), math.sin(theta) * math.sin(phi), math.cos(theta)])


def uniform_sphere(random: np.random.Generator, n: int) -> np.ndarray:
    v = random.standard_normal((n, 3))
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def numbers(random: np.random.Generator, n: int) -> np.ndarray:
    """(n, 3) as the renderer's: multiples of 2^-24 in [0, 1)."""
    return random.integers(0, 2**24, (n, 3)) / 2**24


# Against Mitsuba 3.


@pytest.fixture(scope="module")
def mitsuba():
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("scalar_rgb")
    return mi


def mitsuba_eval_pdf(mi, bsdf: dict, wi: np.ndarray, wo: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    material, context, si = mi.load_dict(bsdf), mi.BSDFContext(), mi.SurfaceInteraction3f()
    values, pdfs = np.zeros((len(wi), 3)), np.zeros(len(wi))
    for i, (a, b) in enumerate(zip(wi.tolist(), wo.tolist(), strict=True)):
        si.wi = a
        value, pdfs[i] = material.eval_pdf(context, si, b)
        values[i] = value
    return values, pdfs


@pytest.mark.parametrize("name", [*LOBES, *NARROW])
def test_eval_and_pdf_are_mitsubas(mitsuba, lobe, name):
    """At 16 directions, for each 24 that are uniform over the sphere and 24 that the lobe itself sends there: to 1e-3; where
    alpha is below 0.05, to 1e-3 of the largest seen for the same wi, as the half vector of two float32 directions has no more
    digits there."""
    random = np.random.default_rng(3)
    wi = uniform_sphere(random, 16)
    if name not in BOTH_SIDES:
        wi[:, 2] = np.abs(wi[:, 2])
    wi = np.repeat(wi, 48, axis=0).astype(np.float32)
    wo = np.where(np.arange(len(wi))[:, None] % 2, uniform_sphere(random, len(wi)), 0)
    drawn = lobe(name).sample(wi, numbers(random, len(wi)))[0]
    drawn[np.linalg.norm(drawn, axis=1) < 0.5] = [0, 0, 1]
    wo = np.where(np.arange(len(wi))[:, None] % 2, wo, drawn).astype(np.float32)
    value, pdf = lobe(name).evaluate(wi, wo)
    expected, expected_pdf = mitsuba_eval_pdf(mitsuba, (LOBES | NARROW)[name], wi, wo)
    assert (expected > 0).sum() > 400
    assert (expected_pdf > 0).sum() > 200
    for ours, theirs in ((value, expected), (pdf[:, None], expected_pdf[:, None])):
        scale = np.abs(theirs)
        if name in NARROW:
            peaks = scale.reshape(16, 48, -1).max(axis=1, keepdims=True)
            scale = np.broadcast_to(peaks, (16, 48, theirs.shape[1])).reshape(theirs.shape)
        error = np.abs(ours - theirs) / np.maximum(scale, 1e-6)
        worst = np.unravel_index(error.argmax(), error.shape)[0]
        assert error.max() < 1e-3, (wi[worst], wo[worst], ours[worst], theirs[worst])
