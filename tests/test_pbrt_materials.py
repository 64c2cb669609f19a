"""What pbrt's materials, textures and media become, and what is reported."""

import math

import numpy as np
import pytest
import small_files
from pbrt_files import TRIANGLE, material, objects, only, read_world

import isonoise
from isonoise.errors import SceneError
from isonoise.scene.formats.pbrt.coats import coat_transmittance, dielectric_reflectance
from isonoise.scene.formats.pbrt.legacy_materials import legacy_alpha
from isonoise.scene.material.presets import conductors
from isonoise.scene.spectra import srgb_to_linear

GOLD = conductors()["Au"]


def rgb(*values):
    return {"type": "rgb", "value": pytest.approx(list(values), rel=1e-6)}


def two_sided(**bsdf):
    return {"type": "twosided", "bsdf": bsdf}


EXACT = {
    'Material "diffuse" "rgb reflectance" [0.1 0.2 0.3]': two_sided(type="diffuse", reflectance=rgb(0.1, 0.2, 0.3)),
    'Material "diffuse"': two_sided(type="diffuse", reflectance=rgb(0.5, 0.5, 0.5)),
    'Material "diffuse" "spectrum reflectance" [300 0.25 900 0.25]': two_sided(
        type="diffuse", reflectance={"type": "rgb", "value": pytest.approx([0.25] * 3, rel=2e-3)}
    ),
    'Material "coateddiffuse" "rgb reflectance" [1 0 0.5] "float thickness" 0': two_sided(
        type="plastic", int_ior=1.5, ext_ior=1.0, nonlinear=True, diffuse_reflectance=rgb(1, 0, 0.5)
    ),
    'Material "coateddiffuse" "float roughness" 0.25 "float eta" 1.3 "float thickness" 0': two_sided(
        type="roughplastic",
        int_ior=1.3,
        ext_ior=1.0,
        nonlinear=True,
        diffuse_reflectance=rgb(0.5, 0.5, 0.5),
        distribution="ggx",
        alpha=0.5,
    ),
    'Material "conductor" "spectrum eta" "metal-Au-eta" "spectrum k" "metal-Au-k" "float roughness" 0.04': two_sided(
        type="roughconductor", eta=rgb(*GOLD[0]), k=rgb(*GOLD[1]), distribution="ggx", alpha=pytest.approx(0.2)
    ),
    'Material "conductor" "float uroughness" 0.1 "float vroughness" 0.3 "bool remaproughness" false '
    '"rgb reflectance" [0.5 0.5 0.5]': two_sided(
        type="roughconductor",
        eta=rgb(1, 1, 1),
        k=rgb(2, 2, 2),
        distribution="ggx",
        alpha_u=pytest.approx(0.1),
        alpha_v=pytest.approx(0.3),
    ),
    'Material "dielectric" "float eta" 1.33': {"type": "dielectric", "int_ior": 1.33, "ext_ior": 1.0},
    'Material "dielectric" "float roughness" 0.01': {
        "type": "roughdielectric",
        "int_ior": 1.5,
        "ext_ior": 1.0,
        "distribution": "ggx",
        "alpha": pytest.approx(0.1),
    },
    'Material "thindielectric" "spectrum eta" [300 1.4 900 1.4]': {
        "type": "thindielectric",
        "int_ior": pytest.approx(1.4),
        "ext_ior": 1.0,
    },
    'Material "interface"': {"type": "null"},
    'Material ""': {"type": "null"},
    'Material "matte" "color Kd" [0.1 0.2 0.3]': two_sided(type="diffuse", reflectance=rgb(0.1, 0.2, 0.3)),
    'Material "mirror" "rgb Kr" [0.8 0.8 0.8]': two_sided(
        type="conductor", material="none", specular_reflectance=rgb(0.8, 0.8, 0.8)
    ),
    'Material "metal" "float roughness" 0.2': two_sided(
        type="roughconductor",
        eta=rgb(*conductors()["Cu"][0]),
        k=rgb(*conductors()["Cu"][1]),
        distribution="ggx",
        alpha=pytest.approx(float(legacy_alpha(np.array(0.2)))),
    ),
    'Material "glass" "float index" 1.6': {"type": "dielectric", "int_ior": 1.6, "ext_ior": 1.0},
}


@pytest.mark.parametrize("text", EXACT)
def test_materials_that_are_mapped_without_loss(tmp_path, text):
    bsdf, report = material(tmp_path, text)
    assert bsdf == EXACT[text]
    assert not report.warnings()


