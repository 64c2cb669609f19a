"""Typos on the command line are answered with the nearest name."""

import pytest

from isonoise.cli import main


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("rendr cornell", "(did you mean 'render'?)"),
        ("render cornell -o a.exr --strateyg uniform", "there is no option --strateyg (did you mean '--strategy'?)"),
        ("render cornell --outptu=a.exr", "there is no option --outptu (did you mean '--output'?)"),
        ("render cornell -o a.exr --sampler soboll", "(did you mean 'sobol'?)"),
        ("compare cornell --strategy x -o d", "there is no option --strategy (did you mean '--strategies'?)"),
        ("--versoin render cornell -o a.exr", "there is no option --versoin (did you mean '--version'?)"),
    ],
)
def test_typos(arguments, message, capsys):
    with pytest.raises(SystemExit) as ended:
        main(arguments.split())
    assert ended.value.code == 2
    last = capsys.readouterr().err.splitlines()[-1]
    assert last.endswith(message)
    assert last.count("there is no option") <= 1


def test_no_suggestion_without_a_typo(capsys):
    with pytest.raises(SystemExit):
        main(["render", "cornell", "-o", "a.exr", "--spp", "4", "more", "--size", "8x8"])
    last = capsys.readouterr().err.splitlines()[-1]
    assert last == "isonoise render: error: unrecognized arguments: more"
