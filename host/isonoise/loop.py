"""The render loop: waves until a limit is reached, with the stated error after each of them.

Called by `isonoise.render`, `isonoise render` and `isonoise compare`.
"""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from typing import Any, NamedTuple

import numpy as np

from isonoise.argument_checks import check_callable, check_keywords
from isonoise.error.energy_loss import EnergyLoss
from isonoise.error.stopping import ErrorStop
from isonoise.error.true_error import true_error
from isonoise.errors import UserError
from isonoise.film.log import LogRow, row_from_values, row_values
from isonoise.luminance import luminance
from isonoise.outcome import Outcome
from isonoise.renderer import Renderer
from isonoise.state.state import State, copy_array
from isonoise.statistics import Statistics
from isonoise.stops import Stops
from isonoise.strategies.measures import image_floor
from isonoise.wave import WaveRecord

LOG_QUANTILES = (0.5, 0.95, 0.99)
"""Quantiles of the stated error in the log."""
PROGRESS_INTERVAL_S = 0.2
"""Shortest time between two calls of `on_progress`."""
MAX_SHARE_OF_TIME_LEFT = 0.85
"""A wave is planned for at most this share of the time left: the speed is known to about a tenth."""
LAST_WAVE_SHARE = 0.02
"""When less than this share of the time is left, a wave may take all of it."""
TIME_TOLERANCE = 0.003
"""A render ends when less than this share of its time is left."""
ERROR_MARGIN = 1.05
"""A wave is cut to this multiple of the samples missing to the stated error: the error is an estimate."""
MIN_WAVE_SHARE = 1 / 16
"""The stated error cuts no wave below this share of the samples so far."""


def render_loop(renderer: Renderer, stops: Stops, **options: Any) -> Outcome:
    """Run waves until a limit is reached: `RenderLoop(renderer, stops, **options).run()`, with its parameters."""
    check_keywords(options, RenderLoop)
    return RenderLoop(renderer, stops, **options).run()


class Periodic(NamedTuple):
    """Something to do during a render, at intervals of `interval_s` seconds.

    `action` is called with the `RenderLoop`, whose `state` and `outcome_so_far` work then. A wave stops for it and then
    goes on, which does not change the image. The clock of the render stands still meanwhile. With `is_wanted` that
    happens only if it returns True; it is called once the interval has passed, some hundred times per second.
    """

    interval_s: float
    action: "Callable[[RenderLoop], None]"
    is_wanted: Callable[[], bool] = lambda: True


class Progress(NamedTuple):
    """How far a render is; the last two are None while unknown."""

    elapsed_s: float
    samples: int
    stated_error: float | None  # after the last wave, at the quantile of `Stops`
    remaining_s: float | None  # estimated seconds to the first limit


