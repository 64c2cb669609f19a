"""The live page of a render: what the render loop does for it."""

import os
import time
from collections.abc import Callable, Sequence

import numpy as np

from isonoise.error.stated_error import relative_standard_error
from isonoise.live.budget import Budget
from isonoise.live.layers import LAYERS, Picture, encode_image, encode_map
from isonoise.live.page_state import PageState, View
from isonoise.live.server import LiveServer
from isonoise.loop import Periodic, RenderLoop
from isonoise.outcome import Outcome

PROGRESS_INTERVAL_S = 0.2
"""Shortest time between two updates of the numbers."""
PAUSE_POLL_S = 0.05
"""How often a paused render looks whether it goes on."""
IDLE_SHARE = {False: 0.1, True: 0.5}
"""Share of the device that is idle while the last paths finish before a picture; True: with several workers."""


class LivePage:
    """A page on loopback that shows a render while it runs, and can pause and end it. Made by `isonoise.live.serve`.

    Pictures are made only while somebody looks, and take half a percent of the time (`budget`).

    Parameters
    ----------
    title, port, save, stops
        As for `serve`.

    Attributes
    ----------
    save : callable or None
        As the parameter. May be set until the render begins.
    url : str
        Address of the page. Who knows it can see and end the render.

    Raises
    ------
    UserError
        If the port cannot be used.
    """

    def __init__(
        self,
        title: str = "isonoise",
        port: int = 0,
        save: Callable[[RenderLoop], Sequence[str]] | None = None,
        stops: float = 0.0,
    ):
        self.save = save
        self._state = PageState(title, stops)
        self._server = LiveServer(self._state, port)
        self.url = self._server.url
        self._budget = Budget()
        self._seconds = {True: 0.0, False: 0.0}  # that pictures took last, between waves (True) and within one
        self._server_cpu_s = 0.0
        self._loop: RenderLoop | None = None
        self._updated_at = 0.0
        self._cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        self._due_since: float | None = None  # when the wave began to stop for a picture

    def __enter__(self) -> "LivePage":
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def periodic(self) -> Periodic:
        """What shows the render while it runs: for `RenderLoop`."""
        return Periodic(0.0, self._act, self._is_wanted)

    def show(self, outcome: Outcome) -> None:
        """Show the finished render. Pages keep it when the server has ended."""
        if outcome.statistics.samples and self._state.has_pictures:
            views = [View(layer, 1) for layer in LAYERS]
            self._state.publish({view: _picture_of_outcome(outcome, view, self._exposure) for view in views})
        self._state.end(outcome)
        self._loop = None

    def close(self) -> None:
        """End the server, after open pages have taken the last picture."""
        if not self._state.has_ended:
            self._state.end(None)
        self._server.close()

    def _is_wanted(self) -> bool:
        """Whether the render has to stop for the page. Called some hundred times per second."""
        state, loop = self._state, self._loop
        if loop is None:
            return True
        if state.wants_stop:
            loop.stop()
            return False
        if state.is_paused or state.wants_save:
            return True
        now = time.perf_counter()
        if now - self._updated_at >= PROGRESS_INTERVAL_S:
            self._updated_at = now
            state.update(loop.progress(), loop.renderer.wave_kind)
        return self._is_picture_due(loop)

    def _is_picture_due(self, loop: RenderLoop) -> bool:
        renderer = loop.renderer
        wanted = self._state.wanted(renderer.samples)
        if not wanted:
            return False
        cpu_s = self._state.cpu_s()
        self._budget.spend((cpu_s - self._server_cpu_s) / self._cores)
        self._server_cpu_s = cpu_s
        if self._due_since is not None:
            return True  # the wave has stopped for it
        is_due = self._budget.allows(self._seconds[renderer.wave_kind is None], any(wanted.values()))
        if is_due:
            self._due_since = time.perf_counter()
        return is_due

    def _act(self, loop: RenderLoop) -> None:
        if self._loop is None:
            self._begin(loop)
            return
        progress = loop.progress()  # the clock stands still meanwhile
        self._state.update(progress, loop.renderer.wave_kind)
        self._do_once(loop)
        if self._state.is_paused:
            self._state.stand_still(True)
            while self._state.is_paused and not (self._state.wants_stop or loop.is_stopped):
                self._do_once(loop)
                time.sleep(PAUSE_POLL_S)
            self._state.stand_still(False)

    def _begin(self, loop: RenderLoop) -> None:
        self._loop, self._exposure = loop, loop.renderer.scene.exposure
        self._budget = Budget()
        self._state.begin(loop, self.save is not None)

    def _do_once(self, loop: RenderLoop) -> None:
        """Save, and make the pictures that are wanted."""
        if self._state.wants_save and self.save is not None:
            self._state.wants_save = False
            self._state.say(_saved(self.save(loop)))
        renderer = loop.renderer
        wanted = self._state.wanted(renderer.samples)
        if wanted:
            start = time.perf_counter()
            self._state.publish({view: self._picture(loop, view) for view in wanted})
            seconds = time.perf_counter() - start
            if renderer.wave_kind is not None and self._due_since is not None:
                seconds += IDLE_SHARE[renderer.waiting_s is not None] * (start - self._due_since)
            if not self._state.is_paused:
                self._seconds[renderer.wave_kind is None] = seconds
                self._budget.spend(seconds)
        self._due_since = None

    def _picture(self, loop: RenderLoop, view: View) -> Picture:
        if view.layer == "image":
            return _picture_of_image(loop.renderer.image(), loop.renderer.samples, view, self._exposure)
        return _picture_of_outcome(loop.outcome_so_far("unfinished"), view, self._exposure)


def _picture_of_image(rgb: np.ndarray, version: int, view: View, exposure: float | None) -> Picture:
    return Picture(version, lambda: encode_image(rgb, version, view.reduction, exposure))


def _picture_of_outcome(outcome: Outcome, view: View, exposure: float | None) -> Picture:
    statistics, floor = outcome.statistics, outcome.floor
    version = statistics.samples + int(statistics.rejected.sum(dtype=int))
    if view.layer == "image":
        return _picture_of_image(outcome.rgb, version, view, exposure)
    if view.layer == "samples":
        return Picture(version, lambda: encode_map(statistics.count, version, view.reduction))
    return Picture(version, lambda: encode_map(relative_standard_error(statistics, floor), version, view.reduction))


def _saved(paths: Sequence[str]) -> str:
    return f"Saved {', '.join(map(os.fspath, paths))}." if paths else "Nothing was saved."
