"""The device of a render, or its workers: what they are, what they have done, and freeing them. Base of `Renderer`."""

import contextlib
from typing import TYPE_CHECKING

from isonoise.errors import UserError
from isonoise.scene.compiled_scene import CompiledScene
from isonoise.strips import LARGE_IMAGE_PIXELS
from isonoise.wave_tracer import WaveTracer

if TYPE_CHECKING:
    from isonoise.distributed.distributed_wavefront import DistributedWavefront
    from isonoise.distributed.worker_report import WorkerReport
    from isonoise.integrator.wavefront import Wavefront


class RenderDevices:
    """The base class of `Renderer`, whose constructor sets the attributes."""

    scene: CompiledScene
    _open_waves: WaveTracer | None
    """None: closed."""
    _distributed: "DistributedWavefront | None"
    """The wavefront, if there are workers."""
    _samples_at_end = 0

    @property
    def _waves(self) -> WaveTracer:
        if self._open_waves is None:
            raise UserError("the renderer is closed: its device has been freed; make another Renderer")
        return self._open_waves

    @property
    def _wavefront(self) -> "Wavefront | DistributedWavefront":
        return self._waves.wavefront

    def close(self) -> None:
        """Free the device and end the workers. Statistics that were read stay; nothing may be called afterwards.

        A second call does nothing.
        """
        if self._open_waves is None:
            return
        with contextlib.suppress(UserError):  # the device may have failed
            self._waves.statistics.forget()
        if self._distributed is not None:
            self._distributed.close()
        self._samples_at_end = self._waves.samples
        self._open_waves = self._distributed = None

    @property
    def samples(self) -> int:
        """Samples traced so far, rejected ones included."""
        return self._samples_at_end if self._open_waves is None else self._open_waves.samples

    @property
    def features(self) -> dict[str, bool]:
        """Feature name -> whether the kernels are compiled with it."""
        return self._wavefront.features

    @property
    def has_little_memory(self) -> bool:
        """Whether the image is large and the device shares the host's memory: keep no statistics during a wave."""
        return self._wavefront.device.shares_memory and self.scene.width * self.scene.height >= LARGE_IMAGE_PIXELS

    @property
    def device_seconds(self) -> float | None:
        """Seconds that kernels ran on the device, without set-up; None without `profile`, and with several devices."""
        device = self._wavefront.device
        return sum(device.seconds.values()) if device.profile else None

    @property
    def devices(self) -> list[str]:
        """Names of the devices that trace, each once; of a cluster those of the workers that have been ready so far."""
        if self._distributed is None:
            return [self._wavefront.device.selected.whole_name]
        return sorted({report.device for report in self.worker_reports()})

    def worker_reports(self) -> "list[WorkerReport]":
        """What every worker has done so far; empty on one device."""
        return [] if self._distributed is None else self._distributed.worker_reports()

    @property
    def waiting_s(self) -> float | None:
        """Seconds that the host has waited for workers; None on one device."""
        return None if self._distributed is None else self._distributed.waiting_s
