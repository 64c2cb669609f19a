"""Error estimates without a reference: the stated error of the image, and the error of every pixel.

The render loop calls `stated_error` after every wave, `film.output` writes `relative_standard_error`.
"""

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from isonoise.error.shrinkage import TILE_SIZE, shrunk_relative_variance
from isonoise.statistics import Statistics
from isonoise.strategies.measures import confidence, image_floor, relative_mean

HISTOGRAM_STRIP_PIXELS = 2**17
"""Pixels processed at a time, so that the temporary arrays stay in the cache."""
OCTAVES = 32
"""The histogram of errors covers 2^-32 to 2^32."""
BINS_PER_OCTAVE = 32
"""Quantiles are interpolated between bins: good to 1e-4."""


def stated_error(statistics: Statistics, quantiles: Sequence[float], floor: float | None = None) -> np.ndarray:
    """The stated error at each quantile q, an estimate of the quantile q of |x - r| / max(r, floor), r the true image.

    It is the e at which the mean over the pixels of P(|Z| sigma_i / scale_i <= e) is q, with Z standard normal, sigma_i
    the shrunk standard error of the pixel's luminance (`shrinkage`), and

        scale_i = max(mean_i, floor), mean_i the smoothed mean of the pixel's luminance (`shrinkage`).

    Parameters
    ----------
    statistics : Statistics
        Of the image.
    quantiles : sequence of float
        In (0, 1).
    floor : float or None
        None: `image_floor` of the image.

    Returns
    -------
    1-D float64
        One error per quantile. Pixels with fewer than two samples may have any error: with a share of 1 - q of them or
        more the result is inf. Noiseless pixels have the error 0: with a share of q of them or more it is 0.

    Raises
    ------
    ValueError
        If a quantile is not in (0, 1).

    Notes
    -----
    Limits: (1) What no sample has hit is unknown: fireflies that hit fewer than one in 16x16 pixels make the error
    larger than stated. (2) For skewed samples x - r is not normal, so with few samples per pixel the definition itself
    differs from the true quantiles (exponential samples, n = 4: 15 % below at q = 0.99; one sample in a few hundred
    with most of the energy, n = 16: 2 to 4 times above). (3) Noisy variances cannot be told from variances that jump at
    random from pixel to pixel (if their logarithm jumps by 1.4, p50 is 30 % too high at n = 4 and 13 % at n = 16).
    """
    if not all(0 < q < 1 for q in quantiles):
        raise ValueError(f"quantiles must be in (0, 1), not {list(quantiles)}")
    floor = image_floor(statistics.mean) if floor is None else floor
    known = int(np.count_nonzero(statistics.count >= 2))
    pixels = statistics.count.size
    if floor > 0:
        noiseless, histogram = _error_histogram(statistics, floor)
    else:  # black image: pixels are exact where all samples are 0; elsewhere there is no scale for the error
        noiseless = int(np.count_nonzero((statistics.count >= 2) & (statistics.variance == 0)))
        histogram = np.zeros(2 * OCTAVES * BINS_PER_OCTAVE + 1)
        known = noiseless
    return np.array([_quantile(q * pixels, noiseless, histogram, known) for q in quantiles])


def relative_standard_error(statistics: Statistics, floor: float) -> np.ndarray:
    """se / max(mean, floor) of every pixel's luminance, not shrunk, (height, width) float32; inf where n < 2."""
    return relative_mean(statistics, floor).astype(np.float32)


def half_width_95(statistics: Statistics) -> np.ndarray:
    """Half the width of every pixel's 95 % confidence interval, (height, width) float64; inf where n < 2.

    Student's t at n - 1 degrees of freedom times the standard error of the luminance, in the scene's units.
    """
    return confidence(statistics, significance=0.05)


def _error_histogram(statistics: Statistics, floor: float) -> tuple[int, np.ndarray]:
    """The number of noiseless pixels; the others over log2 of the relative error, each split between two bins."""
    height, width = statistics.shape
    rows = max(1, HISTOGRAM_STRIP_PIXELS // (TILE_SIZE * max(TILE_SIZE, width))) * TILE_SIZE
    size = 2 * OCTAVES * BINS_PER_OCTAVE + 1
    histogram = np.zeros(size)
    noiseless = 0
    for top in range(0, height, rows):
        strip = np.s_[top : top + rows]
        variance = shrunk_relative_variance(statistics, strip, floor)
        noisy = variance[variance > 0]
        noiseless += variance.size - noisy.size
        position = np.log2(noisy, out=noisy)
        position *= BINS_PER_OCTAVE / 2  # half: of the variance's root
        position += OCTAVES * BINS_PER_OCTAVE
        np.clip(position, 0, size - 1.001, out=position)
        left = position.astype(np.intp)
        position -= left
        right_weight = np.bincount(left, weights=position, minlength=size)
        histogram += np.bincount(left, minlength=size) - right_weight
        histogram[1:] += right_weight[:-1]
    return noiseless, histogram


def _quantile(pixels: float, noiseless: int, histogram: np.ndarray, known: int) -> float:
    """The e for which the expected number of pixels with a smaller error is `pixels`."""
    if pixels <= noiseless:
        return 0.0
    if pixels >= known:
        return math.inf
    half = OCTAVES * BINS_PER_OCTAVE
    probability = _half_normal_cdf()

    def expected_below(error_bin: int) -> float:
        return noiseless + float(histogram @ probability[half * 2 - error_bin : half * 4 + 1 - error_bin])

    low, high = 0, 2 * half
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if expected_below(middle) < pixels else (low, middle)
    below, above = expected_below(low), expected_below(high)
    fraction = min(max((pixels - below) / (above - below), 0.0), 1.0) if above > below else 0.0
    return 2.0 ** ((low + fraction - half) / BINS_PER_OCTAVE)


@lru_cache(maxsize=1)
def _half_normal_cdf() -> np.ndarray:
    """P(|Z| <= 2^(k / BINS_PER_OCTAVE)), k from the largest to the smallest difference of two bins."""
    half = OCTAVES * BINS_PER_OCTAVE
    return np.array([math.erf(2.0 ** (k / BINS_PER_OCTAVE) / math.sqrt(2)) for k in range(2 * half, -2 * half - 1, -1)])
