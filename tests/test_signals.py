"""Signals during a command, in processes of their own."""

import os
import random
import signal
import subprocess
import sys
import time
from collections import Counter

import pytest

from isonoise.device.program_cache import FOLDER_VARIABLE
from isonoise.film.exr import read_reference
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


TAKE_TERMINAL = "import fcntl, sys, termios; from isonoise.__main__ import main; fcntl.ioctl(0, termios.TIOCSCTTY, 0)"


def start(*command, number=signal.SIGINT, **options):
    """A process in which the signal is not ignored, although this one may ignore it."""
    handler = signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL
    options = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True} | options
    return subprocess.Popen([sys.executable, *command], preexec_fn=lambda: signal.signal(number, handler), **options)


@pytest.fixture
def default_interrupt():
    previous = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    assert signal.signal(signal.SIGINT, previous) == signal.default_int_handler


class Buffer:
    """Its destructor is interrupted."""

    def __del__(self):
        signal.raise_signal(signal.SIGINT)


@pytest.mark.usefixtures("default_interrupt")
def test_an_interrupt_in_a_destructor_is_raised_later(monkeypatch):
    printed = []
    monkeypatch.setattr(sys, "unraisablehook", printed.append)
    with handle_signals():
        Buffer()
        with pytest.raises(KeyboardInterrupt):
            raise_if_received()
    assert printed == []
    assert sys.unraisablehook == printed.append


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


def test_a_closed_terminal_keeps_the_image():
    """The terminal sends SIGHUP, and nothing can be printed any more."""
    master, terminal = os.openpty()
    options = {"stdin": terminal, "stdout": terminal, "stderr": terminal, "start_new_session": True}
    script = f"{TAKE_TERMINAL}; sys.exit(main())"
    render = ("render", "cornell", "--size", "64x48", "--time", "1000", "-o", "a.exr", "--log", "a.csv")
    process = start("-c", script, *render, number=signal.SIGHUP, **options)
    os.close(terminal)
    deadline = time.monotonic() + 60
    while not os.path.exists("a.csv"):
        assert process.poll() is None, os.read(master, 10_000)
        assert time.monotonic() < deadline
        time.sleep(0.02)
    os.close(master)
    assert process.wait(timeout=30) == 129
    assert read_reference("a.exr")[0].shape == (48, 64, 3)
    assert sorted(os.listdir()) == ["a.csv", "a.exr"]


def render_until(number: int, delay_s: float, environment: dict[str, str]) -> tuple[int, str]:
    """Start a render, send it a signal after a while; returns exit code and standard error."""
    command = ("-m", "isonoise", "render", "cornell", "--size", "64x48", "--time", "1000", "-o", "a.exr")
    process = start(*command, number=number, env=os.environ | environment)
    time.sleep(delay_s)
    process.send_signal(number)
    try:
        _, err = process.communicate(timeout=60)
    except subprocess.TimeoutExpired:
        process.kill()
        process.communicate()
        raise
    return process.returncode, err


@pytest.mark.long
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, getattr(signal, "SIGHUP", None)])
@pytest.mark.parametrize(("compiles", "tries", "max_delay_s"), [(False, 100, 1.0), (True, 15, 8.0)])
def test_no_signal_is_lost_during_set_up(number, compiles, tries, max_delay_s, tmp_path):
    """At random moments of a start with and without compiled kernels. What ends later has an image of all pixels.

    Before the first line of isonoise the interpreter itself ends by the signal, or with exit code 1 and a message.
    """
    delays = random.Random(number)
    codes = Counter()
    for attempt in range(tries):
        folders = {"POCL_CACHE_DIR": str(tmp_path / f"pocl-{attempt}"), FOLDER_VARIABLE: "off"} if compiles else {}
        code, err = render_until(number, delays.uniform(0, max_delay_s), folders)
        codes[code] += 1
        if code == 1:
            assert err.startswith("Fatal Python error: init_"), err
        else:
            assert code in (128 + number, -number), err
        if os.path.exists("a.exr"):
            assert code == 128 + number
            assert read_reference("a.exr")[0].shape == (48, 64, 3)
            os.unlink("a.exr")
        assert [name for name in os.listdir() if not name.startswith("pocl-")] == []
    assert codes[128 + number] > tries / 2
