"""The samples that remain of a wave, in pixel order, cut into slices. Called by `wavefront`."""

import numpy as np

STRIP_PIXELS = 2**16
"""Pixels whose samples are added up in advance. A running sum over the image would take 8 bytes a pixel."""


class SampleList:
    """The samples that remain of a wave, numbered in pixel order.

    Parameters
    ----------
    remaining : (pixels,) uint32
        Samples of every pixel. `remove_first` subtracts from it.
    """

    def __init__(self, remaining: np.ndarray):
        self._remaining = remaining
        strips = np.arange(0, remaining.size, STRIP_PIXELS)
        self._strip_ends = np.cumsum(np.add.reduceat(remaining, strips, dtype=np.int64))
        self._removed = 0

    @property
    def total(self) -> int:
        """Samples of all pixels."""
        return int(self._strip_ends[-1]) - self._removed

    def first_slice(self, size: int) -> tuple[int, np.ndarray, int]:
        """The slice of the first samples, at most `size`, and of as many pixels.

        Returns
        -------
        pixel : its first pixel
        offsets : (pixels,) uint32, where in the slice the samples of its pixels begin
        samples : how many it has
        """
        first, _ = self._find(0)
        last, _ = self._find(min(size, self.total) - 1)
        number = self._remaining[first : min(last, first + size - 1) + 1]
        ends = np.cumsum(number, dtype=np.int64)
        return first, (ends - number).astype(np.uint32), min(int(ends[-1]), size)

    def remove_first(self, samples: int) -> None:
        """Remove the first `samples`, 1 or more."""
        first, _ = self._find(0)
        last, index = self._find(samples - 1)
        self._remaining[first:last] = 0
        self._remaining[last] -= index + 1
        self._removed += samples

    def _find(self, sample: int) -> tuple[int, int]:
        """The pixel of a sample, and which of its samples it is."""
        in_wave = self._removed + sample
        strip = int(np.searchsorted(self._strip_ends, in_wave, side="right"))
        # those that were removed from the strip do not count
        in_strip = in_wave - max(int(self._strip_ends[strip - 1]) if strip else 0, self._removed)
        begin = strip * STRIP_PIXELS
        ends = np.cumsum(self._remaining[begin : begin + STRIP_PIXELS], dtype=np.int64)
        pixel = int(np.searchsorted(ends, in_strip, side="right"))
        return begin + pixel, in_strip - (int(ends[pixel - 1]) if pixel else 0)
