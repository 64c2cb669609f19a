"""Nested and textured materials on the device, as the kernel `shade` evaluates them, against Mitsuba 3.

One surface is aligned with the axes, one is rotated, and one has a tilted shading normal and tilted tangents. If a
material is chosen at random, the mean over equally spaced numbers is compared: weights are multiples of 1/255 or 1/4,
so it is exact.
"""

import itertools

import numpy as np
import pytest
from bsdf_lobe import assert_close, description, numbers, uniform_sphere
from kernel_build import build_kernels
from PIL import Image

from isonoise.device.opencl import Device
from isonoise.errors import SceneError
from isonoise.scene.material import textures
from isonoise.scene.material.bsdf_kinds import KINDS, feature_of
from isonoise.scene.material.bsdfs import Bsdfs
from isonoise.scene.material.rough_transmittance import NODES
from isonoise.scene.material.textures import Textures

KERNEL = """
#include "bsdf/bsdf.h"
#include "bsdf/nested.h"

__kernel void scatter(uint first, __global const Bsdf* bsdfs, __global const float* rough_transmittances,
                      __global const Texture* textures, __global const uchar* bytes, __global const float* srgb,
                      __global const float* surface, __global const float* wi, __global const float* wo,
                      __global const float* u, __global float* out, uint n)
{
    const uint i = get_global_id(0);
    if (i >= n) return;
    out += 13 * i;
    const Textures all = {textures, bytes, NULL, srgb, NULL, NULL};
    Surface s;
    s.normal = LOAD3(0, surface);
    s.geometric_normal = LOAD3(1, surface);
    s.dp_du = LOAD3(2, surface);
    s.dp_dv = LOAD3(3, surface);
    s.uv = vec2(surface[12], surface[13]);
    s.triangle = NONE;
    s.barycentric = splat2(0.0f);
    BsdfContext ctx;
    ctx.bsdfs = bsdfs;
    ctx.bsdf = first;
    ctx.normal = s.normal;
    ctx.wi = LOAD3(i, wi);
    ctx.cos_i = dot3(ctx.normal, ctx.wi);
    ctx.flipped = false;
    ctx.bump_alpha2 = NO_BUMP;
    set_shading_frame(&ctx, &s);
    ctx.rough_transmittances = rough_transmittances;
    ctx.textures = &all;
    ctx.point = texture_point(&s);
    out[12] = resolve_nested_bsdf(&ctx, &s, u[4 * i + 3]);
    if (out[12] != 0.0f) return;
    if ((material(&ctx).flags & BSDF_TWOSIDED) && ctx.cos_i < 0.0f) flip_to_viewer(&ctx);
    float pdf = 0.0f;
    Vec3 value = splat3(0.0f);
    if (has_non_delta_lobes(&ctx))
        value = scale3(bsdf_eval(&ctx, LOAD3(i, wo), &pdf), bump_shadowing(&ctx, &s, LOAD3(i, wo)));
    STORE3(value, 0, out);
    out[3] = pdf;
    const BsdfSample sample = bsdf_sample(&ctx, LOAD3(0, u + 4 * i));
    if (sample.weight.x + sample.weight.y + sample.weight.z == 0.0f) return;
    STORE3(sample.direction, 0, out + 4);
    STORE3(scale3(sample.weight, bump_shadowing(&ctx, &s, sample.direction)), 0, out + 7);
    out[10] = sample.pdf;
    out[11] = sample.eta;
}
"""
RED = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.8, 0.3, 0.2]}}
GOLD = {"type": "roughconductor", "alpha": 0.3, "distribution": "ggx", "material": "Au"}
BRUSHED = {"type": "roughconductor", "alpha_u": 0.1, "alpha_v": 0.5, "distribution": "ggx"}
GLASS = {"type": "roughdielectric", "alpha": 0.3}
NULL = {"type": "null"}
IMAGES = {"colours": {}, "normals": {"raw": True}, "share": {"raw": True, "filter_type": "nearest"}}
IMAGES |= {"odd": {"raw": True, "filter_type": "nearest"}, "cliff": {"raw": True}}


def two(front: dict, back: dict | None = None) -> dict:
    return {"type": "twosided", "front": front} | ({} if back is None else {"back": back})


def mask(inner: dict, opacity) -> dict:
    return {"type": "mask", "opacity": opacity, "inner": inner}


def blend(first: dict, second: dict, weight) -> dict:
    return {"type": "blendbsdf", "weight": weight, "first": first, "second": second}


