"""The error that the renderer states: quantiles of the relative error over the image, and single pixels' intervals."""

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from isonoise.error.shrinkage import BLOCK, denoised_relative_variance
from isonoise.statistics import Statistics
from isonoise.strategies.measures import confidence, image_floor, relative_mean

STRIP = 2**17  # pixels worked on at a time, so that what lies between the steps stays in the cache
OCTAVES = 32  # errors are resolved from 2^-32 to 2^32
BINS = 32  # per octave; quantiles are interpolated and good to 1e-4


def stated_error(statistics: Statistics, quantiles: Sequence[float], floor: float | None = None) -> np.ndarray:
    """The stated error at each quantile q: the e for which the mean over the pixels of

        P(|Z| sigma_i / max(mean_i, floor) <= e)

    is q, with Z standard normal and sigma_i the standard error of the pixel's luminance, freed of its own noise
    (`shrinkage`). It is what |x - r| / max(r, floor) should show at q.

    - `quantiles`: in (0, 1).
    - `floor`: `image_floor` of the image unless given.

    Returns float64, one for each quantile. A pixel of fewer than two samples may have any error: with a share of 1 - q
    of them or more the result is inf. Noiseless pixels have the error 0: with a share of q of them or more it is 0.

    What it cannot do: see what no sample has seen (fireflies that hit fewer than one in 16x16 pixels make the error
    larger than stated); make |x - r| normal where the samples are skewed, so that at few samples a pixel the definition
    itself lies beside the true quantiles (exponential samples, n = 4: 15 % below at q = 0.99; one sample in a few
    hundred carrying most of the energy, n = 16: 2 to 4 times above); tell noisy variances from variances that jump at
    random from pixel to pixel (their logarithm by 1.4: p50 comes out 30 % above at n = 4 and 13 % at n = 16).
    Raises ValueError if a quantile is not in (0, 1).
    """
    if not all(0 < q < 1 for q in quantiles):
        raise ValueError(f"quantiles are in (0, 1), not {list(quantiles)}")
    floor = image_floor(statistics.mean) if floor is None else floor
    known = int(np.count_nonzero(statistics.count >= 2))
    pixels = statistics.count.size
    if floor > 0:
        noiseless, histogram = _histogram(statistics, floor)
    else:  # black: exact where all samples were 0, and without a scale to measure anything else
        noiseless = int(np.count_nonzero((statistics.count >= 2) & (statistics.variance == 0)))
        histogram = np.zeros(2 * OCTAVES * BINS + 1)
        known = noiseless
    return np.array([_quantile(q * pixels, noiseless, histogram, known) for q in quantiles])


def relative_standard_error(statistics: Statistics, floor: float) -> np.ndarray:
    """se / max(mean, floor) of every pixel's luminance as it is measured, float32 (height, width); inf where n < 2."""
    return relative_mean(statistics, floor).astype(np.float32)


def half_width_95(statistics: Statistics) -> np.ndarray:
    """Half-width of the 95 % confidence interval of every pixel's luminance: Student's t at n - 1 degrees of freedom
    times se. Float64 (height, width), in the image's units; inf where n < 2."""
    return confidence(statistics, significance=0.05)


def _histogram(statistics: Statistics, floor: float) -> tuple[int, np.ndarray]:
    """Noiseless pixels, and the pixels with noise over the logarithm of the relative error, split between two bins."""
    height, width = statistics.shape
    rows = max(1, STRIP // (BLOCK * max(BLOCK, width))) * BLOCK
    size = 2 * OCTAVES * BINS + 1
    histogram = np.zeros(size)
    noiseless = 0
    for top in range(0, height, rows):
        part = np.s_[top : top + rows]
        freed = denoised_relative_variance(
            statistics.count[part], statistics.mean[part], statistics.variance[part], floor
        )
        noisy = freed[freed > 0]
        noiseless += freed.size - noisy.size
        at = np.log2(noisy, out=noisy)
        at *= BINS / 2
        at += OCTAVES * BINS
        np.clip(at, 0, size - 1.001, out=at)
        left = at.astype(np.intp)
        at -= left
        right = np.bincount(left, weights=at, minlength=size)
        histogram += np.bincount(left, minlength=size) - right
        histogram[1:] += right[:-1]
    return noiseless, histogram


def _quantile(pixels: float, noiseless: int, histogram: np.ndarray, known: int) -> float:
    """The e up to which the expected number of pixels with a smaller error is `pixels`."""
    if pixels <= noiseless:
        return 0.0
    if pixels >= known:
        return math.inf
    half = OCTAVES * BINS
    normal = _half_normal()

    def expected(bin_of_e: int) -> float:
        return noiseless + float(histogram @ normal[half * 2 - bin_of_e : half * 4 + 1 - bin_of_e])

    low, high = 0, 2 * half
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if expected(middle) < pixels else (low, middle)
    below, above = expected(low), expected(high)
    within = min(max((pixels - below) / (above - below), 0.0), 1.0) if above > below else 0.0
    return 2.0 ** ((low + within - half) / BINS)


@lru_cache(maxsize=1)
def _half_normal() -> np.ndarray:
    """P(|Z| <= 2^(k / BINS)), k from the largest to the smallest difference of two bins."""
    half = OCTAVES * BINS
    return np.array([math.erf(2.0 ** (k / BINS) / math.sqrt(2)) for k in range(2 * half, -2 * half - 1, -1)])
