"""Renders a reference batch, and the pilot run that determines its allocation map: pure functions.

Called by `local_batches` in this process and by `cluster.batches` on workers.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from isonoise.comparison.interruptible import interruptible_render, interruptible_step
from isonoise.comparison.plan import REFERENCE_BUDGET_FACTOR
from isonoise.comparison.run_task import RunStoppedError
from isonoise.device.selection import SelectedDevice
from isonoise.loop import Stops
from isonoise.renderer import Renderer
from isonoise.samplers import SAMPLERS
from isonoise.scene import CompiledScene
from isonoise.statistics import Statistics
from isonoise.strategies import Strategy, Wave
from isonoise.strategies.allocation import deficit
from isonoise.strategies.measures import image_floor, relative_mean, variance_per_sample

BATCHES = 32
"""Independent renders of a reference: its standard errors have 31 degrees of freedom, a relative error of 13 %."""
PILOT_SHARE = 0.05
"""Share of a reference's budget for the pilot run, which determines the allocation map."""
MAX_ALLOCATION_RATIO = 16
"""Maximum samples of a pixel, over those of the uniform half of the map.

In `penumbra` 16 reduces the p99 of the relative standard error to 0.41 of a uniform map's and 4 to 0.71. In
`bright-spots` 64 makes it worse than uniform, because the pilot run has missed most of the spots.
"""
VARIANCE_CLIP_QUANTILE = 0.999
"""The map clips the pilot run's variance at this quantile over the pixels."""


@dataclass(frozen=True)
class Pilot:
    """What determines the allocation map of the batches.

    Attributes
    ----------
    kind : str
        "reference" or "variance".
    seed : int
        Of the pilot run.
    budget : Stops
        Of all batches: time, or the samples per pixel of a run.
    """

    kind: str
    seed: int
    budget: Stops


@dataclass(frozen=True)
class Batch:
    """One batch: the fields of `Statistics` that a reference needs, and the seconds of its wave."""

    rgb: np.ndarray
    mean: np.ndarray
    count: np.ndarray
    seconds: float


def render_pilot(
    pilot: Pilot, scene: CompiledScene, device: SelectedDevice, should_stop: Callable[[], bool] = lambda: False
) -> np.ndarray:
    """The allocation map of a batch, from a pilot run whose samples are discarded.

    Raises RunStoppedError once `should_stop` returns True, here and in `render_batch`.
    """
    budget, by_time = pilot.budget, pilot.budget.time is not None
    strategy = "relative-mean" if pilot.kind == "reference" else "uniform"
    if by_time:
        stops = Stops(time=PILOT_SHARE * budget.time)
    else:
        stops = Stops(spp=max(PILOT_SHARE * REFERENCE_BUDGET_FACTOR * budget.spp, 16))
    renderer = Renderer(scene, device, strategy, pilot.seed, sampler=SAMPLERS[0])
    outcome = interruptible_render(renderer, stops, should_stop)
    if outcome.reason == "interrupted":
        raise RunStoppedError("the pilot run was stopped")
    statistics = outcome.statistics
    pixels = statistics.count.size
    if by_time:
        speed = statistics.samples / outcome.elapsed_s
        spp = speed * (1 - PILOT_SHARE) * budget.time / BATCHES / pixels
    else:
        spp = REFERENCE_BUDGET_FACTOR * budget.spp / BATCHES
    # every pixel needs a sample in every batch, and a batch must fit into one wave
    spp = min(max(round(spp), 2), 2**20)
    if pilot.kind == "variance":
        return np.full(statistics.shape, spp, np.uint32)
    return reference_allocation(statistics, spp)


def render_batch(
    allocation: np.ndarray,
    seed: int,
    scene: CompiledScene,
    device: SelectedDevice,
    should_stop: Callable[[], bool] = lambda: False,
) -> Batch:
    """One wave of the whole map. Its time excludes set-up and readback."""
    renderer = Renderer(scene, device, _FixedAllocation(allocation), seed, sampler=SAMPLERS[0])
    record = interruptible_step(renderer, should_stop)
    if record.samples < record.planned:
        raise RunStoppedError("the batch was stopped")
    statistics = renderer.statistics()
    return Batch(statistics.rgb, statistics.mean, statistics.count, record.seconds)


def reference_allocation(statistics: Statistics, spp: int) -> np.ndarray:
    """Map of `spp` (at least 2) samples per pixel on average: half uniform, half by the pilot run's errors."""
    uniform = np.full(statistics.shape, (spp + 1) // 2, np.uint32)
    variance = variance_per_sample(statistics, relative_mean(statistics, image_floor(statistics.mean)))
    adaptive = spp * uniform.size - int(uniform.sum(dtype=np.int64))
    return uniform + deficit(uniform, variance, adaptive, 0, clip=VARIANCE_CLIP_QUANTILE, cap=MAX_ALLOCATION_RATIO)


class _FixedAllocation(Strategy):
    """Every wave has the same allocation map."""

    name = "fixed"

    def __init__(self, allocation: np.ndarray):
        self._allocation = allocation

    def waves(self) -> Iterator[Wave]:
        while True:
            yield Wave("adaptive", float(self._allocation.mean(dtype=np.float64)))

    def allocate(self, statistics: Statistics, budget: int) -> np.ndarray:
        return self._allocation
