"""A render in progress: a scene on a device, and the strategy that distributes the samples wave by wave."""

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np

from isonoise.device.drivers import describe_driver
from isonoise.device.opencl import Device
from isonoise.device.pool_size import MAX_POOL_SIZE
from isonoise.error.distribution import ErrorDistribution
from isonoise.error.stated_error import error_distribution
from isonoise.errors import UserError
from isonoise.integrator.driver_check import check_driver
from isonoise.integrator.wavefront import Wavefront
from isonoise.samplers import SAMPLERS
from isonoise.scene.accel.build import build_scene_bvh
from isonoise.scene.compile import compile_scene
from isonoise.scene.compiled_scene import CompiledScene
from isonoise.scene.load import load
from isonoise.statistics import Statistics, UniformSamples
from isonoise.strategies import DEFAULT_STRATEGY, Strategy, Wave, make_strategy
from isonoise.strategies.uniform_allocation import MAX_COUNT, uniform_allocation


@dataclass(frozen=True)
class WaveRecord:
    """What one call of `Renderer.step` did.

    Attributes
    ----------
    kind : str
        'uniform' or 'adaptive'.
    samples : int
        Samples traced, rejected ones included.
    planned : int
        Samples in the allocation map; more than `samples` if the wave was stopped early.
    seconds : float
        Wall-clock time of the call.
    """

    kind: str
    samples: int
    planned: int
    seconds: float


