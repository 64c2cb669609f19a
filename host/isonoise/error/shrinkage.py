"""The distribution of every pixel's error, from its neighbourhood. For `stated_error` and `half_width_95`.

The image is decomposed into sums over 2x2 groups, level by level (a Haar pyramid). On every level the scatter of the
four children about their group's value is compared with the scatter that noise alone would cause.

Variances (`_shrunk_variance`). A variance estimated from a few skewed samples is itself noisy, and quantiles over the
pixels of such variances are too far apart. Deviations are scaled by sqrt(b), b the true share of the scatter, so that
the remaining scatter is the true one (Louis 1984, "Estimating a population of parameter values using Bayes and
empirical Bayes methods", JASA 79; b itself, plain empirical Bayes, gives the best single values but too narrow a
distribution). Group totals are preserved. So variances are pooled where they are smooth and left alone where they are
not.

How noisy a variance is depends on the samples' fourth moment, which is not stored. The third follows from the
statistics, because Cov(mean, s^2) = mu_3 / n; the fourth is derived from it as for a gamma distribution, whose excess
kurtosis is 3/2 of the squared skewness.

Means (`_smoothed_mean`). They are smoothed by a Wiener filter. What the filter removes is a sample of the error itself,
so it has the distribution of the error: with rare bright samples most pixels are a little too dark and a few are far
too bright. What the filter keeps may be signal or noise; the noise in it is taken as normal (`_posterior_variance`).
The error of a pixel is thus modelled as |deviation + sqrt(v) Z|, Z standard normal: the posterior distribution of the
true value. Where neighbours differ by more than noise, the deviation is near 0 and v the variance of the mean.

Arrays are flat, in an order in which the four children of a group are one quarter of the array apart on every level:
`a.reshape(4, -1)` has a group's children in a column, `a.reshape(16, -1)` its grandchildren. n is a sample count, x a
mean, s2 a sample variance, dof its degrees of freedom n - 1.
"""

import math
from dataclasses import replace
from functools import lru_cache

import numpy as np

from isonoise.statistics import Statistics

LEVELS = 4
"""Variances are pooled over groups of up to 16x16 pixels."""
TILE_SIZE = 64
"""Pixels per side of a tile; on the top level, scatter is averaged over 4x4 groups, which is one tile."""
MAX_MEAN = 1e12
"""Larger means, in units of the floor, and larger relative variances are cut."""
MIN_TRUE_SHARE = 1e-6
"""Smaller true shares of the scatter count as this."""
MAX_SCATTER = 1e3
"""A group's scatter of means is cut at this multiple of its noise."""
BLACK_LEVELS = (2, 3)
"""Levels of the groups in which black pixels are found: 4x4 and 8x8 pixels."""
MAX_UNLUCKY_SHARE = 1 / 3
"""Pixels without light are black if at most this share of them can be explained by chance."""
MAX_SKEWNESS_SCATTER = 4.0
"""Groups whose means scatter by more than this multiple of their noise are not used to estimate the skewness."""


def relative_errors(statistics: Statistics, rows: slice, floor: float) -> tuple[np.ndarray, np.ndarray]:
    """Mean square and normal share of the relative error of every pixel, |deviation + sqrt(v) Z| / scale.

    scale = max(smoothed mean, floor). The variances that are shrunk are d s^2, d the design effect: a pixel that has
    seen a rare bright sample has a larger d than its neighbours.

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
    square : 1-D float64
        (deviation^2 + v) / scale^2 of all pixels with two or more samples, in no particular order.
    normal_share : 1-D float64
        v / (deviation^2 + v), 0 where both are 0.
    """
    cells = _Cells(statistics, rows, floor)
    smoothed, kept_noise = _smoothed_mean(cells)
    scale = np.maximum(smoothed, cells.floor)
    noise, _ = _shrunk_noise(cells, scale, exponent=0.5)
    normal = _posterior_variance(cells, kept_noise, noise, scale)
    deviation = cells.x - smoothed
    deviation *= cells.used
    deviation /= scale
    square = np.square(deviation, out=deviation)
    square += normal
    normal_share = _divide(normal, square)
    # The filter is chosen by the same means. Over windows of 8x8 pixels the squares have to add up to the noise.
    square = square.reshape(64, -1)
    square *= _divide(noise.reshape(64, -1).sum(axis=0), square.sum(axis=0))
    square = square.reshape(-1)
    return (square, normal_share) if cells.all_known else (square[cells.known], normal_share[cells.known])


