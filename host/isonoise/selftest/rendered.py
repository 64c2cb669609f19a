"""A scene rendered for its mean, and the case that comes of it.

An image is compared by its mean, with Z of its own standard errors for the noise that there is and so much for rounding
as the case says. Z = 5 is exceeded once in two million cases.
"""

from dataclasses import dataclass

import numpy as np

from isonoise.integrator.wavefront import Wavefront
from isonoise.scene import compile_scene, load
from isonoise.scene.accel.build import build_scene_bvh
from isonoise.selftest.core import Bench, Case
from isonoise.statistics import Statistics

Z = 5.0
ROUNDING = 1e-5
"""Relative: some hundred roundings of 2^-24, at random."""


@dataclass(frozen=True)
class Image:
    """A render's mean luminance over the image, and one standard error of that."""

    statistics: Statistics
    mean: float
    error: float

    @property
    def rejected(self) -> int:
        return int(self.statistics.rejected.sum())


def rendered(bench: Bench, description: dict, spp: int, seed: int = 1) -> Image:
    """With `spp` samples in every pixel."""
    compiled = compile_scene(load(description))
    shape = (compiled.height, compiled.width)
    pool = min(2**17, max(2**10, spp * shape[0] * shape[1]))
    wavefront = Wavefront(bench.device, compiled, build_scene_bvh(compiled), seed=seed, pool_size=pool)
    wavefront.trace(np.full(shape, spp, np.uint32))
    statistics = wavefront.accumulator.statistics(compiled.radiance_scale)
    error = np.sqrt((statistics.variance / np.maximum(statistics.count, 1)).sum()) / statistics.count.size
    return Image(statistics, float(statistics.mean.mean()), float(error))


def case(name: str, image: Image, expected: float, rounding: float = ROUNDING, basis: str = "rounding 10^-5") -> Case:
    """The image's mean; a rejected sample fails it."""
    tolerance = Z * image.error + rounding * abs(expected)
    measured = image.mean if image.rejected == 0 else float("nan")
    return Case(name, measured, expected, tolerance, f"5 standard errors of the image mean, and {basis}")
