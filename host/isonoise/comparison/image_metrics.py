"""Metrics of a single image against a reference, beside `true_error`: mean square error, bias, FLIP.

Called by `recorder` after every wave and by `flip_values`. The functions can be called with any images, such as those
that `isonoise compare --keep-images` writes.
"""

import math
from dataclasses import dataclass
from types import ModuleType

import numpy as np

from isonoise.comparison.reference_error import neighbour_mean
from isonoise.error.true_error import luminance_standard_error
from isonoise.errors import UserError
from isonoise.luminance import luminance
from isonoise.statistics import Statistics
from isonoise.strategies.measures import image_floor


def mean_square_error(image: np.ndarray, reference: np.ndarray) -> float:
    """Mean over pixels and RGB of (x - r)^2, in float64.

    Parameters
    ----------
    image, reference : (height, width, 3)
        Linear RGB in the scene's units.

    Returns
    -------
    float
        In the squared units of the scene.
    """
    difference = np.subtract(image, reference, dtype=np.float64)
    return float(np.mean(np.square(difference, out=difference)))


@dataclass(frozen=True)
class Bias:
    """The mean relative error of an image and its standard error.

    Attributes
    ----------
    value : float
        Mean over the pixels of (x - r) / max(m, floor), above 0 if the image is too bright.
    se : float
        From the standard errors of the image and of the reference; nan if the image's are unknown.
    """

    value: float
    se: float

    @property
    def z(self) -> float:
        """value / se: standard normal if the image is unbiased; nan if se is not above 0."""
        return self.value / self.se if self.se > 0 else math.nan


class BiasMetric:
    """Bias of images against a reference r.

    The denominator max(m, floor), m the mean of r over the pixel's neighbours, is independent of the noise of the
    pixel's own reference value. With r in its place unbiased images would seem too bright: `metrics.bias`, which has
    the same value for several runs.

    Parameters
    ----------
    reference : (height, width, 3)
        Linear RGB.
    reference_se : (height, width, 3) or None
        Its standard errors. None: it is exact.
    """

    def __init__(self, reference: np.ndarray, reference_se: np.ndarray | None = None):
        self._reference = luminance(reference)
        scale = np.maximum(neighbour_mean(self._reference), image_floor(self._reference))
        self._weight = np.divide(1, scale, out=np.zeros_like(scale), where=scale > 0)
        self._reference_variance = 0.0 if reference_se is None else np.square(luminance_standard_error(reference_se))

    def __call__(self, image: np.ndarray, statistics: Statistics | None = None) -> Bias:
        """The bias of `image`, linear RGB (height, width, 3); `statistics` are its own, for the standard error."""
        value = float(np.mean(self._weight * (luminance(image) - self._reference), dtype=np.float64))
        if statistics is None:
            return Bias(value, math.nan)
        variance = statistics.variance_of_mean() + self._reference_variance
        with np.errstate(invalid="ignore"):  # pixels with fewer than two samples have an infinite variance
            se = math.sqrt(float((np.square(self._weight) * variance).sum())) / self._weight.size
        return Bias(value, se if math.isfinite(se) else math.nan)


def flip(image: np.ndarray, reference: np.ndarray) -> float:
    """LDR-FLIP of an image: the difference to the reference that a viewer sees, 0 to 1, mean over the pixels.

    Both images are tone-mapped to 8-bit sRGB by `tone_map`, as in PNG outputs, with the exposure that the reference
    has there. The viewer is 0.7 m from a monitor that is 0.7 m wide and has 3840 pixels in a row: 67 pixels per degree,
    the default of the program. Andersson et al. 2020, "FLIP: a difference evaluator for alternating images".

    Parameters
    ----------
    image, reference : (height, width, 3)
        Linear RGB.

    Raises
    ------
    UserError
        If the package flip-evaluator is not installed.
    """
    flip_evaluator = import_flip()
    from isonoise.film.png import automatic_exposure, tone_map

    exposure = automatic_exposure(np.maximum(reference, 0))
    ldr = [tone_map(pixels, exposure).astype(np.float32) / 255 for pixels in (reference, image)]
    return float(flip_evaluator.evaluate(*ldr, "LDR", applyMagma=False)[1])


def import_flip() -> ModuleType:
    """The package flip_evaluator. Raises UserError if it is not installed."""
    try:
        import flip_evaluator
    except ImportError as error:
        raise UserError("the metric 'flip' needs flip-evaluator: pip install 'isonoise[flip]'") from error
    return flip_evaluator