def shrunk_variance_of_mean(statistics: Statistics, rows: slice, floor: float) -> tuple[np.ndarray, np.ndarray]:
    """d sigma_i^2 / n, sigma_i^2 the best estimate of a pixel's variance, and its precision.

    d is the design effect of the pixel's group of 16x16 pixels, the mean of theirs with their relative variances as
    weights. A pixel that has seen no rare bright sample has a small s^2 and a small design effect of its own; shrunk
    alone, sigma^2 would be that of its neighbours and d would not.

    Parameters as for `relative_errors`.

    Returns
    -------
    variance : float64, of the shape of the rows
        inf where n < 2.
    dof : float64, of the shape of the rows
        Degrees of freedom of the estimate, if the samples are normal: (n - 1) / b, 1 or more.
    """
    cells = _Cells(replace(statistics, design_effect=None), rows, floor)
    scale = np.maximum(_smoothed_mean(cells)[0], cells.floor)
    noise, true_share = _shrunk_noise(cells, scale, exponent=1.0)
    if statistics.design_effect is not None:
        noise *= _group_design_effect(cells, cells.gather(statistics.design_effect[rows]), scale)
    pixels = cells.order[cells.known]
    variance, dof = np.full(cells.shape, np.inf), np.ones(cells.shape)
    variance.reshape(-1)[pixels] = (np.square(scale, dtype=np.float64) * noise * cells.unit**2)[cells.known]
    dof.reshape(-1)[pixels] = np.maximum(cells.dof / np.maximum(true_share, MIN_TRUE_SHARE), 1)[cells.known]
    return variance, dof


