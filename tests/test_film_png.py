"""Tone mapping: exposure, curve, monotony, black and invalid pixels."""

import numpy as np
import pytest

from isonoise.film.output import write_image
from isonoise.film.png import MIDDLE_GREY, SHOULDER, tone_map


def srgb(value):
    """IEC 61966-2-1 for one value above its linear part, as 8 bits."""
    return round(255 * (1.055 * value ** (1 / 2.4) - 0.055))


def grey(luminance):
    return np.repeat(np.asarray(luminance, np.float32)[..., None], 3, axis=-1)


def test_a_constant_image_becomes_middle_grey():
    for level in (1e-20, 0.3, 1.0, 4e10):
        assert np.unique(tone_map(grey(np.full((3, 5), level)))).tolist() == [srgb(MIDDLE_GREY)]


@pytest.mark.parametrize("scale", [2.0**-60, 0.5, 2.0**40])
def test_exposure_follows_the_scale(scale):
    rgb = np.random.default_rng(1).lognormal(0, 2, (32, 20, 3)).astype(np.float32)
    np.testing.assert_array_equal(tone_map(rgb * np.float32(scale)), tone_map(rgb))


def test_the_curve_is_linear_below_the_shoulder_and_smooth_above():
    # the two outer pixels of each triple balance each other: the log-average is 1 and `display` is v * MIDDLE_GREY
    display = np.array([0.05, SHOULDER, SHOULDER + 1e-3, 0.9, 5.0])
    level = display / MIDDLE_GREY
    image = grey(np.stack([level, 1 / level]))
    mapped = tone_map(image)[0, :, 0]
    above = np.maximum(display - SHOULDER, 0) / (1 - SHOULDER)
    expected = np.minimum(display, SHOULDER) + (1 - SHOULDER) * (1 - np.exp(-above))
    assert np.abs(mapped.astype(int) - [srgb(value) for value in expected]).max() <= 1  # 1: rounding in float32
    assert mapped[-1] == 255


def test_the_curve_is_monotonic_over_twenty_decades():
    mapped = tone_map(grey(np.logspace(-10, 10, 1000)[None]))
    assert (np.diff(mapped[0, :, 0].astype(int)) >= 0).all()
    assert mapped.min() == 0
    assert mapped.max() == 255


def test_black_background_and_fireflies_hardly_change_the_exposure():
    lit = np.random.default_rng(2).uniform(0.5, 2, (10, 10))
    framed = np.zeros((40, 40))
    framed[:10, :10] = lit
    np.testing.assert_array_equal(tone_map(grey(framed))[:10, :10], tone_map(grey(lit)))
    bright = grey(np.pad(lit, 20, constant_values=1.0))
    struck = bright.copy()
    struck[0, 0] = 1e4
    assert np.abs(tone_map(bright)[1:].astype(int) - tone_map(struck)[1:]).max() <= 1


def test_black_and_invalid_pixels():
    assert not tone_map(np.zeros((2, 3, 3), np.float32)).any()
    image = grey(np.ones((2, 2)))
    image[0, 0] = [np.nan, np.inf, -1]
    mapped = tone_map(image)
    assert mapped[0, 0].tolist() == [0, 0, 0]
    assert mapped[1, 1].tolist() == [srgb(MIDDLE_GREY)] * 3
    assert tone_map(grey([[1e-30, 3e38]])).tolist()[0][1] == [255] * 3


def test_the_file_contains_the_tone_mapped_image(tmp_path):
    from PIL import Image

    rgb = np.random.default_rng(3).lognormal(0, 1, (7, 13, 3)).astype(np.float32)
    for name in ("a.png", "b.PNG"):
        write_image(tmp_path / name, {"": rgb}, {})
    with Image.open(tmp_path / "a.png") as picture:
        assert picture.mode == "RGB"
        np.testing.assert_array_equal(np.asarray(picture), tone_map(rgb))
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.PNG").read_bytes()


@pytest.mark.parametrize(("share", "is_limited"), [(0.2, True), (0.05, False)])
def test_a_bright_object_before_a_dark_background_is_not_white(share, is_limited):
    """Within a tenth of the pixels highlights may exceed the limit."""
    brightness = np.ones(1000)
    brightness[: int(1000 * share)] = 1000.0
    mapped = tone_map(grey(brightness[None]))[0, 0, 0]
    limit = SHOULDER + (1 - SHOULDER) * -np.expm1(-(1 - SHOULDER) / (1 - SHOULDER))
    assert (mapped == srgb(limit)) == is_limited


def test_a_given_exposure_replaces_the_automatic_one():
    mapped = tone_map(grey([[0.1, 0.4, 0.5]]), exposure=0.5)[0, :, 0]
    assert mapped.tolist() == [srgb(0.05), srgb(0.2), srgb(0.25)]
