"""Commands import only what they need: subprocesses print their modules when they end."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
import small_files

import isonoise

HEAVY = {"trimesh", "PIL", "matplotlib", "jinja2", "rich", "scipy", "mitsuba", "embreex", "dask", "distributed"} | {
    "aiohttp",
    "pyoidn",
}
SHARED = {
    f"isonoise.strategies.{name}"
    for name in (
        "base",
        "lookup",
        "measures",
        "planner",
        "parameters",
        "registry",
        "reset",
        "schedule",
        "uniform_allocation",
    )
}
"""Modules that all strategies use, and `measures` for the floor of the stated error."""
UNUSED = (
    *("benchmark", "comparison", "convert", "selftest", "integrator.feature_superset", "integrator.feature_costs"),
    *("distributed", "live", "notebook", "scene.formats", "scene.other_files", "scene.parameter_list", "scene.volume."),
    *("film.layers", "film.denoise"),
)
"""Beginnings of the names of modules that a render of `cornell` does not use."""
MAX_START_CPU_S = 1.0
"""CPU time up to the first program to be compiled: 0.55 s on the machine where this was written."""

PRINT_MODULES = """
import json, sys
from isonoise.cli import main
try:
    code = main(sys.argv[1:])
except SystemExit as exit_:
    code = exit_.code
print(json.dumps([code, sorted(sys.modules)]))
"""
WITHOUT_CHECK = """
import isonoise.integrator.set_up
isonoise.integrator.set_up.check_driver = lambda *_: None
"""
"""The driver is checked once only, which a render without a program cache cannot know."""
TIME_TO_COMPILER = """
import sys, time
from isonoise.device.opencl import Device

def build(self, text, options):
    print(time.process_time())
    raise SystemExit(0)

Device.build = build
from isonoise.cli import main
main(sys.argv[1:])
"""


def python(code: str, *arguments) -> str:
    """The last line that a Python process prints."""
    command = [sys.executable, "-c", code, *map(str, arguments)]
    environment = os.environ | {"PYTHONPATH": str(Path(isonoise.__file__).parents[1])}
    done = subprocess.run(command, capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()[-1]


def modules_after(*command, before: str = "") -> set[str]:
    """Modules at the end of a command in a process that first runs the code `before`."""
    code, modules = json.loads(python(before + PRINT_MODULES, *command))
    assert code == 0, command
    return set(modules)


def render(scene, *options, folder: Path) -> set[str]:
    command = ("render", scene, "--size", "8x6", "--spp", "1", "-o", folder / "image.exr", *options)
    return modules_after(*command, before=WITHOUT_CHECK)


def strategies(modules: set[str]) -> set[str]:
    return {name for name in modules if name.startswith("isonoise.strategies.")} - SHARED


def test_a_uniform_render_imports_nothing_of_other_renders(tmp_path):
    """No allocation rules, other strategies, formats, mesh readers, plots, benchmarks and self-tests."""
    modules = render("cornell", "--strategy", "uniform", folder=tmp_path)
    assert strategies(modules) == {"isonoise.strategies.uniform"}
    assert modules.isdisjoint(HEAVY)
    for package in UNUSED:
        assert not [name for name in modules if name.startswith(f"isonoise.{package}")], package
    assert {
        "isonoise.strategies.uniform_allocation",
        "numpy",
        "pyopencl",
        "OpenEXR",
    } <= modules  # otherwise names have changed


def test_an_adaptive_render_imports_only_its_own_strategy(tmp_path):
    modules = render("cornell", "--strategy", "relative-mean", folder=tmp_path)
    own = {f"isonoise.strategies.{name}" for name in ("adaptive", "allocation", "pieces", "water_filling")}
    assert strategies(modules) == own


@pytest.mark.parametrize(("kind", "imports"), [("ply", False), ("glb", False), ("stl", True)])
def test_trimesh_is_imported_for_its_formats_only(tmp_path, kind, imports):
    path = tmp_path / f"mesh.{kind}"
    path.write_bytes(small_files.ply() if kind == "ply" else small_files.from_trimesh(kind))
    assert ("trimesh" in modules_after("info", path)) == imports


@pytest.mark.parametrize("command", [("info", "cornell"), ("devices",), ("plugins",), ("--version",)])
def test_commands_without_plots_import_no_heavy_packages(command):
    assert modules_after(*command).isdisjoint(HEAVY)


def test_comparisons_import_plots_only_for_the_report():
    code = "import json, sys, isonoise.commands.compare, isonoise.comparison.runner; print(json.dumps([*sys.modules]))"
    modules = set(json.loads(python(code)))
    assert modules.isdisjoint({"matplotlib", "jinja2", "mitsuba", "dask", "distributed"})
    assert not [name for name in modules if name.startswith("isonoise.distributed")]


def test_a_render_starts_within_a_second(tmp_path):
    """CPU time of the fastest of three: other programs may keep the machine busy."""
    cpu_s = min(
        float(python(TIME_TO_COMPILER, "render", "cornell", "--spp", "1", "-o", tmp_path / "image.exr"))
        for _ in range(3)
    )
    assert cpu_s < MAX_START_CPU_S
