"""Signals during a command, in processes of their own."""

import signal
import subprocess
import sys
import time

import pytest

from isonoise.signals import deferred, exit_code, handle_signals, raise_if_received

pytestmark = [
    pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals"),
    pytest.mark.usefixtures("in_tmp_path"),
]

WAIT = """
import ctypes, time
from isonoise.signals import deferred, handle_signals
with handle_signals(), deferred() as received:
    print("ready", flush=True)
    if IN_LIBRARY:
        mutex, lock = ctypes.create_string_buffer(256), ctypes.CDLL(None).pthread_mutex_lock
        lock(mutex), lock(mutex)  # waits for ever, as for a device that does not answer
    time.sleep(20)
"""


def start(*command, number=signal.SIGINT, **options):
    """A process in which the signal is not ignored, although this one may ignore it."""
    handler = signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen([sys.executable, *command], preexec_fn=lambda: signal.signal(number, handler), **pipes)


@pytest.fixture
def default_interrupt():
    previous = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    assert signal.signal(signal.SIGINT, previous) == signal.default_int_handler


@pytest.mark.usefixtures("default_interrupt")
def test_a_lost_interrupt_is_raised_again():
    with handle_signals():
        raise_if_received()
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        with pytest.raises(KeyboardInterrupt):
            raise_if_received()
        assert exit_code() == 130
    with handle_signals():
        raise_if_received()
        assert exit_code() is None


@pytest.mark.usefixtures("default_interrupt")
def test_only_the_first_signal_raises():
    """Others may arrive while files are cleaned up; `timeout` sends each signal twice."""
    with handle_signals():
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGTERM)
        signal.raise_signal(signal.SIGINT)
        assert exit_code() == 130


@pytest.mark.usefixtures("default_interrupt")
def test_deferred_signals_are_recorded():
    with handle_signals(), deferred() as received:
        signal.raise_signal(signal.SIGTERM)
        signal.raise_signal(signal.SIGINT)
        raise_if_received()
        assert received == [signal.SIGTERM, signal.SIGINT]
        assert exit_code() == 143


def test_ignored_signals_stay_ignored():
    previous = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with handle_signals(), deferred() as received:
            signal.raise_signal(signal.SIGHUP)
            assert received == []
    finally:
        signal.signal(signal.SIGHUP, previous)


@pytest.mark.parametrize("in_library", [False, sys.platform == "linux"])
def test_a_second_interrupt_ends_the_process_at_once(in_library):
    """Also while it waits in a driver's function; but not if it follows the first one immediately."""
    process = start("-c", WAIT.replace("IN_LIBRARY", str(in_library)))
    assert process.stdout.readline() == "ready\n"
    process.send_signal(signal.SIGINT)
    time.sleep(0.02)
    process.send_signal(signal.SIGINT)
    time.sleep(0.3)
    assert process.poll() is None
    process.send_signal(signal.SIGINT)
    assert process.wait(timeout=5) == 130
