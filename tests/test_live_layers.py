"""Pictures of the live page: units, reduction, exposure and scales, from their bytes."""

import numpy as np
import pytest
from live_client import decode

from isonoise.film.png import tone_map
from isonoise.live.layers import encode_image, encode_map

HALF_PRECISION = 2**-11


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e7])
def test_an_image_keeps_its_values_whatever_its_unit(scale):
    rgb = (scale * np.random.default_rng(3).uniform(0.01, 2.0, (5, 7, 3))).astype(np.float32)
    facts, values = decode(encode_image(rgb, 42))
    np.testing.assert_allclose(values, rgb.transpose(2, 0, 1), rtol=HALF_PRECISION)
    assert (facts["version"], facts["reduction"], facts["width"], facts["height"]) == (42, 1, 7, 5)


def test_the_exposure_is_that_of_a_png():
    """The page multiplies by `exposure`, and so does `tone_map` if it is given."""
    rgb = np.random.default_rng(4).uniform(0.0, 9.0, (6, 8, 3)).astype(np.float32)
    exposure = decode(encode_image(rgb, 1))[0]["exposure"]
    np.testing.assert_array_equal(tone_map(rgb, exposure), tone_map(rgb))
    assert decode(encode_image(rgb, 1, exposure=0.25))[0]["exposure"] == 0.25


def test_bright_pixels_stay_finite_and_what_is_not_finite_harms_nothing():
    rgb = np.full((4, 4, 3), 0.5, np.float32)
    rgb[0, 0], rgb[1, 1], rgb[2, 2] = 1e9, np.nan, np.inf
    _, values = decode(encode_image(rgb, 1))
    assert np.isfinite(values[:, 0, 0]).all()
    assert (values[:, 0, 0] > 1e4).all()
    np.testing.assert_allclose(values[:, 3, 3], 0.5)


def test_a_reduced_picture_has_the_means_of_blocks():
    rgb = np.random.default_rng(5).uniform(0.1, 1.0, (7, 8, 3)).astype(np.float32)
    facts, values = decode(encode_image(rgb, 1, reduction=3))
    means = rgb[:6, :6].astype(float).reshape(2, 3, 2, 3, 3).mean(axis=(1, 3)).transpose(2, 0, 1)
    np.testing.assert_allclose(values, means, rtol=2 * HALF_PRECISION)
    assert facts["reduction"] == 3
    assert decode(encode_image(rgb, 1, reduction=16))[0]["reduction"] == 7  # of so small an image


def test_maps_show_counts_beyond_float16_and_unknown_errors():
    count = np.full((20, 20), 3_000_000, np.uint32)
    count[0] = 1_000_000
    facts, values = decode(encode_map(count, 1))
    np.testing.assert_allclose(values[0], count, rtol=HALF_PRECISION)
    assert facts["range"] == [1_000_000, 3_000_000]
    count[1:] = 1
    assert decode(encode_map(count, 1))[0]["range"] == [1_000, 1_000_000]
    error = np.full((4, 5), np.inf, np.float32)
    facts, values = decode(encode_map(error, 1))
    assert np.isinf(values).all()
    assert facts["range"] == [1, 1]
    error[1] = 0.02
    facts, values = decode(encode_map(error, 1))
    assert facts["range"] == pytest.approx([0.02, 0.02])
    np.testing.assert_allclose(values[0, 1], 0.02, rtol=HALF_PRECISION)
