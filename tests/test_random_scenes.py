"""A hundred random scene files (scene_generator.py), rendered by isonoise and by Mitsuba 3.

Seeds are fixed. False-alarm rates for other seeds of the samples: 6e-5 for each image mean (4 standard errors), 1e-4
for the blocks of each image; so below 3 % for all of them together.
"""

import shutil
from pathlib import Path

import numpy as np
import pytest
import references
import scene_generator

import isonoise
from isonoise.scene import vocabulary
from isonoise.scene.vocabulary.textures import CONSTANT_TEXTURES

SEEDS = range(100)
SPP, BATCHES = 64, 16
MAX_STANDARD_ERRORS = 4.0
"""Largest difference of image means, in standard errors."""

UNUSED = {("integrator", "moment"), ("integrator", "aov"), ("shape", "mesh"), ("volume", "constvolume")}
UNUSED |= {("medium", "heterogeneous"), ("volume", "gridvolume"), ("emitter", "projector")}
UNUSED |= {("texture", name) for name in CONSTANT_TEXTURES}
"""Plugins that no file uses: integrators that wrap another one, isonoise's own shape, and what has tests of its own."""


@pytest.fixture(scope="session")
def mitsuba_folder(pytestconfig, tmp_path_factory) -> Path:
    """Cache of Mitsuba's images: ISONOISE_REFERENCE_CACHE, or pytest's cache."""
    pytest.importorskip("mitsuba", reason="needs Mitsuba 3: pip install mitsuba")
    return references.cache_folder(getattr(pytestconfig, "cache", None)) or tmp_path_factory.mktemp("mitsuba")


def test_a_seed_always_gives_the_same_files(tmp_path):
    first, again = (scene_generator.write_scene(tmp_path / name, 3) for name in ("a", "b"))
    assert sorted(path.name for path in first.parent.iterdir()) == sorted(path.name for path in again.parent.iterdir())
    assert all(path.read_bytes() == (again.parent / path.name).read_bytes() for path in first.parent.iterdir())


def test_all_files_load_and_use_the_whole_vocabulary(tmp_path):
    used = set()
    for seed in SEEDS:
        path = scene_generator.write_scene(tmp_path / "scene", seed)
        used |= scene_generator.plugins(path)
        isonoise.load(path)
        shutil.rmtree(path.parent)
    box_and_samples = {"rfilter", "sampler", "scene"}
    supported = {(p.kind, p.name) for p in vocabulary.PLUGINS if p.kind not in box_and_samples} - UNUSED
    assert supported <= used


@pytest.mark.long
@pytest.mark.parametrize("seed", SEEDS)
def test_image_equals_mitsubas(seed, mitsuba_folder, tmp_path):
    path = scene_generator.write_scene(tmp_path / "scene", seed)
    files = [file for file in path.parent.iterdir() if file != path]
    theirs = references.mitsuba_batches(path, SPP, BATCHES, mitsuba_folder, files=files)
    ours = references.wave_batches(path, SPP, BATCHES)

    means = [references.from_batches(images.mean(axis=(1, 2), keepdims=True)) for images in (ours, theirs)]
    assert (np.hypot(means[0].se, means[1].se) <= 0.03 * means[1].mean).all(), "too noisy to compare"
    scores = references.standard_scores(*means).ravel()
    assert np.abs(scores).max() <= MAX_STANDARD_ERRORS, (
        f"image means {means[0].mean} for {means[1].mean}: {scores} standard errors"
    )
    blocks = (references.from_batches(references.block_means(images, 8)) for images in (ours, theirs))
    references.assert_agree(*blocks, tmp_path, alpha=1e-4)
