"""The strategy `tungsten`: the adaptive sampling of the renderer Tungsten."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from isonoise.statistics import Statistics
from isonoise.strategies.base import Strategy, Wave
from isonoise.strategies.parameter_checks import check_range
from isonoise.strategies.uniform_allocation import uniform_allocation

BLOCK = 4
"""Pixels a side of a block."""
QUANTILE = 95
"""Per cent of the blocks with an error below the one at which errors are cut."""
DARK = 1e-3
"""Below this square of the mean, errors are absolute."""


@dataclass(kw_only=True, eq=False)
class Tungsten(Strategy):
    """One sample in every pixel, and a share in proportion to the relative variance of its block's mean.

    From: github.com/tunabrain/tungsten, `src/core/integrators/path_tracer/PathTraceIntegrator.cpp` and
    `SampleRecord.hpp`. Blocks of 4x4 pixels have the error s^2 / (n max(mean^2, 1e-3)), with the statistics of the
    luminance of all samples in the block. It is cut at its 95th percentile over the blocks that have any, spread to
    the neighbours (the largest of a block, the four around it, and two at corners), and the samples beyond one for
    every pixel are given in proportion to it. The fraction of a sample that a pixel cannot get goes on to the next one.
    The constant 1e-3 is in the scene's units, as published.

    Differences: fractions are carried from pixel to pixel along the rows, and not at random from block to block, so
    that the budget is met exactly; a block at the border counts the pixels that it has. Where no block has an error,
    Tungsten stops; here the wave is uniform.

    - `warmup`: samples per pixel before the first test, 2 to 65536.
    - `step`: mean samples per pixel of a wave, 1 to 65536; both are 16 in Tungsten.
    """

    name = "tungsten"

    warmup: int = 16
    step: int = 16

    def __post_init__(self):
        check_range("warmup", self.warmup, 2, 65536)
        check_range("step", self.step, 1, 65536)

    def waves(self) -> Iterator[Wave]:
        yield Wave("uniform", self.warmup)
        while True:
            yield Wave("adaptive", self.step)

    def allocate(self, statistics: Statistics, budget: int) -> np.ndarray:
        weights = dilated(clamped(block_error(statistics)))
        weights = _to_pixels(weights, statistics.shape)
        total = weights.sum()
        if budget <= weights.size or total == 0:
            return uniform_allocation(statistics.shape, budget, statistics.samples)
        # a start of the row of fractions that differs from wave to wave, by the golden section
        start = statistics.samples * 0.5 * (5**0.5 - 1) % 1
        return 1 + carried(weights * ((budget - weights.size) / total), budget - weights.size, start)


def block_error(statistics: Statistics) -> np.ndarray:
    """s^2 / (n max(mean^2, 1e-3)) of the blocks, float64 (blocks down, blocks across); inf where n < 2."""
    count = statistics.count.astype(np.float64)
    n = _block_sum(count)
    mean = _block_sum(count * statistics.mean) / np.maximum(n, 1)
    apart = statistics.mean - _to_pixels(mean, statistics.shape)
    squares = _block_sum(np.maximum(count - 1, 0) * statistics.variance + count * apart * apart)
    error = np.full(n.shape, np.inf)
    return np.divide(squares, (n - 1) * n * np.maximum(mean * mean, DARK), out=error, where=n >= 2)


def clamped(error: np.ndarray) -> np.ndarray:
    """Cut at the 95th percentile of the finite ones above 0; what is unknown counts as that much."""
    found = np.sort(error[np.isfinite(error) & (error > 0)])
    if found.size == 0:
        return np.where(np.isinf(error), 1.0, 0.0)
    return np.minimum(error, found[found.size * QUANTILE // 100])


def dilated(error: np.ndarray) -> np.ndarray:
    """The largest error of a block and its neighbours: those below and to the right, then those above and to the left
    of what came of that. So two of the corners take part, above right and below left."""
    forth = error.copy()
    np.maximum(forth[:-1], error[1:], out=forth[:-1])
    np.maximum(forth[:, :-1], error[:, 1:], out=forth[:, :-1])
    back = forth.copy()
    np.maximum(back[1:], forth[:-1], out=back[1:])
    np.maximum(back[:, 1:], forth[:, :-1], out=back[:, 1:])
    return back


def carried(share: np.ndarray, budget: int, start: float) -> np.ndarray:
    """Whole numbers that sum to `budget` from shares of that sum: each pixel's fraction is carried to the next one.

    `start`, in [0, 1), is carried to the first. Returns uint32 of the shape of `share`.
    """
    edges = np.floor(np.cumsum(share) + start)
    edges[-1] = budget
    return np.diff(np.minimum(edges, budget), prepend=0).astype(np.uint32).reshape(share.shape)


def _to_pixels(blocks: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    return np.repeat(np.repeat(blocks, BLOCK, axis=0), BLOCK, axis=1)[: shape[0], : shape[1]]


def _block_sum(values: np.ndarray) -> np.ndarray:
    down = np.add.reduceat(values, np.arange(0, values.shape[0], BLOCK), axis=0)
    return np.add.reduceat(down, np.arange(0, values.shape[1], BLOCK), axis=1)
