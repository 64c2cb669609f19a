"""A finished render: image, statistics and log."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from isonoise.error.stated_error import relative_standard_error
from isonoise.film.log import LogRow
from isonoise.progress import format_duration, format_number, format_percent
from isonoise.statistics import Statistics
from isonoise.stops import Stops


@dataclass(frozen=True, repr=False)
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
    client_share : float or None
        Share of the time, from 0 to 1, in which this process did not wait for workers: its main thread computed maps,
        statistics and errors, or exchanged tasks. None on one device.
    stops : Stops or None
        The limits of the render.
    layers : mapping of str to array
        The layers that were asked for, by name: (height, width) float32, or (height, width, channels).

    Notebooks show image, error map, sample map, error curve and layers.
    """

    reason: str
    rows: list[LogRow]
    elapsed_s: float
    statistics: Statistics
    floor: float
    stated_error: float
    error_bound: float | None = None
    client_share: float | None = None
    stops: Stops | None = None
    layers: Mapping[str, np.ndarray] = field(default_factory=dict)

    @property
    def rgb(self) -> np.ndarray:
        """Mean linear RGB, (height, width, 3) float32."""
        return self.statistics.rgb

    @property
    def error(self) -> np.ndarray:
        """Relative standard error of every pixel's luminance, (height, width) float32."""
        return relative_standard_error(self.statistics, self.floor)

    def __repr__(self) -> str:
        return f"<isonoise.Outcome: {self._facts()}>"

    def _repr_html_(self) -> str:
        from isonoise.notebook.render_html import render_html  # only notebooks call this

        target = None if self.stops is None else self.stops.error
        return render_html(self._facts(), self.statistics, self.floor, self.rows, target, self.layers)

    def _facts(self) -> str:
        """Size, samples, time, error and reason in one line."""
        height, width = self.statistics.shape
        spp = format_number(self.statistics.samples / (width * height), 4)
        facts = f"{width}x{height} pixels, {spp} samples per pixel in {format_duration(self.elapsed_s)}"
        if self.stops is not None:
            facts += f"; stated error {format_percent(self.stated_error)} at quantile {self.stops.quantile:g}"
            facts += f"; ended by: {self.reason}"
        return facts
