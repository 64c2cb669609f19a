"""The distribution of the pixels' errors. Made by `stated_error` on the host and by `ErrorStage` on the device."""

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

OCTAVES = 32
"""The histogram of errors covers 2^-32 to 2^32."""
BINS_PER_OCTAVE = 32
"""Quantiles are interpolated between bins: good to 1e-4."""
NORMAL_BINS = 8
"""Bins of the square root of the error's normal share."""
ERROR_BINS = 2 * OCTAVES * BINS_PER_OCTAVE + 1


class ErrorDistribution:
    """How many pixels have which error |deviation + sqrt(v) Z| / scale, Z standard normal.

    Parameters
    ----------
    pixels : int
        Of the image. Those that are neither noiseless nor in the histogram have an unknown error.
    """

    def __init__(self, pixels: int):
        self.pixels = pixels
        self.noiseless = 0
        # over the root of the normal share and log2 of the root mean square
        self._histogram = np.zeros((NORMAL_BINS + 1) * ERROR_BINS)
        self._noisy = 0

    def add(self, position: np.ndarray, normal_bin: np.ndarray, number: np.ndarray | None = None) -> None:
        """Add pixels. Each is split between two neighbouring bins of the root mean square.

        Parameters
        ----------
        position : (n,) float
            `histogram_position` of their mean square errors; overwritten.
        normal_bin : (n,) int
            0 to NORMAL_BINS: the square root of the normal share, v / (deviation^2 + v), rounded to a bin.
        number : (n,) or None
            Pixels of each entry; None: 1.
        """
        np.clip(position, 0, ERROR_BINS - 1.001, out=position)
        left = position.astype(np.intp)
        position -= left
        left += ERROR_BINS * normal_bin
        right_weight = position if number is None else position * number
        right = np.bincount(left, right_weight, minlength=self._histogram.size)
        self._histogram += np.bincount(left, number, minlength=self._histogram.size) - right
        self._histogram[1:] += right[:-1]
        self._noisy += len(left) if number is None else int(number.sum())

    def quantiles(self, quantiles: Sequence[float]) -> np.ndarray:
        """The error e, for each quantile q, at which the mean over the pixels of P(error <= e) is q.

        Pixels with an unknown error may have any: with a share of 1 - q of them or more the result is inf. With a share
        of q of noiseless ones or more it is 0.

        Raises
        ------
        ValueError
            If a quantile is not in (0, 1).
        """
        if not all(0 < q < 1 for q in quantiles):
            raise ValueError(f"quantiles must be in (0, 1), not {list(quantiles)}")
        return np.array([self._quantile(q * self.pixels) for q in quantiles])

    def _quantile(self, pixels: float) -> float:
        """The e for which the expected number of pixels with a smaller error is `pixels`."""
        if pixels <= self.noiseless:
            return 0.0
        if pixels >= self.noiseless + self._noisy:
            return math.inf
        half = OCTAVES * BINS_PER_OCTAVE
        histogram, probability = self._histogram.reshape(-1, ERROR_BINS), _error_cdf()
        occupied = np.flatnonzero(histogram.any(axis=0))
        begin, end = occupied[0], occupied[-1] + 1
        histogram = histogram[:, begin:end]

        def expected_below(error_bin: int) -> float:
            window = probability[:, 2 * half - error_bin + begin : 2 * half - error_bin + end]
            return self.noiseless + float(np.einsum("ij,ij->", histogram, window))

        low, high = 0, 2 * half
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (middle, high) if expected_below(middle) < pixels else (low, middle)
        below, above = expected_below(low), expected_below(high)
        fraction = min(max((pixels - below) / (above - below), 0.0), 1.0) if above > below else 0.0
        return 2.0 ** ((low + fraction - half) / BINS_PER_OCTAVE)


def histogram_position(square: np.ndarray) -> np.ndarray:
    """Position in the bins of the root of mean square errors above 0; overwrites them."""
    position = np.log2(square, out=square)
    position *= BINS_PER_OCTAVE / 2  # half: of the square's root
    position += OCTAVES * BINS_PER_OCTAVE
    return position


@lru_cache(maxsize=1)
def _error_cdf() -> np.ndarray:
    """P(|sqrt(1 - u) + sqrt(u) Z| <= 2^(k / BINS_PER_OCTAVE)) for every bin of the normal share u.

    k runs from the largest to the smallest difference of two bins.
    """
    half = OCTAVES * BINS_PER_OCTAVE
    limits = [2.0 ** (k / BINS_PER_OCTAVE) for k in range(2 * half, -2 * half - 1, -1)]
    table = [[float(limit >= 1) for limit in limits]]
    for normal_bin in range(1, NORMAL_BINS + 1):
        sd = normal_bin / NORMAL_BINS
        deviation, unit = math.sqrt(1 - sd * sd), math.sqrt(2) * sd
        table.append(
            [0.5 * (math.erf((limit - deviation) / unit) + math.erf((limit + deviation) / unit)) for limit in limits]
        )
    return np.array(table)
