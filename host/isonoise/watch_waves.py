"""`isonoise.watch`: the waves of a renderer, one after the other, shown in a notebook or on a terminal meanwhile."""

import time
from collections.abc import Iterator

from isonoise.errors import UserError
from isonoise.progress import NotebookOutput, ProgressBar, format_duration, format_number, format_percent, in_notebook
from isonoise.renderer import Renderer
from isonoise.stops import Stops
from isonoise.strategies.measures import image_floor
from isonoise.wave import WaveRecord

PICTURE_INTERVAL_S = 1.0
"""Shortest time between two pictures."""
MAX_PICTURE_SHARE = 0.1
"""Share of the time that pictures may take: those of large images come less often."""


def watch(renderer: Renderer, spp: float | None = None) -> Iterator[WaveRecord]:
    """Iterate over the waves of a renderer as `for wave in renderer` does, and show them meanwhile.

    A notebook shows image, error map, sample map and a progress bar below the cell, a terminal the bar alone. Pictures
    follow at least a second apart and take at most a tenth of the time; the last one stays.

    Parameters
    ----------
    renderer : Renderer
        It may have rendered waves before.
    spp : float or None
        End at this mean number of samples per pixel, earlier waves included. None: when the caller stops.

    Yields
    ------
    WaveRecord : what `Renderer.step` returns

    Raises
    ------
    UserError : if `spp` is not a number above 0, or as for `Renderer.step`

    Examples
    --------
    >>> with isonoise.Renderer("cornell", size=(32, 32)) as renderer:
    ...     for wave in isonoise.watch(renderer, spp=24):
    ...         pass
    >>> wave.number, renderer.samples == 24 * 32 * 32
    (7, True)
    """
    limit = None
    if spp is not None:
        _ = Stops(spp=spp)  # checks it
        limit = max(1, round(spp * renderer.scene.width * renderer.scene.height))
    return _watch(renderer, limit)


def _watch(renderer: Renderer, limit: int | None) -> Iterator[WaveRecord]:
    with ProgressBar() as bar, _Picture() as picture:
        while not renderer.is_full and (limit is None or renderer.samples < limit):
            wave = renderer.step(None if limit is None else limit - renderer.samples)
            if bar.is_visible:
                bar.show(renderer.samples, limit, _describe(renderer, wave))
            picture.show(wave)
            yield wave


def _describe(renderer: Renderer, wave: WaveRecord) -> str:
    statistics = renderer.statistics()
    (error,) = renderer.error_distribution(image_floor(statistics.mean)).quantiles([0.99])
    spp = format_number(renderer.samples / statistics.count.size, 4)
    return (
        f"wave {wave.number} ({wave.kind}) in {format_duration(wave.seconds)}, {spp} samples per pixel, "
        f"error {format_percent(error)}"
    )


class _Picture:
    """The output of a notebook's cell with the pictures of the last wave; nothing elsewhere."""

    def __init__(self) -> None:
        self._output = NotebookOutput() if in_notebook() else None
        self._due_at = 0.0
        self._waiting: WaveRecord | None = None  # not shown yet

    def __enter__(self) -> "_Picture":
        return self

    def __exit__(self, *exception: object) -> None:
        if self._waiting is not None:
            self._draw(self._waiting)

    def show(self, wave: WaveRecord) -> None:
        """Show the wave now, or later if pictures would take too much time; the last one at the end."""
        if self._output is None:
            return
        self._waiting = wave
        if time.perf_counter() >= self._due_at:
            self._draw(wave)

    def _draw(self, wave: WaveRecord) -> None:
        assert self._output is not None  # otherwise no wave is waiting
        start = time.perf_counter()
        try:
            self._output.show(wave._repr_html_(), repr(wave))
        except UserError:  # the renderer is closed, or the device lost
            return
        self._waiting = None
        end = time.perf_counter()
        self._due_at = end + max(PICTURE_INTERVAL_S, (end - start) / MAX_PICTURE_SHARE)
