"""The progress bar, and durations, counts and percentages as text."""

import io
import math
import sys
from types import SimpleNamespace

import pytest

from isonoise.progress import (
    RenderProgressBar,
    format_count,
    format_duration,
    format_number,
    format_percent,
    shorten_numbers,
)


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
    errors = (0.0198, 0.02, 0.000123, 1.234e-7, 2.5, 22.68, -0.4, 0.0, math.inf)
    assert [format_percent(error) for error in errors] == [
        "1.98 %", "2 %", "0.0123 %", "0.0000123 %", "250 %", "2,270 %", "-40 %", "0 %", "unknown",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("number", "digits", "text"),
    [(0.35, 3, "0.35"), (99.96, 3, "100"), (12345.6, 4, "12,350"), (1e15, 3, "1e+15"), (1e-12, 3, "1e-12")],
)
def test_numbers(number, digits, text):
    assert format_number(number, digits) == text


def test_long_fractions_in_a_text_are_rounded():
    text = "pooled:ratio=0.34999999999999998,cap=4,growth=0.2, floor 1.2345678912e-05"
    assert shorten_numbers(text) == "pooled:ratio=0.35,cap=4,growth=0.2, floor 0.0000123457"


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


def test_set_up_prints_the_settings_before_kernels_are_compiled(monkeypatch, capsys):
    """And shows the program that is compiled, on a terminal; what is printed does not end up in the bar."""
    from isonoise.cli import make_parser
    from isonoise.commands import render

    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "120")
    terminal = Terminal()
    monkeypatch.setattr("sys.stderr", terminal)
    monkeypatch.setattr(render, "print_settings", lambda options, renderer: print("scene", renderer))
    display = render._SetUpDisplay(make_parser().parse_args(["render", "a.glb", "-o", "a.exr"]))
    display.update("it", "", 0, 0)
    assert capsys.readouterr().out == "scene it\n"
    display.update("it", "shade", 1, 3)
    display.close()
    assert capsys.readouterr().out == ""
    assert "loading a.glb" in terminal.getvalue()
    assert "1 of 3 done: shade" in terminal.getvalue()


def test_a_notebook_shows_the_bar_until_its_end(notebook_outputs):
    shown = notebook_outputs
    with RenderProgressBar() as bar:
        bar.update(1.0, 2000, 0.05, 3.0)
        bar.update(2.0, 4000, 0.03, None)
    texts = [content["text/plain"] for content in shown[0]]
    assert texts == [
        "first samples",
        "1.00 s, 2 k samples, error 5 %, 3.00 s left",
        "2.00 s, 4 k samples, error 3 %",
        "",
    ]
    assert '<progress value="0.2500"' in shown[0][1]["text/html"]
    assert "<progress aria-label" in shown[0][2]["text/html"]  # the end is unknown


def test_descriptions_are_no_html(notebook_outputs):
    with RenderProgressBar("loading <b>.xml"):
        assert "loading &lt;b&gt;.xml" in notebook_outputs[0][0]["text/html"]


def test_nothing_is_shown_in_a_shell_of_ipython(notebook_outputs, monkeypatch):
    monkeypatch.setitem(sys.modules, "IPython", SimpleNamespace(get_ipython=lambda: SimpleNamespace()))
    with RenderProgressBar() as bar:
        bar.update(1.0, 2000, 0.05, 3.0)
    assert notebook_outputs == []
