"""Error estimates without a reference: the stated error of the image, and the error of every pixel.

The render loop calls `stated_error` after every wave, `film.output` writes `relative_standard_error`.
"""

import math
from collections.abc import Iterator, Sequence
from functools import lru_cache

import numpy as np

from isonoise.error.shrinkage import TILE_SIZE, relative_errors, shrunk_variance_of_mean
from isonoise.statistics import Statistics
from isonoise.strategies.measures import image_floor, relative_mean
from isonoise.student_t import quantile

HISTOGRAM_STRIP_PIXELS = 2**17
"""Pixels processed at a time, so that the temporary arrays stay in the cache."""
OCTAVES = 32
"""The histogram of errors covers 2^-32 to 2^32."""
BINS_PER_OCTAVE = 32
"""Quantiles are interpolated between bins: good to 1e-4."""
NORMAL_BINS = 8
"""Bins of the square root of the error's normal share."""


def stated_error(statistics: Statistics, quantiles: Sequence[float], floor: float | None = None) -> np.ndarray:
    """The stated error at each quantile q, an estimate of the quantile q of |x - r| / max(r, floor), r the true image.

    It is the e at which the mean over the pixels of P(|deviation_i + sqrt(v_i) Z| / scale_i <= e) is q, with Z standard
    normal and

        deviation_i = x_i - mean_i, mean_i the smoothed mean of the pixel's luminance,
        v_i the variance of the smoothed mean, scale_i = max(mean_i, floor) (all: `shrinkage`).

    Where no neighbours are alike, the deviation is 0 and v_i the squared standard error.

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
    larger than stated. (2) Of skewed samples, x - r is not normal where no neighbours are alike, and the largest
    deviations are smoothed too little (one sample in 100 with all the light, n = 16 and 64: p99 is 20 % and 12 % too
    low, p95 5 % too high). (3) Noise is assumed to be smooth or in
    proportion to the luminance. If its logarithm jumps at random from pixel to pixel by 0.7, p50 is 15 to 20 % too
    high, p95 and p99 right; by 1.4, p50 is two to three times too high, and p99 four times at n = 4, 1.4 times at 16.
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
        histogram = np.zeros((NORMAL_BINS + 1, 2 * OCTAVES * BINS_PER_OCTAVE + 1))
        known = noiseless
    return np.array([_quantile(q * pixels, noiseless, histogram, known) for q in quantiles])


def relative_standard_error(statistics: Statistics, floor: float) -> np.ndarray:
    """se / max(mean, floor) of every pixel's luminance, not shrunk, (height, width) float32; inf where n < 2."""
    return relative_mean(statistics, floor).astype(np.float32)


def half_width_95(statistics: Statistics) -> np.ndarray:
    """Half the width of every pixel's 95 % confidence interval, (height, width) float64; inf where n < 2.

    Student's t times the standard error of the luminance, in the scene's units, with the variances shrunk towards those
    of the neighbours (`shrinkage`). So the interval of a pixel that has not seen a rare bright sample knows of those
    that its neighbours have seen.
    """
    result = np.empty(statistics.shape)
    floor = image_floor(statistics.mean) or 1.0  # a black image has no scale, and needs none
    for strip in _strips(*statistics.shape):
        variance, dof = shrunk_variance_of_mean(statistics, strip, floor)
        np.sqrt(variance, out=result[strip])
        result[strip] *= quantile(0.975, dof.astype(np.int64))
    return result


def _strips(height: int, width: int) -> Iterator[slice]:
    """Rows of whole tiles that are processed at a time."""
    rows = max(1, HISTOGRAM_STRIP_PIXELS // (TILE_SIZE * max(TILE_SIZE, width))) * TILE_SIZE
    return (slice(top, min(top + rows, height)) for top in range(0, height, rows))


def _error_histogram(statistics: Statistics, floor: float) -> tuple[int, np.ndarray]:
    """The number of noiseless pixels; the others over the error's normal share and log2 of its root mean square.

    Each pixel is split between two neighbouring bins of the root mean square.
    """
    size = 2 * OCTAVES * BINS_PER_OCTAVE + 1
    histogram = np.zeros((NORMAL_BINS + 1) * size)
    noiseless = 0
    for strip in _strips(*statistics.shape):
        square, normal_share = relative_errors(statistics, strip, floor)
        noisy = square > 0
        if not noisy.all():
            noiseless += square.size - int(np.count_nonzero(noisy))
            square, normal_share = square[noisy], normal_share[noisy]
        position = np.log2(square, out=square)
        position *= BINS_PER_OCTAVE / 2  # half: of the square's root
        position += OCTAVES * BINS_PER_OCTAVE
        np.clip(position, 0, size - 1.001, out=position)
        normal_bin = np.sqrt(normal_share, out=normal_share)
        normal_bin *= NORMAL_BINS
        normal_bin += 0.5
        left = position.astype(np.intp)
        position -= left
        left += size * normal_bin.astype(np.intp)
        right_weight = np.bincount(left, weights=position, minlength=histogram.size)
        histogram += np.bincount(left, minlength=histogram.size) - right_weight
        histogram[1:] += right_weight[:-1]
    return noiseless, histogram.reshape(NORMAL_BINS + 1, size)


def _quantile(pixels: float, noiseless: int, histogram: np.ndarray, known: int) -> float:
    """The e for which the expected number of pixels with a smaller error is `pixels`."""
    if pixels <= noiseless:
        return 0.0
    if pixels >= known:
        return math.inf
    half = OCTAVES * BINS_PER_OCTAVE
    occupied = np.flatnonzero(histogram.any(axis=0))
    begin, end = occupied[0], occupied[-1] + 1
    histogram, probability = histogram[:, begin:end], _error_cdf()

    def expected_below(error_bin: int) -> float:
        window = probability[:, 2 * half - error_bin + begin : 2 * half - error_bin + end]
        return noiseless + float(np.einsum("ij,ij->", histogram, window))

    low, high = 0, 2 * half
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if expected_below(middle) < pixels else (low, middle)
    below, above = expected_below(low), expected_below(high)
    fraction = min(max((pixels - below) / (above - below), 0.0), 1.0) if above > below else 0.0
    return 2.0 ** ((low + fraction - half) / BINS_PER_OCTAVE)


@lru_cache(maxsize=1)
def _error_cdf() -> np.ndarray:
    """P(|sqrt(1 - u) + sqrt(u) Z| <= 2^(k / BINS_PER_OCTAVE)) for every bin of the normal share u.

    k runs from the largest to the smallest difference of two bins.
    """
    half = OCTAVES * BINS_PER_OCTAVE
    limits = [2.0 ** (k / BINS_PER_OCTAVE) for k in range(2 * half, -2 * half - 1, -1)]
    table = [[float(limit >= 1) for limit in limits]]
    for normal_bin in range(1, NORMAL_BINS + 1):
        sd = normal_bin / NORMAL_BINS
        deviation, unit = math.sqrt(1 - sd * sd), math.sqrt(2) * sd
        table.append(
            [0.5 * (math.erf((limit - deviation) / unit) + math.erf((limit + deviation) / unit)) for limit in limits]
        )
    return np.array(table)