@pytest.mark.parametrize(
    ("reflectance", "thickness", "tolerance"),
    [(0.1, 0.0, 0.005), (0.9, 0.0, 0.005), (0.1, 0.01, 0.005), (0.5, 0.01, 0.02), (0.9, 0.01, 0.04)],
)
def test_coated_diffuse_has_nearly_the_albedo_of_pbrts_random_walk(tmp_path, reflectance, thickness, tolerance):
    """pbrt-v4's LayeredBxDF, summed over all bounces between base and coat, against Mitsuba's nonlinear plastic.

    Both add the coat's reflection, which is the same. Tolerances are relative to the albedo for diffuse light; what the
    inside of the coat reflects is absorbed less than in pbrt.
    """
    text = f'Material "coateddiffuse" "rgb reflectance" [{reflectance} {reflectance} {reflectance}] '
    bsdf, _ = material(tmp_path, text + f'"float thickness" {thickness}')
    base = bsdf["bsdf"]["diffuse_reflectance"]["value"][0]
    generator = np.random.default_rng(5)
    cosines = np.sqrt((np.arange(20_000) + generator.random(20_000)) / 20_000)  # of light from outside, then inside
    entered = 1 - dielectric_reflectance(cosines, 1.5)
    power = entered * np.exp(-thickness / np.sqrt(1 - (1 - cosines**2) / 1.5**2))
    mean_plain, emerged = 0.0, np.zeros_like(power)
    plain = entered.copy()
    for _ in range(60):
        power, plain = power * reflectance, plain * base
        inside = np.sqrt((generator.permutation(20_000) + generator.random(20_000)) / 20_000)
        reflected = dielectric_reflectance(inside, 1 / 1.5)
        emerged += power * np.exp(-thickness / inside) * (1 - reflected)
        mean_plain += np.mean(plain) * np.mean(1 - reflected)
        power = power * np.exp(-2 * thickness / inside) * reflected
        plain = plain * np.mean(reflected)
    assert mean_plain == pytest.approx(emerged.mean(), rel=tolerance)
    assert mean_plain >= emerged.mean() * 0.995


LOSSES = {
    'Material "hair"': "measured materials and hair become diffuse grey",
    'Material "measured" "string filename" "a.bsdf"': "measured materials and hair become diffuse grey",
    'Material "subsurface" "float eta" 1.4': "subsurface scattering becomes plastic",
    'Material "coatedconductor"': "approximated by that of `principled`",
    'Material "diffusetransmission"': "approximated by `principledthin`",
    'Material "coateddiffuse" "float albedo" 0.5': "scattering inside a coat is ignored",
    'Material "dielectric" "spectrum eta" "glass-SF11"': None,
    'Material "dielectric" "spectrum eta" "glass-F11"': "the index of refraction at 588 nm is used",
    'Material "diffuse" "rgb reflectance" [2 0.5 0.5]': "a reflectance outside 0 to 1 is clamped",
    'Material "matte" "float sigma" 20': "'sigma' (Oren and Nayar's rough diffuse surface) is ignored",
    'Material "plastic"': "become a coat over a base",
    'Material "uber" "rgb Kr" [0.5 0.5 0.5]': "'Kr' of the material uber is ignored",
    'Material "disney" "rgb scatterdistance" [2 0 0]': "'scatterdistance' of the material disney is ignored",
    'Material "diffuse" "float colour" 1': "the parameter 'colour' of the material 'diffuse' is unknown",
}


@pytest.mark.parametrize("text", LOSSES)
def test_losses_are_reported(tmp_path, text):
    if LOSSES[text] is None:
        with pytest.raises(SceneError, match="unknown spectrum 'glass-SF11'; did you mean 'glass-F11'"):
            material(tmp_path, text)
        return
    bsdf, report = material(tmp_path, text)
    assert any(LOSSES[text] in warning for warning in report.warnings()), report.warnings()
    load(bsdf)


def test_subsurface_materials_have_the_colour_of_their_medium(tmp_path):
    """A preset's name counts, and coefficients may exceed 1."""
    ketchup = 'Material "subsurface" "string name" "Ketchup"'
    by_name, report = material(tmp_path, ketchup)
    coefficients = '"rgb sigma_s" [0.18 0.07 0.03] "rgb sigma_a" [0.061 0.97 1.45]'
    by_coefficients, _ = material(tmp_path, f'Material "subsurface" {coefficients}')
    assert by_name == by_coefficients != material(tmp_path, 'Material "subsurface"')[0]
    assert len(report.warnings()) == 1


def test_index_of_uber_is_that_of_its_coat(tmp_path):
    assert material(tmp_path, 'Material "uber" "float eta" 1.3')[0]["bsdf"]["int_ior"] == 1.3


