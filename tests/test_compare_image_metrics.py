"""Metrics of a single image against closed forms, and FLIP against its authors' program on PNG files."""

import math

import numpy as np
import pytest

from isonoise.comparison import metrics
from isonoise.comparison.image_metrics import BiasMetric, flip, mean_square_error
from isonoise.comparison.reference_error import neighbour_mean
from isonoise.film.png import automatic_exposure, write_png
from isonoise.luminance import luminance
from isonoise.statistics import Statistics
from isonoise.strategies.measures import image_floor


def statistics_of(rgb, variance, count) -> Statistics:
    shape = rgb.shape[:2]
    return Statistics(
        count=np.full(shape, count, np.uint32),
        rejected=np.zeros(shape, np.uint32),
        rgb=rgb,
        mean=luminance(rgb).astype(np.float64),
        variance=np.full(shape, variance, np.float32),
        median=None,
    )


def test_mean_square_error_is_the_definition_in_float64():
    """Of float32 images near 4096, whose squares would lose all digits of the result in float32."""
    rng = np.random.default_rng(1)
    reference = rng.uniform(4096, 4097, (7, 9, 3)).astype(np.float32)
    image = (reference + rng.normal(scale=0.01, size=reference.shape)).astype(np.float32)
    squares = [(float(x) - float(r)) ** 2 for x, r in zip(image.flat, reference.flat, strict=True)]
    assert mean_square_error(image, reference) == pytest.approx(math.fsum(squares) / len(squares), rel=1e-13)
    assert mean_square_error(reference, reference) == 0


def test_bias_of_a_flat_image_in_closed_form():
    """A reference of 2 and an image of 2.1: the bias is 5 %, its standard error (s / sqrt n) / 2 / sqrt pixels."""
    reference, image = np.full((6, 8, 3), 2.0, np.float32), np.full((6, 8, 3), 2.1, np.float32)
    bias = BiasMetric(reference)(image, statistics_of(image, variance=0.25, count=16))
    assert bias.value == pytest.approx(0.05, rel=1e-6)
    assert bias.se == pytest.approx(0.5 / 4 / 2 / math.sqrt(48), rel=1e-6)
    assert bias.z == pytest.approx(bias.value / bias.se)
    se = np.full_like(reference, 0.3)
    with_reference = BiasMetric(reference, se)(image, statistics_of(image, variance=0.25, count=16))
    assert with_reference.se == pytest.approx(math.hypot(0.5 / 4, 0.3) / 2 / math.sqrt(48), rel=1e-6)


def test_bias_equals_that_over_the_seeds_of_the_summary():
    rng = np.random.default_rng(2)
    reference = rng.lognormal(size=(12, 15, 3)).astype(np.float32)
    image = (reference * rng.uniform(0.5, 1.6, reference.shape)).astype(np.float32)
    r = luminance(reference)
    floor = image_floor(r)
    scale = np.maximum(r, floor)
    weight = scale / np.maximum(neighbour_mean(r), floor)
    error = ((luminance(image) - r) / scale)[None]
    assert BiasMetric(reference)(image).value == pytest.approx(metrics.bias(error, weight).value, rel=1e-6)


def test_z_of_unbiased_images_is_standard_normal():
    """300 images with normal noise against noisy references: variance 1 within 4 standard errors, sqrt(2 / 300)."""
    rng = np.random.default_rng(3)
    true = rng.uniform(0.5, 1.5, (10, 12, 1)) * np.ones(3)
    z = []
    for _ in range(300):
        se = np.full(true.shape, 0.05)
        reference = true + 0.05 * rng.normal(size=(10, 12, 1))
        image = (true + 0.2 * rng.normal(size=(10, 12, 1))).astype(np.float32)
        z.append(BiasMetric(reference, se)(image, statistics_of(image, variance=4 * 0.04, count=4)).z)
    assert abs(np.mean(z)) < 4 / math.sqrt(300)
    assert np.var(z) == pytest.approx(1, abs=4 * math.sqrt(2 / 300))


def test_bias_without_scale_or_statistics():
    black, white = np.zeros((3, 4, 3), np.float32), np.ones((3, 4, 3), np.float32)
    assert BiasMetric(black)(white).value == 0  # a black reference has no scale
    assert math.isnan(BiasMetric(white)(black).se)
    assert BiasMetric(white)(black).value == -1
    single = BiasMetric(white)(black, statistics_of(black, variance=0, count=1))  # no variance is known
    assert math.isnan(single.se)
    assert math.isnan(single.z)


def test_flip_is_that_of_the_png_files_with_the_exposure_of_the_reference(tmp_path):
    flip_evaluator = pytest.importorskip("flip_evaluator", reason="flip-evaluator is in the extra 'flip'")
    rng = np.random.default_rng(4)
    reference = rng.lognormal(size=(24, 32, 3)).astype(np.float32)
    image = (reference * rng.uniform(0.5, 1.5, reference.shape)).astype(np.float32)
    names = [str(tmp_path / name) for name in ("reference.png", "image.png")]
    for name, pixels in zip(names, (reference, image), strict=True):
        write_png(name, pixels, automatic_exposure(reference))
    expected = flip_evaluator.evaluate(*names, "LDR", applyMagma=False)[1]
    found = flip(image, reference)
    assert found == pytest.approx(expected, rel=1e-5)
    assert found > 0.05
    assert flip(reference, reference) == 0
    assert flip(64 * image, 64 * reference) == pytest.approx(found, rel=1e-6)  # the exposure follows the reference


def test_flip_grows_with_the_error():
    pytest.importorskip("flip_evaluator", reason="flip-evaluator is in the extra 'flip'")
    rng = np.random.default_rng(5)
    reference = rng.uniform(0.3, 0.8, (16, 16, 3)).astype(np.float32)
    noise = rng.normal(size=reference.shape)
    values = [flip((reference + size * noise).astype(np.float32), reference) for size in (0.01, 0.05, 0.2)]
    assert 0 < values[0] < values[1] < values[2] < 1
