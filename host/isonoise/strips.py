"""Strips: parts of an image that the host processes at a time, so that its temporary arrays stay in the cache."""

from collections.abc import Iterator

LARGE_IMAGE_PIXELS = 2**22
"""From this size on, images give memory back whenever it is not needed. To allocate and clear it again takes 1 ms per
megapixel and wave."""


def pixel_strips(size: int, strip_pixels: int) -> Iterator[slice]:
    """Parts of a flat image of `size` pixels, of `strip_pixels` each; the last one may be shorter."""
    return (slice(begin, min(begin + strip_pixels, size)) for begin in range(0, size, strip_pixels))


def row_strips(shape: tuple[int, int], strip_pixels: int, multiple: int = 1) -> Iterator[slice]:
    """Rows of an image of `shape` (height, width), about `strip_pixels` at a time: a multiple of so many rows."""
    height, width = shape
    rows = max(1, strip_pixels // (multiple * max(multiple, width))) * multiple
    return (slice(top, min(top + rows, height)) for top in range(0, height, rows))
