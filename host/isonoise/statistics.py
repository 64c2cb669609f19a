"""The per-pixel statistics as the host sees them."""

import math
from dataclasses import dataclass

import numpy as np

from isonoise.errors import UserError


@dataclass(frozen=True)
class Needs:
    """Statistics that a strategy reads beyond those every render keeps; only these are kept on the device.

    - `median`: M_x, the running mean of the medians of chunks of `chunk` entries (odd, 1 to 31); an entry is the mean
      of `batch` consecutive samples (1 to 65536).
    - `power`: q, above 0, of the mean of x^q (of x ln x for q = 1); None for none. The device takes it as a float32.
      For q = 2, mean and variance say as much and cost nothing.
    - `half`: the mean of every second sample.

    Raises UserError where a parameter is out of range.
    """

    median: bool = False
    chunk: int = 5
    batch: int = 1
    power: float | None = None
    half: bool = False

    def __post_init__(self):
        if self.chunk not in range(1, 32, 2):
            raise UserError(f"a chunk of {self.chunk} entries has no median to keep; an odd number from 1 to 31 has")
        if self.batch not in range(1, 65537):
            raise UserError(f"a batch of {self.batch} samples cannot be averaged; a whole number from 1 to 65536 can")
        if self.power is not None and not 0 < self.power < math.inf:
            raise UserError(f"the mean of x^{self.power} cannot be kept; the power has to be a finite number above 0")


BASIC_NEEDS = Needs()


@dataclass(frozen=True)
class Statistics:
    """Statistics of the samples of every pixel, arrays of shape (height, width), in the scene's units.

    Before the first full chunk M_x is the median of the entries there are, before the first entry the mean of the
    samples. A renderer's arrays cannot be written to: whoever asks before the next wave gets the same ones.
    `x` is a sample's luminance (Rec. 709). Samples that were negative or not finite are in `rejected` alone.
    """

    count: np.ndarray  # uint32: n, samples that entered
    rejected: np.ndarray  # uint32: samples that were negative or not finite
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
