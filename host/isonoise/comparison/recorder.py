"""Records a run: a row per wave, error images at six times, sample counts; for `run_task` and `mitsuba_worker`."""

import json
from collections.abc import Mapping

import numpy as np

from isonoise.comparison.checked_files import pack_npz
from isonoise.comparison.image_metrics import BiasMetric, mean_square_error
from isonoise.comparison.reference_error import error_quantiles, relative_to_floor
from isonoise.error.true_error import luminance_standard_error
from isonoise.film.log import LogRow, columns, row_values
from isonoise.loop import Stops
from isonoise.luminance import luminance
from isonoise.statistics import Statistics
from isonoise.strategies.measures import image_floor

SNAPSHOTS = 6
"""Error images of a run: the last is final, each earlier one is taken at half the time, or samples, of the next."""

CORRECTED = {"true_p50_corrected": 0.5, "true_p95_corrected": 0.95, "true_p99_corrected": 0.99}
"""Columns with the true errors at these quantiles, without the reference's own error."""
IMAGE_METRICS = ("true_mse", "true_bias", "true_bias_se")
"""Columns with the metrics of `image_metrics`."""
RUN_COLUMNS = (*columns(true_errors=True), *CORRECTED, *IMAGE_METRICS, "device_s")
"""Fields of a row."""

_MAX_HALF = float(np.finfo(np.float16).max)


class Recorder:
    """Collects a run, wave by wave.

    Parameters
    ----------
    stops : Stops
        The budget of the run, time or samples per pixel.
    reference : (height, width, 3) float32
        Linear RGB.
    reference_se : (height, width, 3) float32, optional
        Its standard errors. None: it is exact.

    Attributes
    ----------
    rows : list of dict
        One per wave, with the fields `RUN_COLUMNS`.
    """

    def __init__(self, stops: Stops, reference: np.ndarray, reference_se: np.ndarray | None = None):
        self._reference = reference
        self._luminance = luminance(reference)
        self._bias = BiasMetric(reference, reference_se)
        floor = image_floor(self._luminance)
        self._scale = np.maximum(self._luminance, floor)
        self._relative_se = None
        if reference_se is not None:
            self._relative_se = relative_to_floor(luminance_standard_error(reference_se), self._luminance, floor)
        self._by_time = stops.time is not None
        budget = stops.time if self._by_time else stops.spp * self._luminance.size
        self._due_at = [budget * 2.0 ** (k + 1 - SNAPSHOTS) for k in range(SNAPSHOTS - 1)]
        self.rows: list[dict] = []
        self._snapshots: list[tuple[float, int, np.ndarray]] = []

    def wave(self, row: LogRow, rgb: np.ndarray, device_s: float | None, statistics: Statistics | None = None) -> None:
        """Record a wave: row, image, busy time of the device so far, and the image's statistics if they are known."""
        corrected = error_quantiles(self._error(rgb), tuple(CORRECTED.values()), self._relative_se).tolist()
        bias = self._bias(rgb, statistics)
        metrics = (mean_square_error(rgb, self._reference), bias.value, bias.se)
        values = row_values(row) | dict(zip((*CORRECTED, *IMAGE_METRICS), (*corrected, *metrics), strict=True))
        self.rows.append(values | {"device_s": device_s})
        reached = row.elapsed_s if self._by_time else row.samples
        due = [threshold for threshold in self._due_at if reached >= threshold]
        if due:
            self._due_at = self._due_at[len(due) :]
            self._snapshots += [self._snapshot(row, rgb)] * len(due)

    def pack(self, row: LogRow, rgb: np.ndarray, count: np.ndarray, facts: dict, identity: Mapping) -> bytes:
        """The content of the run's file, made by `pack_npz`; `row`, `rgb` and `count` are the final ones.

        Arrays of the file: `rows` (the rows as JSON text), `snapshot_s` float64 (6,), `snapshot_samples` int64 (6,),
        `errors` float16 (6, height, width): (x - r) / max(r, floor) of the luminance, `rgb` float16 (height, width, 3):
        the final image, `count` uint32 (height, width) and `facts` (JSON text). The JSON has Python's NaN and Infinity.
        """
        missing = SNAPSHOTS - len(self._snapshots)
        seconds, samples, errors = zip(*(self._snapshots + [self._snapshot(row, rgb)] * missing), strict=True)
        arrays = {
            "rows": np.array(json.dumps(self.rows)),
            "snapshot_s": np.array(seconds, np.float64),
            "snapshot_samples": np.array(samples, np.int64),
            "errors": np.stack(errors),
            "rgb": np.clip(rgb, -_MAX_HALF, _MAX_HALF).astype(np.float16),
            "count": np.asarray(count, np.uint32),
            "facts": np.array(json.dumps(facts)),
        }
        return pack_npz(arrays, identity)

    def _snapshot(self, row: LogRow, rgb: np.ndarray) -> tuple[float, int, np.ndarray]:
        return row.elapsed_s, row.samples, self._error(rgb).astype(np.float16)

    def _error(self, rgb: np.ndarray) -> np.ndarray:
        """(x - r) / max(r, floor) of the luminance, limited to the range of float16."""
        difference = luminance(rgb) - self._luminance
        # a black reference has no floor: any other value there counts as the largest error
        error = np.divide(
            difference,
            self._scale,
            out=np.copysign(_MAX_HALF, difference) * (difference != 0),
            where=self._scale > 0,
        )
        return np.clip(error, -_MAX_HALF, _MAX_HALF)
