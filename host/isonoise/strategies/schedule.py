"""Schedules of waves, pure arithmetic: waves grow with the samples so far, so that their number is logarithmic."""

import math
from collections.abc import Iterator

from isonoise.strategies.base import Wave


def uniform_waves(first: float, growth: float) -> Iterator[Wave]:
    """Uniform waves without end: `first` samples per pixel, then `growth` times the samples so far, rounded."""
    spp = first
    yield Wave("uniform", first)
    while True:
        size = max(1, round(growth * spp))
        yield Wave("uniform", size)
        spp += size


def alternating_waves(warmup: int, ratio: float, growth: float) -> Iterator[Wave]:
    """A uniform warm-up, then adaptive and uniform waves in turn without end.

    Each pair brings `growth` times the samples so far, `ratio` of them adaptive for one uniform. Uniform waves have a
    whole number of samples per pixel, so that every pixel gets the same. With `ratio` inf no uniform wave follows the
    warm-up, and an adaptive one brings half of a pair's samples, as it does with ratio 1.
    """
    spp = float(warmup)
    yield Wave("uniform", warmup)
    while ratio == math.inf:
        yield Wave("adaptive", 0.5 * growth * spp)
        spp *= 1 + 0.5 * growth
    while True:
        uniform = max(1, round(growth * spp / (1 + ratio)))
        yield Wave("adaptive", ratio * uniform)
        yield Wave("uniform", uniform)
        spp += (1 + ratio) * uniform
