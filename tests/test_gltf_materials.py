"""glTF: what the metallic-roughness model becomes in Mitsuba 3's vocabulary. Nothing is rendered."""

import math

import numpy as np
import pytest
from gltf_files import read_file, shapes_of
from gltf_material_files import (
    ALPHA,
    COLOURS,
    RGBA,
    RNG,
    UVS,
    WHITE,
    MaterialFile,
    extended,
    inside,
    linear,
    pbr,
    warnings_of,
)

from isonoise.errors import SceneError
from isonoise.scene.formats.gltf.primitives import Geometry, is_closed


def test_metallic_roughness(tmp_path):
    """Without a material everything has its default: a white, rough metal."""
    file = MaterialFile({})
    del file.content["meshes"][0]["primitives"][0]["material"]
    white = {"type": "principled", "base_color": WHITE, "metallic": 1.0, "roughness": 1.0, "eta": 1.5}
    assert inside(file.bsdf(tmp_path), "twosided") == white
    material = pbr(baseColorFactor=[0.5, 0.25, 0.1, 0.7], metallicFactor=0.3, roughnessFactor=0.2)
    principled = inside(MaterialFile(material).bsdf(tmp_path), "twosided")
    assert principled["base_color"]["value"] == [0.5, 0.25, 0.1]
    assert (principled["metallic"], principled["roughness"]) == (0.3, 0.2)


def test_textures_of_metallic_roughness(tmp_path):
    """Base colour in sRGB; metal is the blue and roughness the green channel of a linear image."""
    material = pbr(baseColorTexture={"index": 0}, metallicRoughnessTexture={"index": 1}, roughnessFactor=0.5)
    principled = inside(MaterialFile(material, COLOURS, COLOURS[::-1]).bsdf(tmp_path), "twosided")
    base, metallic, roughness = (principled[name] for name in ("base_color", "metallic", "roughness"))
    np.testing.assert_array_equal(base["bitmap"].pixels, COLOURS)
    assert (base["raw"], base["wrap_mode"], base["filter_type"]) == (False, "repeat", "bilinear")
    np.testing.assert_array_equal(metallic["bitmap"].pixels, COLOURS[::-1, :, 2:])
    np.testing.assert_allclose(roughness["bitmap"].linear(), COLOURS[::-1, :, 1:2] / 510, rtol=1e-6)
    assert metallic["raw"]
    assert roughness["raw"]


def test_a_texture_of_one_colour_is_a_colour(tmp_path):
    material = pbr(baseColorTexture={"index": 0}, baseColorFactor=[0.5, 1, 1, 1], metallicFactor=0)
    principled = inside(MaterialFile(material, np.full((2, 2, 3), 255, np.uint8)).bsdf(tmp_path), "twosided")
    assert principled["base_color"]["value"] == [0.5, 1.0, 1.0]


def test_samplers_and_transforms(tmp_path):
    transform = {"offset": [0.1, 0.2], "rotation": 0.5, "scale": [2, 3]}
    texture = {"index": 0, "extensions": {"KHR_texture_transform": transform}}
    sampler = {"wrapS": 33071, "wrapT": 33071, "magFilter": 9728}
    file = MaterialFile(pbr(baseColorTexture=texture), COLOURS, sampler=sampler)
    base = inside(file.bsdf(tmp_path), "twosided")["base_color"]
    assert (base["wrap_mode"], base["filter_type"]) == ("clamp", "nearest")
    cos, sin = math.cos(0.5), math.sin(0.5)  # counter-clockwise in the image, whose v points down
    expected = [[2 * cos, 3 * sin, 0.1], [-2 * sin, 3 * cos, 0.2]]
    np.testing.assert_allclose(base["to_uv"][:2][:, [0, 1, 3]], expected, rtol=1e-6)


def test_mixed_wrap_modes(tmp_path):
    file = MaterialFile(pbr(baseColorTexture={"index": 0}), COLOURS, sampler={"wrapS": 33071, "wrapT": 33648})
    base = inside(file.bsdf(tmp_path), "twosided")["base_color"]
    assert (base["bitmap"].pixels.shape, base["wrap_mode"]) == ((8, 6, 3), "repeat")
    far = MaterialFile(
        pbr(baseColorTexture={"index": 0}), COLOURS, sampler={"wrapS": 33071}, TEXCOORD_0=UVS * np.float32(90)
    )
    assert "clamping along one axis" in warnings_of(far, tmp_path)


