"""The per-pixel statistics as the host sees them."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Statistics:
    """Statistics of the samples of every pixel, arrays of shape (height, width), in the scene's units.

    `x` is a sample's luminance (Rec. 709). Samples that were not finite are in `rejected` alone.
    """

    count: np.ndarray  # uint32: n, samples that entered
    rejected: np.ndarray  # uint32: samples that were not finite
    rgb: np.ndarray  # float32 (height, width, 3): mean linear RGB, 0 where n = 0
    mean: np.ndarray  # float64: mean of x, 0 where n = 0
    variance: np.ndarray  # float64: s^2 of x with n - 1, 0 where n < 2
    median: np.ndarray | None  # float64: M_x, running mean of the chunk medians; None if the strategy does not need it

    @property
    def shape(self) -> tuple[int, int]:
        return self.count.shape

    @property
    def samples(self) -> int:
        """Samples that entered so far, over the whole image."""
        return int(self.count.sum(dtype=np.int64))
