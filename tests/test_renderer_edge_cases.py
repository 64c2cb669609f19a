"""The renderer's edge cases: scenes without light, rejected samples, a stopped wave."""

import linecache

import numpy as np
import pytest
from small_scene import PIXELS, assert_same_bits, assert_sound, lamp_over_floor, without

from isonoise.render_scene import render
from isonoise.renderer import Renderer

AVERAGES_OVER_PIXELS = {"design_effect", "neighbour_mean", "neighbour_variance"}
DARK = {
    "without lights": without(lamp_over_floor(), "lamp"),
    "nothing at all": without(lamp_over_floor(), "lamp", "floor"),
    "a black lamp": lamp_over_floor(0.0),
}


@pytest.mark.parametrize("name", DARK)
def test_scenes_without_light_are_black(name):
    outcome = render(DARK[name], spp=40)
    assert outcome.statistics.samples == 40 * PIXELS
    assert outcome.reason == "spp"
    assert outcome.floor == 0
    assert (outcome.rgb == 0).all()
    assert (outcome.error == 0).all()  # noiseless
    assert_sound(outcome.statistics)


def test_sources_that_pyopencl_generates_are_not_kept():
    """A function for every kernel object: 27 kB per renderer."""
    Renderer(lamp_over_floor()).step()
    before = len(linecache.cache)
    Renderer(lamp_over_floor()).step()
    assert len(linecache.cache) == before


def test_a_black_image_has_the_error_zero():
    assert render(DARK["without lights"], error=0.01, strategy="uniform").reason == "error"


def test_only_an_environment():
    sky = {"type": "constant", "radiance": {"type": "rgb", "value": [0.2, 0.4, 0.6]}}
    outcome = render(without(lamp_over_floor(), "lamp", "floor") | {"sky": sky}, spp=20)
    np.testing.assert_allclose(outcome.rgb, np.broadcast_to([0.2, 0.4, 0.6], outcome.rgb.shape), rtol=1e-6)
    assert (outcome.statistics.variance == 0).all()
    assert np.ptp(outcome.statistics.count) <= 2  # equal noise; waves are rounded, the last one is shortened


def test_depth_zero_is_black_and_depth_one_shows_emitters_only():
    """Set by the scene's integrator and by the option, which takes precedence."""
    upwards = lamp_over_floor()["lamp"] | {"to_world": np.eye(4)}  # in place of the floor, facing the camera
    alone = without(lamp_over_floor(), "floor") | {"lamp": upwards}
    dark = alone | {"integrator": {"type": "path", "max_depth": 0}}
    black = render(dark, spp=64, strategy="uniform").statistics
    assert (black.count == 64).all()
    assert (black.rgb == 0).all()
    lights = render(alone, spp=64, strategy="uniform", max_depth=1).statistics
    assert lights.mean.max() == pytest.approx(5.0 * (0.2126 + 0.8 * 0.7152 + 0.6 * 0.0722), rel=1e-6)
    assert lights.mean.min() == 0
    unseen = render(lamp_over_floor(), spp=64, strategy="uniform", max_depth=1).statistics
    assert (unseen.rgb == 0).all()  # the lamp faces away from the camera


def blinding_scene() -> dict:
    """A point light so near a tiny floor that its irradiance, 1e20, has no square in float32: legal, and not finite.

    Large shapes that nobody sees keep the scene from being rescaled.
    """
    scene = without(lamp_over_floor(), "lamp")
    scene["sensor"] = scene["sensor"] | {"near_clip": 1e-12, "far_clip": 1.0, "fov": 90.0}
    camera = np.eye(4)
    camera[:3, 3] = (0, 0, 2e-10)
    scene["sensor"]["to_world"] = camera @ np.diag([1.0, -1.0, -1.0, 1.0])
    scene["floor"] = scene["floor"] | {"to_world": np.diag([1e-10, 1e-10, 1.0, 1.0])}
    unseen = np.eye(4)
    unseen[2, 3] = -5.0
    scene |= {name: {"type": "rectangle", "to_world": unseen} for name in ("a", "b")}
    scene["sun"] = {"type": "point", "position": [0.0, 0.0, 1e-10], "intensity": 1.0}
    return scene


@pytest.mark.parametrize("strategy", ["uniform", "relative-median"])
def test_non_finite_samples_are_rejected(strategy):
    outcome = render(blinding_scene(), spp=50, size=(16, 16), strategy=strategy)
    statistics = outcome.statistics
    rejected = int(statistics.rejected.sum())
    assert rejected > 0
    assert statistics.samples + rejected == 50 * 256
    assert outcome.rows[-1].rejected == rejected
    assert statistics.rejected[8, 8] > 0  # the floor covers the middle
    assert statistics.count[8, 8] == 0
    assert statistics.rejected[0, 0] == 0  # but not the corner
    assert (statistics.rgb[8, 8] == 0).all()
    assert_sound(statistics)
    assert np.isposinf(outcome.error[8, 8])  # unknown


def test_rejected_samples_count_in_the_sample_index():
    """Otherwise the next wave would draw the same random numbers again, and samples would count twice."""
    renders = [
        render(blinding_scene(), spp=30, size=(16, 16), strategy=f"uniform:wave_spp={spp}").statistics
        for spp in (10, 30)
    ]
    assert ((renders[0].rejected > 0) & (renders[0].count > 0)).any()
    assert_same_bits(*renders)


def test_an_image_of_rejected_samples_only():
    scene = blinding_scene()
    scene["sensor"] = scene["sensor"] | {"fov": 1.0}
    outcome = render(scene, spp=30)
    assert outcome.reason == "spp"
    assert outcome.statistics.samples == 0
    assert outcome.rows[-1].rejected == 30 * PIXELS
    assert outcome.rows[-1].stated_p99 == np.inf


def test_a_wave_can_be_stopped():
    """After two slices of 192 samples pixels 0 to 11 have their 30 samples, pixel 12 has 24, the rest none."""
    progress = []
    renderer = Renderer(lamp_over_floor(), seed=3, strategy="relative-median:warmup=30", pool_size=12)

    def should_continue(samples: int) -> bool:
        progress.append(samples)
        return samples < 384

    record = renderer.step(should_continue=should_continue)
    assert (record.kind, record.samples, record.planned) == ("uniform", 384, 30 * PIXELS)
    assert progress == sorted(progress)
    statistics = renderer.statistics()
    complete = render(lamp_over_floor(), spp=30, seed=3, strategy="relative-median:warmup=30").statistics
    assert statistics.count.ravel().tolist() == [30] * 12 + [24] + [0] * 22
    for name, plane in statistics.planes().items():
        if name not in AVERAGES_OVER_PIXELS:
            expected = getattr(complete, name).reshape(PIXELS, -1)[:12]
            assert np.array_equal(plane.reshape(PIXELS, -1)[:12], expected), name
    assert_sound(statistics)
