"""The strategy `tungsten`: the adaptive sampling of the renderer Tungsten."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from isonoise.statistics import Statistics
from isonoise.strategies.base import Strategy, Wave
from isonoise.strategies.parameters import ranged
from isonoise.strategies.schedule import warmup_then_adaptive
from isonoise.strategies.uniform_allocation import uniform_allocation

BLOCK_SIZE = 4
"""Pixels per side of a block."""
CLAMP_PERCENTILE = 95
"""Errors are cut at this percentile over the blocks."""
MIN_SQUARED_MEAN = 1e-3
"""Below this square of the mean, errors are absolute."""
GOLDEN_RATIO = 0.5 * (5**0.5 - 1)


@dataclass(kw_only=True, eq=False)
class Tungsten(Strategy):
    """One sample in every pixel; the rest in proportion to the relative variance of the mean of the pixel's block.

    From: github.com/tunabrain/tungsten, `src/core/integrators/path_tracer/PathTraceIntegrator.cpp` and
    `SampleRecord.hpp`. Blocks of 4x4 pixels have the error s^2 / (n max(mean^2, 1e-3)), with the statistics of the
    luminance of all samples in the block. It is clamped at its 95th percentile over the blocks with an error, and
    dilated (the largest of a block, the four around it, and two at corners). The samples beyond one per pixel are
    distributed in proportion to it. The fraction of a sample that a pixel cannot get is carried to the next pixel. The
    constant 1e-3 is in the scene's units, as published.

    Differences: fractions are carried along the rows, not at random from block to block, so that the budget is met
    exactly. A block at the border has only the pixels inside the image. If no block has an error, Tungsten stops; here
    the wave is uniform.

    Parameters
    ----------
    warmup : int
        Samples per pixel before the first test, 2 to 65536.
    step : int
        Mean samples per pixel of a wave, 1 to 65536; both are 16 in Tungsten.
    """

    name = "tungsten"

    warmup: int = ranged(16, 2, 65536)
    step: int = ranged(16, 1, 65536)

    def waves(self) -> Iterator[Wave]:
        return warmup_then_adaptive(self.warmup, self.step)

    def allocate(self, statistics: Statistics, budget: int) -> np.ndarray:
        error = dilated(clamped(block_error(statistics)))
        weights = _to_pixels(error, statistics.shape)
        total = weights.sum()
        if budget <= weights.size or total == 0:
            return uniform_allocation(statistics.shape, budget, statistics.samples)
        rest = budget - weights.size  # after one sample per pixel
        first_carry = statistics.samples * GOLDEN_RATIO % 1  # differs from wave to wave
        return 1 + distributed(weights * (rest / total), rest, first_carry)


def block_error(statistics: Statistics) -> np.ndarray:
    """s^2 / (n max(mean^2, 1e-3)) of every block, float64; inf where n < 2."""
    count = statistics.count.astype(np.float64)
    n = _block_sum(count)
    mean = _block_sum(count * statistics.mean) / np.maximum(n, 1)
    deviation = statistics.mean - _to_pixels(mean, statistics.shape)
    squares = _block_sum(np.maximum(count - 1, 0) * statistics.variance + count * deviation * deviation)
    error = np.full(n.shape, np.inf)
    return np.divide(squares, (n - 1) * n * np.maximum(mean * mean, MIN_SQUARED_MEAN), out=error, where=n >= 2)


def clamped(error: np.ndarray) -> np.ndarray:
    """Errors cut at the 95th percentile of the finite ones above 0; unknown ones (inf) get that value."""
    known = np.sort(error[np.isfinite(error) & (error > 0)])
    if known.size == 0:
        return np.where(np.isinf(error), 1.0, 0.0)
    return np.minimum(error, known[known.size * CLAMP_PERCENTILE // 100])


def dilated(error: np.ndarray) -> np.ndarray:
    """The largest error of a block and its neighbours, in two sweeps as in Tungsten.

    First below and to the right; then, of that result, above and to the left. So two corners count: above right and
    below left.
    """
    forward = error.copy()
    np.maximum(forward[:-1], error[1:], out=forward[:-1])
    np.maximum(forward[:, :-1], error[:, 1:], out=forward[:, :-1])
    backward = forward.copy()
    np.maximum(backward[1:], forward[:-1], out=backward[1:])
    np.maximum(backward[:, 1:], forward[:, :-1], out=backward[:, 1:])
    return backward


def distributed(share: np.ndarray, budget: int, first_carry: float) -> np.ndarray:
    """Whole numbers (uint32) of sum `budget` from shares of that sum: fractions are carried to the next pixel.

    `first_carry`, in [0, 1), is carried to the first pixel.
    """
    ends = np.floor(np.cumsum(share) + first_carry)
    ends[-1] = budget
    return np.diff(np.minimum(ends, budget), prepend=0).astype(np.uint32).reshape(share.shape)


def _to_pixels(blocks: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    return np.repeat(np.repeat(blocks, BLOCK_SIZE, axis=0), BLOCK_SIZE, axis=1)[: shape[0], : shape[1]]


def _block_sum(values: np.ndarray) -> np.ndarray:
    rows = np.add.reduceat(values, np.arange(0, values.shape[0], BLOCK_SIZE), axis=0)
    return np.add.reduceat(rows, np.arange(0, values.shape[1], BLOCK_SIZE), axis=1)
