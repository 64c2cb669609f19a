"""Standard output and error that never raise: a closed pipe, a full disk or a lost terminal costs no result.

`cli` puts them in place during a command and reports what could not be written.
"""

import contextlib
import errno
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager


class SafeStream:
    """Writes to a text stream until that fails; then it discards what is written.

    Parameters
    ----------
    stream : text stream or None
        None is a stream that was closed when the process started.

    Attributes
    ----------
    failure : OSError or None
        The first error.
    """

    def __init__(self, stream):
        self._stream = stream
        self.failure: OSError | None = None

    def write(self, text: str) -> int:
        if self._stream is None and self.failure is None:
            self.failure = OSError(errno.EBADF, "it is closed")
        if self.failure is None:
            with self._failing():
                self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        if self._stream is not None and self.failure is None:
            with self._failing():
                self._stream.flush()

    def isatty(self) -> bool:
        return self._stream is not None and self.failure is None and self._stream.isatty()

    def __getattr__(self, name: str):
        return getattr(self._stream, name)

    @contextmanager
    def _failing(self) -> Iterator[None]:
        try:
            yield
        except (OSError, ValueError) as error:  # ValueError: the stream has been closed
            self.failure = error if isinstance(error, OSError) else OSError(errno.EBADF, "it is closed")
            with contextlib.suppress(OSError, ValueError), open(os.devnull, "wb") as null:
                os.dup2(null.fileno(), self._stream.fileno())  # what is buffered must not fail again at exit


@contextmanager
def safe_streams() -> Iterator[SafeStream]:
    """Put a `SafeStream` in place of sys.stdout, which it yields, and one in place of sys.stderr."""
    _open_missing_descriptors()
    output, error = sys.stdout, sys.stderr
    with contextlib.suppress(AttributeError):  # no stream, or another kind
        output.reconfigure(errors="backslashreplace")  # as stderr has it: names of files may have any character
    sys.stdout, sys.stderr = SafeStream(output), SafeStream(error)
    try:
        yield sys.stdout
    finally:
        sys.stdout.flush()
        sys.stdout, sys.stderr = output, error


def _open_missing_descriptors() -> None:
    """Open the descriptors 0 to 2 if they are closed: else a file of ours gets the number, and a driver's messages."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest free number