def bump(inner: dict, scale: float = 0.2, **more) -> dict:
    return {"type": "bumpmap", "height": "colours", "inner": inner, "scale": scale, **more}


def relief(inner: dict, **more) -> dict:
    return {"type": "normalmap", "normalmap": "normals", "inner": inner, **more}


FREE = {"flip_invalid_normals": False, "use_shadowing_function": False}
MATERIALS = {  # names of images are replaced by bitmaps
    "two sides alike": two(RED),
    "two sides": two(RED, GOLD),
    "mask": mask(GOLD, 0.25),
    "textured mask": mask(RED, "share"),
    "opaque": mask(RED, 1.0),
    "blend": blend(RED, GOLD, 0.25),
    "textured blend": blend(GLASS, GOLD, "share"),
    "blend with nothing": blend(NULL, RED, 0.5),
    "bump": bump(RED),
    "bump of glass": bump(GLASS, 0.05),
    "free bump of glass": bump(GLASS, flip_invalid_normals=False),
    "bump without shadow": bump(RED, use_shadowing_function=False),
    "normals": relief(RED),
    "normals of brushed metal": relief(BRUSHED),
    "normals of glass": relief(GLASS),
    "free normals": relief(GLASS, flip_invalid_normals=False),
    "normals without anything": relief(GOLD, **FREE),
    "two sides of bumps": two(bump(RED), relief(BRUSHED)),
    "bump of two sides": bump(two(RED, GOLD)),
    "bump of two sides alike": bump(two(RED)),
    "normals of a blend": relief(blend(RED, BRUSHED, 0.5)),
    "blend of bumps": blend(relief(RED), bump(GLASS, 0.05), 0.5),
    "mask of normals": mask(relief(RED), 0.5),
    "mask of a blend": mask(blend(two(RED), GLASS, 0.25), 0.5),
    "one normal": relief(RED, normalmap={"type": "rawconstant", "value": [0.6, 0.45, 0.9]}),
    "textured diffuse": {"type": "diffuse", "reflectance": "colours"},
    "textured metal": BRUSHED | dict.fromkeys(("alpha_u", "eta", "k", "specular_reflectance"), "colours"),
    "textured glass": GLASS | dict.fromkeys(("alpha", "specular_reflectance", "specular_transmittance"), "colours"),
    "textured plastic": {"type": "plastic", "diffuse_reflectance": "colours", "nonlinear": True},
    "textured rough plastic": {"type": "roughplastic", "diffuse_reflectance": "colours", "alpha": 0.3},
    "textured principled": {"type": "principled", "clearcoat_gloss": 0.2}
    | dict.fromkeys(("base_color", "roughness", "anisotropic", "metallic", "spec_trans", "spec_tint"), "colours")
    | dict.fromkeys(("sheen", "sheen_tint", "flatness", "clearcoat"), "colours"),
}
MIXED_BY_MEANS = (
    "textured plastic",
    "textured rough plastic",
)  # Mitsuba selects lobes by the mean of the texture
SURFACES = ("straight", "turned", "leaning")
DIRECTIONS = 32


