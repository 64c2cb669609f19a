"""The code blocks of the documents, and a folder in which they run with small budgets.

A block runs as it stands, but for its budgets: images are small, renders take few samples. A block whose paragraph
before it names a file, as in "Save it as `name.py`:", is saved under this name. A block after the comment
`<!-- not run: REASON -->` is not run.
"""

import os
import re
import shlex
import socket
import subprocess
import sys
import time
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

import small_files

CHECKOUT = Path(__file__).resolve().parent.parent
PAGES = [
    *(CHECKOUT / name for name in ("README.md", "scenes/README.md")),
    *sorted((CHECKOUT / "host" / "docs").glob("*.md")),
]
"""Pages with examples. Those of host/README.md need clusters: test_cluster_examples.py. tests/README.md has tests."""
_INSTALLATION = "python3 -m venv"
"""Beginning of the blocks that .ci/run and test_package.py run."""
STAND_INS = ("pip", "apt")
"""Programs that do nothing here."""
TIMEOUT_S = 1800


@dataclass(frozen=True)
class Block:
    """A code block of a page."""

    page: str
    line: int
    language: str
    body: str
    file: str | None  # under which it is saved
    not_run: str | None  # why

    def __str__(self) -> str:
        return f"{self.page}:{self.line}"


def blocks(page: Path) -> list[Block]:
    """The blocks of a page, in order."""
    text = page.read_text("utf-8")
    found = []
    for match in re.finditer(r"^```(\w*)\n(.*?)^```", text, re.M | re.S):
        before = text[: match.start()].rstrip().rpartition("\n\n")[2]
        not_run = re.search(r"<!-- not run: (.+?) -->", before, re.S)
        named = re.search(r"[Ss]ave[^`]*`([\w./-]+\.\w+)`|[Ii]n\s+`([\w./-]+\.\w+)`:?$", before)
        found.append(
            Block(
                page=str(page.relative_to(CHECKOUT)),
                line=text[: match.start()].count("\n") + 1,
                language=match[1],
                body=match[2],
                file=named and (named[1] or named[2]),
                not_run=not_run and not_run[1],
            )
        )
    return found


def isonoise_commands(script: str) -> list[list[str]]:
    """The arguments of every `isonoise` in a shell script."""
    lines = script.replace("\\\n", " ").splitlines()
    words = [shlex.split(line.rstrip(" &"), comments=True) for line in lines]
    return [_first_command(line[line.index("isonoise") + 1 :]) for line in words if "isonoise" in line]


def _first_command(words: list[str]) -> list[str]:
    """The words up to a redirection, a pipe or the next command."""
    ends = [index for index, word in enumerate(words) if word in (">", "|", "&&", ";")]
    return words[: min(ends, default=len(words))]


_LARGEST = {"--spp": "1", "--time": "0.3", "--reference-time": "1", "--seeds": "2", "--repeat": "1"}
"""Option -> its value in place of the one in the documents."""


def with_small_budget(arguments: list[str]) -> list[str]:
    """The arguments of `isonoise` with less to do."""
    result, command = list(arguments), arguments[0] if arguments else ""
    for index, word in enumerate(result[:-1]):
        if (word, result[index + 1]) == ("--device", "0,1"):
            result[index + 1] = "0/2"  # there may be only one
        if word in _LARGEST and "," not in result[index + 1]:
            result[index + 1] = _LARGEST[word]
        elif word == "--size":
            result[index + 1] = "24x16"
    if command in ("render", "compare", "bench"):
        is_file = any(word.endswith(".toml") for word in result)
        result += [] if "--size" in result or is_file else ["--size", "24x16"]
        if not {"--spp", "--time"} & set(result):
            result += ["--spp", "1"] if command == "render" else ["--spp", "4,8"] if "equal-samples" in result else []
    return result


