"""The completion script of bash, in bash."""

import shlex
import shutil
import subprocess

import pytest

from isonoise.cli import SHELLS, main

pytest.importorskip("shtab", reason="no shtab")
ASK = """
complete() {{ [ "$1" = -p ] || builtin complete "$@"; }}
source {script}
COMP_WORDS=({words})
COMP_CWORD=$(({count} - 1))
_shtab_isonoise isonoise "${{COMP_WORDS[COMP_CWORD]}}" "${{COMP_WORDS[COMP_CWORD - 1]}}"
printf '%s\\n' "${{COMPREPLY[@]}}"
"""


@pytest.fixture(scope="module")
def script(tmp_path_factory):
    path = tmp_path_factory.mktemp("completion") / "isonoise.bash"
    with pytest.MonkeyPatch.context() as patch, open(path, "w") as file:
        patch.setattr("sys.stdout", file)
        assert main(["completion", "bash"]) == 0
    return path


@pytest.mark.skipif(not shutil.which("bash"), reason="no bash")
@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["isonoise", "ren"], {"render"}),
        (["isonoise", "render", "--strat"], {"--strategy"}),
        (["isonoise", "render", "cornell", "--sampler", ""], {"sobol", "independent"}),
        (["isonoise", "render", "sce"], {"scene.xml"}),
        (["isonoise", "merge", "sce"], {"scene.xml"}),
    ],
)
def test_bash(script, tmp_path, words, expected):
    (tmp_path / "scene.xml").touch()
    text = ASK.format(script=shlex.quote(str(script)), words=" ".join(map(shlex.quote, words)), count=len(words))
    done = subprocess.run(["bash"], input=text, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert set(done.stdout.split()) == expected, done.stderr


@pytest.mark.parametrize("shell", SHELLS)
def test_scripts_name_the_commands(shell, capsys):
    assert main(["completion", shell]) == 0
    assert "selftest" in capsys.readouterr().out


def test_without_shtab(monkeypatch, capsys):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert main(["completion", "bash"]) == 2
    assert "pip install 'isonoise[completion]'" in capsys.readouterr().err
