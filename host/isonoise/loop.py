"""The render loop: waves until a stop is reached, with the stated error after each of them."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from isonoise.error.stated_error import relative_standard_error, stated_error
from isonoise.error.true_error import true_error
from isonoise.errors import UserError
from isonoise.film.log import LogRow
from isonoise.luminance import luminance
from isonoise.renderer import Renderer, WaveRecord
from isonoise.statistics import Statistics
from isonoise.strategies.measures import image_floor

QUANTILES = (0.5, 0.95, 0.99)
"""Of the stated error in the log."""
PROGRESS_INTERVAL = 0.2
"""Seconds between two reports of progress."""
LAST_WAVE_SHARE = 0.85
"""Of the time left, what a wave is cut to at most: the speed is known to about a tenth, and a few such cuts home in."""
FULL = 2**20
"""Samples of room in a pixel's count below which a render ends."""
LAST_WAVES = 0.02
"""Share of the time from which on a wave may take all that is left."""


@dataclass(frozen=True)
class Stops:
    """Limits of a render; the first one reached ends it. At least one of spp, time and error has to be given.

    spp: mean samples per pixel. time: seconds of rendering. error: the stated error at `quantile`.
    """

    spp: float | None = None
    time: float | None = None
    error: float | None = None
    quantile: float = 0.99

    def __post_init__(self):
        for name in ("spp", "time", "error"):
            value = getattr(self, name)
            if value is not None and not (value > 0 and math.isfinite(value)):
                raise UserError(f"{name} has to be a number above 0, not {value}")
        if not 0 < self.quantile < 1:
            raise UserError(f"quantile has to lie between 0 and 1, not {self.quantile}")
        if self.spp is None and self.time is None and self.error is None:
            raise UserError("a render needs a limit: spp, time or error")


@dataclass(frozen=True)
class Outcome:
    """A finished render."""

    reason: str  # what ended it: 'spp', 'time', 'error', 'interrupted', or 'full': a pixel's count of samples is
    rows: list[LogRow]  # one a wave
    elapsed_s: float  # rendering alone
    statistics: Statistics
    floor: float  # below it no luminance counts as smaller when errors are relative

    @property
    def rgb(self) -> np.ndarray:
        """Mean linear RGB, float32 (height, width, 3)."""
        return self.statistics.rgb

    @property
    def error(self) -> np.ndarray:
        """One relative standard error of every pixel's luminance, float32 (height, width)."""
        return relative_standard_error(self.statistics, self.floor)


def render_loop(
    renderer: Renderer,
    stops: Stops,
    *,
    on_wave: Callable[[LogRow, Statistics], None] = lambda row, statistics: None,
    on_progress: Callable[[float, int, float | None, float | None], None] = lambda *state: None,
    reference: tuple[np.ndarray, np.ndarray | None] | None = None,
    should_stop: Callable[[], bool] = lambda: False,
) -> Outcome:
    """Renders until one of the stops.

    `on_wave` gets a row and the statistics after every wave. `on_progress` gets elapsed seconds, samples, the last
    stated error and seconds left (None: not known) a few times a second. `reference` is RGB and its standard error, or
    None: with it, rows hold true errors. The clock stands still while these are computed and during `on_wave`.
    `should_stop` is asked after every bounce.
    """
    return _Loop(renderer, stops, on_progress, reference, should_stop).run(on_wave)


