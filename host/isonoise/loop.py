"""The render loop: waves until a limit is reached, with the stated error after each of them.

`render` is the one-call interface, `render_loop` the one with callbacks, which `isonoise render` and `isonoise compare`
use.
"""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from isonoise.error.energy_loss import EnergyLoss
from isonoise.error.stated_error import relative_standard_error
from isonoise.error.stopping import ErrorStop
from isonoise.error.true_error import true_error
from isonoise.errors import UserError
from isonoise.film.log import LogRow
from isonoise.luminance import luminance
from isonoise.renderer import Renderer, WaveRecord
from isonoise.statistics import Statistics
from isonoise.strategies.measures import image_floor

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
MIN_REMAINING_PIXEL_SAMPLES = 2**20
"""A render ends when a pixel can take fewer samples than this: its 32-bit count is nearly full."""


@dataclass(frozen=True)
class Stops:
    """Limits of a render; the first one reached ends it. At least one of spp, time and error is required.

    Parameters
    ----------
    spp : float or None
        Mean samples per pixel.
    time : float or None
        Seconds of rendering, without set-up.
    error : float or None
        Relative error at `quantile`, such as 0.02. The render ends when the true error is below it with `confidence`.
    quantile : float
        Quantile over the pixels, between 0 and 1.
    confidence : float
        Probability, at least 0.5 and below 1, that the true error is below `error` when the render ends because of it.
        It holds for all waves together, and as far as the limits of the stated error allow.

    Raises
    ------
    UserError
        If a value is out of range or all limits are missing.
    """

    spp: float | None = None
    time: float | None = None
    error: float | None = None
    quantile: float = 0.99
    confidence: float = 0.95

    def __post_init__(self):
        for name in ("spp", "time", "error"):
            value = getattr(self, name)
            if value is not None and not (value > 0 and math.isfinite(value)):
                raise UserError(f"{name} has to be a number above 0, not {value}")
        if not 0 < self.quantile < 1:
            raise UserError(f"quantile has to lie between 0 and 1, not {self.quantile}")
        if not 0.5 <= self.confidence < 1:
            raise UserError(f"confidence has to be at least 0.5 and below 1, not {self.confidence}")
        if self.spp is None and self.time is None and self.error is None:
            raise UserError("a render needs a limit: spp, time or error")


@dataclass(frozen=True)
class Outcome:
    """A finished render.

    Attributes
    ----------
    reason : str
        Why it ended: 'spp', 'time', 'error', 'interrupted', or 'full' (a pixel's 32-bit sample count is nearly full).
    rows : list of LogRow
        The log, one row per wave.
    elapsed_s : float
        Seconds of rendering, without set-up, callbacks and true errors.
    statistics : Statistics
        Statistics of all samples.
    floor : float
        Relative errors divide by max(luminance, floor).
    stated_error : float
        At the quantile of `Stops`; inf without waves.
    error_bound : float or None
        Upper confidence bound of the true error at this quantile. None without `Stops.error` or waves.
    """

    reason: str
    rows: list[LogRow]
    elapsed_s: float
    statistics: Statistics
    floor: float
    stated_error: float
    error_bound: float | None = None

    @property
    def rgb(self) -> np.ndarray:
        """Mean linear RGB, (height, width, 3) float32."""
        return self.statistics.rgb

    @property
    def error(self) -> np.ndarray:
        """Relative standard error of every pixel's luminance, (height, width) float32."""
        return relative_standard_error(self.statistics, self.floor)