def make_folder(folder: Path) -> dict[str, str]:
    """Write what the examples read to a folder, programs to its subfolder `bin`; return their environment."""
    scene = files("isonoise.scenes").joinpath("cornell.xml").read_text("utf-8")
    (folder / "scenes" / "gallery").mkdir(parents=True)
    for name in ("scene", "cornell-box", "cbox-spheres", "veach-mis", "staircase2", "mesh-82k"):
        (folder / f"{name}.xml").write_text(scene, "utf-8")
    (folder / "bunny.ply").write_bytes(small_files.ply())
    (folder / "chair.stl").write_bytes(small_files.from_trimesh("stl"))
    (folder / "helmet.glb").write_bytes(small_files.from_trimesh("glb"))
    (folder / "studio.hdr").write_bytes(small_files.hdr())
    programs = folder / "bin"
    programs.mkdir()
    for name in STAND_INS:
        _write_program(programs / name, "#!/bin/sh\nexit 0\n")
    _write_program(programs / "isonoise", f"#!{sys.executable}\n{_RUN_COMMAND}")
    _write_program(programs / "tev", f"#!{sys.executable}\n{_TEV}")
    _write_program(programs / "python", f'#!/bin/sh\nexec {shlex.quote(sys.executable)} "$@"\n')
    return os.environ | {
        "HOME": str(folder),
        "PATH": f"{programs}{os.pathsep}{os.environ['PATH']}",
        "PYTHONPATH": os.pathsep.join([str(CHECKOUT / "host"), str(CHECKOUT / "tests")]),
    }


_RUN_COMMAND = """
import sys
from document_examples import wait_for_tev, with_small_budget
from isonoise.cli import main
if __name__ == "__main__":
    if "--preview" in sys.argv:
        wait_for_tev()
    code = main(with_small_budget(sys.argv[1:]))
    sys.exit(0 if code == 1 else code)  # 1: the error was not reached, with so few samples
"""
_TEV = """
import socket
with socket.create_server(("127.0.0.1", 14158)) as server:
    while True:
        connection, _ = server.accept()
        while connection.recv(1 << 20):
            pass
"""
SMALL_STOPS = """
import isonoise.stops as _stops
_check = _stops.Stops.__post_init__
def _small(self):
    _check(self)
    object.__setattr__(self, "spp", min(self.spp or 8, 8))
    object.__setattr__(self, "time", self.time and min(self.time, 0.5))
_stops.Stops.__post_init__ = _small
"""
"""Python code before the Python blocks of a page."""


def wait_for_tev() -> None:
    """Wait until the stand-in of tev, which a script has just started, listens."""
    for _ in range(100):
        with socket.socket() as connection:
            if connection.connect_ex(("127.0.0.1", 14158)) == 0:
                return
        time.sleep(0.1)


def _write_program(path: Path, text: str) -> None:
    path.write_text(text)
    path.chmod(0o755)


def run_page(page: Path, folder: Path) -> int:
    """Run the blocks of a page in an empty folder: shell blocks in their order, then the Python blocks as one script.

    Returns how many ran. Raises AssertionError with the output of what fails.
    """
    environment, python, number = make_folder(folder), [SMALL_STOPS], 0
    for block in blocks(page):
        if block.file:
            (folder / block.file).write_text(block.body, "utf-8")
        elif block.not_run or block.body.startswith(_INSTALLATION) or block.language not in ("sh", "python"):
            continue
        elif block.language == "python":
            python.append(f"# {block}\n{block.body}")
        else:
            _run(
                ["bash", "-e", "-c", f"trap 'kill $(jobs -p) 2> /dev/null || :' EXIT\n{block.body}"],
                folder,
                environment,
            )
        number += 1
    if len(python) > 1:
        _run([sys.executable, "-c", "\n".join(python)], folder, environment)
    return number


def _run(command: list[str], folder: Path, environment: dict[str, str]) -> None:
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=TIMEOUT_S)
    assert done.returncode == 0, f"{command[-1]}\n{done.stdout}\n{done.stderr}"
