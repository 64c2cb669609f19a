"""Schedules of waves. Waves grow with the samples so far, so that their number is logarithmic."""

from collections.abc import Iterator

from isonoise.strategies.base import Wave
from isonoise.strategies.uniform_allocation import MAX_COUNT


def uniform_waves(warmup: float, growth: float) -> Iterator[Wave]:
    """Uniform waves without end: `warmup` samples per pixel, then `growth` times the samples so far, rounded."""
    spp = warmup
    yield Wave("uniform", warmup)
    while True:
        wave_spp = max(1, round(growth * spp))
        yield Wave("uniform", wave_spp)
        spp += wave_spp


def warmup_then_adaptive(warmup: float, wave_spp: float | None) -> Iterator[Wave]:
    """One uniform wave, then adaptive waves of `wave_spp` samples per pixel without end."""
    yield Wave("uniform", warmup)
    while True:
        yield Wave("adaptive", wave_spp)


def alternating_waves(warmup: int, ratio: float, growth: float) -> Iterator[Wave]:
    """A uniform warm-up, then adaptive and uniform waves in turn without end.

    A pair of waves has `growth` times the samples so far, `ratio` adaptive ones for each uniform one. Uniform waves
    have a whole number of samples per pixel, so that every pixel gets the same. With `ratio` inf, or more than a pixel
    can take, there is no uniform wave after the warm-up; adaptive waves have half of a pair's samples, as with ratio 1.
    """
    spp = float(warmup)
    yield Wave("uniform", warmup)
    while ratio > MAX_COUNT:
        yield Wave("adaptive", 0.5 * growth * spp)
        spp *= 1 + 0.5 * growth
    while True:
        uniform_spp = max(1, round(growth * spp / (1 + ratio)))
        yield Wave("adaptive", ratio * uniform_spp)
        yield Wave("uniform", uniform_spp)
        spp += (1 + ratio) * uniform_spp
