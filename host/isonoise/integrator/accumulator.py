"""The per-pixel statistics on the device: the planes that the reduce stage updates, and how they read in float64."""

from collections.abc import Callable

import numpy as np

from isonoise.device.opencl import Device
from isonoise.statistics import Statistics

BLOCK = 16
"""Samples that are summed before they are merged into the statistics (kernels/reduce.cl)."""
CHUNK = 5
"""Samples of a chunk, whose median enters M_x; odd."""

MEAN_NOISE = 2.0**-44
"""Differences of means below this share of them are rounding, and count as none (kernels/reduce.cl)."""

STRIP = 2**18
"""Pixels that are read at a time."""

_SUMS = 10  # planes: high and low parts of the sums of red, green, blue, x, and of M2, over the full blocks
_OPEN = 6  # planes of the unfinished block: sums of red, green, blue; shift; sums of x - shift and its square
_MEDIANS = 2 + CHUNK - 1  # planes: high and low part of the sum of the chunk medians; x of the unfinished chunk


class Accumulator:
    """State of the reduce stage for an image of shape (height, width); medians are kept only if wanted."""

    def __init__(self, device: Device, shape: tuple[int, int], with_median: bool):
        self._device, self._shape = device, shape
        self.pixels = shape[0] * shape[1]
        self.count = device.buffer(4 * self.pixels, "the sample counts")
        self.rejected = device.buffer(4 * self.pixels, "the counts of rejected samples")
        self.sums = device.buffer(4 * _SUMS * self.pixels, "the statistics")
        self.block_sums = device.buffer(4 * _OPEN * self.pixels, "the statistics of unfinished blocks")
        self.medians = device.buffer(4 * _MEDIANS * self.pixels, "the chunk medians") if with_median else None

    def statistics(self, scale: float = 1.0) -> Statistics:
        """Reads the state; samples on the device are `scale` times those of the scene. Waits for the device."""
        n = self.pixels
        flat = Statistics(
            count=np.empty(n, np.uint32),
            rejected=np.empty(n, np.uint32),
            rgb=np.empty((n, 3), np.float32),
            mean=np.empty(n),
            variance=np.empty(n),
            median=None if self.medians is None else np.empty(n),
        )
        for begin in range(0, n, STRIP):  # in strips, so that the intermediate results of a large image stay small
            self._read_strip(flat, begin, min(STRIP, n - begin), scale)
        shape = self._shape
        return Statistics(
            **{
                name: plane if plane is None else plane.reshape(*shape, *plane.shape[1:])
                for name, plane in vars(flat).items()
            }
        )

    def _read_strip(self, into: Statistics, begin: int, n: int, scale: float) -> None:
        """Fills pixels begin to begin + n of the planes of `into`."""
        strip = slice(begin, begin + n)

        def plane(buffer, number: int) -> np.ndarray:
            return self._device.read(buffer, np.float32, n, number * self.pixels + begin).astype(np.float64)

        def total(number: int) -> np.ndarray:
            return plane(self.sums, number) + plane(self.sums, number + 1)

        into.count[strip] = count = self._device.read(self.count, np.uint32, n, begin)
        into.rejected[strip] = self._device.read(self.rejected, np.uint32, n, begin)
        opened = count % BLOCK
        some, full, is_open = np.maximum(count, 1), count - opened, opened > 0
        for channel in range(3):
            rgb = total(2 * channel) + np.where(is_open, plane(self.block_sums, channel), 0)
            into.rgb[strip, channel] = rgb / some / scale

        open_sum, open_squares = plane(self.block_sums, 4), plane(self.block_sums, 5)
        open_mean = open_sum / np.maximum(opened, 1)
        m2 = total(8) + np.where(is_open, np.maximum(open_squares - open_sum * open_mean, 0), 0)
        open_mean += plane(self.block_sums, 3)
        full_sum = total(6)
        difference = np.where(is_open & (full > 0), open_mean - full_sum / np.maximum(full, 1), 0)
        difference[np.abs(difference) < MEAN_NOISE * np.abs(open_mean)] = 0
        # Chan, Golub, LeVeque 1983: the unfinished block merged as the kernel merges a full one
        m2 += difference * difference * (full * (opened / some))
        into.mean[strip] = (full_sum + np.where(is_open, open_mean * opened, 0)) / some / scale
        into.variance[strip] = np.where(count > 1, m2 / np.maximum(count.astype(np.int64) - 1, 1) / scale**2, 0)
        if into.median is not None:
            into.median[strip] = self._median(count, plane) / scale

    def _median(self, count: np.ndarray, plane: Callable) -> np.ndarray:
        """M_x: mean of the medians of the full chunks; before the first of these, the median of what is there."""
        median = (plane(self.medians, 0) + plane(self.medians, 1)) / np.maximum(count // CHUNK, 1)
        early = np.flatnonzero((count > 0) & (count < CHUNK))
        if len(early):
            pending = np.stack([plane(self.medians, 2 + place)[early] for place in range(CHUNK - 1)])
            n = count[early]
            pending[np.arange(CHUNK - 1)[:, None] >= n] = np.inf
            pending.sort(axis=0)
            middle = np.arange(len(early))
            median[early] = 0.5 * (pending[(n - 1) // 2, middle] + pending[n // 2, middle])
        return median
