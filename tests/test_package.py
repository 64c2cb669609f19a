"""The wheel: every tracked file that the program reads is in it, and it works away from the checkout."""

import os
import subprocess
import sys
import sysconfig
import venv
import zipfile
from pathlib import Path

import pytest

CHECKOUT = Path(__file__).resolve().parent.parent
SHIPPED = {"host/isonoise/": "isonoise/", "kernels/": "isonoise/kernels/", "scenes/": "isonoise/scenes/"}
"""Folders of the checkout whose files are shipped, and where they are in the wheel."""


def run(*command, cwd):
    environment = {key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "PYTHONHOME")}
    done = subprocess.run(list(map(str, command)), cwd=cwd, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    return done.stdout


@pytest.fixture(scope="module")
def tracked():
    """Paths of the tracked files that are there."""
    if not (CHECKOUT / ".git").exists():
        pytest.skip("not a git checkout: there is no list of tracked files to compare with")
    names = run("git", "ls-files", "-z", cwd=CHECKOUT).split("\0")
    return [name for name in names if name and (CHECKOUT / name).is_file()]


@pytest.fixture(scope="module")
def wheel(tracked, tmp_path_factory):
    """A wheel of the tracked files alone: neither an old build folder nor a file nobody added can end up in it."""
    pytest.importorskip("setuptools", minversion="77", reason="setuptools is in the extra 'test'")
    folder = tmp_path_factory.mktemp("wheel")
    for name in tracked:
        copy = folder / "source" / name
        copy.parent.mkdir(parents=True, exist_ok=True)
        copy.write_bytes((CHECKOUT / name).read_bytes())
    pip = (sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "--no-index")
    run(*pip, "--wheel-dir", folder, folder / "source", cwd=folder)
    (built,) = folder.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory):
    """Folder with the programs of a fresh environment that has the wheel, and the dependencies of this one."""
    folder = tmp_path_factory.mktemp("environment")
    venv.create(folder / "venv", with_pip=False, symlinks=os.name != "nt")
    programs = folder / "venv" / ("Scripts" if os.name == "nt" else "bin")
    pip = (
        sys.executable,
        "-m",
        "pip",
        "--python",
        programs / "python",
        "install",
        "--quiet",
        "--no-deps",
        "--no-index",
    )
    run(*pip, wheel, cwd=folder)
    # A line in a .pth file adds the folder alone: the hooks of an editable install that lie in it are not run.
    (site,) = (folder / "venv").rglob("site-packages")
    (site / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n" + sysconfig.get_path("platlib") + "\n")
    return programs


def test_everything_that_is_read_is_in_the_wheel(tracked, wheel):
    expected = set()
    for name in tracked:
        for folder, target in SHIPPED.items():
            if name.startswith(folder) and not name.endswith(".md") and not name.startswith("scenes/gallery/"):
                expected.add(target + name.removeprefix(folder))
    with zipfile.ZipFile(wheel) as archive:
        held = {name for name in archive.namelist() if ".dist-info/" not in name}
    assert held == expected
    assert {"isonoise/cli.py", "isonoise/scenes/cornell.xml", "isonoise/kernels/stages/shade.cl"} <= held


def test_the_wheel_works_outside_the_checkout(installed, tmp_path):
    assert run(installed / "isonoise", "--version", cwd=tmp_path).startswith("isonoise ")
    code = """
import importlib.resources, pathlib, sys, isonoise.cli
from isonoise.scene import compile_scene, load_description
assert len(compile_scene(load_description("cornell")).faces) > 0
kernels = importlib.resources.files("isonoise.kernels")
assert "kernel" in (kernels / "stages/shade.cl").read_text()
print(*(pathlib.Path(str(place)).resolve() for place in (isonoise.cli.__file__, kernels)), sep="\\n")
"""
    for place in run(installed / "python", "-c", code, cwd=tmp_path).split():
        assert Path(place).is_relative_to(installed.parent.resolve())


def test_a_render_outside_the_checkout(installed, tmp_path):
    options = ("--size", "8x8", "--spp", "4", "-o", "out.exr")
    run(installed / "python", "-m", "isonoise", "render", "cornell", *options, cwd=tmp_path)
    assert "isonoise.version" in run(installed / "isonoise", "info", "out.exr", cwd=tmp_path)