def surface_of(name: str) -> np.ndarray:
    """Returns rows (14,): normal, geometric normal, dp/du, dp/dv, uv."""
    random = np.random.default_rng(11)
    frame = np.eye(3)
    if name != "straight":
        frame = np.linalg.qr(random.standard_normal((3, 3)))[0]
        frame[2] *= np.linalg.det(frame)
    normal, along, across = frame[2], 1.3 * frame[0] + 0.2 * frame[1], 0.7 * frame[1]
    if name == "leaning":
        normal = normal + 0.3 * random.standard_normal(3)
        along, across = along + 0.4 * frame[2], across - 0.3 * frame[2]
    normal = normal / np.linalg.norm(normal)
    return np.concatenate([normal, frame[2], along, across, random.random(2)]).astype(np.float32)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Returns images of 8 x 8 texels."""
    folder, random = tmp_path_factory.mktemp("images"), np.random.default_rng(12)
    pixels = {
        "colours": random.integers(0, 256, (8, 8, 3)),
        "normals": 255 * (random.random((8, 8, 3)) * [0.7, 0.7, 0.4] + [0.15, 0.15, 0.6]),
        "share": random.integers(1, 255, (8, 8)),
        "odd": random.choice([0, 127, 128, 255], (8, 8, 3)),
        "cliff": random.choice([0, 255], (8, 8)),
    }
    for name, values in pixels.items():
        Image.fromarray(values.astype(np.uint8)).save(folder / f"{name}.png")
    return folder


@pytest.fixture(scope="module")
def with_images(folder):
    """Replaces names of images by bitmaps."""

    def replaced(value):
        if isinstance(value, str) and value in IMAGES:
            return {"type": "bitmap", "filename": str(folder / f"{value}.png"), **IMAGES[value]}
        return {k: replaced(v) for k, v in value.items()} if isinstance(value, dict) else value

    return replaced


@pytest.fixture(scope="module")
def material(with_images):
    """Returns a material by its name."""
    return lambda name: with_images(MATERIALS[name])


@pytest.fixture(scope="module")
def scatter():
    """Returns (n, 13): value, pdf; sampled direction, weight, pdf, eta; whether the path passes through."""
    device = Device()
    on = {feature_of(kind) for kind in KINDS.values()}
    on |= {"NEXT_EVENT", "BECKMANN", "TEXTURES", "BITMAPS", "UVS"}
    kernel = build_kernels(device, KERNEL, on)["scatter"]

    def run(bsdf: dict, surface, wi, wo, u) -> np.ndarray:
        images, n = Textures(), len(wi)
        bsdfs = Bsdfs(images.index)
        first, arrays = bsdfs.index(description(bsdf)), images.arrays()
        tables = bsdfs.tables if bsdfs.tables.size else np.zeros(NODES, np.float32)
        given = (bsdfs.records, tables, arrays.records, arrays.bytes, textures.SRGB)
        given += tuple(np.ascontiguousarray(array, np.float32) for array in (surface, wi, wo, u))
        buffers = [device.buffer(array, "inputs") if array.size else None for array in given]
        out = device.buffer(np.zeros(13 * n, np.float32), "results")
        device.launch(kernel, n, (np.uint32(first), *buffers, out, np.uint32(n)))
        return device.read(out, np.float32, 13 * n).reshape(n, 13)

    return run


def in_mitsuba(mi, bsdf: dict, surface: np.ndarray, wi: np.ndarray, wo: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns Mitsuba's values (n, 3) and pdfs (n,); bitmaps are float32, not float16."""

    def full(value):
        if not isinstance(value, dict):
            return value
        return {k: full(v) for k, v in value.items()} | ({"format": "variant"} if value["type"] == "bitmap" else {})

    normal, geometric, along, across = surface[:12].reshape(4, 3).astype(np.float64)
    tangent = along - normal * (normal @ along)
    tangent /= np.linalg.norm(tangent)
    si = mi.SurfaceInteraction3f()
    si.n, si.sh_frame = geometric, mi.Frame3f(tangent, np.cross(normal, tangent), normal)
    si.dp_du, si.dp_dv, si.uv = along, across, surface[12:]
    loaded, context = mi.load_dict(full(bsdf)), mi.BSDFContext()
    values, pdfs = np.zeros((len(wi), 3)), np.zeros(len(wi))
    for i, (a, b) in enumerate(zip(wi, wo, strict=True)):
        si.wi = si.to_local(a)
        value, pdfs[i] = loaded.eval_pdf(context, si, si.to_local(b))
        values[i] = np.array(value)
    return values, pdfs