def render(
    scene,
    spp: float | None = None,
    time: float | None = None,
    error: float | None = None,
    quantile: float = 0.99,
    confidence: float = 0.95,
    **options,
) -> Outcome:
    """Render a scene until a limit is reached.

    Parameters
    ----------
    scene : str, path or dict
        As for `Renderer`.
    spp, time, error, quantile, confidence
        As for `Stops`. Without spp, time and error the scene's sample_count is the limit.
    **options
        Further parameters of `Renderer`, such as `strategy`, `seed` and `size`.

    Returns
    -------
    Outcome
        Image, statistics and log.

    Raises
    ------
    UserError
        As for `Renderer` and `Stops`.

    Examples
    --------
    >>> outcome = isonoise.render("cornell", spp=32, size=(64, 48), strategy="pooled:window=7")
    >>> outcome.reason, outcome.rgb.shape, len(outcome.rows)
    ('spp', (48, 64, 3), 9)
    """
    renderer = Renderer(scene, **options)
    if spp is None and time is None and error is None:
        spp = float(renderer.scene.sample_count)
    return render_loop(renderer, Stops(spp, time, error, quantile, confidence))


def render_loop(
    renderer: Renderer,
    stops: Stops,
    *,
    on_wave: Callable[[LogRow, Statistics], None] | None = None,
    on_progress: Callable[[float, int, float | None, float | None], None] | None = None,
    reference: tuple[np.ndarray, np.ndarray | None] | None = None,
    should_stop: Callable[[], bool] | None = None,
) -> Outcome:
    """Run waves until a limit is reached.

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

    Returns
    -------
    Outcome
        Image, statistics and log.
    """
    return _RenderLoop(renderer, stops, on_wave, on_progress, reference, should_stop).run()


