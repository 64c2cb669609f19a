"""The per-pixel statistics on the device: the planes that the reduce stage updates, and how they read in float64."""

import numpy as np

from isonoise.device.opencl import Device
from isonoise.statistics import Statistics

BLOCK = 16
"""Samples that are summed before they are merged into the statistics (kernels/reduce.cl)."""
CHUNK = 5
"""Samples of a chunk, whose median enters M_x; odd."""

MEAN_NOISE = 2.0**-44
"""Differences of means below this share of them are rounding, and count as none (kernels/reduce.cl)."""

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
        count = self._device.read(self.count, np.uint32, self.pixels)
        rejected = self._device.read(self.rejected, np.uint32, self.pixels)
        opened = count % BLOCK
        some, full = np.maximum(count, 1), count - opened
        rgb = np.empty((self.pixels, 3), np.float32)
        for channel in range(3):
            total = self._sum(2 * channel)
            total += np.where(opened > 0, self._open(channel), 0)
            rgb[:, channel] = total / some / scale

        open_sum, open_squares = self._open(4), self._open(5)
        open_mean = open_sum / np.maximum(opened, 1)
        m2 = self._sum(8)
        m2 += np.where(opened > 0, np.maximum(open_squares - open_sum * open_mean, 0), 0)
        del open_sum, open_squares
        open_mean += self._open(3)
        full_sum = self._sum(6)
        difference = np.where((opened > 0) & (full > 0), open_mean - full_sum / np.maximum(full, 1), 0)
        difference[np.abs(difference) < MEAN_NOISE * np.abs(open_mean)] = 0
        # Chan, Golub, LeVeque 1983: the unfinished block merged as the kernel merges a full one
        m2 += difference * difference * (full * (opened / some))
        del difference
        mean = (full_sum + np.where(opened > 0, open_mean * opened, 0)) / some / scale
        variance = m2 / np.maximum(count.astype(np.int64) - 1, 1) / scale**2
        shape = self._shape
        return Statistics(
            count=count.reshape(shape),
            rejected=rejected.reshape(shape),
            rgb=rgb.reshape(*shape, 3),
            mean=mean.reshape(shape),
            variance=np.where(count > 1, variance, 0).reshape(shape),
            median=None if self.medians is None else (self._median(count) / scale).reshape(shape),
        )

    def _median(self, count: np.ndarray) -> np.ndarray:
        """M_x: mean of the medians of the full chunks; before the first of these, the median of what is there."""
        total = self._plane(self.medians, 0) + self._plane(self.medians, 1)
        median = total / np.maximum(count // CHUNK, 1)
        early = np.flatnonzero((count > 0) & (count < CHUNK))
        if len(early):
            pending = np.stack([self._plane(self.medians, 2 + place)[early] for place in range(CHUNK - 1)])
            pending[np.arange(CHUNK - 1)[:, None] >= count[early]] = np.nan
            median[early] = np.nanmedian(pending, axis=0)
        return median

    def _plane(self, buffer, plane: int) -> np.ndarray:
        return self._device.read(buffer, np.float32, self.pixels, plane * self.pixels).astype(np.float64)

    def _sum(self, plane: int) -> np.ndarray:
        total = self._plane(self.sums, plane)
        total += self._device.read(self.sums, np.float32, self.pixels, (plane + 1) * self.pixels)
        return total

    def _open(self, plane: int) -> np.ndarray:
        return self._plane(self.block_sums, plane)
