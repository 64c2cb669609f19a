"""Fixed sets of pixels, each spread over the whole image: the units in which a wave is cut into tasks.

`DistributedWavefront` makes them once for a render; the `Dealer` decides which of them go together into a task.
"""

from collections.abc import Sequence
from functools import cached_property

import numpy as np

BLOCK_SIZE = 8
"""Pixels of a block in each direction."""
SHARD_PIXELS = 1024
"""Pixels of a shard, unless that makes fewer than `MIN_SHARDS` or more than `MAX_SHARDS` of them."""
MIN_SHARDS, MAX_SHARDS = 64, 4096


class Shards:
    """The pixels of an image, dealt out to shards by blocks.

    The blocks are ordered along the Morton curve. Of every `number` consecutive blocks each shard gets one, in a hashed
    order. So all shards have as many blocks, but for one, and the cost of a region of the image falls on all of them.
    The same shape and number make the same shards on any machine.

    Parameters
    ----------
    shape : (int, int)
        Height and width of the image.
    number : int or None
        Number of shards; None: by the size of the image. At most one for each block.

    Attributes
    ----------
    number : int
        Of shards.
    """

    def __init__(self, shape: tuple[int, int], number: int | None = None):
        self._height, self._width = shape
        self._grid = -(-self._height // BLOCK_SIZE), -(-self._width // BLOCK_SIZE)
        blocks = self._grid[0] * self._grid[1]
        if number is None:
            number = int(np.clip(-(-self._height * self._width // SHARD_PIXELS), MIN_SHARDS, MAX_SHARDS))
        self.number = min(number, blocks)
        order = _morton_order(self._grid)
        shards = _hashed_runs(blocks, self.number)
        self._shard_of_block = np.empty(blocks, np.uint16 if self.number <= 2**16 else np.uint32)
        self._shard_of_block[order] = shards
        self._blocks = order[np.argsort(shards, kind="stable")].astype(np.uint32)  # those of shard 0, of shard 1, ...
        self._first_block = np.concatenate([[0], np.cumsum(np.bincount(shards, minlength=self.number))])

    def pixels(self, shards: Sequence[int]) -> np.ndarray:
        """Numbers of the pixels of some shards, row * width + column: shard by shard, block by block. uint32."""
        first = self._first_block
        blocks = np.concatenate([self._blocks[:0], *(self._blocks[first[k] : first[k + 1]] for k in shards)])
        block_rows, block_columns = np.divmod(blocks, np.uint32(self._grid[1]))
        within = np.arange(BLOCK_SIZE, dtype=np.uint32)
        rows = (block_rows * np.uint32(BLOCK_SIZE))[:, None, None] + within[:, None]
        columns = (block_columns * np.uint32(BLOCK_SIZE))[:, None, None] + within
        pixels = rows * np.uint32(self._width) + columns
        is_inside = (rows < self._height) & (columns < self._width)
        return pixels[is_inside]

    def sums(self, allocation: np.ndarray) -> np.ndarray:
        """Samples of every shard: (number,) int64, from the allocation map of the image, (height, width) uint32."""
        rows, columns = self._grid
        row_sums = np.zeros((rows, self._width), np.int64)
        for row in range(BLOCK_SIZE):
            part = allocation[row::BLOCK_SIZE]
            row_sums[: len(part)] += part
        block_sums = np.zeros((rows, columns), np.int64)
        for column in range(BLOCK_SIZE):
            part = row_sums[:, column::BLOCK_SIZE]
            block_sums[:, : part.shape[1]] += part
        sums = np.zeros(self.number, np.int64)
        np.add.at(sums, self._shard_of_block, block_sums.ravel())
        return sums

    @cached_property
    def sizes(self) -> np.ndarray:
        """Pixels of every shard: (number,) int64."""
        return self.sums(np.broadcast_to(np.uint32(1), (self._height, self._width)))


def _morton_order(grid: tuple[int, int]) -> np.ndarray:
    """The cells of a grid, row * columns + column, along the Morton curve."""
    rows, columns = (_spread_bits(np.arange(length, dtype=np.uint64)) for length in grid)
    return np.argsort(((rows[:, None] << np.uint64(1)) | columns).ravel(), kind="stable")


def _spread_bits(values: np.ndarray) -> np.ndarray:
    """Move bit k of numbers below 2**32 to bit 2 k."""
    for shift, mask in (
        (16, 0x0000FFFF0000FFFF),
        (8, 0x00FF00FF00FF00FF),
        (4, 0x0F0F0F0F0F0F0F0F),
        (2, 0x3333333333333333),
        (1, 0x5555555555555555),
    ):
        values = (values | (values << np.uint64(shift))) & np.uint64(mask)
    return values


def _hashed_runs(length: int, number: int) -> np.ndarray:
    """The numbers below `number` in a hashed order, then again in another one, and so on: `length` of them."""
    runs = -(-length // number)
    keys = _hash(np.arange(runs * number, dtype=np.uint64)).reshape(runs, number)
    return np.argsort(keys, axis=1, kind="stable").ravel()[:length]


def _hash(values: np.ndarray) -> np.ndarray:
    """The finaliser of SplitMix64 (Steele, Lea, Flood 2014, "Fast splittable pseudorandom number generators")."""
    values = values + np.uint64(0x9E3779B97F4A7C15)
    values = (values ^ (values >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    values = (values ^ (values >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return values ^ (values >> np.uint64(31))
