"""Waves of a strategy on a wavefront: planned, traced and counted, one at a time. Made and called by `Renderer`."""

import time
import weakref
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from isonoise.current_statistics import CurrentStatistics
from isonoise.errors import DeviceError, UserError
from isonoise.integrator.wavefront import Wavefront
from isonoise.scene.compiled_scene import CompiledScene
from isonoise.state.state import State, copy_array, split_strategy_state, with_group
from isonoise.statistics import Statistics, UniformSamples
from isonoise.strategies import Strategy
from isonoise.strategies.planner import WavePlanner
from isonoise.wave import WAVE_VALUES, WaveInProgress, WaveRecord

if TYPE_CHECKING:
    from isonoise.distributed.distributed_wavefront import DistributedWavefront


class WaveTracer:
    """The waves of a render.

    Parameters
    ----------
    wavefront : Wavefront or DistributedWavefront
        Traces the samples. It has none yet.
    strategy : Strategy
        Its schedule is begun.
    scene : CompiledScene
        What the wavefront traces.
    has_uniform : bool
        Whether to keep `Statistics.uniform`.

    Attributes
    ----------
    wavefront : Wavefront or DistributedWavefront
        As given.
    planner : WavePlanner
        The position in the schedule.
    statistics : CurrentStatistics
        Statistics of all samples so far.
    samples : int
        Samples traced so far, rejected ones included.
    wave : WaveInProgress or None
        The wave that has begun and has not ended.
    """

    def __init__(
        self,
        wavefront: "Wavefront | DistributedWavefront",
        strategy: Strategy,
        scene: CompiledScene,
        has_uniform: bool,
    ):
        shape = scene.height, scene.width
        self.wavefront, self._strategy = wavefront, strategy
        self.planner = WavePlanner(strategy, shape)
        self.wave: WaveInProgress | None = None
        self.samples = 0
        uniform = UniformSamples(shape) if has_uniform else None
        self.statistics = CurrentStatistics(wavefront.accumulator, scene.radiance_scale, uniform)

    @property
    def wave_kind(self) -> Literal["uniform", "adaptive"] | None:
        """'uniform' or 'adaptive' during a wave, else None."""
        return None if self.wave is None else self.wave.kind

    def begin_wave(self, samples: int | None) -> None:
        """Plan the next wave, of at most `samples`."""
        start = time.perf_counter()
        kind, allocation = self.planner.plan(self.statistics.read_for_map, samples)
        self.statistics.begin_wave(kind)
        planned = int(allocation.sum(dtype=np.int64))
        self.wave = WaveInProgress(kind, allocation, planned, seconds=time.perf_counter() - start)

    def continue_wave(self, should_continue: Callable[[int], bool] | None) -> bool:
        """Trace samples of the wave until `should_continue` returns False; whether all are traced."""
        start, wave = time.perf_counter(), self._begun_wave()
        may_continue = should_continue or (lambda samples: True)

        def on_reduced(samples: int) -> None:
            wave.traced += samples
            self.samples += samples

        self.statistics.forget()
        try:
            self.wavefront.trace(wave.remaining, lambda: may_continue(wave.traced), on_reduced)
        finally:
            wave.seconds += time.perf_counter() - start
        return wave.traced == wave.planned

    def _begun_wave(self) -> WaveInProgress:
        if self.wave is None:
            raise UserError("no wave has begun: call `begin_wave` before `continue_wave` and `end_wave`")
        return self.wave

    def end_wave(self, workers: int) -> WaveRecord:
        """End the wave, which this many workers have traced. The rest of it, if there is one, is dropped."""
        start, wave = time.perf_counter(), self._begun_wave()
        self.wave = None
        self.statistics.end_wave()
        seconds = wave.seconds + time.perf_counter() - start
        number = self.planner.waves
        return WaveRecord(wave.kind, wave.traced, wave.planned, seconds, workers, number, self._reader(number))

    def _reader(self, number: int) -> Callable[[], Statistics]:
        """Returns the statistics as they are now, while no samples are added. It does not keep the render alive."""
        generation, reference = self.statistics.generation, weakref.ref(self)

        def read() -> Statistics:
            waves = reference()
            if waves is None or waves.statistics.generation != generation:
                raise UserError(
                    f"the statistics after wave {number} are gone, because the renderer has gone on or is closed; "
                    "read `statistics` of a wave before the next one"
                )
            return waves.statistics.read()

        return read

    def state(self, settings: dict[str, object], reuse: State | None) -> State:
        """As `Renderer.state`, of a render with these settings."""
        reduction = self.wavefront.accumulator.state({} if reuse is None else reuse.group("reduction"))
        samples = sum(int(reduction[name].sum(dtype=np.int64)) for name in ("count", "rejected"))
        if samples != self.samples:
            raise DeviceError(f"the device holds {samples} samples of {self.samples}: the render cannot be continued")
        values, arrays = split_strategy_state(self._strategy.name, self._strategy.state())
        arrays = with_group("reduction", reduction) | with_group("strategy", arrays)
        wave = self.wave and {name: getattr(self.wave, name) for name in WAVE_VALUES}
        renderer = {"samples": self.samples, "planner": self.planner.state(), "wave": wave}
        if self.wave is not None:
            arrays["wave/remaining"] = copy_array(self.wave.remaining, "wave/remaining", reuse)
        if self.statistics.uniform is not None:
            arrays["uniform/sums"] = copy_array(self.statistics.uniform.sums, "uniform/sums", reuse)
        return State(settings, {"renderer": renderer, "strategy": values}, arrays)

    def restore(self, state: State) -> None:
        """Continue from what `state` has returned. Only for waves that have not begun yet."""
        values: Any = state.values["renderer"]
        strategy: Any = state.values["strategy"]
        wave = values["wave"]
        self.statistics.forget()
        self.wavefront.accumulator.set_state(state.group("reduction"))
        self.planner.set_state(values["planner"])
        self._strategy.set_state(strategy | state.group("strategy"))
        self.wave = None if wave is None else WaveInProgress(remaining=state.arrays["wave/remaining"].copy(), **wave)
        self.statistics.is_uniform_wave = self.wave_kind == "uniform"
        if self.statistics.uniform is not None:
            self.statistics.uniform.sums = state.arrays["uniform/sums"].copy()
        self.samples = values["samples"]
