"""Renders a scene and compares the mean of the image with a closed form.

The tolerance is Z standard errors of the image mean, taken from the render's own statistics, plus a relative rounding
error. Z = 5 is exceeded once in two million cases.
"""

from dataclasses import dataclass

import numpy as np

from isonoise.integrator.wavefront import Wavefront
from isonoise.scene import compile_scene, load_description
from isonoise.scene.accel.build import build_scene_bvh
from isonoise.selftest.cases import Case, Context
from isonoise.statistics import Statistics

Z = 5.0
ROUNDING = 1e-5
"""Relative: some hundred roundings of 2^-24, at random."""


@dataclass(frozen=True)
class ImageMean:
    """The mean luminance of an image and its standard error."""

    statistics: Statistics
    mean: float
    standard_error: float

    @property
    def rejected(self) -> int:
        """Number of samples that are not finite or negative."""
        return int(self.statistics.rejected.sum())


def render_mean(context: Context, description: dict, spp: int, seed: int = 1) -> ImageMean:
    """Renders with `spp` samples in every pixel."""
    compiled = compile_scene(load_description(description))
    shape = (compiled.height, compiled.width)
    pool = min(2**17, max(2**10, spp * shape[0] * shape[1]))
    wavefront = Wavefront(context.device, compiled, build_scene_bvh(compiled), seed=seed, pool_size=pool)
    wavefront.trace(np.full(shape, spp, np.uint32))
    statistics = wavefront.accumulator.statistics(compiled.radiance_scale)
    variance_sum = statistics.variance_of_mean().sum()
    return ImageMean(statistics, float(statistics.mean.mean()), float(np.sqrt(variance_sum) / statistics.count.size))


def image_case(
    name: str, image: ImageMean, expected: float, rounding: float = ROUNDING, rounding_basis: str = "rounding 10^-5"
) -> Case:
    """Returns the case of an image mean. Rejected samples fail it."""
    tolerance = Z * image.standard_error + rounding * abs(expected)
    measured = image.mean if image.rejected == 0 else float("nan")
    return Case(name, measured, expected, tolerance, f"5 standard errors of the image mean, and {rounding_basis}")
