"""Colours equal those of Mitsuba 3's rgb variants. The expected values were printed by Mitsuba 3.9.1, scalar_rgb."""

import numpy as np
import pytest
from records import slot

from isonoise.scene import compile_scene, load_description
from isonoise.scene.material.presets import conductors, refractive_indices
from isonoise.scene.spectra import MITSUBA_LUMINANCE, constant_to_rgb, spectrum_to_rgb

# Mitsuba computes in float32 and prints six digits; the error of 1000 terms is about 1e-6.
TOLERANCE = {"rtol": 5e-6, "atol": 2e-6}

RADIANCE = [
    ([(400, 1), (700, 1)], (1.19969, 0.94952, 0.903443)),
    ([(400, 0), (500, 8), (600, 15.6), (700, 18.4)], (20.7108, 10.8546, 2.77115)),
    ([(500, 1), (510, 1), (520, 0), (600, 2)], (0.80558, 0.766031, 0.0)),
    ([(300, 1), (900, 1)], (1.20488, 0.948228, 0.909267)),
    ([(300, 1), (900, 5)], (3.89754, 2.48891, 1.74247)),
    ([(800, 1), (900, 1)], (3.2346e-06, 0.0, 0.0)),
]
REFLECTANCE = [
    ([(400, 0.5), (700, 0.5)], (0.497671, 0.499878, 0.497455)),
    ([(400, 1), (700, 1)], (0.995342, 0.999756, 0.994909)),
    ([(400, 0.04), (500, 0.5), (600, 0.6), (700, 0.2)], (0.524288, 0.564623, 0.254397)),
    ([(500, 1), (510, 1), (520, 0), (600, 0.2)], (0.0, 0.197084, 0.00640501)),
    ([(300, 0), (900, 1)], (0.57013, 0.404543, 0.234434)),
    ([(600, 1), (601, 1)], (0.0198287, 0.00112661, 0.0)),
    ([(400, 1), (900, 2)], (1.0, 1.0, 1.0)),
]
UNBOUNDED = [
    ([(400, 0.5), (700, 1.5)], (1.30182, 0.976334, 0.633497)),
    ([(300, 5), (900, 3)], (3.85467, 4.18528, 4.52514)),
]
CASES = [
    (k, *c) for k, t in (("radiance", RADIANCE), ("reflectance", REFLECTANCE), ("unbounded", UNBOUNDED)) for c in t
]


@pytest.mark.parametrize(("kind", "pairs", "expected"), CASES)
def test_spectrum_to_rgb_agrees_with_mitsuba(kind, pairs, expected):
    np.testing.assert_allclose(spectrum_to_rgb(*np.transpose(pairs), kind), expected, **TOLERANCE)


def test_constant_spectra():
    np.testing.assert_allclose(constant_to_rgb(2.5, "radiance"), (3.01198, 2.37073, 2.27229), **TOLERANCE)
    assert constant_to_rgb(0.3, "reflectance").tolist() == [0.3, 0.3, 0.3]
    assert constant_to_rgb(1.0, "radiance") @ MITSUBA_LUMINANCE == pytest.approx(1.0, abs=1e-5)  # Y of equal energy


EMISSIONS = [
    ('<rgb name="radiance" value="0.5"/>', (0.5, 0.5, 0.5)),
    ('<rgb name="radiance" value="1 2 3"/>', (1, 2, 3)),
    ('<rgb name="radiance" value="1, 2, 3"/>', (1, 2, 3)),
    ('<float name="radiance" value="2"/>', (2, 2, 2)),
    ('<integer name="radiance" value="2"/>', (2, 2, 2)),
    ('<spectrum name="radiance" value="1.0"/>', (1.20479, 0.948291, 0.908916)),
    ('<spectrum name="radiance" value="400:0, 500:8, 600:15.6, 700:18.4"/>', (20.7108, 10.8546, 2.77115)),
    ("", (1, 1, 1)),
]