class Renderer:
    """Renders a scene wave by wave.

    Parameters
    ----------
    scene : str, path or dict
        A scene or mesh file, the name of a built-in scene, or a dict in Mitsuba 3's vocabulary (`isonoise.load`).
    device : str, int or None
        Number or part of the name of an OpenCL device. None: the first of
        `isonoise devices`.
    strategy : str or Strategy
        `NAME[:key=value,...]`, `module:Class[:key=value,...]`, or an object.
    seed : int
        0 to 2^64 - 1. The same seed gives the same samples.
    size : (width, height) or None
        Image size in pixels. None: the scene's.
    max_depth : int or None
        Longest path in segments: 1 is emitters only, -1 has no limit. None: the scene's.
    parameters : dict or None
        Values for the `$name` placeholders of an XML scene.
    sampler : str or None
        `sobol`: well-distributed samples; `independent`: independent ones. None: the scene's.
    pool_size : int or None
        Paths in flight, 1 to 2^25. None: the device's default (`isonoise.device.pool_size`). Affects speed only, not
        the image.
    profile : bool
        Measure `device_seconds`.

    Attributes
    ----------
    scene : CompiledScene
        The scene as arrays.
    strategy : Strategy
        The strategy in use.
    device_name : str
        Name of the OpenCL device and its platform.
    driver : str
        Version of its driver, and the CPU that the driver's compiler emits code for, if that is known.
    setup_times : dict of str to float
        Seconds to `load` the scene, `build` its BVH and `compile` the kernels.

    Raises
    ------
    UserError
        If a parameter is wrong; SceneError if the scene is, DeviceError if the device is missing or too small.

    Examples
    --------
    >>> renderer = isonoise.Renderer("cornell", size=(64, 48))
    >>> for wave in range(3):
    ...     record = renderer.step()
    >>> record.kind, round(renderer.statistics().samples / (64 * 48), 1)
    ('uniform', 18.7)
    """

    def __init__(
        self,
        scene,
        device: str | int | None = None,
        strategy: str | Strategy = DEFAULT_STRATEGY,
        seed: int = 0,
        size: tuple[int, int] | None = None,
        max_depth: int | None = None,
        parameters: dict[str, str] | None = None,
        sampler: str | None = None,
        pool_size: int | None = None,
        profile: bool = False,
    ):
        if not 0 <= seed < 2**64:
            raise UserError(f"seed = {seed} is out of range: it goes from 0 to 2^64 - 1")
        if pool_size is not None and not 1 <= pool_size <= MAX_POOL_SIZE:
            raise UserError(f"pool_size = {pool_size} is out of range: it goes from 1 to {MAX_POOL_SIZE}")
        if sampler not in (None, *SAMPLERS):
            raise UserError(f"sampler = {sampler!r} is not one of {', '.join(SAMPLERS)}")
        self.strategy = make_strategy(strategy)
        self.setup_times: dict[str, float] = {}
        with self._measured("load"):
            self.scene: CompiledScene = compile_scene(load(scene, parameters), size, max_depth, sampler)
        with self._measured("build"):
            bvh = build_scene_bvh(self.scene)
        with self._measured("compile"):
            opencl_device = Device(device, profile)
            self.device_name, self.driver = opencl_device.name, describe_driver(opencl_device.device)
            needs = self.strategy.needs.with_sampler(self.scene.sampler)
            self._wavefront = Wavefront(opencl_device, self.scene, bvh, needs, seed, pool_size)
            self._wavefront.warm_up()
            check_driver(self._wavefront, needs)
        self._schedule = self.strategy.waves()
        self._unfinished_wave: Wave | None = None  # the rest of a shortened uniform wave
        self._statistics: Statistics | None = None  # None: out of date
        needs_uniform = self.strategy.needs.uniform
        self._uniform = UniformSamples((self.scene.height, self.scene.width)) if needs_uniform else None
        self._wave_index = 0
        self._max_pixel_samples = 0  # upper bound of the samples that any pixel has

    @contextmanager
    def _measured(self, name: str) -> Iterator[None]:
        start = time.perf_counter()
        yield
        self.setup_times[name] = time.perf_counter() - start

    @property
    def features(self) -> dict[str, bool]:
        """Feature name -> whether the kernels are compiled with it."""
        return self._wavefront.features

    @property
    def remaining_pixel_samples(self) -> int:
        """Samples that one pixel can still take: the device counts them in 32 bits."""
        return MAX_COUNT - self._max_pixel_samples

    @property
    def device_seconds(self) -> float | None:
        """Seconds that kernels ran on the device, without set-up; None unless `profile` is set."""
        device = self._wavefront.device
        return sum(device.seconds.values()) if device.profile else None

    def step(self, samples: int | None = None, should_continue: Callable[[int], bool] | None = None) -> WaveRecord:
        """Render the strategy's next wave.

        Parameters
        ----------
        samples : int or None
            Upper limit for the samples of the wave. The rest of a uniform wave comes with the next step; the rest of an
            adaptive one is dropped.
        should_continue : callable or None
            Called with the wave's samples that have entered the statistics: before every slice, and after every bounce
            while paths are left to start. Once it returns False no new paths start; those in flight are finished and
            counted.

        Returns
        -------
        WaveRecord

        Raises
        ------
        UserError
            If the strategy returns an invalid wave or allocation map.
        """
        start = time.perf_counter()
        wave = self._unfinished_wave or self._next_wave()
        self._unfinished_wave = None
        allocation = self._allocate(wave, samples)
        planned = int(allocation.sum(dtype=np.int64))
        max_allocation = int(allocation.max())
        if max_allocation > self.remaining_pixel_samples:
            raise UserError(
                f"strategy '{self.strategy.name}' asks for {max_allocation} samples in one pixel, "
                f"which can take only {self.remaining_pixel_samples} more"
            )
        self._max_pixel_samples += max_allocation
        self._wave_index += 1
        before = self.statistics() if self._uniform and wave.kind == "uniform" else None
        self._statistics = None
        traced = self._wavefront.trace(allocation, should_continue or (lambda samples_so_far: True))
        if before:
            self._uniform.add_wave(before, self.statistics())
            self._statistics = self._with_uniform(self.statistics())
        return WaveRecord(wave.kind, traced, planned, time.perf_counter() - start)

    def statistics(self) -> Statistics:
        """Return the statistics of all samples so far, in the scene's units. Waits for the device."""
        if self._statistics is None:
            statistics = self._wavefront.accumulator.statistics(self.scene.radiance_scale)
            self._statistics = self._with_uniform(statistics)
        return self._statistics

    def error_distribution(self, floor: float) -> ErrorDistribution:
        """The distribution of the pixels' relative errors |x - r| / max(r, floor), r the true image.

        Its quantiles are those of `isonoise.error.stated_error.stated_error`, to 0.4 %. Waits for the device.
        """
        statistics = self.statistics()  # which the device reads
        if not floor > 0:
            return error_distribution(statistics, floor)
        return self._wavefront.errors.distribution(floor * self.scene.radiance_scale)

    def _with_uniform(self, statistics: Statistics) -> Statistics:
        """The statistics with those of uniform waves, if the strategy needs them."""
        return replace(statistics, uniform=self._uniform.statistics(statistics)) if self._uniform else statistics

    def image(self) -> np.ndarray:
        """Return the mean linear RGB, (height, width, 3) float32. Waits for the device."""
        return self.statistics().rgb

    def _next_wave(self) -> Wave:
        """The schedule's next wave, checked: strategies may be third-party code."""
        wave = next(self._schedule, None)
        if wave is None:
            raise UserError(f"strategy '{self.strategy.name}' plans no more waves; its schedule has to be endless")
        unlimited = wave.kind == "adaptive" and wave.spp is None
        if wave.kind not in ("uniform", "adaptive") or not (unlimited or (wave.spp and 0 < wave.spp < math.inf)):
            raise UserError(
                f"strategy '{self.strategy.name}' planned {wave}; "
                "kind must be 'uniform' or 'adaptive', spp a finite number above 0 (or None if adaptive)"
            )
        return wave

    def _allocate(self, wave: Wave, max_samples: int | None) -> np.ndarray:
        """The wave's allocation map, limited to `max_samples`."""
        shape = (self.scene.height, self.scene.width)
        if wave.spp is None:
            return self._limit(self._checked(self.strategy.allocate(self.statistics(), None), None), max_samples)
        pixels = self.scene.width * self.scene.height
        budget = max(1, round(wave.spp * pixels))
        if max_samples is not None and max_samples < budget:
            if wave.kind == "uniform":
                self._unfinished_wave = replace(wave, spp=wave.spp - max_samples / pixels)
            budget = max_samples
        if wave.kind == "uniform":
            return uniform_allocation(shape, budget, self._wave_index)
        return self._checked(self.strategy.allocate(self.statistics(), budget), budget)

    def _limit(self, allocation: np.ndarray, max_samples: int | None) -> np.ndarray:
        """The map, scaled down in proportion to at most `max_samples`."""
        if max_samples is None or int(allocation.sum(dtype=np.int64)) <= max_samples:
            return allocation
        from isonoise.strategies.allocation import distribute_in_proportion  # uniform renders never need it

        return distribute_in_proportion(allocation, max_samples, self._wave_index)

    def _checked(self, allocation: np.ndarray, budget: int | None) -> np.ndarray:
        """The map of a strategy, after checking type, shape and sum."""
        allocation = np.asarray(allocation)
        shape = (self.scene.height, self.scene.width)
        total = int(allocation.sum(dtype=np.int64)) if allocation.shape == shape else None
        valid = allocation.dtype == np.uint32 and total is not None
        if not valid or (total < 1 if budget is None else total != budget):
            raise UserError(
                f"strategy '{self.strategy.name}' returned an allocation map of {allocation.dtype}, "
                f"shape {allocation.shape}, sum {total}; it has to be uint32, shape {shape}, "
                f"sum {'1 or more' if budget is None else budget}"
            )
        return allocation
