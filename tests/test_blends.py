"""Blends under next-event estimation: both parts are evaluated where that is cheap, and the result is unbiased."""

import math

import numpy as np
import pytest

from isonoise.render_scene import render
from isonoise.scene import compile_scene, load_description, structs
from isonoise.scene.material.bsdf_kinds import bsdf_bits
from isonoise.selftest.scenes import look_at, rgb

RED, BLUE = ({"type": "diffuse", "reflectance": rgb(colour)} for colour in ((0.8, 0.1, 0.1), (0.1, 0.2, 0.6)))
GOLD = {"type": "roughconductor", "alpha": 0.3, "material": "Au", "distribution": "ggx"}
MIRROR, GLASS = {"type": "conductor"}, {"type": "roughdielectric", "alpha": 0.3}


def two_sided(bsdf: dict) -> dict:
    return {"type": "twosided", "inside": bsdf}


def blend(first: dict, second: dict, weight=0.25) -> dict:
    return {"type": "blendbsdf", "weight": weight, "a": first, "b": second}


def scene_of_floor(bsdf: dict, light: dict, max_depth: int = 2) -> dict:
    """A floor at z = 0, seen from above."""
    film = {"type": "hdrfilm", "width": 12, "height": 12, "rfilter": {"type": "box"}}
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": max_depth},
        "sensor": {"type": "perspective", "fov": 30.0, "to_world": look_at((0, -1, 3), (0, 0, 0)), "film": film},
        "floor": {"type": "rectangle", "bsdf": bsdf},
        **light,
    }


@pytest.mark.parametrize(
    ("parts", "both"),
    [
        ((RED, GOLD), True),
        ((RED, MIRROR), True),
        ((two_sided(RED), two_sided(GOLD)), True),
        ((GLASS, {"type": "dielectric"}), True),
        ((RED, two_sided(GOLD)), False),  # seen from behind only one is there
        ((RED, GLASS), False),  # light from behind counts for one only
        ((RED, {"type": "null"}), False),
        ((RED, blend(BLUE, RED)), False),
    ],
    ids=str,
)
def test_both_parts_are_evaluated_if_they_scatter_the_light_of_the_same_side(parts, both):
    bsdfs = compile_scene(load_description(scene_of_floor(blend(*parts), {}))).bsdfs
    assert bsdfs["kind"][-1] == bsdf_bits("blend")
    assert bool(bsdfs["flags"][-1] & structs.BSDF_EVALUATE_BOTH) == both


@pytest.mark.long
def test_a_blend_under_a_point_light_has_no_noise_of_its_own():
    """The closed form of two diffuse parts; samples of a pixel differ by their place in it alone, by a few per cent."""
    light = {"light": {"type": "point", "position": [0.0, 0.0, 4.0], "intensity": math.pi}}
    statistics = render(scene_of_floor(blend(RED, BLUE), light), spp=64, sampler="independent").statistics
    centre = statistics.rgb[5:7, 5:7].mean(axis=(0, 1))
    expected = 0.75 * np.array(RED["reflectance"]["value"]) + 0.25 * np.array(BLUE["reflectance"]["value"])
    assert centre == pytest.approx(expected / 16, rel=5e-3)
    assert (np.sqrt(statistics.variance) < 0.05 * statistics.mean).all()


@pytest.mark.long
@pytest.mark.parametrize("parts", [(RED, GOLD), (GOLD, MIRROR), (GLASS, {"type": "dielectric"})], ids=["1", "2", "3"])
def test_direct_light_of_a_blend_is_the_weighted_sum(parts):
    """Lights that samples of the BSDF find too. Image means of 16 renders: 5 standard errors, 1e-5 false alarms."""
    lamp = {"type": "sphere", "center": [0.4, 0.6, 1.5], "radius": 0.3, "emitter": {"type": "area", "radiance": 9.0}}
    light = {"lamp": lamp, "sky": {"type": "constant", "radiance": 0.3}}

    def means(bsdf: dict) -> np.ndarray:
        scene = load_description(scene_of_floor(bsdf, light))
        images = [render(scene, spp=32, seed=s, sampler="independent").statistics.rgb for s in range(16)]
        return np.mean(images, axis=(1, 2), dtype=float)

    first, second, both = means(parts[0]), means(parts[1]), means(blend(*parts))
    difference = both - (0.75 * first + 0.25 * second)
    error = np.sqrt(both.var(axis=0) + 0.75**2 * first.var(axis=0) + 0.25**2 * second.var(axis=0)) / math.sqrt(15)
    assert (np.abs(difference.mean(axis=0)) < 5 * error + 1e-6).all()
