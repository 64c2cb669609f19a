"""Materials on the device, to evaluate and to sample one by one. Used by the test_bsdf_*.py files and others.

Materials are described as a scene describes them, so that names and defaults are tested too. Directions are in the
shading frame: z is the normal.
"""

import math
from functools import cache

import numpy as np
import pytest
from kernel_build import build_kernels
from records import slot

from isonoise.device.opencl import Device
from isonoise.scene import load_description, structs
from isonoise.scene.material.bsdf_kinds import KINDS, bsdf_bits, feature_of
from isonoise.scene.material.bsdfs import Bsdfs
from isonoise.scene.material.presets import conductors
from isonoise.scene.material.rough_transmittance import NODES

KERNEL = """
#include "bsdf/bsdf.h"

BsdfContext shading(__global const Bsdf* bsdf, __global const float* rough_transmittances, __global const float* frame,
                    Vec3 wi)
{
    BsdfContext ctx;
    ctx.bsdfs = bsdf;
    ctx.bsdf = 0u;
    ctx.normal = LOAD3(2, frame);
    ctx.wi = wi;
    ctx.cos_i = dot3(ctx.normal, wi);
#if HAS_BLEND_LIGHTING
    ctx.other_weight = 0.0f;
#endif
#if HAS_SHADING_FRAME
    ctx.s = LOAD3(0, frame);
    ctx.t = LOAD3(1, frame);
#endif
#if HAS_ROUGH_TRANSMITTANCE
    ctx.rough_transmittances = rough_transmittances;
#endif
    return ctx;
}

__kernel void evaluate(__global const Bsdf* bsdf, __global const float* rough_transmittances,
                       __global const float* frame, __global const float* wi, __global const float* wo,
                       __global float* out, uint n)
{
    const uint i = get_global_id(0);
    if (i >= n) return;
    const BsdfContext ctx = shading(bsdf, rough_transmittances, frame, LOAD3(i, wi));
    float pdf = 0.0f;
    Vec3 value = splat3(0.0f);
    if (has_non_delta_lobes(&ctx)) value = bsdf_eval(&ctx, LOAD3(i, wo), &pdf);
    STORE3(value, 2 * i, out);
    out[6 * i + 3] = pdf;
}

__kernel void draw(__global const Bsdf* bsdf, __global const float* rough_transmittances, __global const float* frame,
                   __global const float* wi, __global const float* u, __global float* out, uint n)
{
    const uint i = get_global_id(0);
    if (i >= n) return;
    const BsdfContext ctx = shading(bsdf, rough_transmittances, frame, LOAD3(i, wi));
    const BsdfSample sample = bsdf_sample(&ctx, LOAD3(i, u));
    if (sample.weight.x + sample.weight.y + sample.weight.z == 0.0f) return;
    STORE3(sample.direction, 3 * i, out);
    STORE3(sample.weight, 3 * i + 1, out);
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
LOBES = {  # append new ones: the seeds of tests follow the order
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
    "roughplastic thinner within": {"type": "roughplastic", "int_ior": 1.0, "ext_ior": 1.25},
    "principled": {"type": "principled", "base_color": RED},
    "principled metal": {
        "type": "principled",
        "base_color": RED,
        "metallic": 0.9,
        "roughness": 0.4,
        "anisotropic": 0.8,
    },
    "principled coated": {
        "type": "principled",
        **{"base_color": RED, "roughness": 0.7, "clearcoat": 1.0, "clearcoat_gloss": 0.2, "spec_tint": 0.6},
        **{"sheen": 0.8, "sheen_tint": 0.5, "flatness": 0.7, "specular": 0.8},
        **{
            "clearcoat_sampling_rate": 2.0,
            "diffuse_reflectance_sampling_rate": 0.5,
            "main_specular_sampling_rate": 1.5,
        },
    },
    "principled glass": {"type": "principled", "base_color": RED, "spec_trans": 1.0, "roughness": 0.5, "eta": 1.4},
    "principled all": {
        "type": "principled",
        **{"base_color": RED, "roughness": 0.6, "metallic": 0.3, "spec_trans": 0.6, "anisotropic": 0.5, "eta": 0.8},
        **{"clearcoat": 0.6, "spec_tint": 0.3, "sheen": 0.4, "flatness": 0.3},
    },
    "principledthin": {"type": "principledthin", "base_color": RED},
    "principledthin paper": {
        "type": "principledthin",
        **{"base_color": RED, "diff_trans": 1.2, "sheen": 0.6, "sheen_tint": 0.4, "flatness": 0.5, "roughness": 0.8},
        "diffuse_transmittance_sampling_rate": 2.0,
    },
    "principledthin glass": {"type": "principledthin", "base_color": RED, "spec_trans": 1.0, "roughness": 0.6},
    "principledthin all": {
        "type": "principledthin",
        **{"base_color": RED, "roughness": 0.7, "anisotropic": 0.6, "spec_trans": 0.5, "eta": 1.8, "spec_tint": 0.7},
        **{"sheen": 0.3, "flatness": 0.4, "diff_trans": 0.8, "specular_reflectance_sampling_rate": 0.5},
        **{"specular_transmittance_sampling_rate": 1.5, "diffuse_reflectance_sampling_rate": 0.7},
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
    "principledthin 0.15": {"type": "principledthin", "roughness": 0.15, "spec_trans": 0.6, "diff_trans": 0.5},
}
DELTA = {
    "dielectric": {"type": "dielectric", **GLASS},
    "thindielectric": {"type": "thindielectric", **GLASS},
    "conductor": {"type": "conductor"},
}
BOTH_SIDES = [
    name
    for name, bsdf in (LOBES | NARROW).items()
    if "dielectric" in bsdf["type"] or "spec_trans" in bsdf or bsdf["type"] == "principledthin"
]


def smallest_alpha(bsdf: dict) -> float:
    return min(bsdf.get(key, 1.0) for key in ("alpha", "alpha_u", "alpha_v"))


def description(bsdf: dict) -> dict:
    """As a scene gives it, defaults filled in."""
    scene = {"type": "scene", "sensor": {"type": "perspective"}, "ball": {"type": "sphere", "material": bsdf}}
    return load_description(scene)["ball"]["bsdf"]


class Lobe:
    """One material on the device. Directions are (n, 3) in its shading frame; the rows of `frame` are that frame."""

    def __init__(self, kernels, device: Device, bsdf: dict, frame=None):
        self.device, self.kernels = device, kernels
        bsdfs = Bsdfs(lambda texture, kind: pytest.fail("no textures here"))
        index = bsdfs.index(description(bsdf))
        self.record = bsdfs.records[index : index + 1]
        tables = bsdfs.tables if bsdfs.tables.size else np.zeros(NODES, np.float32)
        self.frame = np.eye(3) if frame is None else frame
        arrays = self.record, tables, self.frame.astype(np.float32)
        self.buffers = tuple(device.buffer(array, "the material") for array in arrays)

    def index_of_refraction(self) -> float:
        """Inside over outside; 1 for materials that transmit nothing."""
        if self.record["kind"] == bsdf_bits("principled"):
            return slot(self.record, "eta")[0, 0]
        if self.record["kind"] == bsdf_bits("principled_thin"):
            return 1.0
        return slot(self.record, "ior")[0, 0] if self.record["flags"] & structs.BSDF_TRANSMITS else 1.0

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


@cache
def device() -> Device:
    return Device()


@cache
def build_lobes(*off: str) -> dict:
    """Kernels for all kinds of BSDF without textures; `off`: features that are left out."""
    on = {feature_of(kind) for kind in KINDS.values()}
    on |= {"NEXT_EVENT", "BECKMANN", "SAMPLE_ALL_NORMALS"}
    return build_kernels(device(), KERNEL, on - set(off))


def lobe(name: str | dict) -> Lobe:
    """A material by its name in the tables above, or by its description."""
    return Lobe(build_lobes(), device(), name) if isinstance(name, dict) else _named_lobe(name)


@cache
def _named_lobe(name: str) -> Lobe:
    return Lobe(build_lobes(), device(), (LOBES | NARROW | DELTA)[name])


SEEN_FROM = {"above": 0.0, "aslant": 0.6, "low": 1.25, "inside": math.pi - 0.5, "low inside": math.pi - 1.2}
"""Polar angles of wi by name."""


def assert_close(ours, theirs, rel: float, absolute: float = 0.0) -> None:
    """Elementwise; shows where not."""
    far = ~(np.abs(ours - theirs) <= rel * np.abs(theirs) + absolute)
    assert not far.any(), (np.argwhere(far)[:3], ours[far][:3], theirs[far][:3])


def direction(theta: float, phi: float = 0.7) -> np.ndarray:
    return np.array([math.sin(theta) * math.cos(phi), math.sin(theta) * math.sin(phi), math.cos(theta)])


def uniform_sphere(random: np.random.Generator, n: int) -> np.ndarray:
    v = random.standard_normal((n, 3))
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def numbers(random: np.random.Generator, n: int) -> np.ndarray:
    """(n, 3) as the renderer's: multiples of 2^-24 in [0, 1)."""
    return random.integers(0, 2**24, (n, 3)) / 2**24


