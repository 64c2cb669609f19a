"""glTF: what the extensions KHR_materials_* become in Mitsuba 3's vocabulary. Nothing is rendered."""

import math

import numpy as np
import pytest
from gltf_files import read_file, shapes_of
from gltf_material_files import (
    ALPHA,
    COLOURS,
    RGBA,
    WHITE,
    MaterialFile,
    extended,
    inside,
    linear,
    pbr,
    rich_material_file,
    warnings_of,
)

import isonoise
from isonoise.scene.formats.gltf.layers import COAT_ALBEDO


def test_specular(tmp_path):
    assert inside(MaterialFile(extended("ior", {"ior": 1.33})).bsdf(tmp_path), "twosided")["eta"] == 1.33
    blend = MaterialFile(extended("specular", {"specularFactor": 0.3})).bsdf(tmp_path)
    assert blend["weight"] == 0.3
    assert [inside(blend[key], "twosided")["eta"] for key in ("bsdf", "bsdf_1")] == [1.0, 1.5]
    assert inside(MaterialFile(extended("specular", {"specularFactor": 0})).bsdf(tmp_path), "twosided")["eta"] == 1.0
    textured = extended("specular", {"specularTexture": {"index": 0}})
    np.testing.assert_array_equal(MaterialFile(textured, RGBA).bsdf(tmp_path)["weight"]["bitmap"].pixels, ALPHA)
    twice = inside(MaterialFile(extended("specular", {"specularColorFactor": [2, 2, 2]})).bsdf(tmp_path), "twosided")
    eta = twice["eta"]
    assert ((eta - 1) / (eta + 1)) ** 2 == pytest.approx(0.08)
    red = MaterialFile(extended("specular", {"specularColorFactor": [1, 0, 0]}))
    assert "has no colour" in warnings_of(red, tmp_path)
    metal = MaterialFile(extended("specular", {"specularFactor": 0.3}, {})).bsdf(tmp_path)
    assert metal["type"] == "twosided"  # a metal has no dielectric reflection


def test_thin_transmission(tmp_path):
    glass = extended("transmission", {"transmissionFactor": 1}, pbr(metallicFactor=0, roughnessFactor=0))
    bsdf = MaterialFile(glass).bsdf(tmp_path)
    assert bsdf == {"type": "thindielectric", "int_ior": 1.5, "ext_ior": 1.0, "specular_transmittance": WHITE}
    rough = extended("transmission", {"transmissionFactor": 0.25}, pbr(metallicFactor=0, roughnessFactor=0.5))
    blend = MaterialFile(rough).bsdf(tmp_path)
    assert blend["weight"] == 0.25
    assert inside(blend["bsdf"], "twosided")["metallic"] == 0.0
    thin = blend["bsdf_1"]
    assert (thin["type"], thin["spec_trans"], thin["roughness"]) == ("principledthin", 1.0, 0.5)
    textured = pbr(metallicRoughnessTexture={"index": 0})
    textured = extended("transmission", {"transmissionFactor": 1, "transmissionTexture": {"index": 0}}, textured)
    bsdf = MaterialFile(textured, COLOURS).bsdf(tmp_path)
    np.testing.assert_array_equal(bsdf["weight"]["bitmap"].pixels, COLOURS[..., 2:])
    np.testing.assert_array_equal(bsdf["bsdf"]["weight"]["bitmap"].pixels, COLOURS[..., :1])
    assert inside(bsdf["bsdf_1"], "twosided")["metallic"] == 1.0
    assert MaterialFile(extended("transmission", {"transmissionFactor": 1}, {})).bsdf(tmp_path)["type"] == "twosided"


