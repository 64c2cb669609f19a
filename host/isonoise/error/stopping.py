"""Whether the true error is below a limit with a given confidence. The render loop asks after every wave."""

import math

from isonoise.error.distribution import ErrorDistribution

CALIBRATION_MARGIN = 1.05
"""Ratio of true to stated error that model errors of the estimate may cause (`tests/test_error_stop.py`)."""
DISPERSION = 2.0
"""Variance of the number of pixels with a true error above the limit, minus its estimate, over that of a binomial
number: 1 for the pixels' errors, and at most 1 for the estimate, whose noise is no larger."""


class ErrorStop:
    """A test of "the true error at a quantile is below the limit" that may be repeated after every wave.

    `bound` is an upper confidence bound of the true error: the stated error at a raised quantile, times
    CALIBRATION_MARGIN. The test passes when the bound is below the limit. It can only pass wrongly at a look, a wave
    whose stated error is below the limit. Look k spends the error probability (1 - confidence) / (k (k + 1)), so that
    all looks together spend at most 1 - confidence (alpha spending; Lan and DeMets 1983, "Discrete sequential
    boundaries for clinical trials").

    Parameters
    ----------
    limit, quantile, confidence : float
        As in `isonoise.Stops`.

    Attributes
    ----------
    stated : float or None
        The stated error at `quantile`, None before the first wave.
    bound : float or None
        Its upper confidence bound, None before the first wave.
    passed : bool
        Whether the last update passed the test.
    """

    def __init__(self, limit: float, quantile: float, confidence: float):
        self.limit, self.quantile, self.confidence = limit, quantile, confidence
        self.looks = 0
        self.stated: float | None = None
        self.bound: float | None = None
        self.passed = False

    def restore(self, looks: int, stated: float | None, bound: float | None, quantile: float, **settings) -> None:
        """Continue the test of a stopped render, from the attributes of its `ErrorStop`; limits may differ.

        Looks stay spent. The last errors count if the quantile is the same; else the next wave shows them.
        """
        self.looks = looks
        if quantile == self.quantile and settings["confidence"] == self.confidence:
            self.stated, self.bound = stated, bound
            self.passed = bound is not None and bound < self.limit

    def update(self, distribution: ErrorDistribution) -> None:
        """Test an image with this distribution of errors."""
        look = self.looks + 1
        significance = (1 - self.confidence) / (look * (look + 1))
        raised = raised_quantile(self.quantile, distribution.pixels, significance)
        self.stated, bound = distribution.quantiles((self.quantile, raised)).tolist()
        self.bound = CALIBRATION_MARGIN * bound
        self.looks += self.stated < self.limit
        self.passed = self.bound < self.limit


def raised_quantile(quantile: float, pixels: int, significance: float) -> float:
    """The quantile whose stated error exceeds the true error at `quantile` with probability 1 - `significance`.

    The true error at the quantile is below e if at most k = (1 - quantile) pixels errors are above e. If m are
    expected, the number has the quantile m + z s + (z^2 - 1) / 6, s^2 = DISPERSION m (1 - m / pixels), for the
    probability 1 - `significance` (Cornish-Fisher expansion; Abramowitz and Stegun 1964, 26.2.49). It is solved for m.
    With m = `significance`, no error at all is above e with probability 1 - `significance`.
    """
    from statistics import NormalDist  # takes some 10 ms, and not every command needs it

    z = -NormalDist().inv_cdf(significance)
    allowed = (1 - quantile) * pixels - (z * z - 1) / 6
    expected = 0.0
    if allowed > 0:  # (allowed - m)^2 = a m (1 - m / pixels), the root below `allowed`
        a = DISPERSION * z * z
        half = allowed + a / 2
        leading = 1 + a / pixels
        expected = allowed * allowed / (half + math.sqrt(half * half - leading * allowed * allowed))
    return min(1 - max(expected, significance) / pixels, math.nextafter(1, 0))  # below 1 also after rounding
