"""Published Mitsuba scenes: every file loads, and its image equals its reference (tests/README.md).

Seeds are fixed. False-alarm rates, the chance that a correct program fails under other seeds: below 1 % for each
comparison by values (references.assert_agree), at most 0.8 % for each comparison of three image means.
"""

from pathlib import Path

import numpy as np
import pytest
import references

import isonoise
from isonoise.film.exr import read_exr

BATCHES = 16
"""As in test_against_mitsuba.py."""

RENDERED = {"cornell-box": 32, "veach-mis": 64, "staircase2": 32, "cbox-spheres": 128, "bunny-box": 32}
"""Scenes with a reference.exr -> samples per pixel of a batch."""

MITSUBA_TESTS = {
    "bsdf_spheres/test_arealight_path.xml": 128,
    "bsdf_spheres/test_constant_path.xml": 64,
    "bsdf_spheres/test_envmap_path.xml": 64,
    "bsdf_spheres/test_pointlight_path.xml": 128,
    "bsdf_spheres/test_roughplastic_linear_path.xml": 64,
    "bsdf_spheres/test_textured_diffuse_path.xml": 64,
    "floating_sphere/test_directional_direct.xml": 64,
    "instancing/test_instancing_path.xml": 64,
    "participating_media/test_homo_area_light_volpath.xml": 64,
    "participating_media/test_homo_null_envmap_volpath.xml": 64,
}
"""Mitsuba 3's own test scenes -> samples per pixel of a batch. All name files of the folder `common` above theirs."""

REFERENCE_SPP = 32000
"""Samples per pixel of Mitsuba's reference images: the default of its src/render/tests/test_renders.py."""

SUM_ROUNDING = REFERENCE_SPP * 2.0**-24
"""Relative error of these images, whose samples were summed sequentially in float32."""

TO_XYZ = np.array([[0.412453, 0.357580, 0.180423], [0.212671, 0.715160, 0.072169], [0.019334, 0.119193, 0.950227]])
"""Mitsuba 3's `srgb_to_xyz` (include/mitsuba/core/spectrum.h), whose inverse made its reference images RGB."""


def mitsuba_test_folder(public_scenes: Path) -> Path:
    return public_scenes / "mitsuba-tests" / "tests" / "scenes"


def read_mitsuba_reference(scene: Path) -> references.Estimate:
    """Mean and standard error of XYZ. The files contain the mean and the variance of XYZ, converted to RGB."""
    stem = scene.stem.rsplit("_", 1)[0]
    planes = []
    for name in (f"{stem}_ref_rgb.exr", f"{stem}_ref_rgb_var.exr"):
        channels, _ = read_exr(scene.parent / "refs" / name)
        planes.append(np.stack([channels[c] for c in "RGB"], axis=-1, dtype=np.float64) @ TO_XYZ.T)
    mean, variance = planes
    return references.Estimate(mean, np.sqrt(np.maximum(variance, 0) / REFERENCE_SPP), REFERENCE_SPP - 1)


def assert_images_agree(
    batches: np.ndarray, reference: references.Estimate, folder: Path, rounding: float, **means
) -> None:
    """Pixels, means of 8x8 pixels and image means agree."""
    image = references.from_batches(batches)
    references.assert_agree(image, reference, folder, rounding=rounding)
    blocks = references.from_batches(references.block_means(batches, 8))
    references.assert_agree(blocks, reference.blocks(8), folder, rounding=rounding)
    references.assert_means_agree(image, reference, **means)


def test_no_scene_is_left_out(public_scenes):
    folder = mitsuba_test_folder(public_scenes)
    assert {str(path.relative_to(folder)) for path in folder.glob("*/test_*.xml")} == set(MITSUBA_TESTS)
    assert {path.parent.name for path in public_scenes.glob("*/reference.exr")} == set(RENDERED)


@pytest.mark.parametrize("name", MITSUBA_TESTS)
def test_files_outside_the_scenes_folder_are_refused(public_scenes, name):
    with pytest.raises(isonoise.errors.SceneError, match="common' is outside the scene's folder"):
        isonoise.load(mitsuba_test_folder(public_scenes) / name)


@pytest.mark.parametrize("name", [*RENDERED, *MITSUBA_TESTS])
def test_file_loads(public_scenes, name):
    """Old and new files pass the checks. The integrator nested in `moment` is used."""
    path = public_scenes / name / "scene.xml" if name in RENDERED else mitsuba_test_folder(public_scenes) / name
    description = isonoise.load(path, allow_outside=name in MITSUBA_TESTS)
    assert description["integrator"]["type"] in ("path", "direct", "volpath")


def test_published_staircase_equals_the_upgraded_file(public_scenes):
    """Except for film size, filter and max_depth, the file of 2015 compiles to the same bits."""
    folder = public_scenes / "staircase2"
    new, old = isonoise.load(folder / "scene.xml"), isonoise.load(folder / "scene-v0.5.xml")
    assert old["integrator"]["max_depth"] == 65
    assert old["sensor"]["film"]["width"] == 1280
    old["integrator"], old["sensor"]["film"] = new["integrator"], new["sensor"]["film"]
    assert old.compile().hash == new.compile().hash


@pytest.mark.long
@pytest.mark.parametrize("name", RENDERED)
def test_image_equals_the_reference(public_scenes, tmp_path, name):
    folder = public_scenes / name
    batches = references.wave_batches(folder / "scene.xml", RENDERED[name], BATCHES)
    reference = references.read_reference(folder / "reference.exr")
    assert_images_agree(batches, reference, tmp_path, references.ROUNDING)


@pytest.mark.long
@pytest.mark.parametrize("name", MITSUBA_TESTS)
def test_image_equals_that_of_mitsubas_test(public_scenes, tmp_path, name):
    path = mitsuba_test_folder(public_scenes) / name
    batches = references.wave_batches(path, MITSUBA_TESTS[name], BATCHES, allow_outside=True) @ TO_XYZ.T
    assert_images_agree(batches, read_mitsuba_reference(path), tmp_path, SUM_ROUNDING)