def pairs(surface: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns directions on both sides, every third near the mirror direction."""
    random, normal = np.random.default_rng(seed), surface[:3]
    wi, wo = uniform_sphere(random, DIRECTIONS), uniform_sphere(random, DIRECTIONS)
    near = np.arange(DIRECTIONS) % 3 == 0
    wo[near] = 2 * (wi[near] @ normal)[:, None] * normal - wi[near] + 0.3 * wo[near]
    return wi, wo / np.linalg.norm(wo, axis=1, keepdims=True)


@pytest.mark.parametrize("name", MATERIALS)
def test_eval_and_pdf_are_mitsubas(scatter, material, mitsuba, name):
    """To 1e-3 for values above 1e-4; smaller values occur where a facet refracts nearly into its own plane."""
    choices = 255 if "textured" in name else 8
    for number, where in enumerate(SURFACES):
        surface = surface_of(where)
        wi, wo = pairs(surface, number)
        u = np.zeros((DIRECTIONS * choices, 4))
        u[:, 3] = np.tile((np.arange(choices) + 0.5) / choices, DIRECTIONS)
        out = scatter(material(name), surface, np.repeat(wi, choices, axis=0), np.repeat(wo, choices, axis=0), u)
        mean = out.reshape(DIRECTIONS, choices, 13).mean(axis=1, dtype=np.float64)
        value, pdf = in_mitsuba(mitsuba, material(name), surface, wi, wo)
        lit = value.max(axis=1) > 0
        assert lit.sum() > DIRECTIONS // 8
        assert_close(mean[:, :3], value, 1e-3, 1e-7)
        if name not in MIXED_BY_MEANS:
            assert_close(mean[lit, 3], pdf[lit], 1e-3, 1e-7)


@pytest.mark.parametrize("name", MATERIALS)
def test_weights_are_value_over_pdf(scatter, material, name):
    for where in SURFACES:
        random, surface = np.random.default_rng(13), surface_of(where)
        wi = uniform_sphere(random, 2000)
        u = np.concatenate([numbers(random, 2000), random.random((2000, 1))], axis=1)
        first = scatter(material(name), surface, wi, np.zeros_like(wi), u)
        goes_on = (first[:, 7:10].max(axis=1) > 0) & (first[:, 10] > 0)
        assert goes_on.sum() > 200
        wi, u, first = wi[goes_on], u[goes_on], first[goes_on]
        again = scatter(material(name), surface, wi, first[:, 4:7], u)
        assert_close(first[:, 10], again[:, 3], 2e-3)
        assert_close(first[:, 7:10], again[:, :3] / again[:, 3:4], 2e-3, 1e-5)


@pytest.mark.parametrize("free", [{}, FREE], ids=["kept", "free"])
@pytest.mark.parametrize("inner", [RED, BRUSHED, GLASS, two(GOLD)], ids=lambda inner: inner["type"])
def test_edges_of_bumps(scatter, with_images, inner, free):
    """Results are finite and not negative for normal maps with zero or arbitrary normals, steep bump maps, tangents
    that are zero, parallel or huge, and directions along the normal or 1e-5 above and below the horizon."""
    surface = surface_of("straight")
    angles = np.array([0.0, 1e-4, 0.7, np.pi / 2 - 1e-5, np.pi / 2 + 1e-5, 2.5, np.pi])
    theta, phi = (a.ravel() for a in np.meshgrid(angles, np.arange(0.0, 6.0, 0.7)))
    directions = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=1)
    wi, wo = np.repeat(directions, len(directions), axis=0), np.tile(directions, (len(directions), 1))
    u = np.random.default_rng(15).random((len(wi), 4))
    for material in (relief(inner, **free) | {"normalmap": "odd"}, bump(inner, 1e4, **free) | {"height": "cliff"}):
        for along, across in (
            ((1, 0, 0), (0, 1, 0)),
            ((0, 0, 0), (0, 1, 0)),
            ((1, 1, 0), (1, 1, 0)),
            ((1e15, 0, 0), (0, 1e15, 0)),
        ):
            surface[6:9], surface[9:12] = along, across
            for place in ((0.1, 0.2), (0.5, 0.5), (0.9, 0.3)):
                surface[12:] = place
                out = scatter(with_images(material), surface, wi, wo, u)
                assert np.isfinite(out).all()
                assert (out[:, [0, 1, 2, 3, 7, 8, 9]] >= 0).all()


def test_what_passes_is_what_is_not_opaque(scatter, material):
    surface, random = surface_of("straight"), np.random.default_rng(14)
    wi = uniform_sphere(random, 4096)
    u = np.zeros((len(wi), 4))
    u[:, 3] = (np.arange(len(wi)) + 0.5) / len(wi)
    for name, share in (("mask", 0.75), ("opaque", 0.0), ("blend with nothing", 0.5), ("mask of a blend", 0.5)):
        assert scatter(material(name), surface, wi, wi, u)[:, 12].mean() == share, name


@pytest.mark.parametrize(("outer", "inner"), list(itertools.product((bump, relief), (bump, relief))))
@pytest.mark.parametrize("between", [lambda m: m, two, lambda m: blend(RED, m, 0.5)])
def test_a_bump_within_a_bump_is_refused(outer, inner, between):
    named = {"height": {"type": "checkerboard"}, "normalmap": {"type": "checkerboard"}}

    def with_textures(value):
        return {k: named.get(k, with_textures(v)) for k, v in value.items()} if isinstance(value, dict) else value

    with pytest.raises(SceneError, match=r"cannot contain a (bump|normal)map"):
        description(with_textures(outer(between(inner(RED)))))
