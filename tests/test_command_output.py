"""--json prints one JSON object and nothing else, --quiet nothing at all; messages are records of the logger."""

import argparse
import json
import logging
import math
import os
import sys

import pytest

from isonoise.cli import main, make_parser
from isonoise.command_output import command_output, logger, print_json, without_nan
from isonoise.progress import ProgressBar

pytestmark = pytest.mark.usefixtures("in_tmp_path")
SMALL = ("--size", "8x6")
RENDER = ("render", "cornell", *SMALL, "--spp", "2", "-o", "a.exr")


def commands() -> dict[str, argparse.ArgumentParser]:
    (action,) = (action for action in make_parser()._actions if isinstance(action, argparse._SubParsersAction))
    return action.choices


def test_every_command_has_both_options():
    for name, parser in commands().items():
        if name != "completion":  # whose output is a script
            assert {"--json", "--quiet", "-q"} <= set(parser._option_string_actions), name


@pytest.fixture(scope="module")
def rendered(tmp_path_factory):
    """A folder with an image and a checkpoint."""
    folder = tmp_path_factory.mktemp("rendered")
    before = os.getcwd()
    os.chdir(folder)
    try:
        assert main([*RENDER, "--checkpoint", "a.npz", "--quiet"]) == 0
    finally:
        os.chdir(before)
    return folder


COMMANDS = [
    ("devices",),
    ("plugins", "diffuse"),
    ("formats",),
    ("formats", "obj"),
    ("info", "cornell"),
    ("info", "{rendered}/a.exr"),
    ("info", "{rendered}/a.npz"),
    ("convert", "cornell", "out.xml"),
    ("merge", "{rendered}/a.npz", "-o", "merged.exr"),
    RENDER,
]


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: " ".join(command[:2]))
def test_json_and_quiet(command, rendered, capsys):
    command = [word.format(rendered=rendered) for word in command]
    assert main([*command, "--json"]) == 0
    out, err = capsys.readouterr()
    assert json.loads(out, parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))
    assert (out.count("\n"), err) == (1, "")
    assert main([*command, "--quiet"]) == 0
    assert capsys.readouterr() == ("", "")


def test_quiet_keeps_errors(capsys):
    assert main(["info", "missing.xml", "--quiet"]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert "missing.xml" in err


def test_json_has_no_nan(capsys):
    assert without_nan({"a": [math.nan, 1.0, (math.inf,)]}) == {"a": [None, 1.0, [None]]}
    print_json({"a": -math.inf})
    assert capsys.readouterr().out == '{"a": null}\n'


def test_messages_are_log_records(capsys, caplog):
    """Of the command in one line on standard error; of a program as it has configured them."""
    with command_output(argparse.Namespace()):
        logger.warning("a file is full")
        logging.getLogger("isonoise.live").error("no viewer")
    assert capsys.readouterr().err == "isonoise: warning: a file is full\nisonoise: no viewer\n"
    logger.warning("again")
    assert [record.getMessage() for record in caplog.records] == ["again"]


def test_quiet_hides_bars_only_during_the_command():
    with command_output(argparse.Namespace(quiet=True)):
        assert not ProgressBar.is_shown
        print("nobody reads this", file=sys.stdout)
    assert ProgressBar.is_shown


def test_bars_have_no_colours_with_no_color(monkeypatch):
    """As https://no-color.org says; rich reads the variable."""
    from rich.console import Console

    monkeypatch.setenv("NO_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm-256color")
    assert Console(stderr=True, force_terminal=True).no_color