def random_material(random: np.random.Generator) -> dict:
    """Any parameters of any material that scatters; alphas from 0.05 on."""

    def some(low: float = 0.0, high: float = 1.0) -> float:
        return float(random.uniform(low, high))

    def colour() -> dict:
        return {"type": "rgb", "value": [some(), some(), some()]}

    def maybe(share: float = 0.5, **parameters) -> dict:
        return parameters if random.random() < share else {}

    def alphas() -> list[float]:
        return [math.exp(some(math.log(0.05), math.log(1.2))) for _ in range(2)]

    kind = str(
        random.choice(["roughconductor", "roughdielectric", "plastic", "roughplastic", "principled", "principled"])
    )
    material = {"type": kind}
    if kind.startswith("rough"):
        alpha, second = alphas()
        stretched = random.random() < 0.5 and kind != "roughplastic"
        material |= {"alpha_u": alpha, "alpha_v": second} if stretched else {"alpha": alpha}
        material |= {"distribution": str(random.choice(["ggx", "beckmann"]))} | maybe(0.3, sample_visible=False)
    if kind == "roughconductor":
        unbounded = [{"type": "rgb", "value": [some(0.1, top) for _ in range(3)]} for top in (3, 6)]
        preset = {"material": str(random.choice(sorted(conductors())))}
        material |= preset if random.random() < 0.5 else {"eta": unbounded[0], "k": unbounded[1]}
    if kind in ("roughdielectric", "plastic", "roughplastic"):
        material |= maybe(0.7, int_ior=some(1.1, 3.0)) | maybe(ext_ior=some(1.0, 1.08))
    if kind == "roughdielectric":
        material |= maybe(0.2, int_ior=1.0, ext_ior=some(1.1, 2.0)) | maybe(specular_transmittance=colour())
    if "plastic" in kind:
        material |= maybe(0.8, diffuse_reflectance=colour()) | maybe(nonlinear=True)
    if kind != "principled":
        return material | maybe(0.3, specular_reflectance=colour())
    material |= {"base_color": colour(), "roughness": some(0.25)} | maybe(clearcoat_gloss=some(0, 0.5))
    for name in ("anisotropic", "metallic", "spec_trans", "spec_tint", "sheen", "sheen_tint", "flatness", "clearcoat"):
        material |= maybe(**{name: some() if random.random() < 0.8 else float(random.integers(2))})
    for name in ("diffuse_reflectance", "main_specular", "clearcoat"):
        material |= maybe(0.3, **{f"{name}_sampling_rate": some(0.1, 3.0)})
    return material | (maybe(eta=some(1.0, 2.5)) or maybe(specular=some()))


def random_thin_material(random: np.random.Generator) -> dict:
    """Any parameters of `principledthin`, each left out half the time."""
    upper = dict.fromkeys(("anisotropic", "spec_trans", "spec_tint", "sheen", "sheen_tint", "flatness"), 1.0)
    upper |= {"diff_trans": 2.0, "diffuse_reflectance_sampling_rate": 3.0, "specular_transmittance_sampling_rate": 3.0}
    material = {
        "type": "principledthin",
        "roughness": float(random.uniform(0.3, 1)),
        "eta": float(random.uniform(1, 2)),
    }
    material["base_color"] = {"type": "rgb", "value": random.random(3).tolist()}
    return material | {name: float(random.uniform(0, high)) for name, high in upper.items() if random.random() < 0.5}
