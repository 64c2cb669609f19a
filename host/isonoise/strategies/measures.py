"""Measures: per-pixel numbers that stand for a standard error, and the floor below which darkness stops counting."""

import numpy as np

from isonoise.statistics import Statistics
from isonoise.student_t import quantile

STRIP = 2**15
"""Pixels that are pooled at a time, so that what lies between the steps stays in the cache."""


def image_floor(mean: np.ndarray) -> float:
    """1 % of the geometric mean of max(L, 1e-4 mean L) over the pixels with L > 0, both means over these pixels.

    `mean` is the luminance image, shape (height, width). 0 if no pixel is positive. Scaling the image by a power of two
    scales the result exactly.
    """
    lit = mean[mean > 0].astype(np.float64)
    if lit.size == 0:
        return 0.0
    average = lit.mean()
    exponent = int(np.frexp(average)[1])  # the logarithms are taken of numbers that no power-of-two scale changes
    np.maximum(lit, 1e-4 * average, out=lit)
    np.log(np.ldexp(lit, -exponent, out=lit), out=lit)
    return float(np.ldexp(0.01 * np.exp(lit.mean()), exponent))


def relative_median(statistics: Statistics, floor: float, kappa: float = 8.0) -> np.ndarray:
    """e_m = se / max(M_x, mean / kappa, floor), the poster's measure with a denominator that fireflies cannot remove.

    Where more than half of the samples are 0, M_x is 0: `mean / kappa` bounds by what factor such a pixel may look
    worse than by `relative_mean`. `kappa` = inf is the poster's own form. Float64, shape (height, width).

    A pixel of fewer than two samples is inf: nothing is known. One whose samples were all equal is 0, however few they
    were: no correction here, the uniform waves between the adaptive ones are what finds it out.
    """
    scale = statistics.mean / kappa
    np.maximum(scale, statistics.median, out=scale)
    return _ratio(standard_error(statistics), np.maximum(scale, floor, out=scale))


def relative_mean(statistics: Statistics, floor: float) -> np.ndarray:
    """e_a = se / max(mean, floor). Float64, shape (height, width); inf and 0 as in `relative_median`."""
    return _ratio(standard_error(statistics), np.maximum(statistics.mean, floor))


def pooled_variance(statistics: Statistics, floor: float, window: int) -> np.ndarray:
    """V = s^2 / max(mean, floor)^2, the relative variance of one sample, with s^2 and mean pooled over the window about
    the pixel, samples weighing the same: sum n s^2 / sum n, and sum n mean / sum n.

    `window` is odd, pixels a side; beyond the image's edge there is nothing. Float64, shape (height, width); inf where
    n < 2. 0 / 0 is 0 and noise over nothing inf, as in the other measures.
    """
    height, width = statistics.shape
    result = np.empty((height, width))
    reach, rows = window // 2, max(1, STRIP // width)
    for top in range(0, height, rows):
        begin, end = max(top - reach, 0), min(top + rows + reach, height)
        inside = np.s_[top - begin : min(top + rows, height) - begin]
        part = np.s_[begin:end]
        weight = statistics.count[part].astype(np.float64)
        samples = np.maximum(window_sum(weight, window)[inside], 1)
        scale = window_sum(weight * statistics.mean[part], window)[inside]
        scale /= samples
        np.maximum(scale, floor, out=scale)
        variance = window_sum(np.multiply(weight, statistics.variance[part], out=weight), window)[inside]
        variance /= samples
        result[top : top + rows] = _ratio(_ratio(variance, scale), scale)
    result[statistics.count < 2] = np.inf
    return result


def window_sum(values: np.ndarray, window: int) -> np.ndarray:
    """Sums over `window` x `window` pixels around each, shape (height, width), nothing beyond the edge."""
    reach = window // 2
    for axis in (0, 1):
        lines = np.moveaxis(values, axis, 0)
        total = lines.copy()
        for step in range(1, min(reach, len(lines) - 1) + 1):  # sums of neighbours: differences of running sums cancel
            total[step:] += lines[:-step]
            total[:-step] += lines[step:]
        values = np.moveaxis(total, 0, axis)
    return values


