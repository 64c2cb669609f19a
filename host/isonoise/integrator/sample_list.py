"""The samples of an allocation map in pixel order, cut into slices. Called by `wavefront`."""

import numpy as np

STRIP_PIXELS = 2**16
"""Pixels whose samples are added up in advance. A running sum over the image would take 8 bytes a pixel."""


class SampleList:
    """The samples of a wave, numbered in pixel order.

    Parameters
    ----------
    allocation : (pixels,) uint32
        Samples of every pixel.
    """

    def __init__(self, allocation: np.ndarray):
        self._allocation = allocation
        strips = np.arange(0, allocation.size, STRIP_PIXELS)
        self._strip_ends = np.cumsum(np.add.reduceat(allocation, strips, dtype=np.int64))

    @property
    def total(self) -> int:
        """Samples of all pixels."""
        return int(self._strip_ends[-1])

    def slice(self, begin: int, size: int) -> tuple[int, np.ndarray, int]:
        """The slice of at most `size` samples, and as many pixels, from sample `begin` on.

        Returns
        -------
        pixel : its first pixel
        offsets : (pixels,) uint32, where in the slice the samples of its pixels begin
        samples : how many it has
        """
        first, skipped = self._find(begin)
        last, _ = self._find(min(begin + size, self.total) - 1)
        number = self._allocation[first : min(last, first + size - 1) + 1].copy()
        number[0] -= skipped
        ends = np.cumsum(number, dtype=np.int64)
        return first, (ends - number).astype(np.uint32), min(int(ends[-1]), size)

    def _find(self, sample: int) -> tuple[int, int]:
        """The pixel of a sample, and which of its samples it is."""
        strip = int(np.searchsorted(self._strip_ends, sample, side="right"))
        in_strip = sample - (int(self._strip_ends[strip - 1]) if strip else 0)
        begin = strip * STRIP_PIXELS
        ends = np.cumsum(self._allocation[begin : begin + STRIP_PIXELS], dtype=np.int64)
        pixel = int(np.searchsorted(ends, in_strip, side="right"))
        return begin + pixel, in_strip - (int(ends[pixel - 1]) if pixel else 0)
