"""Measures: per-pixel error estimates on which allocation rules act, and the luminance floor of relative errors.

All take `Statistics` and return float64 of shape (height, width). n is the sample count, se the standard error. Unless
stated otherwise a measure is inf where n < 2 (nothing is known) and 0 where all samples are equal.
"""

import weakref
from dataclasses import replace

import numpy as np

from isonoise.statistics import Needs, Statistics
from isonoise.strips import pixel_strips, row_strips
from isonoise.student_t import quantile

MEASURE_STRIP_PIXELS = 2**16
"""Pixels that are pooled at a time, so that the temporary arrays stay in the cache."""
OUTLIER_RATIO = 16
"""Only pixels with so many times the variance of their neighbours may count with their own variance."""


def image_floor(mean: np.ndarray) -> float:
    """1 % of the geometric mean of max(L, 1e-4 mean L) over the pixels with L > 0, both means over these pixels.

    Scaling the image by a power of two scales the result exactly. The floor of the last read-only image is remembered:
    the render loop, the errors and the strategy ask for it in turn.

    Parameters
    ----------
    mean : (height, width)
        The luminance image L, in any unit: `Statistics.mean`.

    Returns
    -------
    float
        In the unit of `mean`; 0 if no pixel is positive.

    Examples
    --------
    >>> import numpy as np
    >>> round(image_floor(np.array([[1.0, 100.0, 0.0]])), 6)
    0.1
    """
    global _last_floor
    image, floor = _last_floor
    if image() is mean and not mean.flags.writeable:
        return floor
    floor = _compute_image_floor(mean.reshape(-1))
    if not mean.flags.writeable:
        _last_floor = weakref.ref(mean), floor
    return floor


_last_floor = (lambda: None), 0.0
"""Weak reference to a read-only image, and its floor."""


def _compute_image_floor(mean: np.ndarray) -> float:
    strips = [mean[strip] for strip in pixel_strips(mean.size, MEASURE_STRIP_PIXELS)]
    size, total = 0, 0.0
    for strip in strips:
        size += int(np.count_nonzero(strip > 0))
        total += float(np.maximum(strip, 0, dtype=np.float64).sum())
    if size == 0:
        return 0.0
    average = total / size
    exponent = int(np.frexp(average)[1])  # taken out before the logarithm, so that it scales exactly
    unit = 2.0 ** min(max(-exponent, -1000), 1000)
    lowest = 1e-4 * average
    # pixels without light count as the darkest ones, and are taken out of the sum
    logarithms = -(mean.size - size) * float(np.log(np.float32(lowest * unit)))
    for strip in strips:
        values = np.maximum(strip, lowest, dtype=np.float64)
        values *= unit
        logarithms += float(np.log(values.astype(np.float32)).sum(dtype=np.float64))
    return float(0.01 * np.exp(logarithms / size)) / unit


def standard_error(statistics: Statistics) -> np.ndarray:
    """se = sqrt(d s^2 / n) of the luminance mean, d the design effect.

    Parameters
    ----------
    statistics : Statistics
        Of all samples.

    Returns
    -------
    (height, width) float64, in the scene's units of luminance
    """
    error = statistics.variance_of_mean()
    return np.sqrt(error, out=error)


def relative_mean(statistics: Statistics, floor: float, rows: slice = slice(None)) -> np.ndarray:
    """e_a = se / max(mean, floor): the relative standard error.

    Parameters
    ----------
    statistics : Statistics
        Of all samples.
    floor : float
        Smallest denominator, in the scene's units of luminance (`image_floor`).
    rows : slice
        Rows of the image.

    Returns
    -------
    (height, width) float64, of these rows; without a unit
    """
    error = statistics.variance_of_mean(rows)
    np.sqrt(error, out=error)
    return _divide(error, np.maximum(statistics.mean[rows], floor))