class RenderLoop:
    """Runs waves until a limit is reached.

    Parameters
    ----------
    renderer : Renderer
        A renderer that has not rendered yet.
    stops : Stops
        The limits.
    on_wave : callable or None
        Called after every wave with its log row and the statistics. The clock stands still meanwhile.
    on_progress : callable or None
        Called a few times per second with elapsed seconds, samples, the last stated error and the estimated seconds
        left; the last two are None while unknown.
    reference : tuple or None
        Linear RGB of a converged image and its standard error (or None), both (height, width, 3). With it the log rows
        hold true errors. The clock stands still while these are computed.
    should_stop : callable or None
        Called between waves, and within a wave as `Renderer.step` calls `should_continue`. Once it returns True, the
        render ends after the paths in flight.
    periodic : sequence of Periodic
        What to do at intervals.
    on_end : callable or None
        Called with the loop when the render ends, before the rest of an unfinished wave is dropped: the last moment at
        which `state` can be continued bit by bit.
    state : State or None
        What `state` of another loop has returned, to continue that render. Limits count from its beginning.

    Attributes
    ----------
    rows : list of LogRow
        The log, one row per wave.

    Raises
    ------
    UserError
        If `state` is that of a render with other settings; the message names the difference.
    """

    def __init__(
        self,
        renderer: Renderer,
        stops: Stops,
        *,
        on_wave: Callable[[LogRow, Statistics], object] | None = None,
        on_progress: Callable[[float, int, float | None, float | None], object] | None = None,
        reference: tuple[np.ndarray, np.ndarray | None] | None = None,
        should_stop: Callable[[], bool] | None = None,
        periodic: Sequence[Periodic] = (),
        on_end: "Callable[[RenderLoop], None] | None" = None,
        state: State | None = None,
    ):
        for name, value, kind in (("renderer", renderer, Renderer), ("stops", stops, Stops)):
            if not isinstance(value, kind):
                raise UserError(f"{name} = {value!r} is not an isonoise.{kind.__name__}")
        for name, function in (("on_wave", on_wave), ("on_progress", on_progress), ("should_stop", should_stop)):
            if function is not None:
                check_callable(name, function)
        self.renderer, self.stops = renderer, stops
        self._on_wave = on_wave or (lambda row, statistics: None)
        self._on_progress = on_progress or (lambda *progress: None)
        self._stop_signal, self._has_stopped = should_stop or (lambda: False), False
        self._periodic, self._on_end = periodic, on_end or (lambda loop: None)
        self._reference = reference
        self._reference_floor = None if reference is None else image_floor(luminance(reference[0]))
        self._pixels = renderer.scene.width * renderer.scene.height
        self._max_samples = None if stops.spp is None else max(1, round(stops.spp * self._pixels))
        self.rows: list[LogRow] = []
        self._energy_loss = EnergyLoss()
        self._samples_per_s: float | None = None  # of the last wave, host work included
        self._error: float | None = None  # stated, at the quantile of `stops`
        self._error_stop = None if stops.error is None else ErrorStop(stops.error, stops.quantile, stops.confidence)
        self.statistics: Statistics | None = None  # after the last wave
        self._last_progress_s = 0.0
        self._elapsed_before = 0.0  # of the render that is continued
        self._clock_start = time.perf_counter()
        self._due_at = [self._clock_start + each.interval_s for each in periodic]
        self._has_just_acted = False  # then the wave goes on, even if the next action is due already
        if state is not None:
            self._restore(state)

    def run(self) -> Outcome:
        """Run waves until a limit is reached; return image, statistics and log.

        After an exception `outcome_so_far` still works, and so does `state` unless the device has failed.
        """
        while (reason := self._stop_reason()) is None:
            if self.renderer.wave_kind is None:
                self._begin_wave()
            if not self._trace_wave():
                self._on_end(self)
                self._end_wave()
                return self.outcome_so_far(self._stop_reason() or "interrupted")
            self._end_wave()
            self._run_periodic()
        self._on_end(self)
        return self.outcome_so_far(reason)

    def outcome_so_far(self, reason: str) -> Outcome:
        """Return what has been rendered so far, as if the render ended now because of `reason`.

        In the middle of a wave the samples of the wave are part of the image, but not of the log. If the device has
        failed, the statistics are those after the last wave.
        """
        try:
            statistics, layers = self.renderer.statistics(), self.renderer.layers()
            _ = statistics.rgb  # which may be the first use of it
        except UserError:
            if self.statistics is None:
                raise
            statistics, layers = self.statistics, {}
        bound = None if self._error_stop is None else self._error_stop.bound
        error = math.inf if self._error is None else self._error
        elapsed, share = self._elapsed(), self._client_share()
        floor = self._floor(statistics)
        return Outcome(reason, self.rows, elapsed, statistics, floor, error, bound, share, self.stops, layers)

    def state(self, reuse: State | None = None) -> State:
        """Return all that the render is, to continue it later. Waits for the device. `reuse`: as for `Renderer`."""
        state = self.renderer.state(reuse)
        values = {
            "rows": [row_values(row) for row in self.rows],
            "elapsed_s": self._elapsed(),
            "samples_per_s": self._samples_per_s,
            "error": self._error,
            "error_stop": self._error_stop and vars(self._error_stop),
            "energy_loss_control": self._energy_loss.control,
            "reference_floor": self._reference_floor,
            "stops": asdict(self.stops),
        }
        arrays = {}
        if self._energy_loss.uniform is not None:
            arrays["energy_loss/uniform"] = copy_array(self._energy_loss.uniform, "energy_loss/uniform", reuse)
        return replace(state, values=state.values | {"loop": values}, arrays=state.arrays | arrays)

    def _restore(self, state: State) -> None:
        self.renderer.restore(state)
        if "loop" not in state.values:
            raise UserError("the render cannot be continued: its state is that of a Renderer, without log and time")
        values = state.values["loop"]
        if values["reference_floor"] != self._reference_floor:
            raise UserError("the render cannot be continued: it had another --reference, or one of both has none")
        self.rows = [row_from_values(row) for row in values["rows"]]
        self._elapsed_before = values["elapsed_s"]
        self._clock_start -= self._elapsed_before
        self._samples_per_s, self._error = values["samples_per_s"], values["error"]
        if self._error_stop is not None and values["error_stop"] is not None:
            self._error_stop.restore(**values["error_stop"])
        self._energy_loss.control = values["energy_loss_control"]
        if "energy_loss/uniform" in state.arrays:
            self._energy_loss.uniform = state.arrays["energy_loss/uniform"].copy()

    def stop(self) -> None:
        """End the render as `should_stop` does. Any thread may call it."""
        self._has_stopped = True

    @property
    def is_stopped(self) -> bool:
        """Whether `stop` or `should_stop` ends the render."""
        return self._has_stopped or self._stop_signal()

    def progress(self) -> Progress:
        """How far the render is. Any thread may call it."""
        elapsed = self._elapsed()
        return Progress(elapsed, self.renderer.samples, self._error, self._remaining_s(elapsed))

    def _elapsed(self) -> float:
        return time.perf_counter() - self._clock_start

    def _client_share(self) -> float | None:
        """`Outcome.client_share`, of this process alone if the render was continued."""
        waiting_s, elapsed = self.renderer.waiting_s, self._elapsed() - self._elapsed_before
        return None if waiting_s is None or elapsed <= 0 else max(1 - waiting_s / elapsed, 0.0)

    def _time_left(self) -> float:
        return self.stops.time - self._elapsed()

    def _floor(self, statistics: Statistics) -> float:
        """The reference's floor if there is one, so that stated and true errors can be compared; else the image's."""
        return image_floor(statistics.mean) if self._reference_floor is None else self._reference_floor

    def _stop_reason(self) -> str | None:
        if self.is_stopped:
            return "interrupted"
        if self._error_stop is not None and self._error_stop.passed:
            return "error"
        if self.renderer.is_full:
            return "full"
        if self._max_samples is not None and self.renderer.samples >= self._max_samples:
            return "spp"
        has_time_left = self.stops.time is None or self._time_left() >= TIME_TOLERANCE * self.stops.time
        return None if has_time_left or not self.renderer.samples else "time"

    def _begin_wave(self) -> None:
        self.renderer.begin_wave(self._wave_limit())
        self._energy_loss.begin_wave(self.renderer.wave_kind, self.renderer.statistics)
        if self.renderer.has_little_memory:
            self.statistics = None

    def _trace_wave(self) -> bool:
        """Trace the wave; return False if it ends early because of a signal or the deadline."""
        while not self.renderer.continue_wave(self._should_continue):
            if self.is_stopped or self._deadline_passed():
                return False
            self._run_periodic()
        return True

    def _should_continue(self, wave_samples: int) -> bool:
        self._report_progress()
        is_due = not self._has_just_acted and any(map(self._is_due, range(len(self._periodic))))
        self._has_just_acted = False
        return not (is_due or self.is_stopped or self._deadline_passed())

    def _is_due(self, index: int) -> bool:
        return time.perf_counter() >= self._due_at[index] and self._periodic[index].is_wanted()

    def _run_periodic(self) -> None:
        self._has_just_acted = True
        for index, each in enumerate(self._periodic):
            if self._is_due(index):
                start = time.perf_counter()
                each.action(self)
                end = time.perf_counter()
                self._clock_start += end - start
                self._due_at[index] = end + each.interval_s

    def _end_wave(self) -> None:
        last_elapsed = self.rows[-1].elapsed_s if self.rows else 0.0
        record = self.renderer.end_wave()
        statistics = self.renderer.statistics()
        if not self.renderer.has_little_memory:
            _ = statistics.rgb  # read now, so that it is there if the device fails from now on
        self.statistics = statistics
        row = self._add_row(record)
        self._samples_per_s = max(record.samples, 1) / max(row.elapsed_s - last_elapsed, 1e-6)
        self._on_wave(row, self.statistics)
        self._clock_start += self._elapsed() - row.elapsed_s  # true errors and `on_wave` do not count

    def _deadline_passed(self) -> bool:
        """Whether the wave has to end. The first one may finish: it makes the image complete."""
        return self.stops.time is not None and bool(self.rows) and self._time_left() <= 0

    def _wave_limit(self) -> int:
        """Upper limit for the samples of the next wave."""
        limits = [self.renderer.remaining_pixel_samples]  # even if all went to one pixel, its count cannot overflow
        if self._max_samples is not None:
            limits.append(self._max_samples - self.renderer.samples)
        if self.stops.time is not None:
            limits.append(self._samples_in_time_left())
        missing = self._samples_to_error()
        if missing is not None:
            limits.append(max(int(ERROR_MARGIN * missing), int(MIN_WAVE_SHARE * self.renderer.samples), 1))
        return min(limits)

    def _samples_in_time_left(self) -> int:
        if self._samples_per_s is None:
            return self._pixels  # one sample per pixel, to measure the speed
        left = self._time_left()
        share = MAX_SHARE_OF_TIME_LEFT if left > LAST_WAVE_SHARE * self.stops.time else 1.0
        return max(int(share * self._samples_per_s * left), 1)

    def _samples_to_error(self) -> float | None:
        """Samples missing to `stops.error`, if the error's bound falls with the square root of the sample count."""
        bound = None if self._error_stop is None else self._error_stop.bound
        if bound is None or not math.isfinite(bound):
            return None
        return self.renderer.samples * max((bound / self.stops.error) ** 2 - 1, 0)

    def _report_progress(self) -> None:
        elapsed = self._elapsed()
        if elapsed - self._last_progress_s >= PROGRESS_INTERVAL_S:
            self._last_progress_s = elapsed
            self._on_progress(*self.progress())

    def _remaining_s(self, elapsed: float) -> float | None:
        """Estimated seconds to the first limit."""
        samples_per_s = self.renderer.samples / max(elapsed, 1e-9)
        estimates = []
        if self.stops.time is not None:
            estimates.append(max(self.stops.time - elapsed, 0.0))
        if self._max_samples is not None and samples_per_s > 0:
            estimates.append((self._max_samples - self.renderer.samples) / samples_per_s)
        missing = self._samples_to_error()
        if missing is not None and samples_per_s > 0:
            estimates.append(missing / samples_per_s)
        return min(estimates, default=None)

    def _add_row(self, record: WaveRecord) -> LogRow:
        statistics = self.statistics
        errors = self.renderer.error_distribution(self._floor(statistics))
        p50, p95, p99, self._error = errors.quantiles((*LOG_QUANTILES, self.stops.quantile)).tolist()
        if self._error_stop is not None:
            self._error_stop.update(errors)
        self._energy_loss.end_wave(record.kind, statistics)
        energy_loss, energy_loss_se = self._energy_loss.estimate(statistics)
        elapsed = self._elapsed()
        true = None
        if self._reference is not None:
            image, standard_error = self._reference
            true = true_error(statistics.rgb, image, standard_error, statistics)
        row = LogRow(
            elapsed_s=elapsed,
            wave=len(self.rows) + 1,
            kind=record.kind,
            samples=statistics.samples,
            spp=statistics.samples / self._pixels,
            stated_p50=p50,
            stated_p95=p95,
            stated_p99=p99,
            true=true,
            rejected=int(statistics.rejected.sum(dtype=np.int64)),
            error_bound=math.nan if self._error_stop is None else self._error_stop.bound,
            energy_loss=energy_loss,
            energy_loss_se=energy_loss_se,
            workers=record.workers,
        )
        self.rows.append(row)
        return row
