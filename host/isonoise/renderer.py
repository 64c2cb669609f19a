"""A render in progress: a scene on a device and a strategy that decides, wave by wave, where the samples go."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from isonoise.device.opencl import Device
from isonoise.errors import UserError
from isonoise.integrator.wavefront import Wavefront
from isonoise.scene.accel.build import build_scene_bvh
from isonoise.scene.compile import compile_scene
from isonoise.scene.compiled_scene import CompiledScene
from isonoise.scene.load import load
from isonoise.statistics import Statistics
from isonoise.strategies import DEFAULT_STRATEGY, Strategy, Wave, make_strategy
from isonoise.strategies.uniform_allocation import uniform_allocation


@dataclass(frozen=True)
class WaveRecord:
    """What one call of `Renderer.step` did."""

    kind: str  # 'uniform' or 'adaptive'
    samples: int  # that entered the statistics, rejected ones included
    planned: int  # that the wave wanted; more than `samples` where it was stopped
    seconds: float


class Renderer:
    """Renders a scene wave by wave.

    Args:
        scene: path of a scene or mesh file, name of a built-in scene, or a dict in Mitsuba 3's vocabulary.
        device: number or part of the name of an OpenCL device; None takes the first GPU, else the first CPU.
        strategy: `NAME[:key=value,...]`, `module:Class`, or a `Strategy`.
        seed: whole number from 0 to 2^64 - 1; the same seed gives the same samples.
        size: (width, height) in place of the film's.
        max_depth: in place of the integrator's.
        parameters: values for the scene file's `$names`.
        pool_size: paths in flight, from 1; None takes the device's (`device.pool`). It changes no pixel.
        profile: whether `device_seconds` are kept.

    Raises:
        SceneError, DeviceError, UserError: with a message for the user.
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
        pool_size: int | None = None,
        profile: bool = False,
    ):
        if not 0 <= seed < 2**64:
            raise UserError(f"seed {seed} is outside 0 to 2^64 - 1")
        if pool_size is not None and pool_size < 1:
            raise UserError(f"a pool of {pool_size} paths cannot render; pool_size has to be 1 or more")
        self.strategy = make_strategy(strategy)
        self.setup_times: dict[str, float] = {}
        clock = time.perf_counter()

        def lap(name: str) -> None:
            nonlocal clock
            clock, begun = time.perf_counter(), clock
            self.setup_times[name] = clock - begun

        self.scene: CompiledScene = compile_scene(load(scene, parameters), size=size, max_depth=max_depth)
        lap("load")
        bvh = build_scene_bvh(self.scene)
        lap("build")
        on_device = Device(device, profile)
        self.device_name = on_device.name
        self._wavefront = Wavefront(on_device, self.scene, bvh, self.strategy.needs, seed, pool_size)
        self._wavefront.warm_up()
        lap("compile")
        self._schedule = self.strategy.waves()
        self._cut_short: Wave | None = None
        self._statistics: Statistics | None = None  # until the next wave is traced
        self._waves = 0
        self._most = 0  # samples that any pixel can have by now

    @property
    def features(self) -> dict[str, bool]:
        """The feature set of scene and strategy: name -> whether it is built in."""
        return self._wavefront.features

    @property
    def room(self) -> int:
        """Samples that one pixel can still get: the device counts them in 32 bits."""
        return 2**32 - 1 - self._most

    @property
    def device_seconds(self) -> float | None:
        """Seconds that the device has worked on kernels since the set-up; None unless they are kept (`profile`)."""
        device = self._wavefront.device
        return sum(device.seconds.values()) if device.profile else None

    def step(
        self, samples: int | None = None, should_continue: Callable[[int], bool] = lambda entered: True
    ) -> WaveRecord:
        """Renders the strategy's next wave, of at most `samples` samples.

        What is cut off a uniform wave comes next time.

        `should_continue` is asked after every bounce, with the samples of the wave that have entered the statistics.
        When it returns False no more paths begin; those in flight still count.
        """
        begun = time.perf_counter()
        wave = self._cut_short or self._planned()
        self._cut_short = None
        allocation = self._allocation(wave, samples)
        planned = int(allocation.sum(dtype=np.int64))
        most = int(allocation.max())
        if most > self.room:
            raise UserError(f"a wave asks for {most} samples in one pixel, which has room for {self.room}")
        self._most += most
        self._waves += 1
        self._statistics = None
        entered = self._wavefront.trace(allocation, should_continue)
        return WaveRecord(wave.kind, entered, planned, time.perf_counter() - begun)

    def statistics(self) -> Statistics:
        """The statistics of every pixel so far, as numpy arrays in the scene's units. Waits for the device."""
        if self._statistics is None:
            self._statistics = self._wavefront.accumulator.statistics(self.scene.radiance_scale)
        return self._statistics

    def image(self) -> np.ndarray:
        """Mean linear RGB, float32 (height, width, 3)."""
        return self.statistics().rgb

    def _planned(self) -> Wave:
        """The schedule's next wave. A strategy may be anybody's: what it plans and returns is checked."""
        wave = next(self._schedule, None)
        if wave is None:
            raise UserError(f"strategy '{self.strategy.name}' plans no more waves; its schedule has to be endless")
        its_own = wave.kind == "adaptive" and wave.spp is None
        if wave.kind not in ("uniform", "adaptive") or not (its_own or (wave.spp and 0 < wave.spp < math.inf)):
            raise UserError(
                f"strategy '{self.strategy.name}' planned {wave}; "
                "a wave is 'uniform' or 'adaptive' and has a finite spp above 0, or none if it is adaptive"
            )
        return wave

    def _allocation(self, wave: Wave, samples: int | None) -> np.ndarray:
        """The wave's map, of at most `samples` samples; what is cut off a uniform wave is kept for the next step."""
        if wave.spp is None:
            allocation = self._checked(self.strategy.allocate(self.statistics(), None), None)
            if samples is None or int(allocation.sum(dtype=np.int64)) <= samples:
                return allocation
            from isonoise.strategies.allocation import proportional  # what uniform waves do without

            return proportional(allocation, samples, self._waves)
        pixels = self.scene.width * self.scene.height
        budget = max(1, round(wave.spp * pixels))
        if samples is not None and samples < budget:
            if wave.kind == "uniform":
                self._cut_short = replace(wave, spp=wave.spp - samples / pixels)
            budget = samples
        if wave.kind == "uniform":
            return uniform_allocation((self.scene.height, self.scene.width), budget, self._waves)
        return self._checked(self.strategy.allocate(self.statistics(), budget), budget)

    def _checked(self, allocation: np.ndarray, budget: int | None) -> np.ndarray:
        """The map, if it is one that the device can take."""
        allocation = np.asarray(allocation)
        shape = (self.scene.height, self.scene.width)
        total = int(allocation.sum(dtype=np.int64)) if allocation.shape == shape else None
        sound = allocation.dtype == np.uint32 and total is not None
        if not sound or (total < 1 if budget is None else total != budget):
            raise UserError(
                f"strategy '{self.strategy.name}' returned an allocation map of {allocation.dtype}, "
                f"shape {allocation.shape}, sum {total}; it has to be uint32, shape {shape}, "
                f"sum {'1 or more' if budget is None else budget}"
            )
        return allocation
