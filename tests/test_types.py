"""Types of the public names, as checkers see them."""

import subprocess
import sys
from pathlib import Path

import pytest

CHECKOUT = Path(__file__).resolve().parent.parent
WRONG_USES = """
import isonoise

isonoise.render("cornell", spp="8")
isonoise.render("cornell", stratgy="uniform")
isonoise.Renderer("cornell", size=8)
isonoise.rendr("cornell")
isonoise.load("cornell").compile(samples=3)
"""


def mypy(*arguments: object) -> tuple[int, str]:
    """Exit code and output of mypy with the settings of pyproject.toml."""
    pytest.importorskip("mypy", reason="mypy is in the extra 'test'")
    command = [sys.executable, "-m", "mypy", "--cache-dir", "/dev/null", *map(str, arguments)]
    done = subprocess.run(command, cwd=CHECKOUT, capture_output=True, text=True)
    return done.returncode, done.stdout + done.stderr


@pytest.mark.long
def test_the_annotations_are_consistent():
    code, output = mypy()
    assert code == 0, output


@pytest.mark.long
def test_wrong_uses_are_found(tmp_path):
    """One error in each line that calls something."""
    (tmp_path / "wrong.py").write_text(WRONG_USES)
    code, output = mypy(tmp_path / "wrong.py")
    lines = {int(line.split(":")[1]) for line in output.splitlines() if ": error:" in line}
    assert code == 1
    assert lines == {4, 5, 6, 7, 8}, output
