"""What the thread that renders and the thread of the web server tell each other. Used by `LivePage` and `LiveServer`.

The server's thread leaves wishes: pause, stop, save, and which pictures somebody looks at. The thread that renders
publishes pictures and messages, and lets the server's thread read the progress of its loop.
"""

import math
import threading
import time
from collections.abc import Callable
from typing import NamedTuple

from isonoise.film.log import LogRow, row_values
from isonoise.live.layers import Picture
from isonoise.loop import Progress, RenderLoop
from isonoise.outcome import Outcome
from isonoise.strategies import describe

LOOK_S = 2.0
"""A picture is wanted for so long after the page has asked for it; the server asks again while the page waits."""
_ROW_FIELDS = ("elapsed_s", "spp", "stated_p50", "stated_p95", "stated_p99", "error_bound", "true_p99")


class View(NamedTuple):
    """A layer, and how many pixels of the image a pixel of its picture stands for in either direction."""

    layer: str
    reduction: int


class PageState:
    """The state of the live page of one render.

    Attributes
    ----------
    is_paused : bool
        Whether the render should pause.
    wants_save, wants_stop : bool
        Whether the files should be written, and whether the render should end.
    on_change : callable
        Called by the thread that renders when there is something new.
    server_cpu_s : float
        Seconds of CPU time that the server's thread has taken, without encoding pictures.
    """

    def __init__(self, title: str, stops: float):
        self.is_paused = self.wants_save = self.wants_stop = False
        self.on_change: Callable[[], None] = lambda: None
        self.server_cpu_s = 0.0
        self.has_ended = False
        self._title, self._stops = title, stops
        self._lock = threading.Lock()
        self._looks: dict[View, tuple[float, int]] = {}  # until when a view is wanted, and above which version
        self._pictures: dict[View, Picture] = {}
        self._encoding_s = 0.0  # of earlier pictures
        self._messages: list[str] = []
        self._rows: list[LogRow] = []
        self._settings: dict[str, object] | None = None
        self._progress: dict[str, object] = {}
        self._stands_still = False

    # The server's thread

    def look(self, view: View, after: int) -> None:
        """Somebody looks at this view, and has the picture with the version `after`; -1: none."""
        with self._lock:
            other = self._looks.get(view, (0.0, after))[1]
            self._looks[view] = time.monotonic() + LOOK_S, min(after, other)

    def picture(self, view: View, after: int) -> Picture | None:
        """The last picture of this view, if its version is above `after`."""
        picture = self._pictures.get(view)
        return picture if picture is not None and picture.version > after else None

    @property
    def name(self) -> str:
        """What the render does, as the page shows it."""
        if self.has_ended:
            return "ended"
        if self._settings is None:
            return "setting up"
        if self.wants_stop:
            return "stopping"
        if self.is_paused:
            return "paused" if self._stands_still else "pausing"
        return "rendering"

    def status(self) -> dict[str, object]:
        """The numbers of the page that change all the time."""
        return _without_nan({"state": self.name, "waves": len(self._rows)} | self._progress)

    def settings(self) -> dict[str, object] | None:
        """What the page has to know once; None while the scene is loaded."""
        return self._settings

    def rows(self, begin: int) -> list[dict[str, object]]:
        """The log from row `begin` on."""
        return [_without_nan(_row(row)) for row in self._rows[begin:]]

    def messages(self, begin: int) -> list[str]:
        """What has been said since message `begin`."""
        return self._messages[begin:]

    # The thread that renders

    def begin(self, loop: RenderLoop, can_save: bool) -> None:
        """The render begins. `can_save`: whether the page may ask to save."""
        scene, stops = loop.renderer.scene, loop.stops
        self._settings = {
            "title": self._title,
            "width": scene.width,
            "height": scene.height,
            "strategy": describe(loop.renderer.strategy),
            "device": loop.renderer.device_name,
            "spp": stops.spp,
            "time_s": stops.time,
            "error": stops.error,
            "quantile": stops.quantile,
            "stops": self._stops,
            "can_save": can_save,
        }
        self._rows = loop.rows

    def update(self, progress: Progress, wave_kind: str | None) -> None:
        """The render has come so far, and is in a wave of this kind or between waves."""
        self._progress = progress._asdict() | {"wave_kind": wave_kind}

    def stand_still(self, stands_still: bool) -> None:
        """The render is paused, or goes on."""
        self._stands_still = stands_still
        self.on_change()

    def wanted(self, samples: int) -> dict[View, bool]:
        """The views that somebody looks at, without a picture of so many samples; and whether they have none at all."""
        now = time.monotonic()
        with self._lock:
            self._looks = {view: look for view, look in self._looks.items() if look[0] > now}
            return {view: after < 0 for view, (_, after) in self._looks.items() if max(after, 0) < samples}

    @property
    def has_pictures(self) -> bool:
        """Whether somebody has looked at a picture."""
        return bool(self._pictures)

    def cpu_s(self) -> float:
        """Seconds of CPU time that the page has taken in other threads."""
        return self.server_cpu_s + self._encoding_s + sum(picture.cpu_s for picture in self._pictures.values())

    def publish(self, pictures: dict[View, Picture]) -> None:
        """These pictures take the place of all others."""
        with self._lock:
            for view in pictures:
                self._looks.pop(view, None)
        self._encoding_s += sum(picture.cpu_s for picture in self._pictures.values())
        self._pictures = pictures
        self.on_change()

    def say(self, message: str) -> None:
        """Show a message on the page."""
        self._messages.append(message)
        self.on_change()

    def end(self, outcome: Outcome | None) -> None:
        """The render has ended; without an outcome by an error."""
        self._progress |= {"reason": "failed", "remaining_s": None, "wave_kind": None}
        if outcome is not None:
            self._progress |= {
                "reason": outcome.reason,
                "elapsed_s": outcome.elapsed_s,
                "samples": outcome.statistics.samples,
                "stated_error": outcome.stated_error,
            }
            self._rows = outcome.rows
        self.has_ended = True
        self.on_change()


def _row(row: LogRow) -> dict[str, object]:
    values = row_values(row)
    return {name: values[name] for name in _ROW_FIELDS if name in values}


def _without_nan(values: dict[str, object]) -> dict[str, object]:
    """The values with None for what JSON does not have."""
    return {
        name: None if isinstance(value, float) and not math.isfinite(value) else value for name, value in values.items()
    }
