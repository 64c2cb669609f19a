"""Phase functions on the device against closed forms, a chi-square test and Mitsuba."""

import math

import numpy as np
import pytest
from bsdf_lobe import KERNEL, Lobe, numbers, uniform_sphere
from kernel_build import build_kernels
from media_scenes import henyey_greenstein

from isonoise.device.opencl import Device
from isonoise.scene.material.bsdfs import Bsdfs
from isonoise.scene.material.rough_transmittance import NODES


class Phase(Lobe):
    """A phase function on the device; directions are in world space."""

    def __init__(self, kernels, device: Device, g: float, lit: bool = True):
        self.device, self.kernels, self.frame = device, kernels, np.eye(3)
        bsdfs = Bsdfs(lambda texture, kind: pytest.fail("no textures here"))
        bsdfs.phase({"type": "hg", "g": g}, lit)
        arrays = bsdfs.records, np.zeros(NODES, np.float32), self.frame.astype(np.float32)
        self.buffers = tuple(device.buffer(array, "the phase function") for array in arrays)


@pytest.fixture(scope="module")
def phase():
    device = Device()
    kernels = build_kernels(device, KERNEL, ("MEDIA", "VOLPATH", "NEXT_EVENT"))
    return lambda g, lit=True: Phase(kernels, device, g, lit)


ANISOTROPIES = (0.0, 0.3, -0.7, 0.95, -0.999, 0.9999)


@pytest.mark.parametrize("g", ANISOTROPIES)
def test_phase_function_is_henyey_and_greensteins(phase, g):
    """To 2e-5, at uniform and at sampled directions. If 1 - |g| is 1e-4 these are within 1e-4 of the axis, and the
    rounding of their components is 1e-3 of that."""
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
    """Directions along the axes, the smallest and largest random numbers, and |g| nearly 1."""
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
    """For next-event estimation: its value is 0, and its sampled directions have the pdf of a delta function."""
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