class _Loop:
    def __init__(self, renderer, stops, on_progress, reference, should_stop):
        self.renderer, self.stops, self.on_progress = renderer, stops, on_progress
        self.reference, self.should_stop = reference, should_stop
        self.reference_floor = None if reference is None else image_floor(luminance(reference[0]))
        pixels = renderer.scene.width * renderer.scene.height
        self.budget = None if stops.spp is None else max(1, round(stops.spp * pixels))
        self.pixels = pixels
        self.rows: list[LogRow] = []
        self.samples = 0
        self.speed: float | None = None  # samples a second of the last wave, host work included
        self.error: float | None = None  # stated, at the stops' quantile
        self.begun = time.perf_counter()
        self.reported = 0.0

    def elapsed(self) -> float:
        return time.perf_counter() - self.begun

    def run(self, on_wave) -> Outcome:
        statistics = None
        while (reason := self._reason()) is None:
            record = self._wave()
            statistics = self.renderer.statistics()
            self._row(record, statistics)
            self.speed = max(record.samples, 1) / max(self.rows[-1].elapsed_s - self._elapsed_before(), 1e-6)
            on_wave(self.rows[-1], statistics)
            self.begun += self.elapsed() - self.rows[-1].elapsed_s  # reports are no rendering
        if statistics is None:
            statistics = self.renderer.statistics()
        return Outcome(reason, self.rows, self.elapsed(), statistics, self._floor(statistics))

    def _floor(self, statistics: Statistics) -> float:
        """The reference's where there is one, so that stated and true errors can be compared; else the image's."""
        return image_floor(statistics.mean) if self.reference_floor is None else self.reference_floor

    def _elapsed_before(self) -> float:
        return self.rows[-2].elapsed_s if len(self.rows) > 1 else 0.0

    def _reason(self) -> str | None:
        """Which stop is reached, if any."""
        if self.should_stop():
            return "interrupted"
        if self.stops.error is not None and self.error is not None and self.error < self.stops.error:
            return "error"
        if self.renderer.room < FULL:
            return "full"
        if self.budget is not None and self.samples >= self.budget:
            return "spp"
        if self.stops.time is not None and self.samples and self._time_left() < 0.003 * self.stops.time:
            return "time"
        return None

    def _late(self) -> bool:
        """Whether a wave has to end for the deadline; the first one, which makes the image whole, may finish."""
        return self.stops.time is not None and bool(self.rows) and self._time_left() <= 0

    def _time_left(self) -> float:
        return self.stops.time - self.elapsed()

    def _limit(self) -> int:
        """Most samples that the next wave may bring."""
        limits = [self.renderer.room]  # however they are spread, no pixel's count can overflow
        if self.budget is not None:
            limits.append(self.budget - self.samples)
        if self.stops.time is not None:
            limits.append(self._samples_in_time())
        if self.stops.error is not None and self._samples_to_error() is not None:
            # a twentieth more than the square root law says, and not in one go: the error is an estimate
            limits.append(max(int(1.05 * self._samples_to_error()), self.samples // 16, 1))
        return min(limits)

    def _samples_in_time(self) -> int:
        if self.speed is None:
            return self.pixels  # a first pass over the image tells how fast the scene is
        left = self._time_left()
        share = LAST_WAVE_SHARE if left > LAST_WAVES * self.stops.time else 1.0
        return max(int(share * self.speed * left), 1)

    def _samples_to_error(self) -> float | None:
        """Samples that are missing to the stated error asked for, if it falls with the square root of their number."""
        if self.stops.error is None or self.error is None or not math.isfinite(self.error):
            return None
        return self.samples * max((self.error / self.stops.error) ** 2 - 1, 0)

    def _wave(self) -> WaveRecord:
        before = self.samples

        def should_continue(entered: int) -> bool:
            self.samples = before + entered
            self._report()
            return not self.should_stop() and not self._late()

        record = self.renderer.step(self._limit(), should_continue)
        self.samples = before + record.samples
        return record

    def _report(self) -> None:
        now = self.elapsed()
        if now - self.reported >= PROGRESS_INTERVAL:
            self.reported = now
            self.on_progress(now, self.samples, self.error, self._remaining(now))

    def _remaining(self, now: float) -> float | None:
        """Seconds to the stop that will probably come first."""
        speed = self.samples / now
        seconds = []
        if self.stops.time is not None:
            seconds.append(max(self.stops.time - now, 0.0))
        if self.budget is not None and speed > 0:
            seconds.append((self.budget - self.samples) / speed)
        if self._samples_to_error() is not None and speed > 0:
            seconds.append(self._samples_to_error() / speed)
        return min(seconds) if seconds else None

    def _row(self, record: WaveRecord, statistics: Statistics) -> None:
        asked = stated_error(statistics, (*QUANTILES, self.stops.quantile), self._floor(statistics))
        self.error = float(asked[-1])
        elapsed = self.elapsed()
        true = None
        if self.reference is not None:
            image, standard_error = self.reference
            true = true_error(statistics.rgb, image, standard_error, statistics)
        self.rows.append(
            LogRow(
                elapsed_s=elapsed,
                wave=len(self.rows) + 1,
                kind=record.kind,
                samples=statistics.samples,
                spp=statistics.samples / self.pixels,
                stated_p50=float(asked[0]),
                stated_p95=float(asked[1]),
                stated_p99=float(asked[2]),
                true=true,
                rejected=int(statistics.rejected.sum(dtype=np.int64)),
            )
        )


def render(
    scene,
    spp: float | None = None,
    time: float | None = None,
    error: float | None = None,
    quantile: float = 0.99,
    **options,
) -> Outcome:
    """Renders a scene and returns image, statistics and log. `options` are those of `Renderer`.

    Without spp, time and error the scene's sample_count holds.
    """
    renderer = Renderer(scene, **options)
    if spp is None and time is None and error is None:
        spp = float(renderer.scene.sample_count)
    return render_loop(renderer, Stops(spp, time, error, quantile))
