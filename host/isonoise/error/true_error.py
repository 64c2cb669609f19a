"""Errors of an image against a reference, and whether the stated confidence intervals cover it."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from isonoise.error.stated_error import half_width_95
from isonoise.field_docs import document_fields
from isonoise.luminance import luminance
from isonoise.statistics import Statistics
from isonoise.strategies.measures import image_floor

TRIMMED_SHARE = 0.001
"""Share of the pixels, the worst ones, that the trimmed relMSE leaves out."""

REL_MSE_EPSILON = 0.01
"""Added to the squared reference in the literature's relMSE: the only absolute constant."""

FLOAT32_ROUNDING = 4 * 2.0**-24
"""Relative rounding of two float32 RGB values and of their luminance. A noiseless pixel differs by this much."""


def _formula(text: str) -> Any:
    return field(metadata={"doc": text})


@document_fields
@dataclass(frozen=True)
class TrueError:
    """Errors of an image x against a reference r, as the log describes them.

    `rel_mse*` are over pixels and RGB, all others over luminance. The trimmed share is rounded down to whole pixels.
    The coverage is over pixels with n >= 2 and allows for float32 rounding. Without statistics, `energy_ratio_se` and
    `coverage` are nan.
    """

    p50: float = _formula(
        "median over the pixels of |x - r| / max(r, floor), luminance x of the image, r of the reference"
    )
    p95: float = _formula("the same at quantile 0.95")
    p99: float = _formula("the same at quantile 0.99")
    max: float = _formula("the same for the worst pixel")
    rel_mse: float = _formula("mean over pixels and RGB of (x - r)^2 / (r^2 + 0.01), the literature's relMSE")
    rel_mse_trimmed: float = _formula("the same without the worst 0.1 % of the pixels")
    rel_mse_floor: float = _formula("mean over pixels and RGB of (x - r)^2 / (r^2 + floor^2)")
    rel_mse_floor_trimmed: float = _formula("the same without the worst 0.1 % of the pixels")
    energy_ratio: float = _formula("mean luminance of the image / mean luminance of the reference")
    energy_ratio_se: float = _formula(
        "standard error of energy_ratio, from the standard errors of the image and of the reference"
    )
    coverage: float = _formula(
        "share of the pixels with |x - r| <= sqrt(h^2 + (1.96 se_ref)^2), h half the width of the 95 % interval"
    )
    floor: float = _formula("1 % of the geometric mean of max(r, 1e-4 mean r) over the pixels with r > 0")


def true_error(
    image: np.ndarray,
    reference: np.ndarray,
    reference_se: np.ndarray | None = None,
    statistics: Statistics | None = None,
) -> TrueError:
    """Errors of `image` against `reference`.

    Parameters
    ----------
    image, reference : (height, width, 3)
        Linear RGB.
    reference_se : (height, width, 3) or None
        Standard errors of the reference. None: the reference counts as exact.
    statistics : Statistics or None
        Of the image, for the coverage and the error of the energy ratio.

    Raises
    ------
    ValueError
        If shapes differ or the reference is not finite everywhere.
    """
    for name, other in (("reference", reference), ("reference_se", reference_se)):
        if other is not None and other.shape != image.shape:
            raise ValueError(f"{name} has shape {other.shape}, the image {image.shape}")
    if not np.isfinite(reference).all():
        raise ValueError("the reference has pixels that are not finite")
    r = luminance(reference)
    floor = image_floor(r)
    difference = np.abs(luminance(image) - r)
    relative = _divide(difference, np.maximum(r, floor))
    # Linear interpolation as usual, except towards inf.
    method = "linear" if np.isfinite(relative).all() else "inverted_cdf"
    p50, p95, p99 = (float(p) for p in np.quantile(relative, (0.5, 0.95, 0.99), method=method))
    rel_mse, rel_mse_trimmed = _rel_mse(image, reference, REL_MSE_EPSILON)
    rel_mse_floor, rel_mse_floor_trimmed = _rel_mse(image, reference, floor**2)
    r_se = np.zeros_like(r) if reference_se is None else luminance_standard_error(reference_se)
    ratio, ratio_se = _energy_ratio(luminance(image), r, r_se, statistics)
    return TrueError(
        p50=p50,
        p95=p95,
        p99=p99,
        max=float(relative.max()),
        rel_mse=rel_mse,
        rel_mse_trimmed=rel_mse_trimmed,
        rel_mse_floor=rel_mse_floor,
        rel_mse_floor_trimmed=rel_mse_floor_trimmed,
        energy_ratio=ratio,
        energy_ratio_se=ratio_se,
        coverage=_coverage(difference, r, r_se, statistics),
        floor=floor,
    )


def _divide(error: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """error / scale; 0 / 0 is 0, anything else over 0 is inf (a black reference has a floor of 0)."""
    return np.divide(error, scale, out=np.where(error > 0, np.inf, 0.0), where=scale > 0)


def _rel_mse(image: np.ndarray, reference: np.ndarray, epsilon: float) -> tuple[float, float]:
    """Mean over pixels and RGB of (x - r)^2 / (r^2 + epsilon), and the same without the worst 0.1 % of the pixels."""
    per_pixel = np.zeros(reference.shape[:2])
    for channel in range(3):  # one at a time, to save memory
        r = reference[..., channel].astype(np.float64)
        per_pixel += _divide((image[..., channel] - r) ** 2, r * r + epsilon) / 3
    per_pixel = per_pixel.ravel()
    size = per_pixel.size - int(TRIMMED_SHARE * per_pixel.size)
    trimmed = np.partition(per_pixel, size - 1)[:size]
    return float(per_pixel.mean()), float(trimmed.mean())


def luminance_standard_error(rgb_se: np.ndarray) -> np.ndarray:
    """Standard error of the luminance from those of RGB, for fully correlated channels.

    That is the upper bound, and close to the truth: the channels of a path share all its random decisions.
    """
    return luminance(np.abs(rgb_se))


def _energy_ratio(x: np.ndarray, r: np.ndarray, r_se: np.ndarray, statistics: Statistics | None) -> tuple[float, float]:
    """Mean of x over mean of r and its standard error (first order, pixels independent)."""
    total = r.sum()
    if total <= 0:
        return float("nan"), float("nan")
    ratio = x.sum() / total
    if statistics is None:
        return float(ratio), float("nan")
    variance = statistics.variance_of_mean().sum() + ratio**2 * np.square(r_se).sum()
    return float(ratio), float(np.sqrt(variance) / total)


def _coverage(difference: np.ndarray, r: np.ndarray, r_se: np.ndarray, statistics: Statistics | None) -> float:
    if statistics is None or not (statistics.count >= 2).any():
        return float("nan")
    allowed = np.hypot(half_width_95(statistics), 1.96 * r_se) + FLOAT32_ROUNDING * np.abs(r)
    return float(np.mean((difference <= allowed)[statistics.count >= 2]))
