"""Frees the per-pixel relative variances of their own noise, so that their distribution over the image is the true one.

A variance estimated from a few skewed samples is itself noisy, and quantiles over the pixels of such variances are too
wide. The image is taken apart into sums over 2x2 groups, level by level (a Haar pyramid). On every level the scatter of
the children about their group's value is compared with what their noise alone would give, and deviations are scaled
down by sqrt(b), b the true share of the scatter, so that the scatter that remains is the true one (Louis 1984,
"Estimating a population of parameter values using Bayes and empirical Bayes methods", JASA 79; b itself, plain
empirical Bayes, gives the best single values and too narrow a distribution). The value of a whole group is kept. So
variances end up pooled where they are smooth and stay what they were where they are not.

How noisy a variance is depends on the fourth moment of the samples, which is not kept. The third shows in the
statistics, because Cov(mean, s^2) = mu_3 / n; the fourth is taken from it as in a gamma distribution, where the excess
kurtosis is 3/2 of the squared skewness.

Arrays are flat, in an order in which the four children of a group stand one quarter of the array apart on every level:
`a.reshape(4, -1)` has a group's children in a column, `a.reshape(16, -1)` its grandchildren.
"""

from functools import lru_cache

import numpy as np

LEVELS = 4  # variances are pooled over groups of up to 16x16 pixels
BLOCK = 64  # pixels a side; on the top level, scatter is averaged over 4x4 groups
STRUCTURE = 1e3  # scatter of means over their noise above which more of it makes no difference
SAME_MEAN = 4.0  # a group whose means scatter more than this many times their noise tells nothing about skewness


def denoised_relative_variance(count: np.ndarray, mean: np.ndarray, variance: np.ndarray, floor: float) -> np.ndarray:
    """(sigma_i / max(mean_i, floor))^2, sigma_i the standard error of the pixel's mean, both freed of their noise.

    `count`, `mean`, `variance`: shape (height, width), as in `Statistics`; `floor` > 0. Returns float64, flat, in no
    particular order: it stands for a distribution. Pixels of fewer than two samples are left out and take no part.
    """
    order, inside = _pyramid_order(*count.shape)
    n = np.where(inside, count.reshape(-1)[order], 0).astype(np.float64)
    known = n > 1
    n *= known
    x = mean.reshape(-1)[order] * known
    s2 = variance.reshape(-1)[order] * known
    freedom = n - known

    scale = _denoised_mean(n, x, freedom, s2)
    np.maximum(scale, floor, out=scale)
    x /= scale
    s2 /= scale
    s2 /= scale
    return _freed(n, x, freedom, s2)[known] / n[known]


def _denoised_mean(n: np.ndarray, x: np.ndarray, freedom: np.ndarray, s2: np.ndarray) -> np.ndarray:
    """Means with the noise taken out that hides no structure (a Wiener filter in the Haar pyramid).

    Within a group the noise of a mean is taken as proportional to the mean, as it is for a count of rare events. So a
    pixel that has caught a firefly gives way, and a dark one beside a bright one stays dark.
    """
    means, noises = _pyramid(n, x), _pyramid(freedom, s2)
    result = means[LEVELS][1]
    for level in reversed(range(LEVELS)):
        weight, value = (a.reshape(4, -1) for a in means[level])
        parent, noise = means[level + 1][1], noises[level + 1][1]
        off = value - parent
        scatter = _ratio((weight * off * off).sum(axis=0), _siblings(weight))
        np.minimum(scatter, STRUCTURE * noise, out=scatter)
        noise = noise.reshape(4, -1).sum(axis=0)  # over 2x2 groups, for more degrees of freedom
        structure = np.maximum(_ratio(scatter.reshape(4, -1).sum(axis=0) - noise, noise), 0)
        structure[noise == 0] = np.inf
        # b = signal / (signal + noise), noise in proportion to value / parent
        louder = np.maximum(_ratio(value, parent), 0).reshape(4, 4, -1)
        louder /= np.maximum(structure, 1e-9)
        off /= 1 + louder.reshape(4, -1)
        off += result
        result = off.reshape(-1)
    return result


