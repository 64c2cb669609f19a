"""Progress of the runs of a comparison, for the bar and the lines of `runner`, `local_runs` and `cluster.runs`."""

import time
from collections.abc import Callable

from isonoise.comparison.run_order import PlannedRun
from isonoise.loop import Stops
from isonoise.progress import ProgressBar, format_duration


class RunProgress:
    """Counts finished runs and estimates the remaining time from them.

    Attributes
    ----------
    total, finished : int
        Runs.
    start : float
        `time.perf_counter()` when the first run began; later by the time that was spent on references.
    """

    def __init__(self, stops: Stops):
        self._stops = stops
        self.total = self.finished = 0
        self.start = time.perf_counter()

    def show(self, bar: ProgressBar, share: float, text: str) -> None:
        """Show what is finished, and `share` runs more."""
        bar.show(self.finished + share, self.total, f"{text}{self.remaining()}")

    def of_run(self, bar: ProgressBar, run: PlannedRun) -> Callable[..., None]:
        """The `on_progress` of a run that is rendered in this process."""

        def show(elapsed_s: float, samples: int, *_) -> None:
            self.show(bar, self._share(elapsed_s, samples, run), run.title)

        return show

    def remaining(self) -> str:
        """Remaining time as text, estimated from the finished runs; empty if none is finished or missing."""
        if not self.finished or self.finished == self.total:
            return ""
        seconds = (time.perf_counter() - self.start) / self.finished * (self.total - self.finished)
        return f", {format_duration(seconds)} left"

    def _share(self, elapsed_s: float, samples: int, run: PlannedRun) -> float:
        """Finished share of a run."""
        if self._stops.time is not None:
            return min(elapsed_s / self._stops.time, 1.0)
        return min(samples / (self._stops.spp * run.scene.width * run.scene.height), 1.0)
