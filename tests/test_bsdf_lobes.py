"""Sampling of BSDFs against their pdf and value, reciprocity, and parameters at the edge of their range.

Statistical tests use fixed random numbers; false alarm rates are for one run of the file with other ones.
"""

import math
from statistics import NormalDist

import numpy as np
import pytest
from bsdf_lobe import (
    BOTH_SIDES,
    DELTA,
    GOLD,
    LOBES,
    NARROW,
    SEEN_FROM,
    Lobe,
    assert_close,
    build_lobes,
    device,
    direction,
    lobe,
    numbers,
    random_material,
    rough,
    smallest_alpha,
    uniform_sphere,
)

from isonoise.scene.material.bsdf_kinds import KIND_OF_PLUGIN

SAMPLED = [(name, view) for name in LOBES for view in SEEN_FROM if "inside" not in view or name in BOTH_SIDES]
BINS, SAMPLES = 40, 2**16


def bin_masses(lobe: Lobe, wi: np.ndarray, nodes: int) -> np.ndarray:
    """Integral of the pdf over BINS x BINS bins of theta and phi, by a Gauss rule in each, where the path goes on."""
    at, weight = np.polynomial.legendre.leggauss(nodes)
    steps = (np.arange(BINS)[:, None] + 0.5 * (at + 1)).ravel() / BINS
    theta, phi = np.meshgrid(math.pi * steps, 2 * math.pi * steps, indexing="ij")
    wo = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)
    value, pdf = lobe.evaluate(wi, wo.reshape(-1, 3))
    pdf = np.where(value.any(axis=1), pdf, 0).reshape(theta.shape) * np.sin(theta)
    area = math.pi * 2 * math.pi / BINS**2 / 4
    masses = pdf.reshape(BINS, nodes, BINS, nodes) * np.outer(weight, weight)[None, :, None]
    return masses.sum(axis=(1, 3)) * area


@pytest.mark.parametrize(("name", "view"), SAMPLED)
def test_directions_follow_the_pdf(name, view):
    """Chi-square over bins of direction, those with few expected samples together: false alarms 1 % for all cases at
    once (Sidak). The mass itself, what is reflected into the surface aside, is 1 up to the 0.35 % of Walter's fit of
    Beckmann's masking, the quadrature's edges, and 5 standard deviations."""
    random = np.random.default_rng([5, SAMPLED.index((name, view))])
    z = sampling_deviate(lobe(name), LOBES[name], direction(SEEN_FROM[view]), random)
    assert z < NormalDist().inv_cdf(0.99 ** (1 / len(SAMPLED)))


@pytest.mark.long
@pytest.mark.parametrize("seed", range(60))
def test_random_materials_follow_the_pdf(seed):
    """As above; alphas from 0.15 on, not too low, a principled boundary that is one: what the bins can resolve."""
    random = np.random.default_rng([23, seed])
    material, wi = random_material(random), np.zeros(3)
    while smallest_alpha(material) < 0.15 or (
        material["type"] == "principled" and min(material.get("eta", 1.5), 1 + material.get("specular", 0.5)) < 1.1
    ):
        material = random_material(random)
    while abs(wi[2]) < 0.15:
        wi = uniform_sphere(random, 1)[0]
    if not ("dielectric" in material["type"] or material.get("spec_trans")):
        wi[2] = abs(wi[2])
    z = sampling_deviate(lobe(material), material, wi, random, nodes=24)
    assert z < NormalDist().inv_cdf(0.99 ** (1 / 60))


