"""What the runs of a strategy did wave by wave: samples against time, stated and true errors; called by `page`."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from isonoise.comparison.results import Run

QUANTILES = ("p50", "p95", "p99")


@dataclass(frozen=True)
class WaveSeries:
    """The waves that all runs have, shape (K,).

    Attributes
    ----------
    spp, elapsed_s
        Samples per pixel and seconds of rendering after the wave, means over the seeds.
    runs
        The same of each run, all its waves.
    stated, true
        Relative errors at the quantiles (`QUANTILES` -> errors), geometric means over the seeds. The true ones are
        without the reference's own error. nan where an error is not positive.
    first
        Index of the first wave after the warm-up, or of the last wave.
    """

    spp: np.ndarray
    elapsed_s: np.ndarray
    runs: Sequence[tuple[np.ndarray, np.ndarray]]
    stated: Mapping[str, np.ndarray]
    true: Mapping[str, np.ndarray]
    first: int

    @property
    def has_stated_errors(self) -> bool:
        """False for other renderers, such as Mitsuba."""
        return any(np.isfinite(errors).any() for errors in self.stated.values())

    def spp_at(self, seconds: Sequence[float]) -> np.ndarray:
        """Samples per pixel at these times: interpolated log-log between the waves of a run, mean over the seeds."""
        found = [np.exp(np.interp(np.log(seconds), np.log(elapsed), np.log(spp))) for spp, elapsed in self.runs]
        return np.mean(found, axis=0)


def read_wave_series(runs: Sequence[Run]) -> WaveSeries:
    """The series of a strategy from its runs, one per seed."""
    rows_of_runs = [run.rows for run in runs]
    count = min(map(len, rows_of_runs))

    def values(column: str) -> np.ndarray:
        return np.array([[row[column] for row in rows[:count]] for rows in rows_of_runs], np.float64)

    def geometric_mean(column: str) -> np.ndarray:
        found = values(column)
        return np.exp(np.log(np.where(found > 0, found, np.nan)).mean(axis=0))

    spp = values("spp").mean(axis=0)
    warm_up_spp = runs[0].facts.get("warm_up_spp") or runs[0].facts.get("first_wave_spp") or 0
    return WaveSeries(
        spp,
        values("elapsed_s").mean(axis=0),
        [tuple(np.array([row[name] for row in rows]) for name in ("spp", "elapsed_s")) for rows in rows_of_runs],
        {quantile: geometric_mean(f"stated_{quantile}") for quantile in QUANTILES},
        {quantile: geometric_mean(f"true_{quantile}_corrected") for quantile in QUANTILES},
        min(int(np.searchsorted(spp, warm_up_spp)), count - 1),
    )