def relative_median(statistics: Statistics, floor: float, kappa: float = 8.0) -> np.ndarray:
    """e_m = se / max(M_x, mean / kappa, floor): the poster's measure with a denominator that fireflies cannot remove.

    M_x is 0 where more than half of the samples are 0. `mean / kappa` limits how much larger than `relative_mean` such
    a pixel's error can be. `kappa` = inf is the poster's own form.
    Source: Pajot, Barthe, Paulin, "Robust adaptive sampling for Monte-Carlo-based rendering", 2011.

    Parameters
    ----------
    statistics : Statistics
        Of all samples, with the median (`Needs.median`).
    floor : float
        Smallest denominator, in the scene's units of luminance (`image_floor`).
    kappa : float
        1 to inf.

    Returns
    -------
    (height, width) float64, without a unit
    """
    scale = statistics.mean / kappa
    np.maximum(scale, statistics.median, out=scale)
    return _divide(standard_error(statistics), np.maximum(scale, floor, out=scale))


def neighbour_variance(statistics: Statistics, floor: float, outlier_share: float = 0.0) -> np.ndarray:
    """V = s^2 / max(mean, floor)^2, the relative variance of one sample, of the pixel's neighbours.

    s^2 (times the design effect) and mean are the statistics `neighbour_variance` and `neighbour_mean`. Neighbours
    weigh equally: counts as weights would favour those that have seen an outlier. A pixel's own samples do not affect
    its V. inf where n < 2 or no neighbour has n >= 2. The only pixel of an image has its own V. The result is in
    float32 if the neighbours' statistics are.

    With `outlier_share` > 0 some pixels have their own s^2 in place of the neighbours': among those whose s^2 is more
    than `OUTLIER_RATIO` times as large, the ones with the largest se / max(mean, floor)^2, as long as their standard
    errors se sum to at most `outlier_share` / sqrt(samples per pixel) of the sum of the image.

    Parameters
    ----------
    statistics : Statistics
        Of all samples, with those of the neighbours (`Needs.neighbours`, `with_neighbours`).
    floor : float
        Smallest denominator, in the scene's units of luminance (`image_floor`).
    outlier_share : float
        0 to 1.

    Returns
    -------
    (height, width) float32 or float64, without a unit
    """
    if statistics.count.size == 1:
        return variance_per_sample(statistics, relative_mean(statistics, floor))
    mean, variance = statistics.neighbour_mean, statistics.neighbour_variance
    result, outliers = variance.copy(), []
    for strip in row_strips(statistics.shape, MEASURE_STRIP_PIXELS):
        scale = np.maximum(mean[strip], variance.dtype.type(floor))
        if outlier_share:
            outliers.append(_outliers(statistics, strip, variance[strip], scale))
        _divide(_divide(result[strip], scale), scale)
    if outlier_share:
        _use_own_variance(result.reshape(-1), statistics, outlier_share, *np.concatenate(outliers, axis=1))
    unknown = statistics.count < 2
    if unknown.any():
        result[unknown] = np.inf
    return result


def with_neighbours(statistics: Statistics, window: int) -> Statistics:
    """The statistics with `neighbour_mean` and `neighbour_variance`.

    The device computes the same faster if the strategy needs it. Nothing is subtracted, so that a large value leaves no
    rounding error behind.

    Parameters
    ----------
    statistics : Statistics
        Of all samples.
    window : int
        Pixels per side of the neighbourhood, odd; the pixel itself is left out.

    Returns
    -------
    Statistics
    """
    height, width = statistics.shape
    known = statistics.count >= 2
    all_known = bool(known.all())
    averages, radius = np.empty((2, height, width)), window // 2
    for strip in row_strips(statistics.shape, MEASURE_STRIP_PIXELS):
        begin, end = max(strip.start - radius, 0), min(strip.stop + radius, height)
        inside, rows = np.s_[strip.start - begin : strip.stop - begin], np.s_[begin:end]
        mean = statistics.mean[rows] if all_known else statistics.mean[rows] * known[rows]
        if all_known:
            number = _count_pixels((height, width), strip, window)
        else:
            number = _neighbour_sum(known[rows].astype(np.float64), window)[inside]
        inverse = 1 / np.maximum(number, 1)
        for values, average in zip((mean, statistics.variance_per_sample(rows)), averages[:, strip], strict=True):
            np.multiply(_neighbour_sum(values, window)[inside], inverse, out=average)
        np.copyto(averages[1, strip], np.inf, where=number == 0)
    return replace(statistics, neighbour_mean=averages[0], neighbour_variance=averages[1])


