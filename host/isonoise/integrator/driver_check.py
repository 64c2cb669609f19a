"""Checks a driver with the compiled kernels of a render: `reduce` on known samples, and a bounce with a closed form.

Called by `Renderer` for programs with which this driver has not passed before. A compiler that is right about one
program may be wrong about another, so the check launches the programs of the render itself, and compiles nothing. A
pass is noted in the program cache.
"""

from dataclasses import replace

import numpy as np

from isonoise.device import program_cache
from isonoise.device.drivers import driver_identity
from isonoise.errors import DeviceError
from isonoise.integrator.accumulator import Accumulator
from isonoise.integrator.check_scene import SIDE, check_scenes
from isonoise.integrator.features import features
from isonoise.integrator.wavefront import MAX_COMPILED_ITEMS, Wavefront
from isonoise.luminance import luminance
from isonoise.scene.accel.build import build_scene_bvh
from isonoise.statistics import Needs, Statistics

_VERSION = "1"
"""Of the check; a new one repeats it."""
_PASSED = b"passed"
_PIXELS, _MAX_COUNT = 1021, 35
"""Pixels with known samples, and most samples of one: sample blocks of 16 are full, begun and empty."""
_SPP = 32
_SIGMAS = 6.0
_TILES = 4
"""Tiles in a row or column of the image that are compared one by one."""

_passed_here: set[str] = set()
"""Keys of the checks that this process has passed, for a program cache that is off or cannot be written."""


def check_driver(wavefront: Wavefront, needs: Needs) -> None:
    """Raise DeviceError if the wavefront's kernels compute wrong numbers on its device.

    `needs` are those that the wavefront was made with; its own buffers are not touched. With the same programs, driver
    and device the check is not repeated once it has passed.
    """
    device = wavefront.device
    texts = [part for text, options in wavefront.stages.texts for part in (text, *options)]
    key = program_cache.program_key("driver check", (_VERSION, *texts), driver_identity(device.device))
    if key in _passed_here or program_cache.load(key) == _PASSED:
        return
    allocated = device.allocated
    fault = reduce_fault(wavefront, needs) or bounce_fault(wavefront, needs)
    device.finish()
    device.reset_profile()
    device.allocated = allocated
    if fault:
        raise DeviceError(
            f"the OpenCL driver of {device.name}, version {device.device.driver_version.strip()}, computes wrong "
            f"numbers: {fault}; choose another device of `isonoise devices` with --device, or install another version "
            "of the driver"
        )
    _passed_here.add(key)
    program_cache.store(key, _PASSED)


def reduce_fault(wavefront: Wavefront, needs: Needs) -> str | None:
    """What is wrong with the statistics of known samples, compared with float64; None if nothing is."""
    device, stages = wavefront.device, wavefront.stages.with_own_arguments()
    random = np.random.default_rng(1)
    counts = random.permutation(np.arange(_PIXELS) % (_MAX_COUNT + 1))
    pixel = np.repeat(np.arange(_PIXELS), counts)
    samples = random.exponential(size=(len(pixel), 3)).astype(np.float32)
    is_rejected = random.random(len(pixel)) < 0.05
    samples[is_rejected, 1] = np.where(random.random(is_rejected.sum()) < 0.5, np.nan, -1.0)
    accumulator = Accumulator(stages, (1, _PIXELS), needs)
    offsets = (np.cumsum(counts) - counts).astype(np.uint32)
    stages.launch(
        "reduce",
        _PIXELS,
        samples=device.buffer(samples, "the check of the driver"),
        pixel_offset=device.buffer(offsets, "the check of the driver"),
        pixels=np.uint32(_PIXELS),
        slice_samples=np.uint32(len(pixel)),
        first_pixel=np.uint32(0),
    )
    measured = accumulator.statistics()
    for name, expected in _expected_statistics(pixel, samples, is_rejected).items():
        values = getattr(measured, name).reshape(expected.shape)
        tolerance = 0 if expected.dtype.kind == "i" else 1e-4  # float32 sums of 35 samples of some 1
        wrong = np.count_nonzero(~(np.abs(values - expected) <= tolerance))
        if wrong:
            return f"`reduce` returned {wrong} wrong values of {expected.size} for the statistic `{name}`"
    return None


def _expected_statistics(pixel: np.ndarray, samples: np.ndarray, is_rejected: np.ndarray) -> dict[str, np.ndarray]:
    """Statistics of samples (n, 3) of pixels (n,), by name; 0 where a pixel has too few."""

    def total(values: np.ndarray) -> np.ndarray:
        return np.bincount(kept, values, minlength=_PIXELS)

    kept, colours = pixel[~is_rejected], samples[~is_rejected].astype(np.float64)
    x, count = luminance(colours), np.bincount(kept, minlength=_PIXELS)
    mean = total(x) / np.maximum(count, 1)
    return {
        "count": count,
        "rejected": np.bincount(pixel[is_rejected], minlength=_PIXELS),
        "rgb": np.stack([total(channel) for channel in colours.T], axis=-1) / np.maximum(count, 1)[:, None],
        "mean": mean,
        "variance": total((x - mean[kept]) ** 2) / np.maximum(count - 1, 1),
    }


def bounce_fault(wavefront: Wavefront, needs: Needs) -> str | None:
    """What is wrong with the image of a check scene; None if nothing is, or if no check scene suits the kernels."""
    device, on = wavefront.device, wavefront.features
    grid_size = 1 if wavefront.brute_force else 6
    for check in check_scenes():
        scene = check.compile(grid_size, wavefront.scene.sampler, on["FILTER_TABLE"], on["HIDE_EMITTERS"])
        if all(on[name] for name, is_used in features(scene, needs).items() if is_used):
            break
    else:
        return None
    # kernels are compiled for the sizes of this pool, and for this stack
    pool_size, bvh = min(wavefront.pool_size, MAX_COMPILED_ITEMS), build_scene_bvh(scene)
    bvh = replace(bvh, stack=max(bvh.stack, wavefront.bvh_stack))
    tracer = Wavefront(device, scene, bvh, needs, 1, pool_size, feature_override=on)
    allocation = np.zeros((SIDE, SIDE), np.uint32)
    traced = min(SIDE * SIDE, pool_size)  # a small pool takes many launches
    allocation.flat[:traced] = _SPP
    tracer.trace(allocation)
    return _image_fault(tracer.accumulator.statistics(scene.radiance_scale), check.image(), traced)


def _image_fault(measured: Statistics, image: np.ndarray, traced: int) -> str | None:
    """What is wrong if the mean of the first `traced` pixels, or of a tile, is over `_SIGMAS` standard errors off."""
    if measured.samples != _SPP * traced:
        return f"of {_SPP * traced} paths {measured.samples} returned a radiance"
    is_traced = measured.count > 0

    def sums(values: np.ndarray) -> np.ndarray:
        tiles = np.where(is_traced, values, 0.0).reshape(_TILES, SIDE // _TILES, _TILES, -1).sum(axis=(1, 3)).ravel()
        return np.append(tiles, tiles.sum())

    expected, total = sums(image), sums(measured.mean)
    tolerance = _SIGMAS * np.sqrt(sums(measured.variance / _SPP)) + 1e-4 * expected  # roundings, pixels not points
    if (np.abs(total - expected) <= tolerance).all():
        return None
    return f"one bounce of light has {total[-1] / expected[-1]:.4g} times the radiance of the closed form"
