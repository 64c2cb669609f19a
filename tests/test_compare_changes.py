"""A comparison that goes on with other code, another driver or another version: noticed, refused or rendered again."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from compare_command import compare, options, run_files, write_flat_reference

from isonoise.comparison import strategy_code
from isonoise.comparison.environment import ENVIRONMENT_FILE, program_version
from isonoise.comparison.plan import read_plan, write_plan
from isonoise.comparison.plan_changes import differences
from isonoise.comparison.strategy_code import code_of
from isonoise.errors import UserError
from isonoise.input_files import read_json

pytestmark = pytest.mark.usefixtures("in_tmp_path", "no_report")

STRATEGY = """
from {helper} import WARMUP
from isonoise.strategies.uniform import Uniform

class Mine(Uniform):
    name = "mine"

    def __init__(self):
        super().__init__(warmup=WARMUP)
"""


@pytest.fixture
def no_report(monkeypatch):
    """Plots take most of the time of a small comparison."""
    monkeypatch.setattr("isonoise.commands.compare._report", lambda directory: {})


@pytest.fixture
def own_strategy(monkeypatch, tmp_path, request):
    """Spec of a strategy in a file of its own, which imports a second one; both are new modules for this process."""
    name = f"strategy_{abs(hash(request.node.name))}"
    Path(f"{name}_helper.py").write_text("WARMUP = 4\n")
    Path(f"{name}.py").write_text(STRATEGY.format(helper=f"{name}_helper"))
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(strategy_code, "_first_seen", {})
    yield f"{name}:Mine"
    for module in (name, f"{name}_helper"):
        sys.modules.pop(module, None)


def start_again(monkeypatch):
    """As if this process had not seen the files of strategies yet."""
    monkeypatch.setattr(strategy_code, "_first_seen", {})


def test_code_of_a_strategy_is_its_file_and_what_it_imports_from_its_folder(own_strategy, monkeypatch):
    module = own_strategy.partition(":")[0]
    before = code_of(own_strategy)
    assert before.startswith(f"{module}.py, {module}_helper.py: sha256 ")
    assert code_of(f"{own_strategy}:sampler=independent") == before
    for path in (Path(f"{module}_helper.py"), Path(f"{module}.py")):
        text = path.read_text()
        path.write_text(text + "# edited\n")
        with pytest.raises(UserError, match="has been edited since this Python process imported it"):
            code_of(own_strategy)
        start_again(monkeypatch)
        assert code_of(own_strategy) != before
        path.write_text(text)
        start_again(monkeypatch)
        assert code_of(own_strategy) == before


def test_strategies_of_isonoise_have_no_code_of_their_own():
    assert [code_of(spec) for spec in ("uniform", "pooled:warmup=8,sampler=independent", "oracle")] == [None] * 3


def test_the_version_changes_with_the_source_files(monkeypatch, tmp_path):
    package, kernels = tmp_path / "isonoise", tmp_path / "kernels"
    for path in (package / "renderer.py", package / "commands" / "compare.py", kernels / "path" / "shade.cl"):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("")
    monkeypatch.setattr("isonoise.__file__", str(package / "__init__.py"))
    monkeypatch.setattr("isonoise.comparison.environment.resources.files", lambda _: kernels)
    versions = [program_version.__wrapped__()]
    for path in ("isonoise/commands/compare.py", "isonoise/renderer.py", "kernels/path/shade.cl"):
        (tmp_path / path).write_text("edited")
        versions.append(program_version.__wrapped__())
    assert versions[0] == versions[1]  # the command does not take part in a render
    assert len(set(versions)) == 3


def test_an_edited_strategy_is_refused_or_rendered_again(own_strategy, monkeypatch, capsys):
    write_flat_reference("a.exr")
    arguments = (*options("out", ("uniform", own_strategy), 1, 4), "--reference", "a.exr")
    assert compare(*arguments) == 0
    before = {name: path.stat().st_mtime_ns for name, path in run_files("out").items()}
    plan = Path("out/plan.json").read_bytes()
    assert len(read_json(Path("out") / ENVIRONMENT_FILE)) == 1

    path = Path(own_strategy.partition(":")[0] + ".py")
    path.write_text(path.read_text() + "# edited\n")
    start_again(monkeypatch)
    capsys.readouterr()
    assert compare(*arguments) == 2
    err = capsys.readouterr().err
    assert f"the code of the strategy '{own_strategy}' was {path.name}" in err
    assert "--rerun-changed" in err
    assert Path("out/plan.json").read_bytes() == plan
    assert {name: path.stat().st_mtime_ns for name, path in run_files("out").items()} == before

    assert compare(*arguments, "--rerun-changed") == 0
    assert "the code of its strategy was another one" in capsys.readouterr().err
    after = {name: path.stat().st_mtime_ns for name, path in run_files("out").items()}
    assert [name for name in after if after[name] != before[name]] == [name for name in before if "Mine" in name]
    assert compare(*arguments) == 0  # nothing is left to be rendered again
    assert {name: path.stat().st_mtime_ns for name, path in run_files("out").items()} == after


@pytest.mark.parametrize(
    ("name", "message"),
    [("device_identity", "device was"), ("program_version", "isonoise was")],
)
def test_another_driver_or_version_is_refused(name, message, monkeypatch, capsys):
    write_flat_reference("a.exr")
    arguments = (*options("out", ("uniform",), 1, 4), "--reference", "a.exr")
    assert compare(*arguments) == 0
    monkeypatch.setattr(f"isonoise.comparison.planning.{name}", lambda *_: "another one")
    capsys.readouterr()
    assert compare(*arguments) == 2
    err = capsys.readouterr().err
    assert message in err
    assert "is another one. Restore it, or give --rerun-changed" in err


def test_an_edited_scene_or_reference_is_a_change_and_another_size_a_setting():
    write_flat_reference("a.exr")
    assert compare(*options("out", ("uniform",), 1, 4), "--reference", "a.exr") == 0
    plan = read_plan(Path("out"))
    (scene,) = plan.scenes
    edited = replace(plan, scenes=(replace(scene, hash="", reference_sha256=""),))
    assert differences(plan, edited).changes == [
        "the scene 'cornell' has been edited",
        f"the reference '{scene.reference}' has been edited",
    ]
    assert differences(plan, edited).settings == []
    larger = differences(plan, replace(plan, scenes=(replace(scene, hash="", width=32, size=(32, 12)),)))
    assert (larger.settings, larger.changes) == (["size of 'cornell' was 16x12 and is 32x12"], [])
    write_plan(Path("out"), plan)
    assert read_plan(Path("out")) == plan


SCRIPT = """
from isonoise.comparison.strategy_code import code_of
from isonoise.strategies.uniform import Uniform

WARMUP = 4

def warmup():
    return WARMUP

class Mine(Uniform):
    name = "mine"

    def __init__(self):
        super().__init__(warmup=warmup())

print(code_of("__main__:Mine"))
"""


def test_code_of_a_script_is_the_class_and_what_it_uses():
    """The rest of a script may change."""

    def code(text):
        Path("script.py").write_text(text)
        done = subprocess.run([sys.executable, "script.py"], capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        return done.stdout

    first = code(SCRIPT)
    assert first.startswith("Mine, WARMUP, warmup: sha256 ")
    assert code(SCRIPT + "print()").strip() == first.strip()
    assert code(SCRIPT.replace("WARMUP = 4", "WARMUP = 8")) != first
    assert code(SCRIPT.replace("return WARMUP", "return WARMUP + 1")) != first


def test_the_code_of_a_measure_is_that_of_its_strategy(monkeypatch, tmp_path):
    Path("measure_of_this_test.py").write_text("def of(statistics, floor):\n    return statistics.mean\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    start_again(monkeypatch)
    assert code_of("adaptive:measure=measure_of_this_test:of").startswith("measure_of_this_test.py: sha256 ")