def test_coats_of_extreme_index_have_a_transmittance():
    """They let light pass along the normal only: on both ways, or from outside, as nearly for less extreme ones."""
    assert coat_transmittance(0.1, 1000.0) == pytest.approx(math.exp(-0.2), rel=1e-6)
    assert coat_transmittance(0.1, 0.001) == pytest.approx(coat_transmittance(0.1, 0.01), rel=0.03)


def test_constant_heights_are_not_reported(tmp_path):
    bsdf, report = material(tmp_path, 'Material "diffuse" "texture displacement" "t"', 'Texture "t" "float" "constant"')
    assert bsdf["bsdf"]["type"] == "diffuse"
    assert not report.warnings()


def test_white_of_another_colour_space_is_not_reported(tmp_path):
    _, report = material(tmp_path, 'Material "diffuse" "rgb reflectance" [1 1 1]', 'ColorSpace "rec2020"')
    assert not report.warnings()


def load(bsdf: dict) -> dict:
    """The normalised BSDF: all of its names and values are valid."""
    scene = {"type": "scene", "camera": {"type": "perspective"}, "shape": {"type": "sphere", "bsdf": bsdf}}
    return isonoise.load(scene)["shape"]["bsdf"]


def test_all_mapped_materials_are_valid(tmp_path):
    for text in EXACT:
        load(material(tmp_path, text)[0])


def test_roughness_remapping_of_pbrt_v3():
    """TrowbridgeReitzDistribution::RoughnessToAlpha at two values."""
    assert legacy_alpha(np.array([1.0, 0.1])) == pytest.approx([1.62142, 0.461760], rel=1e-4)


def test_disney_becomes_principled(tmp_path):
    text = 'Material "disney" "rgb color" [0.1 0.2 0.3] "float metallic" 0.5 "float clearcoat" 1 "float spectrans" 0'
    bsdf, report = material(tmp_path, text)
    principled = load(bsdf)["bsdf"]
    assert (principled["metallic"], principled["clearcoat"], principled["roughness"]) == (0.5, 1.0, 0.5)
    assert not report.warnings()


def test_mixtures(tmp_path):
    before = 'MakeNamedMaterial "a" "string type" "diffuse"\nMakeNamedMaterial "b" "string type" "dielectric"\n'
    mix, report = material(tmp_path, 'Material "mix" "string materials" ["a" "b"] "float amount" 0.25', before)
    assert (mix["type"], mix["weight"]) == ("blendbsdf", 0.25)
    assert [mix["first"]["type"], mix["second"]["type"]] == ["twosided", "dielectric"]
    old = 'Material "mix" "string namedmaterial1" "a" "string namedmaterial2" "b" "rgb amount" [0.25 0.25 0.25]'
    mix, _ = material(tmp_path, old, before)
    assert mix["weight"] == pytest.approx(0.75)  # of the second one
    assert not report.warnings()


def test_alpha_is_a_mask_for_the_volume_integrator(tmp_path):
    scene, report = read_world(tmp_path, 'Shape "sphere" "float alpha" 0.25 Shape "sphere" "float alpha" 0')
    (sphere,) = objects(scene, "sphere")
    assert (sphere["bsdf"]["type"], sphere["bsdf"]["opacity"]) == ("mask", 0.25)
    assert scene["integrator"]["type"] == "volpath"
    assert not report.warnings()


def test_images_are_flipped_scaled_and_inverted(tmp_path):
    (tmp_path / "a.png").write_bytes(small_files.image_file("PNG"))
    before = """
    Texture "plain" "spectrum" "imagemap" "string filename" "a.png" "float uscale" 2 "float vscale" 3 "float vdelta" 0.5
    Texture "half" "spectrum" "scale" "texture tex" "plain" "float scale" 0.5
    Texture "inverse" "spectrum" "imagemap" "string filename" "a.png" "bool invert" true "string wrap" "clamp"
    Texture "linear" "spectrum" "imagemap" "string filename" "a.png" "string encoding" "linear" "string filter" "point"
    Texture "mixed" "spectrum" "mix" "texture tex1" "plain" "rgb tex2" [1 1 1] "float amount" 0.25
    """

    def texture(name: str) -> dict:
        bsdf, report = material(tmp_path, f'Material "diffuse" "texture reflectance" "{name}"', before)
        assert not report.warnings()
        return bsdf["bsdf"]["reflectance"]

    plain = texture("plain")
    pixels = plain["bitmap"].pixels / 255
    # pbrt reads row 1 - t; t = 3 v + 0.5; with w = 1 - v that is 1 - (3 (1 - w) + 0.5) = 3 w - 2.5
    assert plain["to_uv"] == pytest.approx(np.array([[2, 0, 0, 0], [0, 3, 0, -2.5], [0, 0, 1, 0], [0, 0, 0, 1]]))
    assert plain["raw"] is False
    assert plain["filter_type"] == "bilinear"
    linear = srgb_to_linear(pixels)
    assert texture("half")["bitmap"].pixels == pytest.approx(0.5 * linear, abs=1e-6)
    assert texture("inverse")["bitmap"].pixels == pytest.approx(1 - linear, abs=1e-6)
    assert texture("inverse")["wrap_mode"] == "clamp"
    assert texture("mixed")["bitmap"].pixels == pytest.approx(0.75 * linear + 0.25, abs=1e-6)
    raw = texture("linear")
    assert raw["raw"] is True
    assert raw["filter_type"] == "nearest"