@pytest.mark.parametrize(("xml", "expected"), EMISSIONS)
def test_emission_of_a_scene(xml, expected, scene_of):
    scene = compile_scene(scene_of(f'<shape type="sphere"><emitter type="area">{xml}</emitter></shape>'))
    np.testing.assert_allclose(scene.lights["radiance"][0] / scene.radiance_scale, expected, **TOLERANCE)


@pytest.mark.parametrize("kind", ["point", "directional", "constant"])
def test_every_emitter_converts_its_spectrum_as_emission(kind):
    name = {"point": "intensity", "directional": "irradiance", "constant": "radiance"}[kind]
    emitter = {"type": kind, name: {"type": "spectrum", "value": [(400, 1.0), (700, 1.0)]}}
    scene = compile_scene(load_description({"type": "scene", "sensor": {"type": "perspective"}, "light": emitter}))
    np.testing.assert_allclose(scene.lights["radiance"][0] / scene.radiance_scale, RADIANCE[0][1], **TOLERANCE)


def test_conductors_by_name():
    # Mitsuba 3.9.1: traverse(load_dict({'type': 'conductor', 'material': ...}))
    for name, eta, k in (
        ("Al", (1.6575, 0.880405, 0.521244), (9.22381, 6.2695, 4.837)),
        ("Cu", (0.201005, 0.92375, 1.10222), (3.91326, 2.45305, 2.14209)),
        ("none", (0, 0, 0), (1, 1, 1)),
    ):
        np.testing.assert_allclose(conductors()[name], (eta, k), **TOLERANCE)


def test_conductor_defaults(scene_of):
    def eta_and_k(xml):
        shape = f'<shape type="sphere"><bsdf type="conductor">{xml}</bsdf></shape>'
        bsdfs = compile_scene(scene_of(shape)).bsdfs
        return slot(bsdfs, "eta")[0], slot(bsdfs, "k")[0]

    eta, k = eta_and_k("")
    assert eta.tolist() == [0, 0, 0]
    assert k.tolist() == [1, 1, 1]
    eta, k = eta_and_k('<float name="eta" value="1.5"/>')
    assert eta.tolist() == [1.5, 1.5, 1.5]
    assert k.tolist() == [1, 1, 1]
    eta, k = eta_and_k('<spectrum name="eta" value="400:0.5, 700:1.5"/><spectrum name="k" value="6.15"/>')
    np.testing.assert_allclose(eta, UNBOUNDED[0][1], **TOLERANCE)
    np.testing.assert_allclose(k, 6.15, rtol=1e-7)


def test_dielectric_indices(scene_of):
    def eta(xml):
        shape = f'<shape type="sphere"><bsdf type="dielectric">{xml}</bsdf></shape>'
        return float(slot(compile_scene(scene_of(shape)).bsdfs, "ior")[0, 0])

    assert eta("") == pytest.approx(1.504183292388916, rel=1e-7)  # Mitsuba 3.9.1
    assert eta('<float name="int_ior" value="1.0"/>') == pytest.approx(0.9997230172157288, rel=1e-7)
    diamond = '<string name="int_ior" value="Diamond"/><string name="ext_ior" value="vacuum"/>'
    assert eta(diamond) == pytest.approx(2.419, rel=1e-7)
    assert refractive_indices()["water ice"] == 1.31


def test_named_materials_agree_with_mitsuba(mitsuba):
    for name, expected in conductors().items():
        values = mitsuba.traverse(mitsuba.load_dict({"type": "conductor", "material": name}))
        theirs = [np.broadcast_to(np.array(values[key]), 3) for key in ("eta.value", "k.value")]
        np.testing.assert_allclose(expected, theirs, rtol=2e-6, atol=1e-9, err_msg=name)
    for name, expected in refractive_indices().items():
        values = mitsuba.traverse(mitsuba.load_dict({"type": "dielectric", "int_ior": name, "ext_ior": "vacuum"}))
        assert float(values["eta"]) == pytest.approx(expected, rel=1e-7), name
