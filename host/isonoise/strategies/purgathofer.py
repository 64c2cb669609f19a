"""The strategy `purgathofer`: a pixel has converged when its confidence interval is narrow enough."""

import math
from dataclasses import dataclass

import numpy as np

from isonoise.statistics import Statistics
from isonoise.strategies.measures import confidence
from isonoise.strategies.parameters import ranged
from isonoise.strategies.stopping import StoppingStrategy


@dataclass(kw_only=True, eq=False)
class Purgathofer(StoppingStrategy):
    """Stops sampling a pixel when its mean is known to the tolerance at the significance level.

    From: Purgathofer, "A statistical method for adaptive stochastic sampling", Computers & Graphics 11 (2), 1987, as
    later surveys describe it (the paper itself was not available; both defaults are ours). A pixel has converged when
    t se <= d, t the quantile 1 - alpha / 2 of Student's distribution with n - 1 degrees of freedom and d the tolerance,
    an absolute one for values from 0 to 1. If all samples are equal, se is 0 and no evidence. Then there must be
    ln(alpha) / ln(1 - d) samples or more: a share d of the pixel that looks different is missed with probability
    (1 - d)^n.

    Differences: the test comes after every `step` samples, not after each one. It is made on the luminance in the
    scene's units, which may exceed 1, so results depend on the scene's brightness. When all pixels have converged, the
    tolerance is halved (`StoppingStrategy`).

    Parameters
    ----------
    significance : float
        alpha, the probability that a converged pixel is not known to the tolerance, 1e-9 to 0.5.
    tolerance : float
        d, in the scene's units, 1e-6 to 0.5.
    warmup : int
        Samples per pixel before the first test, 2 to 65536.
    step : int
        Samples of an active pixel between two tests, 1 to 65536.
    """

    name = "purgathofer"

    significance: float = ranged(0.05, 1e-9, 0.5)
    tolerance: float = ranged(0.05, 1e-6, 0.5)
    warmup: int = ranged(8, 2, 65536)
    step: int = ranged(8, 1, 65536)

    @property
    def first_test_spp(self) -> int:
        return self.warmup

    def pixel_error(self, statistics: Statistics) -> np.ndarray:
        return confidence(statistics, self.significance)

    def active_pixels(
        self, error: np.ndarray, statistics: Statistics, threshold_scale: float, previous: np.ndarray | None
    ) -> np.ndarray:
        tolerance = self.tolerance * threshold_scale
        min_equal_samples = math.log(self.significance) / math.log1p(-tolerance)
        active = (error > tolerance) | ((error == 0) & (statistics.count < min_equal_samples))
        return active if previous is None else active & previous