def test_volume(tmp_path):
    """exp(-sigma_t d) is the attenuation colour at the attenuation distance d."""
    volume = {"thicknessFactor": 0.1, "attenuationDistance": 0.5, "attenuationColor": [0.5, 0.25, 1]}
    material = pbr(metallicFactor=0, roughnessFactor=0, baseColorFactor=[0.25, 1, 1, 1])
    material |= {
        "extensions": {
            "KHR_materials_transmission": {"transmissionFactor": 1},
            "KHR_materials_volume": volume,
            "KHR_materials_ior": {"ior": 1.33},
        }
    }
    shape = MaterialFile(material).shape(tmp_path)
    assert shape["bsdf"]["type"] == "dielectric"
    assert shape["bsdf"]["int_ior"] == 1.33
    assert shape["bsdf"]["specular_transmittance"]["value"] == [0.5, 1.0, 1.0]
    assert shape["interior"]["albedo"] == 0.0
    medium = shape["interior"]
    assert max(medium["sigma_t"]["value"]) == 1.0  # Mitsuba 3 takes no more
    transmittance = np.exp(-0.5 * medium["scale"] * np.array(medium["sigma_t"]["value"]))
    np.testing.assert_allclose(transmittance, [0.5, 0.25, 1])
    material["pbrMetallicRoughness"]["roughnessFactor"] = 0.5
    rough = MaterialFile(material).bsdf(tmp_path)
    assert (rough["type"], rough["spec_trans"], rough["eta"]) == ("principled", 1.0, 1.33)
    volume |= {"attenuationColor": [1, 1, 1]}
    assert "interior" not in MaterialFile(material).shape(tmp_path)
    volume |= {"attenuationColor": [0, 0, 0], "thicknessFactor": 0}
    thin = MaterialFile(material).shape(tmp_path)
    assert thin["bsdf"]["type"] == "principledthin"
    assert "interior" not in thin


def test_clearcoat(tmp_path):
    """The weight is the coat's mean reflectance; times the reflectance of its lobe it is 4 % at normal incidence."""
    coat = {"clearcoatFactor": 0.5, "clearcoatRoughnessFactor": 0.1, "clearcoatNormalTexture": {"index": 0}}
    scene, report = read_file(MaterialFile(extended("clearcoat", coat), COLOURS), tmp_path)
    assert "clearcoat of materials[0]" in report.warnings()[0]
    (shape,) = shapes_of(scene)
    bsdf = shape["bsdf"]
    assert bsdf["weight"] == pytest.approx(0.5 * COAT_ALBEDO)
    assert inside(bsdf["bsdf"], "twosided")["roughness"] == 1.0
    lobe = inside(bsdf["bsdf_1"], "normalmap", "twosided")
    assert (lobe["metallic"], lobe["roughness"]) == (1.0, 0.1)
    assert lobe["base_color"] * bsdf["weight"] == pytest.approx(0.5 * 0.04)
    assert MaterialFile(extended("clearcoat", {"clearcoatFactor": 0})).bsdf(tmp_path)["type"] == "twosided"


def test_clearcoat_of_dielectrics(tmp_path):
    """Base and coat with half of the weight each reflect twice as much."""
    coat = {"clearcoatFactor": 0.5, "clearcoatRoughnessFactor": 0.1}
    bsdf = MaterialFile(extended("clearcoat", coat, pbr(metallicFactor=0, roughnessFactor=0.6))).bsdf(tmp_path)
    assert bsdf["weight"] == 0.5
    assert inside(bsdf["bsdf"], "twosided")["eta"] == 1.5
    coated = bsdf["bsdf_1"]
    assert (coated["type"], coated["weight"]) == ("blendbsdf", 0.5)
    base, lobe = (inside(coated[key], "twosided") for key in ("bsdf", "bsdf_1"))
    reflectances = [((one["eta"] - 1) / (one["eta"] + 1)) ** 2 for one in (base, lobe)]
    np.testing.assert_allclose(reflectances, [2 * 0.96 * 0.04, 2 * 0.04])
    assert (base["roughness"], lobe["roughness"]) == (0.6, 0.1)


