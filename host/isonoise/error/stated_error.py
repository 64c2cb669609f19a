"""Error estimates without a reference: the stated error of the image, and the error of every pixel.

The render loop calls `stated_error` after every wave, `film.output` writes `relative_standard_error`.
"""

from collections.abc import Sequence

import numpy as np

from isonoise.error.distribution import NORMAL_BINS, ErrorDistribution, histogram_position
from isonoise.error.shrinkage import TILE_SIZE, relative_errors, shrunk_variance_of_mean
from isonoise.statistics import Statistics
from isonoise.strategies.measures import image_floor, relative_mean
from isonoise.strips import row_strips
from isonoise.student_t import quantile

HISTOGRAM_STRIP_PIXELS = 2**17
"""Pixels processed at a time, so that the temporary arrays stay in the cache."""


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
    floor = image_floor(statistics.mean) if floor is None else floor
    return error_distribution(statistics, floor).quantiles(quantiles)


def error_distribution(statistics: Statistics, floor: float) -> ErrorDistribution:
    """The distribution of which `stated_error` takes quantiles. `Renderer.error_distribution` computes it faster."""
    result = ErrorDistribution(statistics.count.size)
    if (
        not floor > 0
    ):  # black image: pixels are exact where all samples are 0; elsewhere there is no scale for the error
        result.noiseless = int(np.count_nonzero((statistics.count >= 2) & (statistics.variance == 0)))
        return result
    for strip in row_strips(statistics.shape, HISTOGRAM_STRIP_PIXELS, TILE_SIZE):
        square, normal_share = relative_errors(statistics, strip, floor)
        noisy = square > 0
        if not noisy.all():
            result.noiseless += square.size - int(np.count_nonzero(noisy))
            square, normal_share = square[noisy], normal_share[noisy]
        normal_bin = np.sqrt(normal_share, out=normal_share)
        normal_bin *= NORMAL_BINS
        normal_bin += 0.5
        result.add(histogram_position(square), normal_bin.astype(np.intp))
    return result


def relative_standard_error(statistics: Statistics, floor: float) -> np.ndarray:
    """se / max(mean, floor) of every pixel's luminance, not shrunk, (height, width) float32; inf where n < 2."""
    result = np.empty(statistics.shape, np.float32)
    for strip in row_strips(statistics.shape, HISTOGRAM_STRIP_PIXELS):
        result[strip] = relative_mean(statistics, floor, strip)
    return result


def half_width_95(statistics: Statistics) -> np.ndarray:
    """Half the width of every pixel's 95 % confidence interval, (height, width) float64; inf where n < 2.

    Student's t times the standard error of the luminance, in the scene's units, with the variances shrunk towards those
    of the neighbours (`shrinkage`). So the interval of a pixel that has not seen a rare bright sample knows of those
    that its neighbours have seen.
    """
    result = np.empty(statistics.shape)
    floor = image_floor(statistics.mean) or 1.0  # a black image has no scale, and needs none
    for strip in row_strips(statistics.shape, HISTOGRAM_STRIP_PIXELS, TILE_SIZE):
        variance, dof = shrunk_variance_of_mean(statistics, strip, floor)
        np.sqrt(variance, out=result[strip])
        result[strip] *= quantile(0.975, dof.astype(np.int64))
    return result
