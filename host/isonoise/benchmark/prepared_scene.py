"""A compiled scene on a device, ready to be measured: every run traces the same samples, so only times vary."""

import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from isonoise.device.opencl import Device, Launch
from isonoise.integrator.wavefront import Wavefront
from isonoise.scene.accel.build import build_scene_bvh
from isonoise.scene.compiled_scene import CompiledScene
from isonoise.statistics import BASIC_NEEDS, Needs
from isonoise.strategies.uniform_allocation import uniform_allocation


class MeasuredDevice(Device):
    """A device that records its programs, and the bytes of its buffers by their content.

    `programs` holds source, options and kernels of each.
    """

    def __init__(self, choice: str | int | None = None):
        self.buffer_bytes: Counter[str] = Counter()
        self.programs: list[tuple[str, tuple[str, ...], dict[str, object]]] = []
        super().__init__(choice)

    def build(self, source: str, options: tuple[str, ...]) -> dict[str, object]:
        kernels = super().build(source, options)
        self.programs.append((source, options, kernels))
        return kernels

    def buffer(self, content: int | np.ndarray, label: str):
        content_bytes = content.nbytes if isinstance(content, np.ndarray) else int(content)
        self.buffer_bytes[label.removeprefix("the ")] += content_bytes
        return super().buffer(content, label)


@dataclass
class KernelTotals:
    """Sums over all launches of a kernel in one run."""

    launches: int = 0
    items: int = 0
    seconds: float = 0.0


@dataclass(frozen=True)
class Run:
    """One run: wall-clock seconds; if it was profiled, its launches in order."""

    seconds: float
    launches: list[Launch] | None

    def kernels(self) -> dict[str, KernelTotals]:
        """Totals by kernel of a profiled run, in the order of their first launches."""
        totals: dict[str, KernelTotals] = {}
        for launch in self.launches:
            kernel = totals.setdefault(launch.kernel, KernelTotals())
            kernel.launches += 1
            kernel.items += launch.items
            kernel.seconds += launch.seconds
        return totals


class PreparedScene:
    """A compiled scene with its programs built and every kernel launched once.

    A run is one uniform wave of `samples` samples, with counts per pixel that differ by at most one, and the transfer
    of its statistics. `needs`, `pool_size` and `feature_override` are those of `Wavefront`.
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
        """Trace the wave from its first sample on and read its statistics."""
        device = self.device
        self.reset(profile)
        launches: list[Launch] = []
        device.on_launch = launches.append
        remaining = self.allocation.copy()
        start = time.perf_counter()
        self.wavefront.trace(remaining)
        self.wavefront.accumulator.statistics(self.scene.radiance_scale)
        device.finish()
        seconds = time.perf_counter() - start
        device.on_launch = None
        return Run(seconds, launches if profile else None)

    def reset(self, profile: bool) -> None:
        """Discard all samples and profiled times; turn profiling of the queue on or off."""
        self.device.set_profiling(profile)
        self.device.reset_profile()
        self.wavefront.accumulator.reset()
        self.device.finish()
