"""glTF: energy of the lobes that clearcoat and sheen become, against closed forms and quadrature."""

import numpy as np
import pytest
from bsdf_lobe import direction, lobe
from gltf_files import read_file, shapes_of
from gltf_material_files import MaterialFile, extended, inside, pbr
from test_bsdf_energy import furnace

from isonoise.scene.formats.gltf.layers import _SHEEN_ALBEDO, COAT_ALBEDO


def quadrature(low: float, high: float, count: int) -> tuple[np.ndarray, np.ndarray]:
    nodes, weights = np.polynomial.legendre.leggauss(count)
    return low + 0.5 * (high - low) * (nodes + 1), 0.5 * (high - low) * weights


def fresnel(cosine: np.ndarray, eta: float) -> np.ndarray:
    refracted = np.sqrt(1 - (1 - cosine**2) / eta**2)
    parallel, perpendicular = (
        (eta * cosine - refracted) / (eta * cosine + refracted),
        (cosine - eta * refracted) / (cosine + eta * refracted),
    )
    return 0.5 * (parallel**2 + perpendicular**2)


def bsdf_of(material: dict, folder) -> dict:
    (shape,) = shapes_of(read_file(MaterialFile(material), folder)[0])
    return shape["bsdf"]


def albedo(bsdf: dict, cosine: float) -> np.ndarray:
    """Of a blend of materials, seen at an angle."""
    if bsdf["type"] == "blendbsdf":
        first, second = (albedo(bsdf[key], cosine) for key in ("bsdf", "bsdf_1"))
        return (1 - bsdf["weight"]) * first + bsdf["weight"] * second
    return furnace(lobe(inside(bsdf, "twosided")), direction(np.arccos(cosine)))


def mean_albedo(bsdf: dict) -> float:
    """Over all directions, cosine-weighted; the largest channel."""
    pairs = zip(*quadrature(0, 1, 12), strict=True)
    return max(sum(2 * cosine * weight * albedo(bsdf, cosine) for cosine, weight in pairs))


def test_sheen_albedos():
    """The table is the mean of the Charlie distribution times Ashikhmin's visibility."""
    (view, view_weights), (light, light_weights) = quadrature(0, 1, 100), quadrature(0, 1, 100)
    angle, angle_weights = quadrature(0, np.pi, 48)
    i, o, phi = np.ix_(view, light, angle)
    sin_i, sin_o = np.sqrt(1 - i**2), np.sqrt(1 - o**2)
    half = np.stack(np.broadcast_arrays(sin_i + sin_o * np.cos(phi), sin_o * np.sin(phi), i + o))
    sin_h = np.sqrt(1 - (half[2] / np.linalg.norm(half, axis=0)) ** 2)
    weights = 2 * view * view_weights  # cosine-weighted mean over the view
    for number, expected in enumerate(_SHEEN_ALBEDO):
        if number:
            inverse = 100.0 / number**2
            density = (2 + inverse) * sin_h**inverse / (2 * np.pi)
            lobe_values = density / (4 * (o + i - o * i)) * o
            mean = np.einsum("iop,i,o,p", lobe_values, weights, light_weights, 2 * angle_weights)
            assert mean == pytest.approx(expected, abs=0.002)


@pytest.mark.long
def test_the_cloth_lobe_of_sheen_neither_gains_nor_loses(tmp_path):
    """Its mean albedo over all directions is 1, and the weight is what the sheen takes from the base."""
    sheen = {"sheenColorFactor": [1, 1, 1], "sheenRoughnessFactor": 0.5}
    bsdf = bsdf_of(extended("sheen", sheen), tmp_path)
    assert bsdf["weight"] == pytest.approx(_SHEEN_ALBEDO[5])
    cosines, weights = quadrature(0, 1, 12)
    mean = sum(
        2 * cosine * weight * albedo(bsdf["bsdf_1"], cosine) for cosine, weight in zip(cosines, weights, strict=False)
    )
    np.testing.assert_allclose(mean, 1.0, atol=0.005)


@pytest.mark.long
@pytest.mark.parametrize("factor", [0.3, 1.0])
def test_clearcoat_on_black_dielectrics(tmp_path, factor):
    """Without a diffuse base, the albedo is Fresnel's formula of the lobes: nothing else reflects."""
    coat = {"clearcoatFactor": factor, "clearcoatRoughnessFactor": 0.0}
    black = pbr(metallicFactor=0, roughnessFactor=0.1, baseColorFactor=[0, 0, 0, 1])
    bsdf = bsdf_of(extended("clearcoat", coat, black), tmp_path)
    etas = [(1 + root) / (1 - root) for root in np.sqrt([0.04, 2 * 0.96 * 0.04, 2 * 0.04])]
    for cosine in (1.0, 0.7, 0.3):
        plain, below, above = (fresnel(cosine, eta) for eta in etas)
        expected = (1 - factor) * plain + factor * 0.5 * (below + above)
        np.testing.assert_allclose(albedo(bsdf, cosine), expected, rtol=0.02, atol=5e-4)


@pytest.mark.long
@pytest.mark.parametrize("factor", [0.3, 1.0])
def test_clearcoat_on_metals(tmp_path, factor):
    """At normal incidence 4 % of the light are reflected, and no more of it than before reaches a white metal."""
    coat = {"clearcoatFactor": factor, "clearcoatRoughnessFactor": 0.0}
    for colour in (0.0, 1.0):
        metal = pbr(roughnessFactor=0.05, baseColorFactor=[colour] * 3 + [1])
        bsdf = bsdf_of(extended("clearcoat", coat, metal), tmp_path)
        for cosine in (1.0, 0.7, 0.3):
            grazing = (1 - cosine) ** 5
            base = colour + (1 - colour) * grazing
            lobe_albedo = factor * (0.04 + (COAT_ALBEDO - 0.04) * grazing)
            expected = (1 - factor * COAT_ALBEDO) * base + lobe_albedo
            np.testing.assert_allclose(albedo(bsdf, cosine), expected, rtol=0.01, atol=5e-4)
            assert expected <= 1


@pytest.mark.long
def test_layers_over_white_gain_no_energy(tmp_path):
    """Mean albedo over all directions. That of the white base itself may exceed 1: `principled` gains up to 7 %."""
    layers = {
        "clearcoat": {"clearcoatFactor": 1, "clearcoatRoughnessFactor": 0.3},
        "sheen": {"sheenColorFactor": [1, 1, 1], "sheenRoughnessFactor": 0.5},
    }
    for name, values in layers.items():
        for metallic in (0, 1):
            white = pbr(metallicFactor=metallic, roughnessFactor=0.5)
            base, layered = (mean_albedo(bsdf_of(m, tmp_path)) for m in (white, extended(name, values, white)))
            assert layered <= max(base, 1.0) + 0.002, (name, metallic)
            assert layered > 0.95 * base, (name, metallic)
