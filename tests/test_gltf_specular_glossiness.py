"""KHR_materials_pbrSpecularGlossiness: the conversion is exact for grey metals and dielectrics."""

import numpy as np
import pytest
from gltf_files import read_file, shapes_of
from gltf_material_files import MaterialFile, warnings_of

from isonoise.scene.spectra import srgb_to_linear

EXTENSION = "KHR_materials_pbrSpecularGlossiness"


def principled(file: MaterialFile, folder) -> dict:
    scene, report = read_file(file, folder)
    assert [text for text in report.warnings() if "converted to metallic and roughness" not in text] == []
    (shape,) = shapes_of(scene)
    return shape["bsdf"]["bsdf"]


@pytest.mark.parametrize("metallic", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("base", [0.1, 0.8])
def test_factors(base, metallic, tmp_path):
    """Specular and diffuse colours of the metallic-roughness model give its factors again."""
    specular = 0.04 * (1 - metallic) + base * metallic
    diffuse = base * 0.96 * (1 - metallic) / (1 - specular)
    values = {"diffuseFactor": [diffuse] * 3 + [1], "specularFactor": [specular] * 3, "glossinessFactor": 0.75}
    bsdf = principled(MaterialFile({"extensions": {EXTENSION: values}}), tmp_path)
    assert bsdf["metallic"] == pytest.approx(metallic, abs=1e-6)
    assert bsdf["roughness"] == pytest.approx(0.25)
    np.testing.assert_allclose(bsdf["base_color"]["value"], [base] * 3, rtol=1e-5)


def test_textures(tmp_path):
    """Texel by texel; the smaller image is repeated."""
    diffuse = np.array([[[0, 0, 0], [128, 128, 128]]] * 2, np.uint8)
    specular = np.full((4, 2, 4), 56, np.uint8)  # sRGB of 0.04
    specular[:, 0, :3], specular[..., 3] = (255, 200, 100), [[255, 51], [0, 102]] * 2
    values = {"diffuseTexture": {"index": 0}, "specularGlossinessTexture": {"index": 1}}
    bsdf = principled(MaterialFile({"extensions": {EXTENSION: values}}, diffuse, specular), tmp_path)
    colours = bsdf["base_color"]["bitmap"].linear()
    np.testing.assert_allclose(colours[:, 0], [srgb_to_linear(np.array([1, 200 / 255, 100 / 255]))] * 4, rtol=1e-5)
    np.testing.assert_allclose(colours[:, 1], srgb_to_linear(128 / 255), rtol=2e-3)
    np.testing.assert_allclose(bsdf["metallic"]["bitmap"].linear(raw=True)[..., 0], [[1, 0]] * 4, atol=2e-3)
    roughness = bsdf["roughness"]["bitmap"].linear(raw=True)[..., 0]
    np.testing.assert_allclose(roughness, [[0, 0.8], [1, 0.6]] * 2, atol=1e-6)


def test_textures_with_other_coordinates_are_reported(tmp_path):
    values = {"diffuseTexture": {"index": 0}, "specularGlossinessTexture": {"index": 1, "texCoord": 1}}
    image = np.full((2, 2, 3), 128, np.uint8)
    file = MaterialFile({"extensions": {EXTENSION: values}}, image, image)
    assert "the coordinates of one" in warnings_of(file, tmp_path)


def test_a_metallic_roughness_model_goes_first(tmp_path):
    """It is the exporter's own fallback."""
    material = {"pbrMetallicRoughness": {"metallicFactor": 0.5}, "extensions": {EXTENSION: {}}}
    assert principled(MaterialFile(material), tmp_path)["metallic"] == 0.5
    assert read_file(MaterialFile(material), tmp_path)[1].warnings() == []
