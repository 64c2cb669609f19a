"""The per-pixel statistics as the host sees them."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Needs:
    """Statistics that a strategy reads beyond those every render keeps; only these are kept on the device.

    - `median`: M_x, the running mean of the medians of chunks of `chunk` entries (odd); an entry is the mean of
      `batch` consecutive samples.
    - `power`: q of the mean of x^q (of x ln x for q = 1); None for none.
    - `half`: the mean of every second sample.
    """

    median: bool = False
    chunk: int = 5
    batch: int = 1
    power: float | None = None
    half: bool = False


NOTHING_MORE = Needs()


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
    median: np.ndarray | None  # float64: M_x, running mean of the chunk medians; None unless needed
    power: np.ndarray | None = None  # float64: mean of max(x, 0)^q, for q = 1 of x ln x; None unless needed
    half: np.ndarray | None = None  # float32 (height, width, 3): mean RGB of samples 2, 4, 6, ...; None unless needed

    @property
    def shape(self) -> tuple[int, int]:
        return self.count.shape

    @property
    def samples(self) -> int:
        """Samples that entered so far, over the whole image."""
        return int(self.count.sum(dtype=np.int64))
