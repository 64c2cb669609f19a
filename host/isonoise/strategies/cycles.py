"""The strategy `cycles`: the adaptive sampling of Blender's Cycles."""

import math
from dataclasses import dataclass

import numpy as np

from isonoise.statistics import Needs, Statistics
from isonoise.strategies.measures import brightness, half_difference
from isonoise.strategies.parameters import ranged
from isonoise.strategies.stopping import StoppingStrategy

THRESHOLD_FACTOR = 5
"""Errors are compared with this many times the user's threshold."""


@dataclass(kw_only=True, eq=False)
class Cycles(StoppingStrategy):
    """Stops sampling pixels in which the mean of every second sample is close to the mean of all.

    From: github.com/blender/cycles, `src/kernel/film/adaptive_sampling.h` (error, neighbours),
    `src/integrator/adaptive_sampling.cpp` (when tests come), `src/scene/integrator.cpp` (defaults); after Dammertz et
    al. 2010, per pixel and without blocks. With I the mean RGB and A that of every second sample the error is

        (|I_R - A_R| + |I_G - A_G| + |I_B - A_B|) / (1e-4 + N(I_R + I_G + I_B)), N(x) = sqrt(x) below 1 and x above,

    and a pixel has converged when it is less than 5 times `threshold`. The first test comes after more than
    `min_samples` samples, at a multiple of 16; further ones every 16 samples. The eight neighbours of a pixel that has
    not converged are made active again; other converged pixels stay converged. The constants 1e-4 and 1 are in the
    scene's units, as published (Cycles multiplies by the exposure first): results depend on the scene's brightness.

    Differences: with few active pixels, tests are further apart (`StoppingStrategy`). When all pixels have converged,
    Cycles stops; here the threshold is halved. (Cycles' own scheduler does the same on the way from a higher first
    threshold to the given one.)

    Parameters
    ----------
    threshold : float
        1e-6 to 1; 0.01 is Cycles' default.
    min_samples : int
        No pixel is tested before it has more samples, 0 to 65536; 0 takes Cycles' max(4, 16 / threshold^0.3).
    """

    name = "cycles"
    needs = Needs(half=True)
    step = 16

    threshold: float = ranged(0.01, 1e-6, 1)
    min_samples: int = ranged(0, 0, 65536)

    @property
    def first_test_spp(self) -> int:
        min_samples = max(4, self.min_samples or math.ceil(16 / self.threshold**0.3))
        return (min_samples + 1) // self.step * self.step + self.step  # Cycles tests after sample (min + 1) | 15

    def pixel_error(self, statistics: Statistics) -> np.ndarray:
        return display_error(statistics)

    def active_pixels(
        self, error: np.ndarray, statistics: Statistics, threshold_scale: float, previous: np.ndarray | None
    ) -> np.ndarray:
        active = error >= THRESHOLD_FACTOR * self.threshold * threshold_scale
        return dilate(active if previous is None else active & previous)


def display_error(statistics: Statistics) -> np.ndarray:
    """The error of `Cycles`, (height, width) float64; inf where n < 2."""
    light = brightness(statistics)
    return half_difference(statistics) / (1e-4 + np.where(light < 1, np.sqrt(light), light))


def dilate(active: np.ndarray) -> np.ndarray:
    """`active` with the eight neighbours of every active pixel: one pixel along x, then along y."""
    along_x = active.copy()
    along_x[:, 1:] |= active[:, :-1]
    along_x[:, :-1] |= active[:, 1:]
    result = along_x.copy()
    result[1:] |= along_x[:-1]
    result[:-1] |= along_x[1:]
    return result
