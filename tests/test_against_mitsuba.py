"""Renders against Mitsuba 3: every pixel, blocks of pixels, image means, and the stated variance.

Seeds are fixed. False-alarm rates, the chance that a correct program fails under other seeds: below 1 % for each
comparison by values (references.assert_agree), at most 0.8 % for each comparison of three image means, 6e-5 for each
check of the stated variance.
"""

from pathlib import Path

import numpy as np
import pytest
import references

import isonoise
from isonoise.scene.builtin import find_scene

BATCHES = 16
"""Independent renders of a scene. With 15 degrees of freedom a firefly in one batch does not look certain, and
Student's t still has a usable tail."""

BLOCKS = {"cornell": (1, 8), "penumbra": (1, 8), "bright-spots": (8,), "glass-roof": (8,)}
"""Sides of the blocks whose means are compared. Single pixels of bright-spots and glass-roof are not compared: in
most of them no batch has one of the rare bright paths, so their standard errors are too small."""


@pytest.fixture(scope="session")
def mitsuba_folder(pytestconfig, tmp_path_factory) -> Path:
    """Cache of Mitsuba's images: ISONOISE_REFERENCE_CACHE, or pytest's cache."""
    pytest.importorskip("mitsuba", reason="needs Mitsuba 3: pip install mitsuba")
    return references.cache_folder(getattr(pytestconfig, "cache", None)) or tmp_path_factory.mktemp("mitsuba")


def render_batches(path: Path, spp: int) -> list[isonoise.Statistics]:
    return [
        isonoise.render(path, spp=spp, strategy=f"uniform:wave_spp={spp}", seed=seed).statistics
        for seed in range(BATCHES)
    ]


def compare(ours: np.ndarray, theirs: np.ndarray, blocks: tuple[int, ...], folder: Path) -> None:
    """Asserts that two batches of images agree."""
    for size in blocks:
        image, reference = (references.from_batches(references.block_means(b, size)) for b in (ours, theirs))
        references.assert_agree(image, reference, folder)
    references.assert_means_agree(references.from_batches(ours), references.from_batches(theirs))


@pytest.mark.parametrize("name", BLOCKS)
def test_builtin_scene_in_small(name, mitsuba_folder, tmp_path):
    path = references.resized(find_scene(name), 64, tmp_path)
    theirs = references.mitsuba_batches(path, 64, BATCHES, mitsuba_folder)
    ours = np.stack([statistics.rgb for statistics in render_batches(path, 64)])
    compare(ours, theirs, BLOCKS[name], tmp_path)


@pytest.mark.long
@pytest.mark.parametrize("name", BLOCKS)
def test_builtin_scene(name, mitsuba_folder, tmp_path):
    path = find_scene(name)
    theirs = references.mitsuba_batches(path, 64, BATCHES, mitsuba_folder)
    ours = np.stack([statistics.rgb for statistics in render_batches(path, 64)])
    compare(ours, theirs, BLOCKS[name], tmp_path)


def test_public_cornell_box(public_scenes, tmp_path):
    folder = public_scenes / "cornell-box"
    reference = references.read_reference(folder / "reference.exr")
    batches = render_batches(folder / "scene.xml", 8)
    assert all((statistics.count == 8).all() and not statistics.rejected.any() for statistics in batches)

    image = references.from_batches(np.stack([statistics.rgb for statistics in batches]))
    references.assert_agree(image, reference, tmp_path)
    references.assert_agree(image.blocks(8), reference.blocks(8), tmp_path)
    references.assert_means_agree(image, reference)

    stated = references.from_statistics(batches)
    references.assert_agree(stated, references.luminance_of(reference), tmp_path)
    measured = references.from_batches(np.stack([statistics.mean for statistics in batches])[..., None])
    np.testing.assert_allclose(stated.mean, measured.mean, rtol=1e-12)
    assert_variances_agree(stated.se**2, measured.se**2, weights=1 / np.maximum(reference.mean[..., :1], 1e-3) ** 2)


def assert_variances_agree(stated: np.ndarray, measured: np.ndarray, weights: np.ndarray) -> None:
    """Asserts that the stated variance equals the variance between batches.

    Both are unbiased estimates of the same value. So the differences of independent pixels have mean 0, with any
    weights that do not depend on the samples: their sum over its standard error is a standard normal deviate.
    """
    differences = ((measured - stated) * weights).ravel()
    deviate = differences.sum() / np.sqrt((differences**2).sum())
    ratio = (measured * weights).sum() / (stated * weights).sum()
    assert abs(deviate) <= 4, f"the batches have {ratio:.3f} of the stated variance, {deviate:.1f} standard errors off"