def _group_design_effect(cells: "_Cells", design_effect: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """The design effect of every pixel's largest group: the mean of its pixels', weighted with s^2 / scale^2."""
    weight = cells.relative_variance(scale)
    group_pixels = 4**LEVELS
    total = weight.reshape(group_pixels, -1).sum(axis=0)
    group = _divide((weight * design_effect).reshape(group_pixels, -1).sum(axis=0), total)
    return np.tile(group, group_pixels)


def _shrunk_noise(cells: "_Cells", scale: np.ndarray, exponent: float) -> tuple[np.ndarray, np.ndarray]:
    """Shrunk variances of the means over scale^2, 0 where n < 2, and the pixels' factors of shrinkage."""
    s2 = cells.relative_variance(scale)
    variance, factor = _shrunk_variance(cells.n, cells.x / scale, cells.dof, s2, exponent)
    return _divide(variance, cells.n), factor


class _Cells:
    """Statistics in the order of the pyramid, padded with cells of no samples, and pyramids of means and noise.

    In float32 for speed. The unit of the means is the power of two at the floor. Means are cut at MAX_MEAN and its
    inverse, so that with 2^32 samples per pixel all sums and quotients are in range.
    """

    def __init__(self, statistics: Statistics, rows: slice, floor: float):
        count = statistics.count[rows]
        self.shape = count.shape
        self.unit = 2.0 ** max(math.frexp(floor)[1], -1000)  # so that its inverse is finite
        self.floor = np.float32(floor / self.unit)
        self.order, inside = _pyramid_order(*count.shape)
        n = count.reshape(-1)[self.order].astype(np.float32)
        self.known = inside & (n > 1)
        self.all_known = bool(self.known.all())
        self.n = n * self.known
        inverse = 1 / self.unit
        with np.errstate(over="ignore"):  # what overflows is cut
            mean = (statistics.mean[rows] * inverse).astype(np.float32)
            variance = statistics.variance_per_sample(rows) * inverse
            variance = np.multiply(variance, inverse, out=variance).astype(np.float32)
        self.x = self.gather(_limited(mean, MAX_MEAN))
        self.s2 = self.gather(_limited(variance, MAX_MEAN**2))
        self.dof = self.n - self.known
        self.used = self.known
        self._make_pyramids()
        black = _find_black(self)
        if black is not None:
            self.used = self.known & ~black
            self.n *= self.used
            self.dof *= self.used
            self._make_pyramids()

    def _make_pyramids(self) -> None:
        self.means = _pyramid(self.n, self.x)
        self.variances = _pyramid(self.dof, self.s2)

    def gather(self, values: np.ndarray) -> np.ndarray:
        """Values of the pixels in the order of the pyramid, 0 where n < 2."""
        gathered = values.astype(np.float32, copy=False).reshape(-1)[self.order]
        return gathered if self.all_known else gathered * self.known

    def relative_variance(self, scale: np.ndarray) -> np.ndarray:
        """s^2 / scale^2 of every pixel, cut at MAX_MEAN."""
        result = self.s2 / scale / scale
        return np.minimum(result, MAX_MEAN, out=result)

    def noise(self, level: int) -> np.ndarray:
        """Variance of the mean of every group of a level."""
        return _divide(self.variances[level][1], self.means[level][0])


def _find_black(cells: _Cells) -> np.ndarray | None:
    """The pixels whose samples are all 0 because the pixel is black, such as those beside the edge of a lit object.

    Other pixels have no light in their samples because it is rare. If all pixels of a group saw light with the same
    probability p, a pixel would have none with the probability exp(-n p), with p = 1 / (1 + s^2 / mean^2) as if every
    light were equally bright. A group with far more pixels without light has black ones. None if there are none.
    """
    zero = (cells.dof > 0) & (cells.x == 0) & (cells.s2 == 0)
    if not zero.any():
        return None
    black = np.zeros(zero.shape, bool)
    for level in BLACK_LEVELS:
        (weight, mean), variance = cells.means[level], cells.variances[level][1]
        seen, zeros = (pixels.reshape(4**level, -1).sum(axis=0, dtype=np.float32) for pixels in (cells.known, zero))
        relative_variance = _divide(_divide(variance, mean), mean)
        without_light = np.exp(-_divide(weight, seen * (1 + relative_variance)))
        unlucky = without_light * (seen - zeros)
        is_black = (mean > 0) & (unlucky < MAX_UNLUCKY_SHARE * (1 - without_light) * zeros)
        black |= np.tile(is_black, 4**level)
    black &= zero
    return black


def _smoothed_mean(cells: _Cells) -> tuple[np.ndarray, list[np.ndarray]]:
    """Means of the pixels, smoothed where neighbours differ by noise alone: a Wiener filter in the Haar pyramid.

    Within a group the noise of a mean is assumed proportional to the mean, as for a count of rare events. So a pixel
    with a firefly is smoothed, and a dark pixel beside a bright one stays dark. But where noise hides the signal, a
    dark pixel may be one without a firefly, and has the noise of its group. A child keeps its ratio to its group, not
    its difference, when the group's mean changes: a dark pixel would become negative.

    Also returns, level by level from the coarsest, the shares of the noise in the children's deviations that the
    smoothed mean still has, or that the deviations lack: where they scatter by less than their noise, the rest of the
    noise is not seen in them.
    """
    result, kept_noise = cells.means[LEVELS][1], []
    for level in reversed(range(LEVELS)):
        weight, value = (array.reshape(4, -1) for array in cells.means[level])
        parent, noise = cells.means[level + 1][1], cells.variances[level + 1][1]
        deviation = value - parent
        scatter = _divide((weight * deviation * deviation).sum(axis=0), _child_dof(weight))
        np.minimum(scatter, MAX_SCATTER * noise, out=scatter)
        noise = noise.reshape(4, -1).sum(axis=0)  # over 2x2 groups, for more degrees of freedom
        signal = _divide(scatter.reshape(4, -1).sum(axis=0) - noise, noise)
        unseen = np.maximum(-signal, 0)
        np.maximum(signal, 1e-9, out=signal)
        signal[noise == 0] = np.inf
        # The share is signal / (signal + noise), noise in proportion to value / parent.
        noise_share = np.maximum(_divide(value, parent).reshape(4, 4, -1), np.minimum(1 / signal, 1))
        noise_share /= signal
        noise_share += 1
        share = np.reciprocal(noise_share, out=noise_share).reshape(4, -1)
        deviation *= share
        deviation += parent
        deviation *= _divide(result, parent)
        deviation += result * (parent == 0)
        result = deviation.reshape(-1)
        kept_noise.append(np.maximum(share, np.tile(unseen, 4), out=share))
    return result, kept_noise


def _posterior_variance(
    cells: _Cells, kept_noise: list[np.ndarray], noise: np.ndarray, scale: np.ndarray
) -> np.ndarray:
    """Variance of the smoothed means over scale^2. `noise` are the pixels' shrunk variances of the mean over scale^2.

    A child has the relative variance of its group, and the part of its own noise that `kept_noise` says.
    """
    result = cells.noise(LEVELS)
    for level, share in zip(reversed(range(LEVELS)), kept_noise, strict=True):
        ratio = _divide(cells.means[level][1].reshape(4, -1), cells.means[level + 1][1])
        ratio *= ratio
        own = cells.noise(level) if level else noise * scale * scale
        own = own.reshape(4, -1) - ratio * cells.noise(level + 1)
        np.maximum(own, 0, out=own)
        own *= share
        ratio *= result
        ratio += own
        result = ratio.reshape(-1)
    result /= scale
    result /= scale
    return result


def _shrunk_variance(
    n: np.ndarray, x: np.ndarray, dof: np.ndarray, s2: np.ndarray, exponent: float
) -> tuple[np.ndarray, np.ndarray]:
    """The variances s2, shrunk, and the pixels' factors of shrinkage; `x` are the means in the same scale.

    `exponent` is 0.5 for the true scatter (Louis), 1 for the best single values.

    From the largest groups down to the pixels, each level takes three steps:

    1. scatter: the relative variance of the four children about their group's value;
    2. factor: true_share^exponent, true_share the part of the scatter that noise does not explain;
    3. shrink: child = new value of the group + factor * (child - old value of the group).

    For example, with exponent 0.5 and many degrees of freedom, if the scatter is 0.50 and noise alone would cause 0.32,
    the true share is 1 - 0.32 / 0.50 = 0.36 and the factor 0.6: in a group of value 1 a child of 2 becomes 1.6.
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
        factor = _true_share(scatter, valid, total, child_dof, noise_by_level[level]) ** exponent

        deviation = deviation.reshape(4, 16, -1)
        deviation *= factor
        deviation = deviation.reshape(4, -1)
        deviation += result
        # Not below the value that a child without variance would get: the group's own, scaled by 1 - factor.
        lower_bound = (result.reshape(16, -1) * (1 - factor)).reshape(-1)
        result = np.maximum(deviation, lower_bound, out=deviation).reshape(-1)
    return result, np.tile(factor, 64)


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
    share = np.maximum(1 - _divide(phi, apparent_noise), 0) * (apparent_noise > 0)
    return share * _divide(child_w, child_w + phi)


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
    third_moment = _divide((n * (s2 - parent)).sum(axis=0), child_dof * parent * np.sqrt(parent)) * usable
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


def _limited(values: np.ndarray, limit: float) -> np.ndarray:
    """Values up to `limit`, and 0 for those below 1 / limit, in place."""
    np.minimum(values, limit, out=values)
    values[values < 1 / limit] = 0
    return values


def _child_dof(weight: np.ndarray) -> np.ndarray:
    """Children with weight in each group, minus one; 0 if there is none."""
    return np.maximum((weight > 0).sum(axis=0, dtype=np.float32) - 1, 0)


def _window_sum(groups: np.ndarray) -> np.ndarray:
    """Sums over 4x4 groups."""
    return groups.reshape(16, -1).sum(axis=0)


def _divide(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """a / b, and 0 where b is 0."""
    if b.min(initial=1) > 0:
        return np.divide(a, b, dtype=np.float32)
    return np.divide(a, b, out=np.zeros(np.broadcast_shapes(a.shape, b.shape), np.float32), where=b > 0)


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
