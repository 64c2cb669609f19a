"""Signals that end a command: SIGINT (Ctrl-C), SIGTERM (batch systems) and SIGHUP (a closed terminal).

`cli` handles them during a whole command. The first signal raises KeyboardInterrupt, or is only recorded within
`deferred`. Python drops a KeyboardInterrupt in destructors and callbacks of compiled code, so `raise_if_received` is
called between the stages of set-up. A second SIGINT ends the process at once.
"""

import os
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

NAMES = ("SIGINT", "SIGTERM", "SIGHUP")
"""Windows has no SIGHUP."""
REPEAT_INTERVAL_S = 0.25
"""A SIGINT that follows sooner is the same one: `timeout` and some launchers send each signal twice."""
_SHOW_CURSOR = b"\x1b[?25h\n"
"""For terminals; progress bars hide the cursor."""

_received: list[int] = []
_raised: list[int] = []
"""The signal that raised KeyboardInterrupt, if any."""
_deferrals: list[None] = []
"""One entry per active `deferred`."""


@contextmanager
def handle_signals() -> Iterator[None]:
    """Handle the signals during the `with` block; signals that are ignored, as SIGHUP under nohup, stay so.

    Outside the main thread, which alone may set handlers, nothing changes.
    """
    _received.clear()
    _raised.clear()
    previous = {}
    try:
        for number in (getattr(signal, name) for name in NAMES if hasattr(signal, name)):
            if signal.getsignal(number) not in (signal.SIG_IGN, None):
                previous[number] = signal.signal(number, _on_signal)
    except ValueError:  # not the main thread
        yield
        return
    try:
        with _watch_repeated_interrupts():
            yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


@contextmanager
def deferred() -> Iterator[list[int]]:
    """Signals raise nothing during the `with` block. Yields the list of all signals received since `handle_signals`."""
    _deferrals.append(None)
    try:
        yield _received
    finally:
        _deferrals.pop()


def raise_if_received() -> None:
    """Raise KeyboardInterrupt if a signal has been received, and its own KeyboardInterrupt may have been lost."""
    if _received and not _deferrals:
        raise KeyboardInterrupt


def exit_code() -> int | None:
    """128 + number of the first signal received, or None."""
    return 128 + _received[0] if _received else None


def interrupted_exit_code() -> int | None:
    """`exit_code` if the signal raised KeyboardInterrupt; None if none was received, or it was deferred."""
    return exit_code() if _raised else None


def _on_signal(number, frame) -> None:
    _received.append(number)
    if len(_received) == 1 and not _deferrals:
        _raised.append(number)
        raise KeyboardInterrupt
    if os.name != "posix" and number == signal.SIGINT and len(_received) > 1:
        os._exit(128 + number)


@contextmanager
def _watch_repeated_interrupts() -> Iterator[None]:
    """End the process at a second SIGINT, by a thread: the main thread handles none inside a driver's function."""
    if os.name != "posix":  # the interpreter writes to sockets only
        yield
        return
    import threading

    read_end, write_end = os.pipe()
    os.set_blocking(write_end, False)
    previous = signal.set_wakeup_fd(write_end, warn_on_full_buffer=False)
    thread = threading.Thread(target=_end_at_second_interrupt, args=(read_end,), name="signals", daemon=True)
    thread.start()
    try:
        yield
    finally:
        signal.set_wakeup_fd(previous)
        os.close(write_end)  # ends the thread
        thread.join()
        os.close(read_end)


def _end_at_second_interrupt(read_end: int) -> None:
    first_s = None
    while numbers := os.read(read_end, 64):  # one byte per signal
        if signal.SIGINT not in numbers:
            continue
        now_s = time.monotonic()
        if first_s is None:
            first_s = now_s
        elif now_s - first_s >= REPEAT_INTERVAL_S:
            if sys.__stderr__ is not None and sys.__stderr__.isatty():
                os.write(sys.__stderr__.fileno(), _SHOW_CURSOR)
            os._exit(128 + signal.SIGINT)