@pytest.mark.parametrize("encoding", ["", "gamma", "gamma x", "srgb"])
def test_unknown_encodings_are_errors(tmp_path, encoding):
    (tmp_path / "a.png").write_bytes(small_files.image_file("PNG"))
    texture = f'Texture "t" "spectrum" "imagemap" "string filename" "a.png" "string encoding" "{encoding}"'
    with pytest.raises(SceneError, match="gamma"):
        read_world(tmp_path, texture)


def test_images_below_a_coat_stay_images_of_bytes(tmp_path):
    (tmp_path / "a.png").write_bytes(small_files.image_file("PNG"))
    before = 'Texture "t" "spectrum" "imagemap" "string filename" "a.png"'
    plain, _ = material(tmp_path, 'Material "diffuse" "texture reflectance" "t"', before)
    coated, _ = material(tmp_path, 'Material "coateddiffuse" "texture reflectance" "t"', before)
    pixels = [plain["bsdf"]["reflectance"]["bitmap"].pixels, coated["bsdf"]["diffuse_reflectance"]["bitmap"].pixels]
    assert pixels[1].dtype == np.uint8
    expected = coat_transmittance(0.01, 1.5) * srgb_to_linear(pixels[0] / 255)
    assert np.abs(srgb_to_linear(pixels[1] / 255) - expected).max() < 0.005


def test_checkerboards_alternate_as_in_pbrt(tmp_path):
    before = (
        'Texture "t" "spectrum" "checkerboard" "rgb tex1" [1 0 0] "rgb tex2" [0 1 0] "float uscale" 5 "float vscale" 3'
    )
    bsdf, report = material(tmp_path, 'Material "diffuse" "texture reflectance" "t"', before)
    board = bsdf["bsdf"]["reflectance"]
    assert (board["color0"], board["color1"]) == (rgb(1, 0, 0), rgb(0, 1, 0))
    generator = np.random.default_rng(1)
    for u, v in generator.random((50, 2)):
        is_first = (math.floor(5 * u) + math.floor(3 * v)) % 2 == 0  # pbrt
        s, t = (board["to_uv"] @ [u, 1 - v, 0, 1])[:2]  # Mitsuba's uv has v at the top
        assert is_first == ((s % 1 > 0.5) == (t % 1 > 0.5))  # Mitsuba's checkerboard
    assert not report.warnings()


def test_textures_of_textures(tmp_path):
    before = """
    Texture "a" "float" "constant" "float value" 0.5
    Texture "b" "float" "scale" "texture tex" "a" "float scale" 0.5
    Texture "board" "float" "checkerboard" "texture tex1" "b" "float tex2" 0.75
    Texture "c" "float" "mix" "texture tex1" "board" "float tex2" 1 "float amount" 0.5
    """
    bsdf, report = material(tmp_path, 'Material "conductor" "texture roughness" "c"', before)
    alpha = bsdf["bsdf"]["alpha"]
    assert (alpha["color0"], alpha["color1"]) == (pytest.approx(0.625**0.5), pytest.approx(0.875**0.5))
    assert not report.warnings()


def test_procedural_textures_and_mappings_are_reported(tmp_path):
    before = """
    Texture "fbm" "float" "fbm" "integer octaves" 3
    Texture "dots" "spectrum" "dots" "rgb inside" [1 0 0] "rgb outside" [0 1 0]
    Texture "planar" "spectrum" "checkerboard" "string mapping" "planar"
    """
    bsdf, report = material(tmp_path, 'Material "diffuse" "texture reflectance" "dots"', before)
    assert bsdf["bsdf"]["reflectance"] == rgb(0.5, 0.5, 0)
    text = " ".join(report.warnings())
    for problem in ("'fbm' is replaced by a constant", "'dots' is replaced by", "the mapping 'planar' is replaced by"):
        assert problem in text


