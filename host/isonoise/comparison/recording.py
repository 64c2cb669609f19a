"""What a run leaves behind: a row a wave, images of the error at six moments, the samples of every pixel."""

import json
from pathlib import Path

import numpy as np

from isonoise.film.files import write_atomically
from isonoise.film.log import LogRow, row_values
from isonoise.loop import Stops
from isonoise.luminance import luminance
from isonoise.strategies.measures import image_floor

SNAPSHOTS = 6
"""The last is the final image, each earlier one is after half as much time, or samples, as the next."""

_LARGEST = float(np.finfo(np.float16).max)


class Recorder:
    """Collects a run, wave by wave.

    - `stops`: the run's budget, of time or samples per pixel.
    - `reference`: linear RGB (height, width, 3).

    `rows`: a dict a wave, the log's columns and `device_s`.
    """

    def __init__(self, stops: Stops, reference: np.ndarray):
        self._luminance = luminance(reference)
        self._scale = np.maximum(self._luminance, image_floor(self._luminance))
        self._by_time = stops.time is not None
        budget = stops.time if self._by_time else stops.spp * self._luminance.size
        self._moments = [budget * 2.0 ** (k + 1 - SNAPSHOTS) for k in range(SNAPSHOTS - 1)]
        self.rows: list[dict] = []
        self._snapshots: list[tuple[float, int, np.ndarray]] = []

    def wave(self, row: LogRow, rgb: np.ndarray, device_s: float | None) -> None:
        """Take the state after a wave: its row, the image so far, and how long the device has worked so far."""
        self.rows.append(row_values(row) | {"device_s": device_s})
        reached = row.elapsed_s if self._by_time else row.samples
        due = [moment for moment in self._moments if reached >= moment]
        if due:
            self._moments = self._moments[len(due) :]
            self._snapshots += [self._snapshot(row, rgb)] * len(due)

    def write(self, path: Path, row: LogRow, rgb: np.ndarray, count: np.ndarray, facts: dict) -> None:
        """Write the run, whole or not at all; `row`, `rgb` and `count` are the final ones.

        Arrays of the file: `rows` (JSON text: the rows), `snapshot_s`, `snapshot_samples` (6), `errors` float16
        (6, height, width): (x - r) / max(r, floor) of the luminance, `count` uint32 (height, width) and `facts` (JSON
        text). JSON has Python's NaN and Infinity. Raises UserError if it cannot be written.
        """
        missing = SNAPSHOTS - len(self._snapshots)
        seconds, samples, errors = zip(*(self._snapshots + [self._snapshot(row, rgb)] * missing), strict=True)
        arrays = {
            "rows": np.array(json.dumps(self.rows)),
            "snapshot_s": np.array(seconds, np.float64),
            "snapshot_samples": np.array(samples, np.int64),
            "errors": np.stack(errors),
            "count": np.asarray(count, np.uint32),
            "facts": np.array(json.dumps(facts)),
        }
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, lambda temporary: np.savez_compressed(temporary, **arrays))

    def _snapshot(self, row: LogRow, rgb: np.ndarray) -> tuple[float, int, np.ndarray]:
        off = luminance(rgb) - self._luminance
        # a black reference has no floor: what is not black there is as wrong as can be
        error = np.divide(off, self._scale, out=np.copysign(_LARGEST, off) * (off != 0), where=self._scale > 0)
        return row.elapsed_s, row.samples, np.clip(error, -_LARGEST, _LARGEST).astype(np.float16)