def _outliers(statistics: Statistics, strip: slice, variance: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Of the pixels of a strip with far more variance than their neighbours: index, se, relative variance, rank."""
    own = statistics.variance_per_sample(strip, variance.dtype)
    found = np.flatnonzero((own > OUTLIER_RATIO * variance) & (scale > 0))
    index = found + strip.start * statistics.shape[1]
    scale, own = (values.reshape(-1)[found].astype(np.float64) for values in (scale, own))
    error = np.sqrt(own / statistics.count.reshape(-1)[index])
    return np.stack([index, error, own / scale / scale, error / scale / scale])


def _use_own_variance(result, statistics: Statistics, share: float, index, error, own, rank) -> None:
    """Write the pixels' own relative variances to `result`, highest rank first, as far as `share` allows."""
    order = np.argsort(-rank, kind="stable")
    limit = share * float(statistics.mean.sum()) * np.sqrt(statistics.count.size / max(statistics.samples, 1))
    chosen = order[: np.searchsorted(np.cumsum(error[order]), limit, side="right")]
    result[index[chosen].astype(np.intp)] = own[chosen]


def _neighbour_sum(values: np.ndarray, window: int) -> np.ndarray:
    """Sums over `window` x `window` pixels around each pixel, as far as they are inside the image, without itself."""
    radius = window // 2
    total = np.zeros_like(values)
    _add_shifted(total.T, values.T, radius)
    _add_shifted(total, values + total, radius)
    return total


def _add_shifted(total: np.ndarray, lines: np.ndarray, radius: int) -> None:
    """Add to each line of `total` the lines up to `radius` before and after it."""
    for step in range(1, min(radius, len(lines) - 1) + 1):
        total[step:] += lines[:-step]
        total[:-step] += lines[step:]


def _count_pixels(shape: tuple[int, int], rows: slice, window: int) -> np.ndarray:
    """Pixels of the window around each pixel of the rows, without itself; a single row if it is the same for all."""
    down, across = (
        np.minimum(np.arange(size), window // 2) + np.minimum(np.arange(size)[::-1], window // 2) + 1.0
        for size in shape
    )
    down = down[rows]
    return np.outer(down[:1] if (down == down[0]).all() else down, across) - 1


def tsallis(statistics: Statistics, q: float) -> np.ndarray:
    """sqrt(1 - S_q / S_max) with S_q = (1 - sum p^q) / (q - 1), p_i = x_i / sum x, S_max = (1 - n^(1-q)) / (q - 1).

    For q = 1 their limits, Shannon's entropy and ln n. Computed as (sum p^q - n^(1-q)) / (1 - n^(1-q)); for q = 2 that
    is s^2 / (n mean^2). It knows no design effect. It depends only on the samples' shares and needs no floor. 0 where
    n < 2 or all samples are 0.
    Source: Xu, Sbert, Xing, Zhan, "Adaptive sampling based on Tsallis entropy", 2007.

    Parameters
    ----------
    statistics : Statistics
        Of all samples; if q is not 2, with the mean of x^q (`Needs.power`).
    q : float
        The entropic index, above 0.

    Returns
    -------
    (height, width) float64, 0 to 1
    """
    n = np.maximum(statistics.count, 2).astype(np.float64)
    mean = statistics.mean
    square = np.zeros(statistics.shape)
    valid = (statistics.count >= 2) & (mean > 0)
    if q == 2:
        np.divide(statistics.variance, n, out=square, where=valid)
        np.divide(square, mean, out=square, where=valid)
        np.divide(square, mean, out=square, where=valid)
    elif q == 1:
        np.divide(statistics.power, mean, out=square, where=valid)
        square -= np.log(mean, out=np.zeros(statistics.shape), where=valid)
        square /= np.log(n)
    else:
        uniform_sum = n ** (1 - q)
        np.divide(statistics.power, np.where(valid, mean, 1) ** q, out=square, where=valid)
        square = np.where(valid, (square - 1) * uniform_sum / (1 - uniform_sum), 0)
    return np.sqrt(np.maximum(square, 0, out=square), out=square)


def confidence(statistics: Statistics, significance: float) -> np.ndarray:
    """t se: half the width of the confidence interval with probability 1 - significance for normal samples.

    t is the quantile 1 - significance / 2 of Student's distribution with n - 1 degrees of freedom. The unit is
    the scene's.
    Source: Purgathofer, "A statistical method for adaptive stochastic sampling", 1987.

    Parameters
    ----------
    statistics : Statistics
        Of all samples.
    significance : float
        Between 0 and 1.

    Returns
    -------
    (height, width) float64, in the scene's units of luminance
    """
    return standard_error(statistics) * quantile(1 - significance / 2, np.maximum(statistics.count, 2) - 1)


def half_buffer(statistics: Statistics) -> np.ndarray:
    """e_p = (|I_R - A_R| + |I_G - A_G| + |I_B - A_B|) / sqrt(I_R + I_G + I_B).

    I is the mean of all samples, A that of every second one. The square root weighs noise as the eye does; e_p scales
    with the square root of the light. Black pixels have 0.
    Source: Dammertz, Hanika, Keller, Lensch, "A hierarchical automatic stopping condition for Monte Carlo global
    illumination", 2010, section 2.1.

    Parameters
    ----------
    statistics : Statistics
        Of all samples, with those of every second sample (`Needs.half`).

    Returns
    -------
    (height, width) float64, in the square root of the scene's units
    """
    return _divide(half_difference(statistics), np.sqrt(brightness(statistics)))


def half_difference(statistics: Statistics) -> np.ndarray:
    """|I_R - A_R| + |I_G - A_G| + |I_B - A_B| of `half_buffer`, from the same `statistics`, in the scene's units."""
    difference = np.abs(statistics.rgb - statistics.half.astype(np.float64)).sum(axis=-1)
    difference[statistics.count < 2] = np.inf
    return difference


def brightness(statistics: Statistics) -> np.ndarray:
    """max(R + G + B, 0) of the mean RGB of `statistics`, (height, width) float64, in the scene's units."""
    return np.maximum(statistics.rgb.sum(axis=-1, dtype=np.float64), 0)


# the statistics that these need as a parameter of the strategy `adaptive`
relative_median.needs = Needs(median=True, batch=4)  # type: ignore[attr-defined]
half_buffer.needs = Needs(half=True)  # type: ignore[attr-defined]


def variance_per_sample(statistics: Statistics, measure: np.ndarray) -> np.ndarray:
    """V = n m^2, the variance of one sample that a measure m of the mean's error implies.

    Parameters
    ----------
    statistics : Statistics
        Of all samples.
    measure : (height, width)
        m, such as `relative_mean`.

    Returns
    -------
    (height, width) float64, in the squared unit of the measure
    """
    variance = measure * measure
    return np.multiply(variance, statistics.count, out=variance, where=np.isfinite(variance))


def _divide(error: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """error / scale, in place; 0 / 0 is 0 (a black pixel without noise), anything else over 0 is inf."""
    if scale.size and scale.min() > 0:
        return np.divide(error, scale, out=error)
    positive = scale > 0
    np.divide(error, scale, out=error, where=positive)
    error[~positive & (error > 0)] = np.inf
    return error
