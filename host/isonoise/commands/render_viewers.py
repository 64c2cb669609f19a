"""What shows a render while it runs, as the options of `isonoise render` ask for it."""

import argparse
import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from typing import TYPE_CHECKING

from isonoise.loop import Periodic, RenderLoop
from isonoise.outcome import Outcome

if TYPE_CHECKING:
    from isonoise.live.live_page import LivePage


class Viewers:
    """The viewers of a render. Their modules are imported only if an option asks for them.

    Parameters
    ----------
    options : Namespace
        Options of the command.

    Raises
    ------
    UserError
        If a viewer cannot be reached or set up.
    """

    def __init__(self, options: argparse.Namespace):
        self._viewers, self._stack = [], ExitStack()
        self._page: LivePage | None = None
        if options.preview:
            from isonoise.live.tev import TevViewer

            self._add(TevViewer(f"isonoise {options.scene}", options.preview))
        if options.serve is not None:
            from isonoise.live import serve

            self._page = self._add(serve(options.scene, options.serve, stops=options.exposure))
            print(f"isonoise: watch the render at {self._page.url}", file=sys.stderr, flush=True)

    @property
    def url(self) -> str | None:
        """Address of the live page, if there is one."""
        return self._page and self._page.url

    def _add(self, viewer):
        self._stack.callback(viewer.close)
        self._viewers.append(viewer)
        return viewer

    def periodic(self, save: Callable[[RenderLoop], Sequence[str]]) -> list[Periodic]:
        """What the viewers do during the render. `save` writes the files and returns their paths."""
        if self._page:
            self._page.save = save
        return [viewer.periodic() for viewer in self._viewers]

    def show(self, outcome: Outcome) -> None:
        """Show the finished render."""
        for viewer in self._viewers:
            viewer.show(outcome)

    def close(self) -> None:
        """End all connections."""
        self._stack.close()