def _freed(n: np.ndarray, x: np.ndarray, freedom: np.ndarray, s2: np.ndarray) -> np.ndarray:
    """Variances s2 whose scatter is freed of noise; `x` are the means in the same scale."""
    pyramid = _pyramid(freedom, s2)
    noise_by_level = _noise_per_freedom(n, x, pyramid)
    result = pyramid[LEVELS][1]
    for level in reversed(range(LEVELS)):
        weight, value = (a.reshape(4, -1) for a in pyramid[level])
        total, parent = pyramid[level + 1]
        off = value - parent
        siblings = _siblings(weight)
        live = (siblings > 0) & (parent > 0)
        scatter = _ratio((weight * off * off).sum(axis=0), siblings * parent * parent)

        # Averages over windows of 4x4 groups. With noise phi per degree of freedom, group shares are Dirichlet
        # distributed as for gamma variables, and the scatter has the mean phi w / (w + phi), w the group's freedom.
        groups = _window(live)
        scatter = _ratio(_window(scatter * live), groups)
        w = _ratio(_window(total * live), groups)
        child_w = _ratio(_window(total * live), _window((siblings + 1) * live))
        phi = noise_by_level[level]
        apparent = _ratio(scatter, np.maximum(1 - _ratio(scatter, w), 1e-6))
        true_share = np.maximum(1 - _ratio(phi, apparent), 0) * _ratio(child_w, child_w + phi)
        keep = np.sqrt(true_share)

        off = off.reshape(4, 16, -1)
        off *= keep
        off = off.reshape(4, -1)
        off += result
        # Not below what the group's own value, scaled alike, would leave of a child without variance.
        least = (result.reshape(16, -1) * (1 - keep)).reshape(-1)
        result = np.maximum(off, least, out=off).reshape(-1)
    return result


def _noise_per_freedom(n: np.ndarray, x: np.ndarray, pyramid: list) -> list[np.ndarray]:
    """Relative variance of s^2 times its degrees of freedom, 2 + 3/2 skewness^2, for the windows of every level.

    Var(s^2) = sigma^4 (2 / (n - 1) + excess kurtosis / n); the skewness is an average over 16x16 pixels.
    """
    weight, s2 = (a.reshape(4, -1) for a in pyramid[0])
    parent = pyramid[1][1]
    n, x = n.reshape(4, -1), x.reshape(4, -1)
    off = x - _ratio((n * x).sum(axis=0), n.sum(axis=0))
    siblings = _siblings(weight)
    n = n * off
    same_mean = (n * off).sum(axis=0) < SAME_MEAN * siblings * parent
    third = _ratio((n * (s2 - parent)).sum(axis=0), siblings * parent**1.5) * same_mean
    skewness = _ratio(third.reshape(64, -1).sum(axis=0), same_mean.reshape(64, -1).sum(axis=0))
    at = 2 + 1.5 * np.maximum(skewness, 0) ** 2
    coarser = at.reshape(4, -1).mean(axis=0)
    return [np.tile(at, 4), at, coarser, coarser.reshape(4, -1).mean(axis=0)]


def _pyramid(weight: np.ndarray, value: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Total weights and weighted means, from pixels to the groups of the top level."""
    levels = [(weight, value)]
    for _ in range(LEVELS):
        total = weight.reshape(4, -1).sum(axis=0)
        value = _ratio((weight * value).reshape(4, -1).sum(axis=0), total)
        levels.append((weight := total, value))
    return levels


def _siblings(weight: np.ndarray) -> np.ndarray:
    """Children with weight in each group, less one; 0 where there is none."""
    return np.maximum((weight > 0).sum(axis=0) - 1.0, 0)


def _window(groups: np.ndarray) -> np.ndarray:
    """Sums over 4x4 groups."""
    return groups.reshape(16, -1).sum(axis=0)


def _ratio(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """a / b, and 0 where b is 0."""
    return np.divide(a, b, out=np.zeros(np.broadcast_shapes(a.shape, b.shape)), where=b > 0)


@lru_cache(maxsize=4)
def _pyramid_order(height: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    """Index of each cell's pixel in the flat image, and whether it has one: the image is padded to whole blocks."""
    rows, columns = -(-height // BLOCK), -(-width // BLOCK)
    bits = BLOCK.bit_length() - 1
    cells = np.arange(rows * columns * BLOCK * BLOCK).reshape([rows] + [2] * bits + [columns] + [2] * bits)
    # Axes of the row's bits and the column's bits, finest first, then the blocks.
    axes = [axis for bit in range(bits) for axis in (bits - bit, 2 * bits + 1 - bit)]
    cells = cells.transpose([*axes, 0, bits + 1]).reshape(-1)
    y, x = np.divmod(cells, columns * BLOCK)
    inside = (y < height) & (x < width)
    return np.where(inside, y * width + x, 0), inside