def test_sheen(tmp_path):
    sheen = {"sheenColorFactor": [0.5, 0.25, 0], "sheenRoughnessFactor": 0.5}
    scene, report = read_file(MaterialFile(extended("sheen", sheen)), tmp_path)
    assert "sheen of materials[0]" in report.warnings()[0]
    bsdf = shapes_of(scene)[0]["bsdf"]
    cloth = inside(bsdf["bsdf_1"], "twosided")
    colour = bsdf["weight"] * np.array(cloth["base_color"]["value"])
    np.testing.assert_allclose(colour / colour[0], [1, 0.5, 0])
    textured = extended("sheen", sheen | {"sheenColorTexture": {"index": 0}})
    bsdf = shapes_of(read_file(MaterialFile(textured, COLOURS), tmp_path)[0])[0]["bsdf"]
    product = bsdf["weight"]["bitmap"].linear() * inside(bsdf["bsdf_1"], "twosided")["base_color"]["bitmap"].linear()
    expected = linear(COLOURS) * [0.5, 0.25, 0]
    np.testing.assert_allclose(product / product.max(), expected / expected.max(), atol=1e-6)
    rough = extended("sheen", sheen | {"sheenRoughnessTexture": {"index": 0}})
    assert "the mean of the texture of its roughness" in warnings_of(MaterialFile(rough, RGBA), tmp_path)


def test_anisotropy(tmp_path):
    """alpha along the tangent is alpha + (1 - alpha) strength^2, across it alpha."""
    material = extended("anisotropy", {"anisotropyStrength": 0.5}, pbr(roughnessFactor=0.7))
    principled = inside(MaterialFile(material).bsdf(tmp_path), "twosided")
    aspect = math.sqrt(1 - 0.9 * principled["anisotropic"])
    assert principled["roughness"] ** 2 * aspect == pytest.approx(0.49)
    assert principled["roughness"] ** 2 / aspect == pytest.approx(0.49 + 0.51 * 0.25)
    strong = extended("anisotropy", {"anisotropyStrength": 1}, pbr(roughnessFactor=0.1))
    assert "at least a tenth" in warnings_of(MaterialFile(strong), tmp_path)
    tiny = extended("anisotropy", {"anisotropyStrength": 1e-200}, pbr(roughnessFactor=0.0))
    assert "anisotropic" not in inside(MaterialFile(tiny).bsdf(tmp_path), "twosided")


def test_unlit(tmp_path):
    material = extended("unlit", {}, pbr(baseColorTexture={"index": 0}))
    scene, report = read_file(MaterialFile(material, COLOURS), tmp_path)
    assert "also light what is around them" in report.warnings()[0]
    (shape,) = shapes_of(scene)
    assert shape["bsdf"]["reflectance"]["value"] == [0.0, 0.0, 0.0]
    np.testing.assert_array_equal(shape["emitter"]["radiance"]["bitmap"].pixels, COLOURS)


@pytest.mark.parametrize(
    ("extension", "values", "feature"),
    [
        ("iridescence", {"iridescenceFactor": 1}, "iridescence"),
        ("dispersion", {"dispersion": 0.1}, "dispersion"),
        ("diffuse_transmission", {"diffuseTransmissionFactor": 0.5}, "transmission"),
    ],
)
def test_extensions_that_lose_something(tmp_path, extension, values, feature):
    material = extended(extension, values)
    assert feature in warnings_of(MaterialFile(material), tmp_path)
    inactive = extended(extension, dict.fromkeys(values, 0))
    assert MaterialFile(inactive).bsdf(tmp_path)["type"] == "twosided"


def test_every_mapping_is_a_valid_scene(tmp_path):
    """Normalisation accepts what the materials become, and equal surfaces stay one object."""
    scene, _ = read_file(rich_material_file(), tmp_path)
    first, second, third, _ = shapes_of(scene)
    assert second["bsdf"] is third["bsdf"]
    assert first["bsdf"]["type"] == "mask"
    with pytest.warns(UserWarning, match=r"a\.glb"):
        description = isonoise.load(tmp_path / "a.glb")
    assert description["integrator"]["type"] == "volpath"  # for masks and media
    assert sum(value["type"] == "mesh" for name, value in description.items() if name != "type") == 4