def test_sets_of_texture_coordinates(tmp_path):
    """A mesh keeps the coordinates of the base colour. Of a texture with others, the mean is used."""
    material = pbr(baseColorTexture={"index": 0, "texCoord": 1}, metallicFactor=0)
    file = MaterialFile(material, COLOURS, COLOURS, TEXCOORD_1=UVS * np.float32(0.5))
    np.testing.assert_array_equal(file.shape(tmp_path)["texcoords"].max(), 0.5)
    material["emissiveTexture"], material["emissiveFactor"] = {"index": 1}, [1, 1, 1]
    file = MaterialFile(material, COLOURS, COLOURS, TEXCOORD_1=UVS)
    scene, report = read_file(file, tmp_path)
    assert "several sets of texture coordinates of materials[0].emissiveTexture" in report.warnings()[0]
    (shape,) = shapes_of(scene)
    mean = shape["emitter"]["radiance"]["value"]
    np.testing.assert_allclose(mean, linear(COLOURS).mean(axis=(0, 1)), rtol=1e-6)
    assert "TEXCOORD_3 is missing" in warnings_of(
        MaterialFile(pbr(baseColorTexture={"index": 0, "texCoord": 3}), COLOURS), tmp_path
    )


@pytest.mark.parametrize("factor", [1.0, 0.5])
def test_vertex_colours(tmp_path, factor):
    colours = RNG.random((4, 3)).astype("f4")
    material = pbr(baseColorFactor=[factor, 1, 0.5, 1], metallicFactor=0)
    shape = MaterialFile(material, COLOR_0=colours).shape(tmp_path)
    base = inside(shape["bsdf"], "twosided")["base_color"]
    assert base == {"type": "mesh_attribute", "name": "vertex_color"}
    np.testing.assert_allclose(shape["attributes"]["vertex_color"], colours * [factor, 1, 0.5], rtol=1e-6)


def test_vertex_colours_over_a_texture(tmp_path):
    """One colour becomes a factor, shades of one a blend with black; of others only the luminance varies."""
    material = pbr(baseColorTexture={"index": 0}, metallicFactor=0)
    one = MaterialFile(material, COLOURS, COLOR_0=np.tile(np.array([[0.5, 0.25, 1]], "f4"), (4, 1)))
    base = inside(one.bsdf(tmp_path), "twosided")["base_color"]
    np.testing.assert_allclose(base["bitmap"].linear(), linear(COLOURS) * [0.5, 0.25, 1], rtol=1e-6)
    shades = np.array([[0.1], [0.3], [0.7], [1]], "f4") * np.array([1, 0.5, 0.25], "f4")
    shape = MaterialFile(material, COLOURS, COLOR_0=shades).shape(tmp_path)
    blend = shape["bsdf"]
    assert blend["type"] == "blendbsdf"
    assert inside(blend["bsdf"], "twosided")["base_color"]["value"] == [0.0, 0.0, 0.0]
    textured = inside(blend["bsdf_1"], "twosided")["base_color"]["bitmap"].linear()
    luminance = shape["attributes"]["vertex_color"] @ [0.212671, 0.715160, 0.072169]
    weights = luminance * blend["weight"]["scale"]
    expected = linear(COLOURS)[1, 2] * shades[:, None]
    np.testing.assert_allclose(weights[:, None] * textured[1, 2], expected[:, 0], rtol=1e-5)
    random = MaterialFile(material, COLOURS, COLOR_0=RNG.random((4, 3)).astype("f4"))
    assert "only their luminance varies" in warnings_of(random, tmp_path)


def test_factors_out_of_range_are_limited(tmp_path):
    material = pbr(baseColorTexture={"index": 0}, baseColorFactor=[1e300, -1, 0.5, 1])
    base = inside(MaterialFile(material, COLOURS).bsdf(tmp_path), "twosided")["base_color"]
    np.testing.assert_allclose(base["bitmap"].linear(), linear(COLOURS) * [1, 0, 0.5], rtol=1e-6)


