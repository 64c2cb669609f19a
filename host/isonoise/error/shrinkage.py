"""Shrinks noisy per-pixel variances, so that their distribution over the image is the true one. For `stated_error`.

The means in the denominator of relative variances are smoothed first (`_smoothed_mean`).

Shrinkage moves every estimate towards the value of its group. The larger the noise's share of the scatter in the
group, the farther it moves.

A variance estimated from a few skewed samples is itself noisy, and quantiles over the pixels of such variances are too
far apart. The image is decomposed into sums over 2x2 groups, level by level (a Haar pyramid). On every level the
scatter of the four children about their group's value is compared with the scatter that noise alone would cause.
Deviations are scaled by sqrt(b), b the true share of the scatter, so that the remaining scatter is the true one (Louis
1984, "Estimating a population of parameter values using Bayes and empirical Bayes methods", JASA 79; b itself, plain
empirical Bayes, gives the best single values but too narrow a distribution). Group totals are preserved. So variances
are pooled where they are smooth and left alone where they are not.

How noisy a variance is depends on the samples' fourth moment, which is not stored. The third follows from the
statistics, because Cov(mean, s^2) = mu_3 / n; the fourth is derived from it as for a gamma distribution, whose excess
kurtosis is 3/2 of the squared skewness.

Arrays are flat, in an order in which the four children of a group are one quarter of the array apart on every level:
`a.reshape(4, -1)` has a group's children in a column, `a.reshape(16, -1)` its grandchildren. n is a sample count, x a
mean, s2 a sample variance, dof its degrees of freedom n - 1.
"""

from functools import lru_cache

import numpy as np

from isonoise.statistics import Statistics

LEVELS = 4
"""Variances are pooled over groups of up to 16x16 pixels."""
TILE_SIZE = 64
"""Pixels per side of a tile; on the top level, scatter is averaged over 4x4 groups, which is one tile."""
MAX_SCATTER = 1e3
"""A group's scatter of means is cut at this multiple of its noise."""
MAX_SKEWNESS_SCATTER = 4.0
"""Groups whose means scatter by more than this multiple of their noise are not used to estimate the skewness."""


def shrunk_relative_variance(statistics: Statistics, rows: slice, floor: float) -> np.ndarray:
    """(sigma_i / max(mean_i, floor))^2, with sigma_i the shrunk standard error and mean_i the smoothed mean of a pixel.

    The design effect varies slowly over the image and multiplies the shrunk variances.

    Parameters
    ----------
    statistics : Statistics
        Of the image.
    rows : slice
        Rows of the image, from a multiple of TILE_SIZE on.
    floor : float
        Above 0.

    Returns
    -------
    1-D float64
        The values of all pixels with two or more samples, in no particular order.
    """
    count = statistics.count[rows]
    order, inside = _pyramid_order(*count.shape)
    n = np.where(inside, count.reshape(-1)[order], 0).astype(np.float64)
    known = n > 1
    n *= known
    x = statistics.mean[rows].reshape(-1)[order] * known
    s2 = statistics.variance[rows].reshape(-1)[order] * known
    d = 1.0 if statistics.design_effect is None else statistics.design_effect[rows].reshape(-1)[order]
    dof = n - known

    scale = _smoothed_mean(n, x, dof, d * s2)
    np.maximum(scale, floor, out=scale)
    x /= scale
    s2 /= scale
    s2 /= scale
    return (_shrunk_variance(n, x, dof, s2) * d)[known] / n[known]


def _smoothed_mean(n: np.ndarray, x: np.ndarray, dof: np.ndarray, s2: np.ndarray) -> np.ndarray:
    """Means of the pixels, smoothed where neighbours differ by noise alone: a Wiener filter in the Haar pyramid.

    Within a group the noise of a mean is assumed proportional to the mean, as for a count of rare events. So a pixel
    with a firefly is smoothed, and a dark pixel beside a bright one stays dark.
    """
    means, noises = _pyramid(n, x), _pyramid(dof, s2)
    result = means[LEVELS][1]
    for level in reversed(range(LEVELS)):
        weight, value = (array.reshape(4, -1) for array in means[level])
        parent, noise = means[level + 1][1], noises[level + 1][1]
        deviation = value - parent
        scatter = _divide((weight * deviation * deviation).sum(axis=0), _child_dof(weight))
        np.minimum(scatter, MAX_SCATTER * noise, out=scatter)
        noise = noise.reshape(4, -1).sum(axis=0)  # over 2x2 groups, for more degrees of freedom
        signal = np.maximum(_divide(scatter.reshape(4, -1).sum(axis=0) - noise, noise), 0)
        signal[noise == 0] = np.inf
        # b = signal / (signal + noise), noise in proportion to value / parent
        noise_share = np.maximum(_divide(value, parent), 0).reshape(4, 4, -1)
        noise_share /= np.maximum(signal, 1e-9)
        deviation /= 1 + noise_share.reshape(4, -1)
        deviation += result
        result = deviation.reshape(-1)
    return result


