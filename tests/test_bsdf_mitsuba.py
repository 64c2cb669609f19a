"""BSDFs on the device against Mitsuba 3.

Statistical tests use fixed random numbers.
"""

import numpy as np
import pytest
from bsdf_lobe import (
    BOTH_SIDES,
    DELTA,
    GOLD,
    LOBES,
    NARROW,
    RED,
    assert_close,
    direction,
    lobe,
    numbers,
    random_material,
    random_thin_material,
    uniform_sphere,
)

from isonoise.scene.material.presets import conductors


def mitsuba_eval_pdf(mi, bsdf: dict, wi: np.ndarray, wo: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    material, context, si = mi.load_dict(bsdf), mi.BSDFContext(), mi.SurfaceInteraction3f()
    values, pdfs = np.zeros((len(wi), 3)), np.zeros(len(wi))
    for i, (a, b) in enumerate(zip(wi.tolist(), wo.tolist(), strict=True)):
        si.wi = a
        value, pdfs[i] = material.eval_pdf(context, si, b)
        values[i] = value
    return values, pdfs


@pytest.mark.parametrize("name", [*LOBES, *NARROW])
def test_eval_and_pdf_are_mitsubas(mitsuba, name):
    """At 16 directions, for each 24 that are uniform over the sphere and 24 that the lobe itself sends there: to 1e-3;
    where alpha is below 0.05, to 1e-3 of the largest seen for the same wi, as the half vector of two float32 directions
    has no more digits there. What is below 1e-8 is zero."""
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
        error = np.abs(ours - theirs) / np.maximum(scale, 1e-5)
        worst = np.unravel_index(error.argmax(), error.shape)[0]
        assert error.max() < 1e-3, (wi[worst], wo[worst], ours[worst], theirs[worst])


@pytest.mark.parametrize("seed", [*range(40), *(pytest.param(seed, marks=pytest.mark.long) for seed in range(40, 400))])
def test_random_materials_are_mitsubas(mitsuba, seed):
    """From all sides to all sides, a third to where the material itself sends light. To 1e-3 and 2e-6: where a facet
    refracts nearly into its own plane, both renderers live on the root of a difference. The half vector of two grazing
    directions is a difference too, which the rotation into the shading frame rounds. Where nothing is scattered the pdf
    says nothing."""
    random = np.random.default_rng([21, seed])
    material = random_material(random)
    wi, wo, n = uniform_sphere(random, 120), uniform_sphere(random, 120), np.arange(120)
    wi[n % 4 != 0, 2] = np.abs(wi[n % 4 != 0, 2])
    drawn = lobe(material).sample(wi, numbers(random, 120))[0]
    own = (n % 3 == 0) & (np.linalg.norm(drawn, axis=1) > 0.5)
    wi, wo = wi.astype(np.float32), np.where(own[:, None], drawn, wo).astype(np.float32)
    value, pdf = lobe(material).evaluate(wi, wo)
    expected, expected_pdf = mitsuba_eval_pdf(mitsuba, material, wi, wo)
    lit = expected.max(axis=1) > 0
    assert lit.sum() > 20
    grazing = 2e-5 / np.maximum(np.abs(wi[:, 2:] + wo[:, 2:]), 1e-3)
    assert_close(value, expected, 1e-3 + grazing, 2e-6)
    assert_close(pdf[lit], expected_pdf[lit], 1e-3, 2e-6)


@pytest.mark.parametrize("seed", [*range(4), *(pytest.param(seed, marks=pytest.mark.long) for seed in range(4, 60))])
def test_random_thin_materials_are_mitsubas(mitsuba, seed):
    """Values and pdfs as above. Both pick the lobe by the same number; diffuse directions and weights are the same."""
    random = np.random.default_rng([27, seed])
    material = random_thin_material(random)
    wi, wo, u = uniform_sphere(random, 120), uniform_sphere(random, 120), numbers(random, 120)
    drawn, weight, drawn_pdf, _ = lobe(material).sample(wi, u)
    wo = np.where(np.arange(120)[:, None] % 3 == 0, drawn, wo)
    wo[np.linalg.norm(wo, axis=1) < 0.5] = [0, 0, 1]
    wi, wo = wi.astype(np.float32), wo.astype(np.float32)
    value, pdf = lobe(material).evaluate(wi, wo)
    expected, expected_pdf = mitsuba_eval_pdf(mitsuba, material, wi, wo)
    grazing = 2e-5 / np.maximum(np.abs(wi[:, 2:] + wo[:, 2:]), 1e-3)
    assert_close(value, expected, 1e-3 + grazing, 2e-6)
    assert_close(pdf, expected_pdf, 1e-3 + grazing[:, 0], 2e-6)
    loaded, si = mitsuba.load_dict(material), mitsuba.SurfaceInteraction3f()
    for i in range(0, 120, 4):
        si.wi = wi[i]
        sample, expected = loaded.sample(mitsuba.BSDFContext(), si, float(u[i, 0]), u[i, 1:].tolist())
        if mitsuba.has_flag(sample.sampled_type, mitsuba.BSDFFlags.Diffuse):
            assert drawn[i] == pytest.approx(np.array(sample.wo), abs=1e-4)
            assert drawn_pdf[i] == pytest.approx(sample.pdf, rel=2e-3)
            assert weight[i] == pytest.approx(np.array(expected), rel=2e-3, abs=1e-6)
        if weight[i].any() and np.array(expected).any():
            assert drawn[i, 2] * sample.wo.z > 0


def test_every_metal_is_mitsubas(mitsuba):
    """All presets, and eta and k, at five angles; nothing from behind."""
    given = [{"material": name} for name in conductors()] + [GOLD | {"specular_reflectance": RED}]
    for material in given:
        loaded, si = mitsuba.load_dict({"type": "conductor"} | material), mitsuba.SurfaceInteraction3f()
        thetas = (0.0, 0.7, 1.2, 1.5, 1.57)
        wi = np.array([direction(theta) for theta in thetas])
        wo, weight, pdf, eta = lobe({"type": "conductor"} | material).sample(wi, np.zeros((len(wi), 3)))
        for i in range(len(thetas)):
            si.wi = wi[i]
            sample, expected = loaded.sample(mitsuba.BSDFContext(), si, 0.5, (0.5, 0.5))
            expected = np.nan_to_num(np.array(expected), nan=1.0)  # where eta and k are 0 all is reflected
            assert weight[i] == pytest.approx(expected, rel=1e-4, abs=1e-6), material
            assert wo[i] == pytest.approx(np.array(sample.wo), abs=1e-6)
        assert (pdf < 0).all()
        assert (eta == 1).all()
        assert not lobe({"type": "conductor"} | material).sample(-wi, np.zeros((len(wi), 3)))[1].any()


def test_thin_and_smooth_glass_are_mitsubas(mitsuba):
    """Share of the reflections, directions and weights, from both sides."""
    u = np.zeros((512, 3))
    u[:, 0] = np.arange(512) / 512
    tint = {"specular_reflectance": RED, "specular_transmittance": {"type": "rgb", "value": [0.2, 0.9, 0.5]}}
    glasses = [DELTA["dielectric"], DELTA["thindielectric"], {"type": "dielectric", "int_ior": "water", "ext_ior": 1.7}]
    for glass in (*glasses, DELTA["dielectric"] | tint, DELTA["thindielectric"] | tint):
        material, context, si = mitsuba.load_dict(glass), mitsuba.BSDFContext(), mitsuba.SurfaceInteraction3f()
        for theta in (0.0, 0.6, 1.5, 2.0, 3.0):
            si.wi = direction(theta)
            wo, weight, pdf, eta = lobe(glass).sample(direction(theta), u)
            for i in (0, 17, 100, 300, 511):
                expected, factor = material.sample(context, si, u[i, 0], (0.5, 0.5))
                assert wo[i] == pytest.approx(np.array(expected.wo), abs=1e-5), theta
                assert weight[i] == pytest.approx(np.array(factor), rel=1e-5)
                assert eta[i] == pytest.approx(expected.eta)
            assert (pdf < 0).all()