def test_opacity(tmp_path):
    material = pbr(baseColorTexture={"index": 0}, baseColorFactor=[1, 1, 1, 0.5])
    opaque = MaterialFile(material, RGBA).bsdf(tmp_path)
    assert opaque["type"] == "twosided"
    blended = MaterialFile(material | {"alphaMode": "BLEND"}, RGBA).bsdf(tmp_path)
    np.testing.assert_allclose(blended["opacity"]["bitmap"].linear(), ALPHA / 510, rtol=1e-6)
    assert inside(blended, "mask")["type"] == "twosided"
    cut = MaterialFile(material | {"alphaMode": "MASK", "alphaCutoff": 0.2}, RGBA).bsdf(tmp_path)
    opacity = np.clip(cut["opacity"]["bitmap"].linear(), 0, 1)
    np.testing.assert_array_equal(opacity, ALPHA / 510 >= 0.2)
    hidden = MaterialFile(material | {"alphaMode": "MASK", "alphaCutoff": 1e40}, RGBA).bsdf(tmp_path)
    assert np.isfinite(hidden["opacity"]["bitmap"].pixels).all()
    assert hidden["opacity"]["bitmap"].pixels.max() < 0
    constant = pbr(baseColorFactor=[1, 1, 1, 0.4])
    assert MaterialFile(constant | {"alphaMode": "BLEND"}).bsdf(tmp_path)["opacity"] == 0.4
    assert MaterialFile(constant | {"alphaMode": "MASK"}).bsdf(tmp_path)["opacity"] == 0.0
    assert MaterialFile(constant | {"alphaMode": "MASK", "alphaCutoff": 0.4}).bsdf(tmp_path)["type"] == "twosided"
    alphas = np.concatenate([np.ones((4, 3)), RNG.random((4, 1))], axis=1).astype("f4")
    faded = MaterialFile(constant | {"alphaMode": "BLEND"}, COLOR_0=alphas).shape(tmp_path)
    assert faded["bsdf"]["opacity"] == {"type": "mesh_attribute", "name": "vertex_alpha"}
    assert inside(faded["bsdf"], "mask")["opacity"] == 0.4
    np.testing.assert_array_equal(faded["attributes"]["vertex_alpha"], alphas[:, 3:])
    with pytest.raises(SceneError, match=r"materials\[0\].alphaMode: it has to be one of OPAQUE, MASK, BLEND"):
        read_file(MaterialFile({"alphaMode": "SOLID"}), tmp_path)
    with pytest.raises(SceneError, match=r"alphaCutoff: it has to be a finite number, got 'x'"):
        read_file(MaterialFile({"alphaMode": "MASK", "alphaCutoff": "x"}), tmp_path)


def test_emission(tmp_path):
    material = {"emissiveFactor": [0.5, 1, 0.25], "emissiveTexture": {"index": 0}}
    strong = extended("emissive_strength", {"emissiveStrength": 8}, material)
    radiance = MaterialFile(strong, COLOURS).shape(tmp_path)["emitter"]["radiance"]
    np.testing.assert_allclose(radiance["bitmap"].linear(), linear(COLOURS) * [4, 8, 2], rtol=1e-6)
    plain = MaterialFile({"emissiveFactor": [0.5, 1, 0.25]}).shape(tmp_path)
    assert plain["emitter"] == {"type": "area", "radiance": {"type": "rgb", "value": [0.5, 1.0, 0.25]}}
    assert "emitter" not in MaterialFile(material, COLOURS * 0).shape(tmp_path)
    assert "emitter" not in MaterialFile({"emissiveTexture": {"index": 0}}, COLOURS).shape(tmp_path)


def test_transparent_parts_do_not_emit(tmp_path):
    material = pbr(baseColorTexture={"index": 0}) | {"alphaMode": "BLEND", "emissiveFactor": [1, 2, 3]}
    radiance = MaterialFile(material, RGBA).shape(tmp_path)["emitter"]["radiance"]
    np.testing.assert_allclose(radiance["bitmap"].linear(), ALPHA / 255 * [1, 2, 3], rtol=1e-6)
    textured = material | {"emissiveTexture": {"index": 1}, "emissiveFactor": [1, 1, 1]}
    radiance = MaterialFile(textured, RGBA, COLOURS[::-1].copy()).shape(tmp_path)["emitter"]["radiance"]
    np.testing.assert_allclose(radiance["bitmap"].linear(), linear(COLOURS[::-1]) * ALPHA / 255, rtol=1e-6)
    half = pbr(baseColorFactor=[1, 1, 1, 0.5]) | {"alphaMode": "BLEND", "emissiveFactor": [1, 2, 3]}
    assert MaterialFile(half).shape(tmp_path)["emitter"]["radiance"]["value"] == [0.5, 1.0, 1.5]
    wide = MaterialFile(textured, RGBA, np.tile(COLOURS, (1, 2, 1)))
    assert "transparent parts emit too" in warnings_of(wide, tmp_path)


