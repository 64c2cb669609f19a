"""A scene on a device, to be measured: every run traces the same samples, so that counts don't vary, only times."""

import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from isonoise.device.opencl import Device
from isonoise.integrator.wavefront import Wavefront
from isonoise.scene.accel.build import build_scene_bvh
from isonoise.scene.compiled_scene import CompiledScene
from isonoise.statistics import BASIC_NEEDS, Needs
from isonoise.strategies.uniform_allocation import uniform_allocation


class MeasuredDevice(Device):
    """A device that keeps the bytes of its buffers (`bytes_of`), by what they are for."""

    def __init__(self, choice: str | int | None = None):
        self.bytes_of: Counter[str] = Counter()
        super().__init__(choice)

    def buffer(self, size: int | np.ndarray, what: str):
        self.bytes_of[what.removeprefix("the ")] += size.nbytes if isinstance(size, np.ndarray) else int(size)
        return super().buffer(size, what)


@dataclass
class Work:
    """What a kernel did in one run."""

    launches: int = 0
    items: int = 0
    seconds: float = 0.0


@dataclass(frozen=True)
class Run:
    """One run: by the wall clock, and by kernel where the queue kept times."""

    seconds: float
    kernels: dict[str, Work] | None


class Subject:
    """A compiled scene with its program built and every kernel launched once.

    A run is a uniform wave of `samples` samples, at most one more in one pixel than in another, and the reading of its
    statistics. `needs` and `feature_override` as of `Wavefront`.
    """

    def __init__(
        self,
        scene: CompiledScene,
        device: MeasuredDevice,
        samples: int,
        pool_size: int | None = None,
        needs: Needs = BASIC_NEEDS,
        feature_override: Mapping[str, bool] | None = None,
    ):
        self.scene, self.device, self.samples = scene, device, samples
        self.bvh = build_scene_bvh(scene)
        self.wavefront = Wavefront(
            device, scene, self.bvh, needs, pool_size=pool_size, feature_override=feature_override
        )
        self.wavefront.warm_up()
        self.allocation = uniform_allocation((scene.height, scene.width), samples, 0)

    @property
    def pool_size(self) -> int:
        return self.wavefront.pool_size

    def run(self, profile: bool) -> Run:
        """The wave and its statistics, from the first sample on."""
        device = self.device
        self.begin(profile)
        kernels: dict[str, Work] = {}

        def on_launch(kernel: str, items: int, seconds: float) -> None:
            work = kernels.setdefault(kernel, Work())
            work.launches += 1
            work.items += items
            work.seconds += seconds

        device.on_launch = on_launch
        begun = time.perf_counter()
        self.wavefront.trace(self.allocation)
        self.wavefront.accumulator.statistics(self.scene.radiance_scale)
        device.finish()
        seconds = time.perf_counter() - begun
        device.on_launch = None
        return Run(seconds, kernels if profile else None)

    def begin(self, profile: bool) -> None:
        """As if nothing had been traced yet, with or without a queue that keeps times."""
        self.device.set_profiling(profile)
        self.device.reset_profile()
        self.wavefront.accumulator.reset()
        self.device.finish()
