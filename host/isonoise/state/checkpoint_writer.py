"""Writes the checkpoints of a render in the background, so that the render goes on meanwhile."""

import contextlib
import os
import threading

from isonoise.errors import UserError
from isonoise.state.checkpoint import write_checkpoint
from isonoise.state.state import State

_NICENESS = 10
"""Of the thread, so that it takes the time in which the render leaves a core idle."""


class CheckpointWriter:
    """Writes states to one file, one after the other, in a thread.

    Parameters
    ----------
    path : path
        The file; the previous checkpoint stays until the next one is on the disk.
    """

    def __init__(self, path: str | os.PathLike):
        self.path = path
        self._thread: threading.Thread | None = None
        self._failure: UserError | None = None

    def begin(self, state: State) -> None:
        """Begin to write a state. Waits for the one before; raises UserError if that could not be written."""
        self.finish()
        self._thread = threading.Thread(target=self._write, args=(state,), name="checkpoint")
        self._thread.start()

    def finish(self) -> None:
        """Wait until the last state is on the disk. Raises UserError if it could not be written."""
        if self._thread is not None:
            self._thread.join()
            self._thread = None
        failure, self._failure = self._failure, None
        if failure is not None:
            raise failure

    def _write(self, state: State) -> None:
        with contextlib.suppress(AttributeError, OSError):  # on Linux: of this thread alone
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), _NICENESS)
        try:
            write_checkpoint(self.path, state)
        except UserError as error:
            self._failure = error
        except Exception as error:  # such as MemoryError: the render goes on
            self._failure = UserError(f"cannot write '{self.path}': {type(error).__name__}: {error}")
