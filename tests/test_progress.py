"""The progress bar, and durations, counts and percentages as text."""

import io
import math

import pytest

from isonoise.progress import RenderProgressBar, format_count, format_duration, format_percent


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (0, "0.00 s"),
        (0.314, "0.31 s"),
        (9.996, "10.0 s"),
        (12.34, "12.3 s"),
        (59.96, "1:00"),
        (245, "4:05"),
        (3723, "1:02:03"),
    ],
)
def test_durations(seconds, text):
    assert format_duration(seconds) == text


@pytest.mark.parametrize(
    ("number", "text"),
    [(0, "0"), (999, "999"), (999.6, "1 k"), (1234567, "1.23 M"), (999_600, "1 M"), (4.56e10, "45.6 G"), (2e12, "2 T")],
)
def test_counts(number, text):
    assert format_count(number) == text


def test_percentages():
    assert [format_percent(error) for error in (0.0198, 0.000123, 2.5, math.inf)] == [
        "1.98 %",
        "0.0123 %",
        "250 %",
        "unknown",
    ]


def test_nothing_is_shown_without_a_terminal(capsys):
    with RenderProgressBar() as bar:
        bar.update(1.0, 1000, 0.5, 2.0)
    assert capsys.readouterr() == ("", "")


def test_the_bar_shows_time_samples_error_and_time_left(monkeypatch):
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "120")
    terminal = Terminal()
    monkeypatch.setattr("sys.stderr", terminal)
    with RenderProgressBar() as bar:
        bar.update(0.5, 1000, None, None)
        bar.update(12.0, 1234567, 0.0456, 68.0)
    shown = terminal.getvalue()
    assert "12.0 s, 1.23 M samples, error 4.56 %, 1:08 left" in shown
