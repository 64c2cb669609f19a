"""Plans waves: takes them from a strategy's schedule, gets and checks the allocation maps. Called by the renderer.

Strategies may be third-party code, so everything that they return is checked.
"""

import math
from collections.abc import Callable, Mapping
from typing import Literal

import numpy as np

from isonoise.errors import UserError
from isonoise.statistics import Statistics
from isonoise.strategies.base import Strategy, Wave
from isonoise.strategies.uniform_allocation import MAX_COUNT, uniform_allocation


class WavePlanner:
    """The position of a render in the schedule of its strategy.

    Parameters
    ----------
    strategy : Strategy
        Its schedule is begun.
    shape : (height, width)
        Of the image.
    """

    def __init__(self, strategy: Strategy, shape: tuple[int, int]):
        self.strategy, self.shape = strategy, shape
        self._schedule = strategy.waves()
        self._waves_taken = 0  # from the schedule
        self._unfinished_spp: float | None = None  # of the rest of a shortened uniform wave
        self._wave_index = 0
        self._max_pixel_samples = 0  # upper bound of the samples that any pixel has

    @property
    def waves(self) -> int:
        """Waves planned so far."""
        return self._wave_index

    @property
    def remaining_pixel_samples(self) -> int:
        """Samples that one pixel can still take: the device counts them in 32 bits."""
        return MAX_COUNT - self._max_pixel_samples

    def plan(
        self, statistics: Callable[[], Statistics], max_samples: int | None
    ) -> tuple[Literal["uniform", "adaptive"], np.ndarray]:
        """Kind and allocation map of the next wave, of at most `max_samples`; the caller may change the map.

        The rest of a uniform wave comes with the next call; the rest of an adaptive one is dropped. `statistics`
        returns those of all samples so far. Raises UserError if the strategy returns an invalid wave or map.
        """
        is_new = self._unfinished_spp is None
        wave = self._next_wave() if is_new else Wave("uniform", self._unfinished_spp)
        allocation, rest = self._allocate(wave, statistics, max_samples)
        max_allocation = int(allocation.max())
        if max_allocation > self.remaining_pixel_samples:
            raise UserError(
                f"strategy '{self.strategy.name}' asks for {max_allocation} samples in one pixel, "
                f"which can take only {self.remaining_pixel_samples} more"
            )
        self._waves_taken += is_new
        self._unfinished_spp = rest
        self._max_pixel_samples += max_allocation
        self._wave_index += 1
        return wave.kind, allocation

    def state(self) -> dict[str, int | float | None]:
        """The position, as plain values."""
        return {
            "waves_taken": self._waves_taken,
            "unfinished_spp": self._unfinished_spp,
            "wave_index": self._wave_index,
            "max_pixel_samples": self._max_pixel_samples,
        }

    def set_state(self, state: Mapping[str, int | float | None]) -> None:
        """Continue at a position that `state` has returned. Only for a planner that has planned nothing yet."""
        for _ in range(state["waves_taken"]):
            next(self._schedule)
        self._waves_taken, self._unfinished_spp = state["waves_taken"], state["unfinished_spp"]
        self._wave_index, self._max_pixel_samples = state["wave_index"], state["max_pixel_samples"]

    def _next_wave(self) -> Wave:
        wave = next(self._schedule, None)
        if wave is None:
            raise UserError(f"strategy '{self.strategy.name}' plans no more waves; its schedule has to be endless")
        unlimited = wave.kind == "adaptive" and wave.spp is None
        is_finite = bool(wave.spp) and 0 < wave.spp * math.prod(self.shape) < math.inf
        if wave.kind not in ("uniform", "adaptive") or not (unlimited or is_finite):
            raise UserError(
                f"strategy '{self.strategy.name}' planned {wave}; "
                "kind must be 'uniform' or 'adaptive', spp a finite number above 0 (or None if adaptive)"
            )
        return wave

    def _allocate(
        self, wave: Wave, statistics: Callable[[], Statistics], max_samples: int | None
    ) -> tuple[np.ndarray, float | None]:
        """The map, and the samples per pixel of the rest of a uniform wave."""
        if wave.spp is None:
            allocation = self._checked(self.strategy.allocate(statistics(), None), None)
            return self._limit(allocation, max_samples), None
        pixels, rest = math.prod(self.shape), None
        budget = max(1, round(wave.spp * pixels))
        if max_samples is not None and max_samples < budget:
            rest = wave.spp - max_samples / pixels
            budget = max_samples
        if wave.kind == "uniform":
            return uniform_allocation(self.shape, budget, self._wave_index), rest
        return self._checked(self.strategy.allocate(statistics(), budget), budget), None

    def _limit(self, allocation: np.ndarray, max_samples: int | None) -> np.ndarray:
        """The map, scaled down in proportion to at most `max_samples`."""
        if max_samples is None or int(allocation.sum(dtype=np.int64)) <= max_samples:
            return allocation
        from isonoise.strategies.allocation import distribute_in_proportion  # uniform renders never need it

        return distribute_in_proportion(allocation, max_samples, self._wave_index)

    def _checked(self, allocation: np.ndarray, budget: int | None) -> np.ndarray:
        """A copy of the map of a strategy, which may keep its own, after checking type, shape and sum."""
        allocation = np.asarray(allocation)
        total = int(allocation.sum(dtype=np.int64)) if allocation.shape == self.shape else None
        valid = allocation.dtype == np.uint32 and total is not None
        if not valid or (total < 1 if budget is None else total != budget):
            raise UserError(
                f"strategy '{self.strategy.name}' returned an allocation map of {allocation.dtype}, "
                f"shape {allocation.shape}, sum {total}; it has to be uint32, shape {self.shape}, "
                f"sum {'1 or more' if budget is None else budget}"
            )
        return allocation.copy()