def tsallis(statistics: Statistics, q: float) -> np.ndarray:
    """sqrt(1 - S_q / S_max) with S_q = (1 - sum p^q) / (q - 1), p_i = x_i / sum x, S_max = (1 - n^(1-q)) / (q - 1);
    for q = 1 their limits, Shannon's entropy and ln n.

    Computed as (sum p^q - n^(1-q)) / (1 - n^(1-q)). For q = 2 that is se^2 / mean^2. It depends on the samples' shares
    alone and needs no floor. Float64, shape (height, width); 0 where n < 2 or all samples were 0.
    From: Xu, Sbert, Xing, Zhan 2007, 'Adaptive sampling based on Tsallis entropy'.
    """
    n = np.maximum(statistics.count, 2).astype(np.float64)
    mean = statistics.mean
    square = np.zeros(statistics.shape)
    lit = (statistics.count >= 2) & (mean > 0)
    if q == 2:
        np.divide(statistics.variance, n, out=square, where=lit)
        np.divide(square, mean, out=square, where=lit)
        np.divide(square, mean, out=square, where=lit)
    elif q == 1:
        np.divide(statistics.power, mean, out=square, where=lit)
        square -= np.log(mean, out=np.zeros(statistics.shape), where=lit)
        square /= np.log(n)
    else:
        least = n ** (1 - q)
        np.divide(statistics.power, np.where(lit, mean, 1) ** q, out=square, where=lit)
        square = np.where(lit, (square - 1) * least / (1 - least), 0)
    return np.sqrt(np.maximum(square, 0, out=square), out=square)


def confidence(statistics: Statistics, significance: float) -> np.ndarray:
    """t se, t the quantile 1 - significance / 2 of Student's distribution with n - 1 degrees of freedom: half of the
    interval that holds the luminance with probability 1 - significance where samples are normal.

    Float64, shape (height, width), in the scene's units; inf where n < 2, and 0 where all samples were equal.
    From: Purgathofer 1987, 'A statistical method for adaptive stochastic sampling'.
    """
    return standard_error(statistics) * quantile(1 - significance / 2, np.maximum(statistics.count, 2) - 1)


def half_buffer(statistics: Statistics) -> np.ndarray:
    """e_p = (|I_R - A_R| + |I_G - A_G| + |I_B - A_B|) / sqrt(I_R + I_G + I_B), I the mean of all samples and A that of
    every second one: the noise of I, and its square root of the brightness for the eye.

    Float64, shape (height, width); scales with the square root of the light; inf where n < 2, and 0 for black.
    From: Dammertz, Hanika, Keller, Lensch 2010, 'A hierarchical automatic stopping condition for Monte Carlo global
    illumination', 2.1.
    """
    return _ratio(half_difference(statistics), np.sqrt(brightness(statistics)))


def half_difference(statistics: Statistics) -> np.ndarray:
    """|I_R - A_R| + |I_G - A_G| + |I_B - A_B| of `half_buffer`, float64 (height, width); inf where n < 2."""
    difference = np.abs(statistics.rgb - statistics.half.astype(np.float64)).sum(axis=-1)
    difference[statistics.count < 2] = np.inf
    return difference


def brightness(statistics: Statistics) -> np.ndarray:
    """max(R + G + B, 0) of the mean, float64 (height, width)."""
    return np.maximum(statistics.rgb.sum(axis=-1, dtype=np.float64), 0)


def standard_error(statistics: Statistics) -> np.ndarray:
    """se = s / sqrt(n) of the luminance mean, float64 (height, width); inf where n < 2: nothing is known there."""
    error = np.full(statistics.shape, np.inf)
    known = statistics.count >= 2
    np.divide(statistics.variance, statistics.count, out=error, where=known)
    return np.sqrt(error, out=error)


def variance_of_one(statistics: Statistics, measure: np.ndarray) -> np.ndarray:
    """V = n m^2: the variance of one sample in the measure's terms; inf where n < 2."""
    variance = measure * measure
    return np.multiply(variance, statistics.count, out=variance, where=np.isfinite(variance))


def _ratio(error: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """error / scale, in place of error: 0 / 0 is 0 (a black pixel without noise), and noise over nothing is inf."""
    lit = scale > 0
    np.divide(error, scale, out=error, where=lit)
    error[~lit & (error > 0)] = np.inf
    return error
