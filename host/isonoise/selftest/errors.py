"""Checks of the error estimate on the device, the kernel `relative_errors`, against the host's in numpy."""

from collections.abc import Iterator

import numpy as np

from isonoise.device.opencl import Device
from isonoise.error.distribution import ErrorDistribution
from isonoise.error.stated_error import error_distribution
from isonoise.integrator.error_stage import ErrorStage, build_constants
from isonoise.integrator.image_scratch import scratch_bytes
from isonoise.integrator.kernel_table import KERNELS
from isonoise.integrator.stages import Stages
from isonoise.selftest.cases import Case, Check, Context, array_case, count_case
from isonoise.statistics import BASIC_NEEDS, Statistics

QUANTILES = (0.05, 0.5, 0.9, 0.99)
BIN = 0.005
"""The device rounds an error to a bin by up to 0.4 %; float32 rounds much less."""


def device_distribution(
    device: Device, statistics: Statistics, floor: float, work_items: int | None = None
) -> ErrorDistribution:
    """The distribution of the errors that `statistics`, in device units, have. None: the device's work-items."""
    work_items = work_items or device.form.tile_work_items
    table = {"relative_errors": KERNELS["relative_errors"]}
    stages = Stages(device, table, {}, build_constants(work_items), {}, local_sizes={"relative_errors": work_items})
    height, width = statistics.shape
    planes = np.stack([statistics.mean, statistics.variance_per_sample()]).astype(np.float32)
    stages.arguments.update(
        image_width=np.uint32(width),
        total_pixels=np.uint32(height * width),
        count=device.buffer(statistics.count, "the counts"),
        luminance=device.buffer(planes, "the luminance"),
        error_bins=device.buffer(scratch_bytes((height, width), BASIC_NEEDS)["per_pixel"], "the errors"),
    )
    return ErrorStage(stages, statistics.shape, work_items).distribution(floor)


def noisy_image(height: int, width: int, seed: int) -> Statistics:
    """Skewed noise on a smooth image: a black strip, a jump of 10^4, and pixels of 0, 1, 7 and 2^31 samples."""
    random = np.random.default_rng(seed)
    x = np.linspace(0, 3, width) * np.ones((height, 1))
    light = np.exp(np.sin(x) + np.linspace(0, 1, height)[:, None])
    light[:, width // 2 :] *= 1e4
    light[: height // 5] = 0
    samples = light * (random.random((16, height, width)) < 0.3) * random.exponential(size=(16, height, width))
    count = random.choice(np.array([16, 7, 2**31], np.uint32), size=(height, width), p=[0.9, 0.05, 0.05])
    count[-1, : width // 8] = np.arange(width // 8) % 2
    variance = np.where(count > 1, samples.var(axis=0, ddof=1), 0)
    mean = np.where(count > 0, samples.mean(axis=0), 0)
    rejected = np.zeros((height, width), np.uint32)
    return Statistics(count, rejected, np.zeros((height, width, 3), np.float32), mean, variance, None)


def distribution_of_errors(context: Context) -> Iterator[Case]:
    """Quantiles of the error over the pixels."""
    for height, width in ((130, 97), (64, 64)):
        statistics = noisy_image(height, width, seed=height)
        floor = 0.01 * float(statistics.mean.mean())
        expected = error_distribution(statistics, floor)
        measured = device_distribution(context.device, statistics, floor)
        name = f"errors of {width}x{height} pixels"
        yield count_case(f"{name}: noiseless", measured.noiseless, "exact", expected.noiseless)
        quantiles, expected_quantiles = measured.quantiles(QUANTILES), expected.quantiles(QUANTILES)
        tolerance = BIN * expected_quantiles
        yield array_case(f"{name}: quantiles", quantiles, expected_quantiles, tolerance, "bins of 0.8 %, rounded")


CHECKS: tuple[Check, ...] = (distribution_of_errors,)
