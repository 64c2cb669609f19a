"""Samples spread evenly: what uniform waves need of the allocation, and all rules share."""

import numpy as np

MAX_COUNT = 2**32 - 1
"""Samples that a pixel can count (uint32), all waves together."""


def uniform_allocation(shape: tuple[int, int], budget: int, wave_index: int) -> np.ndarray:
    """The same count in every pixel; the remainder goes, one sample each, by a hashed order that changes with the wave.

    Returns uint32 of `shape` (height, width) that sums to `budget` exactly.
    Raises ValueError if the budget is negative or more than uint32 counts hold.
    """
    pixels = shape[0] * shape[1]
    check_budget(budget, pixels * MAX_COUNT)
    each, rest = divmod(int(budget), pixels)
    allocation = np.full(pixels, each, dtype=np.uint32)
    allocation[first_in_hashed_order(np.arange(pixels, dtype=np.uint32), rest, wave_index)] += np.uint32(1)
    return allocation.reshape(shape)


def check_budget(budget: int, most: int) -> None:
    if not 0 <= budget <= most:
        raise ValueError(f"a wave of {budget} samples is outside of 0 to {most}, what the pixels can count")


def first_in_hashed_order(pixels: np.ndarray, k: int, wave_index: int) -> np.ndarray:
    """Indices into `pixels` (uint32, distinct) of the k that come first in the wave's order."""
    if k == 0 or k == pixels.size:
        return np.arange(k)
    salt = _mix(np.array([wave_index & MAX_COUNT], dtype=np.uint32)) ^ np.uint32((wave_index >> 32) & MAX_COUNT)
    return np.argpartition(_mix(_mix(pixels) ^ salt), k)[:k]


def _mix(x: np.ndarray) -> np.ndarray:
    """A bijection of the 32-bit integers that looks random: C. Wellons' lowbias32 (github.com/skeeto/hash-prospector).

    One to one, so that no two pixels of a wave share a place in the order.
    """
    x = x ^ (x >> np.uint32(16))
    x *= np.uint32(0x7FEB352D)
    x ^= x >> np.uint32(15)
    x *= np.uint32(0x846CA68B)
    x ^= x >> np.uint32(16)
    return x
