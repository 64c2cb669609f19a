"""The share of a wave's time that is not tracing: statistics, errors, pooling and allocation. Called by `measure`."""

import time
from collections.abc import Iterator

import numpy as np

from isonoise.benchmark.spread import spread
from isonoise.error.energy_loss import EnergyLoss
from isonoise.loop import LOG_QUANTILES
from isonoise.renderer import Renderer
from isonoise.statistics import Statistics
from isonoise.strategies import DEFAULT_STRATEGY, Strategy, Wave, make_strategy
from isonoise.strategies.measures import image_floor

WARMUP_SAMPLES, WAVE_SAMPLES = 16, 8
"""Samples per pixel of the uniform wave before the measurement, and of the adaptive waves that are measured."""


class _TimedStrategy(Strategy):
    """The default strategy, with equal adaptive waves; it measures the time of its allocation."""

    name = "timed"

    def __init__(self):
        self._strategy = make_strategy(DEFAULT_STRATEGY)
        self.needs = self._strategy.needs
        self.seconds = 0.0  # of the last allocation

    def waves(self) -> Iterator[Wave]:
        yield Wave("uniform", WARMUP_SAMPLES)
        while True:
            yield Wave("adaptive", WAVE_SAMPLES)

    def allocate(self, statistics: Statistics, budget: int) -> np.ndarray:
        start = time.perf_counter()
        allocation = self._strategy.allocate(statistics, budget)
        self.seconds = time.perf_counter() - start
        return allocation


def measure_wave_costs(source: str, repeat: int, **options) -> dict[str, object]:
    """The JSON field `wave_costs`. `options` are those of `Renderer`."""
    strategy = _TimedStrategy()
    renderer, energy_loss = Renderer(source, strategy=strategy, **options), EnergyLoss()
    waves = [_time_wave(renderer, strategy, energy_loss) for _ in range(2 + repeat)][2:]  # the first two are a warm-up

    def share(*parts: str) -> dict[str, float]:
        return spread(sum(wave[part] for part in parts) / sum(wave.values()) for wave in waves)

    return {
        "strategy": DEFAULT_STRATEGY,
        "samples_per_pixel": WAVE_SAMPLES,
        "wave_s": spread(sum(wave.values()) for wave in waves),
        "statistics_share": share("statistics"),
        "errors_share": share("errors"),
        "allocation_share": share("allocation"),
        "total_share": share("statistics", "errors", "allocation"),
    }


def _time_wave(renderer: Renderer, strategy: _TimedStrategy, energy_loss: EnergyLoss) -> dict[str, float]:
    """Seconds of the parts of a wave, as in the render loop."""
    before = renderer.statistics()
    record = renderer.step()
    start = time.perf_counter()
    energy_loss.begin_wave(record.kind, lambda: before)
    statistics = renderer.statistics()
    after_statistics = time.perf_counter()
    renderer.error_distribution(image_floor(statistics.mean)).quantiles(LOG_QUANTILES)
    energy_loss.end_wave(record.kind, statistics)
    energy_loss.estimate(statistics)
    end = time.perf_counter()
    return {
        "statistics": after_statistics - start,
        "errors": end - after_statistics,
        "allocation": strategy.seconds,
        "tracing": record.seconds - strategy.seconds,
    }