class _RenderLoop:
    def __init__(self, renderer, stops, on_wave, on_progress, reference, should_stop):
        self.renderer, self.stops = renderer, stops
        self.on_wave = on_wave or (lambda row, statistics: None)
        self.on_progress = on_progress or (lambda *state: None)
        self.should_stop = should_stop or (lambda: False)
        self.reference = reference
        self.reference_floor = None if reference is None else image_floor(luminance(reference[0]))
        self.pixels = renderer.scene.width * renderer.scene.height
        self.max_samples = None if stops.spp is None else max(1, round(stops.spp * self.pixels))
        self.rows: list[LogRow] = []
        self.energy_loss = EnergyLoss()
        self.samples = 0
        self.samples_per_s: float | None = None  # of the last wave, host work included
        self.error: float | None = None  # stated, at the quantile of `stops`
        self.error_stop = None if stops.error is None else ErrorStop(stops.error, stops.quantile, stops.confidence)
        self.clock_start = time.perf_counter()
        self.last_progress_s = 0.0

    def run(self) -> Outcome:
        statistics = None
        while (reason := self._stop_reason()) is None:
            last_elapsed = self.rows[-1].elapsed_s if self.rows else 0.0
            record = self._render_wave()
            statistics = self.renderer.statistics()
            row = self._add_row(record, statistics)
            self.samples_per_s = max(record.samples, 1) / max(row.elapsed_s - last_elapsed, 1e-6)
            self.on_wave(row, statistics)
            self.clock_start += self._elapsed() - row.elapsed_s  # true errors and `on_wave` do not count
        if statistics is None:
            statistics = self.renderer.statistics()
        bound = None if self.error_stop is None else self.error_stop.bound
        error = math.inf if self.error is None else self.error
        return Outcome(reason, self.rows, self._elapsed(), statistics, self._floor(statistics), error, bound)

    def _elapsed(self) -> float:
        return time.perf_counter() - self.clock_start

    def _time_left(self) -> float:
        return self.stops.time - self._elapsed()

    def _floor(self, statistics: Statistics) -> float:
        """The reference's floor if there is one, so that stated and true errors can be compared; else the image's."""
        return image_floor(statistics.mean) if self.reference_floor is None else self.reference_floor

    def _stop_reason(self) -> str | None:
        if self.should_stop():
            return "interrupted"
        if self.error_stop is not None and self.error_stop.passed:
            return "error"
        if self.renderer.remaining_pixel_samples < MIN_REMAINING_PIXEL_SAMPLES:
            return "full"
        if self.max_samples is not None and self.samples >= self.max_samples:
            return "spp"
        if self.stops.time is not None and self.samples and self._time_left() < TIME_TOLERANCE * self.stops.time:
            return "time"
        return None

    def _render_wave(self) -> WaveRecord:
        samples_before = self.samples

        def should_continue(wave_samples: int) -> bool:
            self.samples = samples_before + wave_samples
            self._report_progress()
            return not self.should_stop() and not self._deadline_passed()

        record = self.renderer.step(self._wave_limit(), should_continue)
        self.samples = samples_before + record.samples
        return record

    def _deadline_passed(self) -> bool:
        """Whether the wave has to end. The first one may finish: it makes the image complete."""
        return self.stops.time is not None and bool(self.rows) and self._time_left() <= 0

    def _wave_limit(self) -> int:
        """Upper limit for the samples of the next wave."""
        limits = [self.renderer.remaining_pixel_samples]  # even if all went to one pixel, its count cannot overflow
        if self.max_samples is not None:
            limits.append(self.max_samples - self.samples)
        if self.stops.time is not None:
            limits.append(self._samples_in_time_left())
        missing = self._samples_to_error()
        if missing is not None:
            limits.append(max(int(ERROR_MARGIN * missing), int(MIN_WAVE_SHARE * self.samples), 1))
        return min(limits)

    def _samples_in_time_left(self) -> int:
        if self.samples_per_s is None:
            return self.pixels  # one sample per pixel, to measure the speed
        left = self._time_left()
        share = MAX_SHARE_OF_TIME_LEFT if left > LAST_WAVE_SHARE * self.stops.time else 1.0
        return max(int(share * self.samples_per_s * left), 1)

    def _samples_to_error(self) -> float | None:
        """Samples missing to `stops.error`, if the error's bound falls with the square root of the sample count."""
        bound = None if self.error_stop is None else self.error_stop.bound
        if bound is None or not math.isfinite(bound):
            return None
        return self.samples * max((bound / self.stops.error) ** 2 - 1, 0)

    def _report_progress(self) -> None:
        elapsed = self._elapsed()
        if elapsed - self.last_progress_s >= PROGRESS_INTERVAL_S:
            self.last_progress_s = elapsed
            self.on_progress(elapsed, self.samples, self.error, self._remaining_s(elapsed))

    def _remaining_s(self, elapsed: float) -> float | None:
        """Estimated seconds to the first limit."""
        samples_per_s = self.samples / elapsed
        estimates = []
        if self.stops.time is not None:
            estimates.append(max(self.stops.time - elapsed, 0.0))
        if self.max_samples is not None and samples_per_s > 0:
            estimates.append((self.max_samples - self.samples) / samples_per_s)
        missing = self._samples_to_error()
        if missing is not None and samples_per_s > 0:
            estimates.append(missing / samples_per_s)
        return min(estimates, default=None)

    def _add_row(self, record: WaveRecord, statistics: Statistics) -> LogRow:
        errors = self.renderer.error_distribution(self._floor(statistics))
        p50, p95, p99, self.error = errors.quantiles((*LOG_QUANTILES, self.stops.quantile)).tolist()
        if self.error_stop is not None:
            self.error_stop.update(errors)
        self.energy_loss.add_wave(record.kind, statistics)
        energy_loss, energy_loss_se = self.energy_loss.estimate(statistics)
        elapsed = self._elapsed()
        true = None
        if self.reference is not None:
            image, standard_error = self.reference
            true = true_error(statistics.rgb, image, standard_error, statistics)
        row = LogRow(
            elapsed_s=elapsed,
            wave=len(self.rows) + 1,
            kind=record.kind,
            samples=statistics.samples,
            spp=statistics.samples / self.pixels,
            stated_p50=p50,
            stated_p95=p95,
            stated_p99=p99,
            true=true,
            rejected=int(statistics.rejected.sum(dtype=np.int64)),
            error_bound=math.nan if self.error_stop is None else self.error_stop.bound,
            energy_loss=energy_loss,
            energy_loss_se=energy_loss_se,
        )
        self.rows.append(row)
        return row
