"""True errors: what an image is off from a reference, and whether the stated intervals cover it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from isonoise.error.stated_error import half_width_95
from isonoise.luminance import luminance
from isonoise.statistics import Statistics
from isonoise.strategies.measures import image_floor

WORST = 0.001
"""Share of the pixels that the trimmed relMSE leaves out."""

REL_MSE_EPSILON = 0.01
"""Added to the squared reference in the literature's relMSE: the only absolute constant."""

ROUNDING = 4 * 2.0**-24
"""Relative rounding of two float32 values and of the luminance made of them; a noiseless pixel is off by as much."""


@dataclass(frozen=True)
class TrueError:
    """Errors of an image x against a reference r.

    relMSE is over pixels and RGB; all else is on luminance (Rec. 709). `floor` is the reference's `image_floor`.

    | field | formula |
    |---|---|
    | `p50`, `p95`, `p99`, `max` | quantiles over the pixels of abs(x - r) / max(r, floor) |
    | `rel_mse` | mean of (x - r)^2 / (r^2 + 0.01) |
    | `rel_mse_floor` | mean of (x - r)^2 / (r^2 + floor^2) |
    | `rel_mse_trimmed`, `rel_mse_floor_trimmed` | the same without the 0.1 % of the pixels where each is largest |
    | `energy_ratio` | mean of x / mean of r |
    | `energy_ratio_se` | its standard error, from s^2 / n and the reference's standard errors where given |
    | `coverage` | share of pixels with abs(x - r) <= sqrt(h^2 + (1.96 se_ref)^2), h from `half_width_95` |
    | `floor` | 1 % of the geometric mean of max(r, 1e-4 mean r) over r > 0 |

    0.1 % of the pixels is rounded down. The coverage is over the pixels that have an interval (n >= 2) and allows for
    float32 rounding. Without statistics, `energy_ratio_se` and `coverage` are nan.
    """

    p50: float
    p95: float
    p99: float
    max: float
    rel_mse: float
    rel_mse_trimmed: float
    rel_mse_floor: float
    rel_mse_floor_trimmed: float
    energy_ratio: float
    energy_ratio_se: float
    coverage: float
    floor: float


def true_error(
    image: np.ndarray,
    reference: np.ndarray,
    reference_se: np.ndarray | None = None,
    statistics: Statistics | None = None,
) -> TrueError:
    """Errors of `image` against `reference`, both linear RGB of shape (height, width, 3).

    - `reference_se`: standard errors of the reference, RGB of the same shape; without it the reference counts as exact.
    - `statistics`: of the image, for the coverage and the error of the energy ratio.

    Raises ValueError if shapes differ or the reference has values that are not finite.
    """
    for name, other in (("reference", reference), ("reference_se", reference_se)):
        if other is not None and other.shape != image.shape:
            raise ValueError(f"{name} has shape {other.shape}, the image {image.shape}")
    if not np.isfinite(reference).all():
        raise ValueError("the reference has pixels that are not finite")
    r = luminance(reference)
    floor = image_floor(r)
    off = np.abs(luminance(image) - r)
    relative = _over(off, np.maximum(r, floor))
    # Interpolated as usual, but there is nothing between a number and inf.
    method = "linear" if np.isfinite(relative).all() else "inverted_cdf"
    p50, p95, p99 = (float(p) for p in np.quantile(relative, (0.5, 0.95, 0.99), method=method))
    rel_mse, rel_mse_trimmed = _rel_mse(image, reference, REL_MSE_EPSILON)
    rel_mse_floor, rel_mse_floor_trimmed = _rel_mse(image, reference, floor**2)
    r_se = np.zeros_like(r) if reference_se is None else _luminance_se(reference_se)
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
        coverage=_coverage(off, r, r_se, statistics),
        floor=floor,
    )


def is_reference_accurate(p99_compared: Sequence[float], reference: np.ndarray, reference_se: np.ndarray) -> bool:
    """Whether the reference can tell the compared images apart: its own p99 over the pixels of se / max(r, floor) is at
    most a quarter of the smallest p99 compared."""
    r = luminance(reference)
    relative = _over(_luminance_se(reference_se), np.maximum(r, image_floor(r)))
    return bool(np.quantile(relative, 0.99) <= min(p99_compared) / 4)


def _over(error: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """error / scale; 0 / 0 is 0 and anything else over 0 is inf (a black reference has no floor)."""
    return np.divide(error, scale, out=np.where(error > 0, np.inf, 0.0), where=scale > 0)


def _rel_mse(image: np.ndarray, reference: np.ndarray, epsilon: float) -> tuple[float, float]:
    """Mean over pixels and RGB of (x - r)^2 / (r^2 + epsilon), and the same without the worst 0.1 % of the pixels."""
    per_pixel = np.zeros(reference.shape[:2])
    for channel in range(3):  # one at a time: large images in float64
        r = reference[..., channel].astype(np.float64)
        per_pixel += _over((image[..., channel] - r) ** 2, r * r + epsilon) / 3
    per_pixel = per_pixel.ravel()
    kept = per_pixel.size - int(WORST * per_pixel.size)
    trimmed = np.partition(per_pixel, kept - 1)[:kept]
    return float(per_pixel.mean()), float(trimmed.mean())


def _luminance_se(rgb_se: np.ndarray) -> np.ndarray:
    """Standard error of the luminance from those of RGB, as if the channels erred together: the largest it can be, and
    near what it is, since a path's three channels share all its random decisions."""
    return luminance(np.abs(rgb_se))


def _energy_ratio(x: np.ndarray, r: np.ndarray, r_se: np.ndarray, statistics: Statistics | None) -> tuple[float, float]:
    """Mean of x over mean of r and its standard error (first order, pixels independent)."""
    total = r.sum()
    if total <= 0:
        return float("nan"), float("nan")
    ratio = x.sum() / total
    if statistics is None:
        return float(ratio), float("nan")
    if (statistics.count < 2).any():
        return float(ratio), float("inf")
    variance = (statistics.variance / statistics.count).sum() + ratio**2 * np.square(r_se).sum()
    return float(ratio), float(np.sqrt(variance) / total)


def _coverage(off: np.ndarray, r: np.ndarray, r_se: np.ndarray, statistics: Statistics | None) -> float:
    if statistics is None or not (statistics.count >= 2).any():
        return float("nan")
    allowed = np.hypot(half_width_95(statistics), 1.96 * r_se) + ROUNDING * np.abs(r)
    return float(np.mean((off <= allowed)[statistics.count >= 2]))