def test_emission_of_double_sided_surfaces(tmp_path):
    """A closed mesh has no visible inside; a sheet loses the light of its back."""
    material = {"emissiveFactor": [1, 1, 1], "doubleSided": True}
    assert "only the front" in warnings_of(MaterialFile(material), tmp_path)
    tetrahedron = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], "f4")
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    assert is_closed(Geometry(tetrahedron, faces))
    assert is_closed(Geometry(tetrahedron[faces].reshape(-1, 3), np.arange(12).reshape(4, 3)))
    assert not is_closed(Geometry(tetrahedron, faces[:3]))
    assert not is_closed(Geometry(tetrahedron, np.concatenate([faces[:3], faces[3:, ::-1]])))


def test_normal_maps(tmp_path):
    """Green points up in the image, as Mitsuba's n x dp/du does unless the image is mirrored on the surface."""
    material = {"normalTexture": {"index": 0}}
    bsdf = MaterialFile(material, COLOURS).bsdf(tmp_path)
    np.testing.assert_array_equal(bsdf["normalmap"]["bitmap"].pixels, COLOURS)
    assert bsdf["normalmap"]["raw"]
    assert inside(bsdf, "normalmap", "twosided")["type"] == "principled"
    mirrored = MaterialFile(material, COLOURS, TEXCOORD_0=UVS * np.array([-1, 1], "f4")).bsdf(tmp_path)
    pixels = mirrored["normalmap"]["bitmap"].pixels
    np.testing.assert_array_equal(pixels[..., 1], 255 - COLOURS[..., 1])
    np.testing.assert_array_equal(pixels[..., [0, 2]], COLOURS[..., [0, 2]])
    folded = MaterialFile(material, COLOURS, TEXCOORD_0=np.array([[0, 1], [1, 1], [1, 0], [1, 1]], "f4"))
    assert len(folded.shapes(tmp_path)) == 2  # the second triangle shows the mirrored image
    scaled = MaterialFile({"normalTexture": {"index": 0, "scale": 0.5}}, COLOURS).bsdf(tmp_path)
    normals = 2 * scaled["normalmap"]["bitmap"].linear(raw=True) - 1
    np.testing.assert_allclose(normals, (COLOURS / 127.5 - 1) * [0.5, 0.5, 1], atol=1e-6)


@pytest.mark.parametrize("angle", [0.0, math.pi / 2, 1.0])
def test_normal_maps_of_turned_images(tmp_path, angle):
    """A normal along the u of the image bends the surface along that direction, wherever it is on the mesh."""
    transform = {"rotation": angle, "scale": [2, 2]}
    texture = {"index": 0, "extensions": {"KHR_texture_transform": transform}}
    right = np.tile(np.array([255, 128, 128], np.uint8), (4, 4, 1))
    right[0, 0] = 0  # an image of one colour would be no texture
    shape = MaterialFile({"normalTexture": texture}, right).bsdf(tmp_path)["normalmap"]
    x, y = (2 * shape["bitmap"].linear(raw=True) - 1)[2, 2, :2]
    step = np.array([x, -y])  # in the mesh's coordinates, v down
    along = shape["to_uv"][:2, :2] @ step  # in those of the image
    np.testing.assert_allclose(along / np.linalg.norm(along), [1, 0], atol=5e-3)


def test_occlusion_gives_no_warning(tmp_path):
    assert MaterialFile({"occlusionTexture": {"index": 0}}, COLOURS).bsdf(tmp_path)["type"] == "twosided"


def test_damaged_images_and_unsupported_formats(tmp_path):
    file = MaterialFile(pbr(baseColorTexture={"index": 0}))
    file.add("textures", extensions={"KHR_texture_basisu": {"source": 0}})
    assert "its image is KTX2, which is not supported: convert it to PNG" in warnings_of(file, tmp_path)
    file.content["textures"] = [{"source": 0}]
    file.add("images", bufferView=file.view(b"no image"), mimeType="image/png")
    with pytest.raises(SceneError, match=r"images\[0\]: not a supported image"):
        read_file(file, tmp_path)
    with pytest.raises(SceneError, match=r"there is no textures\[7\]"):
        read_file(MaterialFile(pbr(baseColorTexture={"index": 7})), tmp_path)
