"""Signals that end a command: SIGINT (Ctrl-C), SIGTERM (batch systems) and SIGHUP (a closed terminal).

`__main__` handles them from the start, `run_command` if only `isonoise.cli.main` is called. The first signal raises
KeyboardInterrupt, or is only recorded within `deferred`. Compiled code may lose a KeyboardInterrupt, as in destructors
and callbacks, or abort the process. So large packages are imported within `deferred`, and `raise_if_received` is called
between the stages of set-up. A second SIGINT ends the process at once.
"""

import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

NAMES = ("SIGINT", "SIGTERM", "SIGHUP")
"""Windows has no SIGHUP."""
REPEAT_INTERVAL_S = 0.25
"""A SIGINT that follows sooner is the same one: `timeout` and some launchers send each signal twice."""
_SHOW_CURSOR = b"\x1b[?25h\n"
"""For terminals; progress bars hide the cursor."""

_handlers: dict[int, object] = {}
"""Signal -> the handler outside `handle_signals`."""
_received: list[int] = []
_raised: list[int] = []
"""The signals that raised KeyboardInterrupt."""
_deferrals: list[None] = []
"""One entry per active `deferred`."""


@contextmanager
def handle_signals() -> Iterator[None]:
    """Handle the signals during the `with` block; signals that are ignored, as SIGHUP under nohup, stay so.

    Nothing changes inside another such block, or outside the main thread, which alone may set handlers.
    """
    if _handlers:
        yield
        return
    with deferred():
        end_watch = _install_handlers()
        hook, sys.unraisablehook = sys.unraisablehook, _without_interrupts(sys.unraisablehook)
    try:
        yield
    finally:
        with deferred():
            sys.unraisablehook = hook
            end_watch()
            for number, handler in _handlers.items():
                signal.signal(number, handler)
            _handlers.clear()
            _received.clear()
            _raised.clear()


def _without_interrupts(hook: Callable) -> Callable:
    """A hook that prints no KeyboardInterrupt of a destructor: `raise_if_received` raises it again."""
    return lambda unraisable: None if issubclass(unraisable.exc_type, KeyboardInterrupt) else hook(unraisable)


def _install_handlers() -> Callable[[], None]:
    """Set the handlers and watch for a second SIGINT; return what ends the watch."""
    try:
        for number in (getattr(signal, name) for name in NAMES if hasattr(signal, name)):
            if signal.getsignal(number) not in (signal.SIG_IGN, None):
                _handlers[number] = signal.signal(number, _on_signal)
    except ValueError:  # not the main thread
        return lambda: None
    return _watch_repeated_interrupts()


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
        _raised.append(_received[0])
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


def _watch_repeated_interrupts() -> Callable[[], None]:
    """End the process at a second SIGINT, by a thread: the main thread handles none inside a driver's function.

    Returns what ends the thread.
    """
    if os.name != "posix":  # the interpreter writes to sockets only
        return lambda: None
    import threading

    read_end, write_end = os.pipe()
    os.set_blocking(write_end, False)
    previous = signal.set_wakeup_fd(write_end, warn_on_full_buffer=False)
    thread = threading.Thread(target=_end_at_second_interrupt, args=(read_end,), name="signals", daemon=True)
    thread.start()

    def end() -> None:
        signal.set_wakeup_fd(previous)
        os.close(write_end)  # ends the thread
        thread.join()
        os.close(read_end)

    return end


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