def sampling_deviate(lobe: Lobe, material: dict, wi: np.ndarray, random: np.random.Generator, nodes: int = 8) -> float:
    """Chi-square of directions sampled against the pdf, as a standard normal deviate; checks the mass of the pdf."""
    wo, weight, pdf, _ = lobe.sample(wi, numbers(random, SAMPLES))
    drawn = wo[(pdf > 0) & (weight.max(axis=1) > 0)]
    masses = bin_masses(lobe, wi, nodes)
    total = masses.sum()
    fit = 0.0 if "principled" in material["type"] or material.get("distribution") == "ggx" else 0.0035
    assert abs(total - len(drawn) / SAMPLES) < fit + 5e-4 + 5 * math.sqrt(0.25 / SAMPLES)
    theta, phi = np.arccos(np.clip(drawn[:, 2], -1, 1)), np.arctan2(drawn[:, 1], drawn[:, 0]) % (2 * math.pi)
    rows, columns = (theta / math.pi * BINS).astype(int), (phi / (2 * math.pi) * BINS).astype(int)
    place = np.minimum(rows, BINS - 1) * BINS + np.minimum(columns, BINS - 1)
    counts, expected = np.bincount(place, minlength=BINS**2), masses.ravel() / total * len(drawn)
    few = expected < 10
    counts = np.append(counts[~few], counts[few].sum())
    expected = np.append(expected[~few], expected[few].sum())
    if expected[-1] < 10:
        counts, expected = np.append(counts[:-2], counts[-2:].sum()), np.append(expected[:-2], expected[-2:].sum())
    assert len(expected) > 10
    chi = ((counts - expected) ** 2 / expected).sum()
    freedom = len(expected) - 1
    # Wilson and Hilferty 1931
    return ((chi / freedom) ** (1 / 3) - 1 + 2 / (9 * freedom)) / math.sqrt(2 / (9 * freedom))


@pytest.mark.parametrize("name", [*LOBES, *NARROW])
def test_weights_are_value_over_pdf(name):
    """To 1e-3: the value comes from the half vector again. Below an alpha of 0.05 it cancels, the pdf does not."""
    random = np.random.default_rng(6)
    for view, theta in SEEN_FROM.items():
        wi = direction(theta)
        wo, weight, pdf, eta = lobe(name).sample(wi, numbers(random, 4096))
        if "inside" in view and name not in BOTH_SIDES:
            assert not weight.any()
            continue
        smooth = pdf > 0
        assert smooth.sum() > 1000
        assert_close(np.linalg.norm(wo[smooth], axis=1), np.ones(smooth.sum()), 1e-6)
        value, expected = lobe(name).evaluate(wi, wo)
        ratio = value[smooth] / expected[smooth, None]
        assert_close(weight[smooth], ratio, 1e-3, 1e-5)
        if name in LOBES:
            assert_close(pdf[smooth], expected[smooth], 1e-3)
        passed = (wo[:, 2] * wi[2] < 0) & smooth
        assert (
            passed.any() == (name in BOTH_SIDES and name != "principledthin") or view == "low inside"
        )  # where all may be reflected
        index = lobe(name).index_of_refraction()
        assert (eta[smooth & ~passed] == 1).all()
        assert_close(eta[passed], np.full(passed.sum(), index if wi[2] > 0 else 1 / index), 1e-6)


