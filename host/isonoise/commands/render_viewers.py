"""What shows a render while it runs, as the options of `isonoise render` ask for it."""

import argparse
from contextlib import ExitStack

from isonoise.loop import Periodic
from isonoise.outcome import Outcome


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
        if options.preview:
            from isonoise.live.tev import TevViewer

            self._add(TevViewer(f"isonoise {options.scene}", options.preview))

    def _add(self, viewer) -> None:
        self._stack.callback(viewer.close)
        self._viewers.append(viewer)

    def periodic(self) -> list[Periodic]:
        """What the viewers do during the render."""
        return [viewer.periodic() for viewer in self._viewers]

    def show(self, outcome: Outcome) -> None:
        """Show the finished render."""
        for viewer in self._viewers:
            viewer.show(outcome)

    def close(self) -> None:
        """End all connections."""
        self._stack.close()
