"""The statistics of a render as they are now: read from the device once, and kept until samples are added.

Called by `Renderer`.
"""

import weakref
from dataclasses import replace

import numpy as np

from isonoise.integrator.accumulator import Accumulator
from isonoise.statistics import Statistics, UniformSamples


class CurrentStatistics:
    """The statistics of all samples so far.

    Parameters
    ----------
    accumulator : Accumulator
        Computes them.
    scale : float
        Radiance in the scene's units over radiance on the device.
    uniform : UniformSamples or None
        For `Statistics.uniform`; None if it is not needed.

    Attributes
    ----------
    generation : int
        Changes whenever samples are added.
    """

    def __init__(self, accumulator: Accumulator, scale: float, uniform: UniformSamples | None):
        self._accumulator, self._scale, self.uniform = accumulator, scale, uniform
        self.is_uniform_wave = False
        self.generation = 0
        self._kept: Statistics | None = None  # None: out of date

    def read(self) -> Statistics:
        """The statistics, in the scene's units. Waits for the device."""
        if self._kept is None:
            self._kept = self._with_uniform(self._accumulator.statistics(self._scale, defer_rgb=True))
        return self._kept

    def read_rgb(self) -> np.ndarray:
        """Mean linear RGB alone, which is faster in the middle of a wave. Waits for the device."""
        return self._accumulator.rgb(self._scale) if self._kept is None else self._kept.rgb

    def read_for_map(self) -> Statistics:
        """Statistics for an allocation map; what computed them leaves its memory to the map of a large image."""
        statistics = self.read()
        self._accumulator.release_scratch()
        return statistics

    def forget(self) -> None:
        """Samples will be added. Statistics that are still in use get their RGB now."""
        in_use = (lambda: None) if self._kept is None else weakref.ref(self._kept)
        self._kept = None
        self.generation += 1
        statistics = in_use()
        if statistics is not None:
            _ = statistics.rgb

    def begin_wave(self, kind: str) -> None:
        """A wave of this kind begins."""
        is_uniform = kind == "uniform"
        if self.uniform is not None and is_uniform:
            self.uniform.begin_wave(self.read())
        self.is_uniform_wave = is_uniform

    def end_wave(self) -> None:
        """The wave has ended."""
        if self.uniform is not None and self.is_uniform_wave:
            self.uniform.end_wave(self.read())
        self.is_uniform_wave = False
        self._kept = self._with_uniform(self.read())

    def _with_uniform(self, statistics: Statistics) -> Statistics:
        """The statistics with those of uniform waves, if they are needed. They are not known during one."""
        if self.uniform is None or self.is_uniform_wave:
            return statistics
        return replace(statistics, uniform=self.uniform.statistics(statistics))