def faces_away(wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
    """Whether the facet of a thin sheet that transmits wi into wo faces away from wo. Mitsuba 3 drops the others,
    although the facet of the reversed path may do so."""
    facet = wi + wo * [1, 1, -1]
    return (facet * wo).sum(axis=1) < 0


@pytest.mark.parametrize("name", LOBES)
def test_reciprocity(name):
    """f(wi, wo) = f(wo, wi) where light is reflected, f(wi, wo) / n_o^2 = f(wo, wi) / n_i^2 where it is refracted
    (Veach 1997, 5.2): to 2e-3; where a facet refracts into its own plane, Fresnel's formula lives on the root of a
    difference."""
    random = np.random.default_rng(7)
    a, b = uniform_sphere(random, 4000), uniform_sphere(random, 4000)
    grazing = (np.abs(a[:, 2]) < 0.05) | (np.abs(b[:, 2]) < 0.05)
    a, b = a[~grazing], b[~grazing]
    if name not in BOTH_SIDES:
        a[:, 2], b[:, 2] = np.abs(a[:, 2]), np.abs(b[:, 2])
    there = lobe(name).evaluate(a, b)[0] / np.abs(b[:, 2:])
    back = lobe(name).evaluate(b, a)[0] / np.abs(a[:, 2:])
    index = lobe(name).index_of_refraction()
    passes = a[:, 2] * b[:, 2] < 0
    there[passes] *= np.where(a[passes, 2:] > 0, index**2, 1)
    back[passes] *= np.where(b[passes, 2:] > 0, index**2, 1)
    assert (there > 0).sum() > 1000
    if "thin" in name:
        one_way = passes & (faces_away(a, b) != faces_away(b, a))
        assert one_way.mean() < 0.2
        there[one_way] = back[one_way] = 0
    assert_close(there, back, 2e-3, 1e-5)


EDGES = {
    **{
        f"{t} {a} {d}": rough(t, a, d)
        for t in ("roughconductor", "roughdielectric", "roughplastic")
        for a in (1e-4, 5.0)
        for d in ("ggx", "beckmann")
    },
    "stretched": rough("roughconductor", (1e-4, 1.0), **GOLD),
    "stretched beckmann": rough("roughdielectric", (1.0, 1e-4), "beckmann"),
    "all normals": rough("roughdielectric", 1e-4, sample_visible=False),
    "all normals beckmann": rough("roughconductor", 1e-4, "beckmann", sample_visible=False),
    "nearly no boundary": rough("roughdielectric", 0.2, int_ior=1.0001, ext_ior=1.0),
    "hardly any boundary all normals": rough("roughdielectric", 1.0, "beckmann", int_ior=1.0001, ext_ior=1.0),
    "dense": rough("roughdielectric", 0.3, int_ior=4.0, ext_ior=1.0),
    "dense beckmann": rough("roughdielectric", (1.0, 0.01), "beckmann", int_ior=4.0, ext_ior=1.0),
    "dense plastic": {"type": "plastic", "int_ior": 4.0, "diffuse_reflectance": 1.0},
    "dense roughplastic": rough("roughplastic", 0.3, int_ior=4.0, diffuse_reflectance=1.0, nonlinear=True),
    "hardly a coat": {"type": "plastic", "int_ior": 1.0001, "ext_ior": 1.0},
    "hardly a rough coat": rough("roughplastic", 0.5, int_ior=1.0001, ext_ior=1.0),
    "nothing": {"type": "dielectric", "int_ior": 1.0, "ext_ior": 1.0},
    "nothing thin": {"type": "thindielectric", "int_ior": 1.0, "ext_ior": 1.0},
    "dense principled": {"type": "principled", "eta": 4.0, "spec_trans": 1.0, "roughness": 0.0, "anisotropic": 1.0},
    "hardly principled": {"type": "principled", "eta": 1.0001, "spec_trans": 0.7, "roughness": 1.0},
    "mirror-like": {
        "type": "principled",
        "roughness": 0.0,
        "clearcoat": 1.0,
        "clearcoat_gloss": 1.0,
        "spec_trans": 0.5,
    },
    "black": {"type": "principled", "base_color": 0.0, "spec_tint": 1.0, "sheen": 1.0, "sheen_tint": 1.0},
    "unsampled": {
        "type": "principled",
        **{
            "main_specular_sampling_rate": 0.0,
            "diffuse_reflectance_sampling_rate": 0.0,
            "clearcoat_sampling_rate": 0.0,
        },
    },
    "unsampled thin": {
        "type": "principledthin",
        **{"diffuse_reflectance_sampling_rate": 0.0, "specular_reflectance_sampling_rate": 0.0},
    },
    "mirror-like thin": {"type": "principledthin", "roughness": 0.0, "spec_trans": 1.0, "diff_trans": 2.0, "eta": 1.0},
    "no index": {"type": "principled", "eta": 1.0, "metallic": 1.0},
    "black plastic": {"type": "plastic", "diffuse_reflectance": 0.0, "specular_reflectance": 0.0},
    "black roughplastic": {"type": "roughplastic", "diffuse_reflectance": 0.0, "specular_reflectance": 0.0},
    **LOBES,
    **DELTA,
}


@pytest.mark.parametrize("name", EDGES)
def test_edges_stay_finite(name):
    """Along the normal, 1e-5 and less above and below the horizon, with the least and largest random numbers: finite,
    no negative value, unit directions, and weights that importance sampling bounds."""
    grazing = [math.pi / 2 + s * d for s in (-1, 1) for d in (1e-3, 1e-5, 1e-7)]
    thetas = [0.0, 1e-7, 1e-4, 0.5, *grazing, 2.5, math.pi - 1e-4, math.pi]
    ends = [0.0, 2.0**-24, 1e-3, 0.25, 0.5, 0.75, 1 - 1e-3, 1 - 2.0**-23, 1 - 2.0**-24]
    directions = np.array([direction(theta, phi) for theta in thetas for phi in (0.0, 0.7, math.pi / 2)])
    directions = np.concatenate([directions, [[0, 0, 1], [0, 0, -1], [1, 0, 0], [0, -1, 0]]])
    u = np.stack(np.meshgrid(ends, ends, ends, indexing="ij"), axis=-1).reshape(-1, 3)
    wi = np.repeat(directions, len(u), axis=0)
    wo, weight, pdf, eta = lobe(EDGES[name]).sample(wi, np.tile(u, (len(directions), 1)))
    assert np.isfinite([*wo.T, *weight.T, pdf, eta]).all()
    assert (weight >= 0).all()
    goes_on = weight.max(axis=1) > 0
    assert (pdf[goes_on] != 0).all()
    assert_close(np.linalg.norm(wo[goes_on], axis=1), np.ones(goes_on.sum()), 1e-6)
    assert (eta[goes_on] > 0).all()
    if EDGES[name]["type"] in ("roughconductor", "roughdielectric") and EDGES[name].get("sample_visible", True):
        power = weight.max(axis=1) * np.where(goes_on, eta, 1) ** 2
        assert power.max() <= 1.001  # F G1(o) / F, times a reflectance
    pairs = np.repeat(directions, len(directions), axis=0), np.tile(directions, (len(directions), 1))
    value, density = lobe(EDGES[name]).evaluate(*pairs)
    assert np.isfinite(value).all()
    assert np.isfinite(density).all()
    assert (value >= 0).all()
    assert (density >= 0).all()


def test_a_turned_frame_turns_the_lobe():
    random = np.random.default_rng(9)
    frame = np.linalg.qr(random.standard_normal((3, 3)))[0]
    frame[2] *= np.linalg.det(frame)
    wi, wo, u = np.abs(uniform_sphere(random, 500)), uniform_sphere(random, 500), numbers(random, 500)
    for name in LOBES:
        straight, turned = (Lobe(build_lobes(), device(), LOBES[name], f) for f in (None, frame))
        assert_close(turned.evaluate(wi, wo)[0], straight.evaluate(wi, wo)[0], 1e-3, 1e-5)
        if "SHADING_FRAME" not in KIND_OF_PLUGIN[LOBES[name]["type"]].helpers:
            continue  # it samples in a frame of its own about the normal
        both = turned.sample(wi, u)[0], straight.sample(wi, u)[0]
        close = np.abs(both[0] - both[1]).max(axis=1) < 1e-3
        assert close.mean() > 0.99  # a choice of lobe may fall to the other side


def test_without_beckmann_ggx_is_the_same():
    """Leaving out what a scene does not use changes nothing."""
    random = np.random.default_rng(10)
    wi, u = uniform_sphere(random, 1000), numbers(random, 1000)
    fewer = build_lobes("BECKMANN", "SAMPLE_ALL_NORMALS")
    for name in ("roughconductor ggx stretched", "roughdielectric ggx", "principled all"):
        one, other = (Lobe(k, device(), LOBES[name]).sample(wi, u) for k in (build_lobes(), fewer))
        for a, b in zip(one, other, strict=True):
            assert (a == b).all()
