"""The image comparison of references.py accepts correct images and rejects wrong ones."""

import numpy as np
import pytest
import references
from references import Estimate

SIDE, BATCHES = 64, 16


def draw(seed: int, truth: np.ndarray) -> np.ndarray:
    """Batches of images with standard normal noise."""
    return truth + np.random.default_rng(seed).standard_normal((BATCHES, *truth.shape))


@pytest.fixture
def truth() -> np.ndarray:
    return np.full((SIDE, SIDE, 3), 10.0)


def test_two_estimates_of_an_image_agree(truth, tmp_path):
    image, reference = (references.from_batches(draw(seed, truth)) for seed in (1, 2))
    scores = references.assert_agree(image, reference, tmp_path)
    references.assert_means_agree(image, reference)
    # 12,288 scores: their standard deviation is known to 0.6 %; Wallace's approximation adds up to 2 %
    assert abs(scores.std() - 1) < 0.03


def test_a_wrong_spot_fails_and_the_images_are_written(truth, tmp_path):
    wrong = truth.copy()
    wrong[:4, :4] += 5  # 0.4 % of the pixels, 14 standard errors
    image, reference = (references.from_batches(draw(seed, t)) for seed, t in ((1, wrong), (2, truth)))
    with pytest.raises(AssertionError, match=r"scores\.png"):
        references.assert_agree(image, reference, tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"image.exr", "reference.exr", "scores.exr", "scores.png"}


def test_a_small_bias_is_detected_in_blocks_and_means(truth, tmp_path):
    image, reference = (references.from_batches(draw(seed, t)) for seed, t in ((1, truth * 1.03), (2, truth)))
    references.assert_agree(image, reference, tmp_path)  # 0.8 standard errors of a pixel: not significant
    with pytest.raises(AssertionError, match="standard errors"):
        references.assert_agree(image.blocks(8), reference.blocks(8), tmp_path)
    with pytest.raises(AssertionError, match="image means"):
        references.assert_means_agree(image, reference)


def test_blocks_from_batches_and_of_standard_errors_agree(truth):
    batches = draw(1, truth)
    from_batches = references.from_batches(references.block_means(batches, 8))
    from_errors = references.from_batches(batches).blocks(8)
    np.testing.assert_allclose(from_errors.mean, from_batches.mean, rtol=1e-12)
    # 192 standard errors from 16 batches each: the mean of their squares is known to sqrt(2 / 15 / 192) = 2.6 %.
    assert abs((from_batches.se**2).mean() / (from_errors.se**2).mean() - 1) < 0.12


@pytest.mark.parametrize(
    ("t", "dof", "z"),
    # two-sided tails of 1e-4 and 1e-7: quantiles of Student's t and of the normal distribution with the same tail
    [(5.2391, 15, 3.8906), (9.4830, 15, 5.3267), (4.4824, 30, 3.8906), (6.9557, 30, 5.3267), (4.0340, 113, 3.8906)],
)
def test_scores_are_normal_deviates(t, dof, z):
    def one(value: float) -> np.ndarray:
        return np.full((1, 1, 1), value)

    scores = references.standard_scores(Estimate(one(t), one(1.0), dof), Estimate(one(0.0), one(0.0), 1))
    assert scores.item() == pytest.approx(z, rel=0.01)


def test_without_noise_only_rounding_errors_pass():
    image = Estimate(np.array([[[1.00005], [1.001], [0.0]]]), np.zeros((1, 3, 1)), 15)
    reference = Estimate(np.array([[[1.0], [1.0], [0.0]]]), np.zeros((1, 3, 1)), 15)
    assert references.standard_scores(image, reference).tolist() == [[[0.0], [np.inf], [0.0]]]