def test_bump_and_normal_maps_are_inside_twosided(tmp_path):
    (tmp_path / "a.png").write_bytes(small_files.image_file("PNG"))
    before = 'Texture "h" "float" "imagemap" "string filename" "a.png" "float scale" 0.1'
    bump, report = material(tmp_path, 'Material "diffuse" "texture displacement" "h"', before)
    assert (bump["type"], bump["bsdf"]["type"], bump["bsdf"]["bsdf"]["type"]) == ("twosided", "bumpmap", "diffuse")
    normal, _ = material(tmp_path, 'Material "dielectric" "string normalmap" "a.png"')
    assert (normal["type"], normal["normalmap"]["raw"]) == ("normalmap", True)
    load(bump), load(normal)
    assert not report.warnings()


def test_meshes_without_coordinates_get_those_of_pbrt(tmp_path):
    before = 'Texture "t" "spectrum" "checkerboard"\nMaterial "diffuse" "texture reflectance" "t"\n'
    mesh = only(read_world(tmp_path, before + TRIANGLE)[0], "mesh")
    assert mesh["texcoords"].tolist() == [[0, 1], [1, 1], [1, 0]]


MEDIUM = 'MakeNamedMedium "m" "string type" '


def medium(tmp_path, text: str) -> tuple[dict, list[str]]:
    world = f'{MEDIUM}{text}\nMediumInterface "m" ""\nMaterial "interface"\nShape "sphere"'
    scene, report = read_world(tmp_path, world)
    sphere = only(scene, "sphere")
    assert "exterior" not in sphere
    assert scene["integrator"]["type"] == "volpath"
    isonoise.load(scene)
    return sphere["interior"], report.warnings()


def test_homogeneous_media(tmp_path):
    text = '"homogeneous" "rgb sigma_a" [1 2 0] "rgb sigma_s" [3 2 0] "float scale" 2 "float g" 0.5'
    made, warnings = medium(tmp_path, text)
    assert (made["sigma_t"], made["albedo"]) == (rgb(1, 1, 0), rgb(0.75, 0.5, 0))  # Mitsuba refuses rgb above 1
    assert (made["scale"], made["phase"]) == (8, {"type": "hg", "g": 0.5})
    assert not warnings
    made, warnings = medium(tmp_path, '"homogeneous" "string preset" "Ketchup"')
    assert made["scale"] * np.array(made["sigma_t"]["value"]) == pytest.approx([0.18 + 0.061, 0.07 + 0.97, 1.48])
    assert made["phase"] == {"type": "isotropic"}
    assert not warnings


def test_grids_fill_their_box(tmp_path):
    text = '"uniformgrid" "integer nx" 2 "integer ny" 1 "integer nz" 3 "float density" [0 1 2 3 4 5] '
    made, warnings = medium(tmp_path, text + '"point3 p0" [1 1 1] "point3 p1" [3 4 5] "float sigma_s" 3')
    data = made["sigma_t"]["data"]
    assert data.shape == (3, 1, 2)
    assert data[1, 0].tolist() == [8, 12]
    corners = made["sigma_t"]["to_world"] @ np.array([[0, 0, 0, 1], [1, 1, 1, 1]]).T
    assert corners[:3].T.tolist() == [[1, 1, 1], [3, 4, 5]]
    assert made["albedo"] == rgb(0.75, 0.75, 0.75)
    assert not warnings


def test_media_that_the_files_integrator_ignores_are_left_out(tmp_path):
    world = MEDIUM + '"homogeneous" MediumInterface "m" "" Material "interface" Shape "sphere"'
    scene, report = read_world(tmp_path, world, 'Integrator "path"')
    assert "interior" not in only(scene, "sphere")
    assert "renders no media" in report.warnings()[0]


def test_same_medium_on_both_sides_is_no_boundary(tmp_path):
    scene, _ = read_world(tmp_path, MEDIUM + '"homogeneous" MediumInterface "m" "m" Shape "sphere"')
    assert not {"interior", "exterior"} & set(only(scene, "sphere"))


def test_the_camera_is_in_the_outer_medium(tmp_path):
    options = MEDIUM + '"homogeneous" MediumInterface "" "m" Camera "perspective"'
    scene, _ = read_world(tmp_path, TRIANGLE, options)
    assert scene["sensor"]["medium"]["type"] == "homogeneous"