def _shrunk_variance(n: np.ndarray, x: np.ndarray, dof: np.ndarray, s2: np.ndarray) -> np.ndarray:
    """The variances s2, shrunk; `x` are the means in the same scale.

    From the largest groups down to the pixels, each level takes three steps:

    1. scatter: the relative variance of the four children about their group's value;
    2. factor: sqrt(true_share), true_share the part of the scatter that noise does not explain;
    3. shrink: child = new value of the group + factor * (child - old value of the group).

    For example, with many degrees of freedom, if the scatter is 0.50 and noise alone would cause 0.32, the true share
    is 1 - 0.32 / 0.50 = 0.36 and the factor 0.6: in a group of value 1 a child of 2 becomes 1.6.
    """
    pyramid = _pyramid(dof, s2)
    noise_by_level = _variance_noise(n, x, pyramid)
    result = pyramid[LEVELS][1]
    for level in reversed(range(LEVELS)):
        weight, value = (array.reshape(4, -1) for array in pyramid[level])
        total, parent = pyramid[level + 1]
        deviation = value - parent
        child_dof = _child_dof(weight)
        valid = (child_dof > 0) & (parent > 0)
        scatter = _divide((weight * deviation * deviation).sum(axis=0), child_dof * parent * parent)
        factor = np.sqrt(_true_share(scatter, valid, total, child_dof, noise_by_level[level]))

        deviation = deviation.reshape(4, 16, -1)
        deviation *= factor
        deviation = deviation.reshape(4, -1)
        deviation += result
        # Not below the value that a child without variance would get: the group's own, scaled by 1 - factor.
        lower_bound = (result.reshape(16, -1) * (1 - factor)).reshape(-1)
        result = np.maximum(deviation, lower_bound, out=deviation).reshape(-1)
    return result


def _true_share(
    scatter: np.ndarray, valid: np.ndarray, total: np.ndarray, child_dof: np.ndarray, phi: np.ndarray
) -> np.ndarray:
    """The part of the scatter that noise does not explain, 0 to 1, for windows of 4x4 groups.

    `total` is a group's degrees of freedom, `phi` the noise per degree of freedom. The groups' shares are Dirichlet
    distributed, as for gamma variables, so noise alone gives the scatter a mean of phi w / (w + phi), w the mean of
    `total`. Solved for phi this is the apparent noise, which the scatter would need if all of it were noise.
    """
    groups = _window_sum(valid)
    scatter = _divide(_window_sum(scatter * valid), groups)
    w = _divide(_window_sum(total * valid), groups)
    child_w = _divide(_window_sum(total * valid), _window_sum((child_dof + 1) * valid))
    apparent_noise = _divide(scatter, np.maximum(1 - _divide(scatter, w), 1e-6))
    return np.maximum(1 - _divide(phi, apparent_noise), 0) * _divide(child_w, child_w + phi)


def _variance_noise(n: np.ndarray, x: np.ndarray, pyramid: list) -> list[np.ndarray]:
    """Relative variance of s^2 times its degrees of freedom, 2 + 3/2 skewness^2, for the windows of every level.

    Var(s^2) = sigma^4 (2 / (n - 1) + excess kurtosis / n); the skewness is an average over 16x16 pixels.
    """
    weight, s2 = (array.reshape(4, -1) for array in pyramid[0])
    parent = pyramid[1][1]
    n, x = n.reshape(4, -1), x.reshape(4, -1)
    deviation = x - _divide((n * x).sum(axis=0), n.sum(axis=0))
    child_dof = _child_dof(weight)
    n = n * deviation
    usable = (n * deviation).sum(axis=0) < MAX_SKEWNESS_SCATTER * child_dof * parent
    third_moment = _divide((n * (s2 - parent)).sum(axis=0), child_dof * parent**1.5) * usable
    skewness = _divide(third_moment.reshape(64, -1).sum(axis=0), usable.reshape(64, -1).sum(axis=0))
    noise = 2 + 1.5 * np.maximum(skewness, 0) ** 2
    coarser = noise.reshape(4, -1).mean(axis=0)
    return [np.tile(noise, 4), noise, coarser, coarser.reshape(4, -1).mean(axis=0)]


def _pyramid(weight: np.ndarray, value: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Total weights and weighted means of every level, from pixels to the largest groups."""
    levels = [(weight, value)]
    for _ in range(LEVELS):
        total = weight.reshape(4, -1).sum(axis=0)
        value = _divide((weight * value).reshape(4, -1).sum(axis=0), total)
        levels.append((weight := total, value))
    return levels


def _child_dof(weight: np.ndarray) -> np.ndarray:
    """Children with weight in each group, minus one; 0 if there is none."""
    return np.maximum((weight > 0).sum(axis=0) - 1.0, 0)


def _window_sum(groups: np.ndarray) -> np.ndarray:
    """Sums over 4x4 groups."""
    return groups.reshape(16, -1).sum(axis=0)


def _divide(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """a / b, and 0 where b is 0."""
    return np.divide(a, b, out=np.zeros(np.broadcast_shapes(a.shape, b.shape)), where=b > 0)


@lru_cache(maxsize=4)
def _pyramid_order(height: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    """Index into the flat image of every cell, and whether the cell is a pixel: the image is padded to full tiles."""
    rows, columns = -(-height // TILE_SIZE), -(-width // TILE_SIZE)
    bits = TILE_SIZE.bit_length() - 1
    cells = np.arange(rows * columns * TILE_SIZE * TILE_SIZE).reshape([rows] + [2] * bits + [columns] + [2] * bits)
    # Axes of the row's bits and the column's bits, finest first, then the tiles.
    axes = [axis for bit in range(bits) for axis in (bits - bit, 2 * bits + 1 - bit)]
    cells = cells.transpose([*axes, 0, bits + 1]).reshape(-1)
    y, x = np.divmod(cells, columns * TILE_SIZE)
    inside = (y < height) & (x < width)
    return np.where(inside, y * width + x, 0), inside
