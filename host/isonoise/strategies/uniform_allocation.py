"""Even distribution of samples, and the hashed pixel order that breaks ties: shared by uniform waves and all rules."""

import numpy as np

from isonoise.strips import pixel_strips

MAX_COUNT = 2**32 - 1
"""Samples that a pixel can count (uint32), all waves together."""
STRIP_PIXELS = 2**16
"""Pixels that are hashed at a time."""


def uniform_allocation(shape: tuple[int, int], budget: int, wave_index: int) -> np.ndarray:
    """Give every pixel the same count; the remainder goes, one sample each, to the first pixels in hashed order.

    Parameters
    ----------
    shape : (height, width)
        Shape of the image.
    budget : int
        Samples to distribute.
    wave_index : int
        Any number that changes with the wave. It determines the hashed order.

    Returns
    -------
    (height, width) uint32
        Samples per pixel; they sum to `budget` exactly.

    Raises
    ------
    ValueError
        If the budget is negative or more than uint32 counts hold.
    """
    pixels = shape[0] * shape[1]
    check_budget(budget, pixels * MAX_COUNT)
    each, remainder = divmod(int(budget), pixels)
    allocation = np.full(pixels, each, dtype=np.uint32)
    if remainder:
        order = _hashed_order(np.arange(pixels, dtype=np.uint32), wave_index)
        allocation += order <= np.partition(order, remainder - 1)[remainder - 1]  # there are no ties
    return allocation.reshape(shape)


def check_budget(budget: int, max_budget: int) -> None:
    if not 0 <= budget <= max_budget:
        raise ValueError(f"a wave of {budget} samples is out of range: the pixels can count 0 to {max_budget}")


def first_in_hashed_order(pixels: np.ndarray, k: int, wave_index: int) -> np.ndarray:
    """Indices into `pixels` (uint32, distinct) of the k that come first in the wave's pseudo-random order."""
    if k == 0 or k == pixels.size:
        return np.arange(k)
    return np.argpartition(_hashed_order(pixels, wave_index), k)[:k]


def _hashed_order(pixels: np.ndarray, wave_index: int) -> np.ndarray:
    """Distinct numbers (uint32), in whose order the pixels come in this wave."""
    salt = _hash(np.array([wave_index & MAX_COUNT], dtype=np.uint32)) ^ np.uint32((wave_index >> 32) & MAX_COUNT)
    order = np.empty_like(pixels)
    for strip in pixel_strips(pixels.size, STRIP_PIXELS):
        order[strip] = _hash(_hash(pixels[strip]) ^ salt)
    return order


def _hash(x: np.ndarray) -> np.ndarray:
    """lowbias32 by C. Wellons (github.com/skeeto/hash-prospector): a bijection of uint32, so the order has no ties."""
    x = x ^ (x >> np.uint32(16))
    x *= np.uint32(0x7FEB352D)
    x ^= x >> np.uint32(15)
    x *= np.uint32(0x846CA68B)
    x ^= x >> np.uint32(16)
    return x
