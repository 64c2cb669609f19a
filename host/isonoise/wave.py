"""A wave: the one in progress, and the record of one that has ended. Made by `Renderer`."""

import functools
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from isonoise.errors import UserError
from isonoise.progress import format_count, format_duration, format_number
from isonoise.statistics import Statistics


@dataclass(frozen=True)
class WaveRecord:
    """What one call of `Renderer.step` did.

    Attributes
    ----------
    kind : str
        'uniform' or 'adaptive'.
    samples : int
        Samples traced, rejected ones included.
    planned : int
        Samples in the allocation map; more than `samples` if the wave was stopped early.
    seconds : float
        Wall-clock time of the call.
    workers : int
        Devices, or processes of a cluster, that traced samples of it.
    number : int
        Of the wave in its render, from 1.

    Notebooks show image, error map and sample map.

    Examples
    --------
    >>> with isonoise.Renderer("cornell", size=(32, 32), strategy="uniform:wave_spp=8") as renderer:
    ...     for wave in renderer:
    ...         if wave.statistics.count.min() >= 24:
    ...             break
    >>> wave.number, wave.kind, wave.samples
    (3, 'uniform', 8192)
    """

    kind: Literal["uniform", "adaptive"]
    samples: int
    planned: int
    seconds: float
    workers: int = 1
    number: int = 1
    _read: Callable[[], Statistics] | None = field(default=None, repr=False, compare=False)

    @functools.cached_property
    def statistics(self) -> Statistics:
        """The statistics of all samples of the render after this wave; read when they are first asked for.

        Raises UserError if the renderer has gone on, or is closed, and they were not read before.
        """
        if self._read is None:
            raise UserError("this record of a wave has no statistics: it was not made by a Renderer")
        return self._read()

    def _repr_html_(self) -> str:
        from isonoise.notebook.figures import page  # only notebooks call this
        from isonoise.notebook.render_html import render_html
        from isonoise.strategies.measures import image_floor

        facts = f"wave {self.number}, {self.kind}: {format_count(self.samples)} samples"
        facts += f" in {format_duration(self.seconds)}"
        try:
            statistics = self.statistics
        except UserError:
            return page(f"{facts}; its statistics were not read before the renderer went on", [])
        spp = format_number(statistics.samples / statistics.count.size, 4)
        return render_html(f"{facts}; {spp} samples per pixel so far", statistics, image_floor(statistics.mean))


@dataclass
class WaveInProgress:
    """A wave that has begun and has not ended. A checkpoint stores all of it."""

    kind: Literal["uniform", "adaptive"]
    remaining: np.ndarray  # samples per pixel that are left to trace
    planned: int
    traced: int = 0
    seconds: float = 0.0


WAVE_VALUES = ("kind", "planned", "traced", "seconds")
"""Members of `WaveInProgress` that are no arrays."""
