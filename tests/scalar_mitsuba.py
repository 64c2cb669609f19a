"""Renders small scenes with Mitsuba's scalar_rgb in this process: it needs no LLVM, which may conflict with drivers."""

import numpy as np
import pytest
import references

import isonoise
from isonoise.scene.volume.grid_file import VolumeGrid


def import_mitsuba():
    """Returns the quiet module; skips the test without Mitsuba."""
    mitsuba = pytest.importorskip("mitsuba", reason="needs Mitsuba 3: pip install mitsuba")
    mitsuba.set_variant("scalar_rgb")
    mitsuba.set_log_level(mitsuba.LogLevel.Error)
    return mitsuba


def as_mitsuba(mitsuba, scene: dict) -> dict:
    """Converts a scene for isonoise to one for `mitsuba.load_dict`."""
    result = {}
    for name, value in scene.items():
        if isinstance(value, dict):
            value = as_mitsuba(mitsuba, value)
        elif name in ("to_world", "to_uv"):
            value = mitsuba.ScalarTransform4f(np.asarray(value, float))
        elif isinstance(value, VolumeGrid):
            value = mitsuba.VolumeGrid(value.values)
        elif name == "data":
            value = mitsuba.TensorXf(value.astype(np.float32))
        result[name] = value
    return result


def assert_same_picture(scene: dict, folder, spp: int = 64, batches: int = 16, share: float = 0.9975) -> None:
    """Asserts that pixels and image means of isonoise and Mitsuba agree, as defined in tests/references.py."""
    mitsuba = import_mitsuba()
    loaded = mitsuba.load_dict(as_mitsuba(mitsuba, scene))
    theirs = np.stack([np.array(mitsuba.render(loaded, spp=spp, seed=seed))[..., :3] for seed in range(batches)])
    ours = np.stack(
        [
            isonoise.render(scene, spp=spp, strategy=f"uniform:wave_spp={spp}", seed=seed).statistics.rgb
            for seed in range(batches)
        ]
    )
    image, reference = references.from_batches(ours), references.from_batches(theirs)
    references.assert_agree(image, reference, folder, share)
    references.assert_means_agree(image, reference)
