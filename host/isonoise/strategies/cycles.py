"""The strategy `cycles`: the adaptive sampling of Blender's Cycles."""

import math
from dataclasses import dataclass

import numpy as np

from isonoise.statistics import Needs, Statistics
from isonoise.strategies.measures import brightness, half_difference
from isonoise.strategies.parameter_checks import check_range
from isonoise.strategies.stopping import Retiring

FACTOR = 5
"""Between the threshold a user gives and the one that errors are compared with."""


@dataclass(kw_only=True, eq=False)
class Cycles(Retiring):
    """Retires pixels in which the mean of every second sample is near the mean of all.

    From: github.com/blender/cycles, `src/kernel/film/adaptive_sampling.h` (error, neighbours),
    `src/integrator/adaptive_sampling.cpp` (when tests come), `src/scene/integrator.cpp` (defaults); after Dammertz et
    al. 2010, by the pixel and without blocks. With I the mean RGB and A that of every second sample the error is

        (|I_R - A_R| + |I_G - A_G| + |I_B - A_B|) / (1e-4 + N(I_R + I_G + I_B)), N(x) = sqrt(x) below 1 and x above,

    and a pixel is done when it is less than 5 times `threshold`. Tests begin after `min_samples`, at a multiple of 16,
    and come every 16 samples. The eight neighbours of a pixel that is not done are made active again; else done pixels
    stay done. The constants 1e-4 and 1 are in the scene's units, as published (Cycles multiplies by the exposure
    first): results depend on the scene's brightness.

    Differences: where few pixels are active tests are further apart (`Retiring`). When all pixels are done Cycles
    stops; here the threshold is halved and all begin anew from their statistics, so that a deadline is used. (Cycles'
    own scheduler does the same on the way from a higher first threshold to the one given.)

    - `threshold`: 1e-6 to 1; Cycles' default is 0.01.
    - `min_samples`: no pixel is tested before it has more, 0 to 65536; 0 takes Cycles' max(4, 16 / threshold^0.3).
    """

    name = "cycles"
    needs = Needs(half=True)
    step = 16

    threshold: float = 0.01
    min_samples: int = 0

    def __post_init__(self):
        check_range("threshold", self.threshold, 1e-6, 1)
        check_range("min_samples", self.min_samples, 0, 65536)

    @property
    def first(self) -> int:
        least = max(4, self.min_samples or math.ceil(16 / self.threshold**0.3))
        return (least + 1) // self.step * self.step + self.step  # the test follows sample (least + 1) | 15, from 0

    def error(self, statistics: Statistics) -> np.ndarray:
        return display_error(statistics)

    def active(self, error: np.ndarray, statistics: Statistics, scale: float, before: np.ndarray | None) -> np.ndarray:
        active = error >= FACTOR * self.threshold * scale
        return with_neighbours(active if before is None else active & before)


def display_error(statistics: Statistics) -> np.ndarray:
    """The error of `Cycles`, float64 (height, width); inf where n < 2."""
    light = brightness(statistics)
    return half_difference(statistics) / (1e-4 + np.where(light < 1, np.sqrt(light), light))


def with_neighbours(active: np.ndarray) -> np.ndarray:
    """Also the eight pixels around each: a step along x, then along y."""
    wide = active.copy()
    wide[:, 1:] |= active[:, :-1]
    wide[:, :-1] |= active[:, 1:]
    high = wide.copy()
    high[1:] |= wide[:-1]
    high[:-1] |= wide[1:]
    return high
