"""Figures of a comparison without the error of the reference itself; called by `recorder`, `results`, `summary`.

The reference is the true image plus independent noise of known standard error, the same for all runs.
"""

from collections.abc import Callable, Sequence

import numpy as np

from isonoise.comparison.metrics import leave_one_out_rms_quantiles, rms_over_seeds
from isonoise.error.true_error import REL_MSE_EPSILON

REPLICATES = 4
"""Images of added noise, averaged: the noise of 4 leaves p99 of 64x64 pixels uncertain by less than 1 %."""
NEIGHBOUR_RADIUS = 2
"""Neighbours of a pixel are the other pixels of the square of 2 * 2 + 1 = 5 pixels around it."""


def without_reference_error(
    figure: Callable[[np.ndarray], np.ndarray], errors: np.ndarray, relative_se: np.ndarray | None
) -> np.ndarray:
    """`figure` of the errors as an exact reference would show it: simulation extrapolation.

    Noise with the reference's standard error is added to the errors once more. The square of the figure is a linear
    function of the variance of that noise if errors are normal, and nearly so if the noise is small. So it is
    extrapolated linearly to a reference without noise: figure(errors)^2 - (figure(errors + noise)^2 - figure(errors)^2)
    (Cook and Stefanski 1994, "Simulation-extrapolation estimation in parametric measurement error models").

    Parameters
    ----------
    figure : callable
        From errors to figures of the dimension of an error, such as quantiles of |e|.
    errors : (..., height, width)
        Signed relative errors e = (x - r) / max(r, floor).
    relative_se : (height, width) or None
        The reference's standard error over max(r, floor). None: it is exact.
    """
    observed = np.square(figure(errors))
    if relative_se is None or not relative_se.any():
        return np.sqrt(observed)
    rng = np.random.default_rng(0)
    noise = (relative_se * rng.standard_normal(relative_se.shape) for _ in range(REPLICATES))
    doubled = np.mean([np.square(figure(errors + z)) for z in noise], axis=0)
    return np.sqrt(np.maximum(2 * observed - doubled, 0))


def error_quantiles(error: np.ndarray, quantiles: Sequence[float], relative_se: np.ndarray | None) -> np.ndarray:
    """Quantiles over the pixels of |e| of a single image, without the reference's error."""
    return without_reference_error(lambda e: np.quantile(np.abs(e), quantiles), error, relative_se)


def rms_quantiles(
    errors: np.ndarray, quantiles: Sequence[float], relative_se: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """Quantiles over the pixels of the RMS over the seeds, without the reference's error.

    Returns
    -------
    all_seeds : (Q,) float64
    leave_one_out : (S, Q) float64
        Row i is computed without seed i. (0, Q) with a single seed. The reference's share is that of all seeds.
    """

    def figure(images: np.ndarray) -> np.ndarray:
        return np.sqrt(np.quantile(np.square(rms_over_seeds(images)), quantiles))

    all_seeds = without_reference_error(figure, errors, relative_se)
    reference_share = np.square(figure(errors)) - np.square(all_seeds)
    leave_one_out = leave_one_out_rms_quantiles(errors, quantiles)
    return all_seeds, np.sqrt(np.maximum(np.square(leave_one_out) - reference_share, 0))


def relative_to_floor(standard_error: np.ndarray, reference: np.ndarray, floor: float) -> np.ndarray:
    """se / max(r, floor) of luminances; 0 in a black reference, whose floor is 0."""
    scale = np.maximum(reference, floor)
    return np.divide(standard_error, scale, out=np.zeros_like(scale), where=scale > 0)


def reference_rel_mse(rgb: np.ndarray, rgb_se: np.ndarray) -> float:
    """What the reference's error adds to the relMSE on average: mean over pixels and RGB of se^2 / (r^2 + 0.01)."""
    return float(np.mean(np.square(rgb_se, dtype=np.float64) / (np.square(rgb, dtype=np.float64) + REL_MSE_EPSILON)))


def neighbour_mean(image: np.ndarray, radius: int = NEIGHBOUR_RADIUS) -> np.ndarray:
    """Mean of a pixel's neighbours in the image, without the pixel itself: float64 (height, width)."""
    values = np.asarray(image, np.float64)
    if values.size == 1:
        return values
    count = _box_sum(np.ones_like(values), radius) - 1
    return (_box_sum(values, radius) - values) / count


def _box_sum(image: np.ndarray, radius: int) -> np.ndarray:
    """Sum over the part of the square of 2 radius + 1 pixels that lies in the image."""
    for axis in (0, 1):
        size = image.shape[axis]
        sums = np.insert(np.cumsum(image, axis=axis), 0, 0, axis=axis)
        position = np.arange(size)
        upper, lower = np.minimum(position + radius + 1, size), np.maximum(position - radius, 0)
        image = np.take(sums, upper, axis=axis) - np.take(sums, lower, axis=axis)
    return image
