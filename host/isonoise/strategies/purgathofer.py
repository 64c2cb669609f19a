"""The strategy `purgathofer`: a pixel is done when its confidence interval is narrow enough."""

import math
from dataclasses import dataclass

import numpy as np

from isonoise.statistics import Statistics
from isonoise.strategies.measures import confidence
from isonoise.strategies.parameter_checks import check_range
from isonoise.strategies.stopping import Retiring


@dataclass(kw_only=True, eq=False)
class Purgathofer(Retiring):
    """Retires pixels whose mean is known to the tolerance at the significance.

    From: Purgathofer, "A statistical method for adaptive stochastic sampling", Computers & Graphics 11 (2), 1987,
    as later surveys give it (the paper itself was not at hand; the two defaults are ours). A pixel is done when t
    se <= d, t the quantile 1 - alpha / 2 of Student's distribution with n - 1 degrees of freedom and d the
    tolerance: an absolute one, for values from 0 to 1. Where all samples are equal that says nothing; then they
    have to be ln(alpha) / ln(1 - d) or more, since a share of d of the pixel that looked different would be missed
    with probability (1 - d)^n.

    Differences: tests come after every `step` samples and not after each; luminance in the scene's units is tested,
    which nothing bounds by 1, so results depend on the scene's brightness. When all pixels are done the tolerance is
    halved and all begin anew from their statistics, so that a deadline is used.

    - `significance`: alpha, the chance that a pixel taken for done is not, 1e-9 to 0.5.
    - `tolerance`: d, in the scene's units, 1e-6 to 0.5.
    - `warmup`: samples per pixel before the first test, 2 to 65536.
    - `step`: samples of an active pixel between two tests, 1 to 65536.
    """

    name = "purgathofer"

    significance: float = 0.05
    tolerance: float = 0.05
    warmup: int = 8
    step: int = 8

    def __post_init__(self):
        check_range("significance", self.significance, 1e-9, 0.5)
        check_range("tolerance", self.tolerance, 1e-6, 0.5)
        check_range("warmup", self.warmup, 2, 65536)
        check_range("step", self.step, 1, 65536)

    @property
    def first(self) -> int:
        return self.warmup

    def error(self, statistics: Statistics) -> np.ndarray:
        return confidence(statistics, self.significance)

    def active(self, error: np.ndarray, statistics: Statistics, scale: float, before: np.ndarray | None) -> np.ndarray:
        tolerance = self.tolerance * scale
        equal = math.log(self.significance) / math.log1p(-tolerance)
        active = (error > tolerance) | ((error == 0) & (statistics.count < equal))
        return active if before is None else active & before
