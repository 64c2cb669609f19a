"""`isonoise.compare`: scenes and strategies as objects, tables, resuming, bad arguments."""

import warnings
from pathlib import Path

import numpy as np
import pytest
from compare_command import HEIGHT, WIDTH, run_files, write_flat_reference

import isonoise
from isonoise.comparison.tidy_tables import runs_table
from isonoise.errors import UserError
from isonoise.strategies.uniform import Uniform

pytestmark = pytest.mark.usefixtures("in_tmp_path")

SMALL = {"spp": 4, "seeds": 1, "size": (WIDTH, HEIGHT)}


@pytest.fixture
def no_report(monkeypatch):
    monkeypatch.setattr("isonoise.comparison.report.write_report", lambda directory: {"scenes": [], "baseline": ""})


def test_scene_objects_are_compared_and_resumed(no_report):
    """Twice the radiance and a reference twice as bright: the MSE is 4 times as large."""
    rgb = write_flat_reference("a.exr")
    isonoise.film.exr.write_exr("b.exr", {"": 2 * rgb}, {})
    bright = isonoise.load("cornell")
    bright["lamp.emitter.radiance"] = [2 * value for value in bright["lamp.emitter.radiance"]]
    scenes, lines = {"a": "cornell", "b": bright}, []
    arguments = {**SMALL, "references": {"a": "a.exr", "b": "b.exr"}, "output": "out", "log": lines.append}
    result = isonoise.compare(scenes, ["uniform", Uniform(warmup=2)], **arguments)
    assert len(lines) == 4
    assert result.runs["scene"].tolist() == ["a", "a", "b", "b"]
    assert "warmup=2" in result.runs["spec"].tolist()[1]
    error = result.runs["true_mse"].reshape(2, 2)
    np.testing.assert_allclose(error[1], 4 * error[0], rtol=1e-5)
    assert bright["film.size"] != (WIDTH, HEIGHT)  # the caller's scene is as it was
    before = {path: path.stat().st_mtime_ns for path in run_files("out").values()}

    again = isonoise.compare(scenes, ["uniform", Uniform(warmup=2)], **arguments)
    assert again.runs["true_mse"].tolist() == result.runs["true_mse"].tolist()
    assert {path: path.stat().st_mtime_ns for path in run_files("out").values()} == before
    bright["lamp.emitter.radiance"] = 1.0
    with pytest.raises(UserError, match="the scene 'b' has been edited"):
        isonoise.compare(scenes, ["uniform", Uniform(warmup=2)], **arguments)


def test_results_without_a_folder_are_tables():
    write_flat_reference("a.exr")
    result = isonoise.compare("cornell", "uniform", **{**SMALL, "spp": [2, 4]}, references=["a.exr"])
    assert result.directory is None
    assert result.runs["budget_spp"].tolist() == [2, 4]
    assert sorted(result.summary["folder"].tolist()) == ["spp-2", "spp-4"]
    assert result.waves.row_count >= 2
    assert [column.name for column in result.summary.columns] == list(result.summary)
    frame = result.runs.to_pandas()
    assert frame["true_rel_mse"].tolist() == result.runs["true_rel_mse"].tolist()
    arrow = result.summary.to_arrow()
    assert arrow.column("rel_mse").to_pylist() == result.summary["rel_mse"].tolist()
    assert arrow.schema.field("elapsed_s").metadata[b"unit"] == b"s"
    assert result.runs.to_csv().splitlines()[0] == ",".join(result.runs)
    for text in (repr(result.summary), result._repr_html_()):
        assert "cornell" in text
        assert "spp-4" in text


def test_a_table_shows_its_first_rows_and_escapes_text():
    from isonoise.comparison.result_table import MAX_SHOWN_ROWS, ResultTable
    from isonoise.comparison.table_columns import TableColumn

    names = np.array([f"<{number}>" for number in range(MAX_SHOWN_ROWS + 5)])
    table = ResultTable("runs", {"name": names}, [TableColumn("name", "string", "", 'a "name"')])
    shown = table._repr_html_()
    assert "&lt;0&gt;" in shown
    assert f"&lt;{MAX_SHOWN_ROWS}&gt;" not in shown
    assert "a &quot;name&quot;" in shown
    assert f"{MAX_SHOWN_ROWS + 5} rows, the first {MAX_SHOWN_ROWS} shown" in shown


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"spp": None}, "there is no budget"),
        ({"sead": 1}, "there is no argument 'sead' (did you mean 'seeds'?)"),
        ({"spp": "8"}, "spp has to be a number above 0, not '8'"),
        ({"time": 1}, "time and spp are both given"),
        ({"seeds": 0}, "seeds = 0 is out of range"),
        ({"seeds": [-1]}, "seeds = -1 is out of range"),
        ({"size": (0, 3)}, "size"),
        ({"max_depth": 0.5}, "max_depth"),
        ({"strategies": [Uniform]}, "neither a strategy's name nor an object"),
        ({"strategies": "unifrm"}, "did you mean 'uniform'"),
        ({"strategies": ()}, "name a strategy"),
        ({"scenes": "corneli"}, "no such file or built-in scene"),
        ({"scenes": 3}, "3 is no scene"),
        ({"references": {"penumbra": "a.exr"}}, "references has 'penumbra'"),
        ({"metrics": ["flop"]}, "no metric 'flop'"),
        ({"keep_images": 1}, "keep_images"),
        ({"scenes": "e.toml"}, "strategies is a key of an experiment's file"),
    ],
)
def test_wrong_arguments_are_a_message(changes, message):
    arguments = {"scenes": "cornell", "strategies": "uniform", **SMALL, **changes}
    with pytest.raises(UserError) as raised:
        isonoise.compare(**arguments)
    assert message in str(raised.value)


def test_an_experiment_runs_from_python(no_report):
    write_flat_reference("a.exr")
    Path("e.toml").write_text(
        'strategies = ["uniform"]\nspp = 4\nseeds = 1\nsize = [16, 12]\n'
        'scenes = [{ source = "cornell", reference = "a.exr", set = { "lamp.emitter.radiance" = 3.5 } }]'
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        result = isonoise.compare("e.toml", output="out")
    assert result.runs["scene.lamp.emitter.radiance"].tolist() == [3.5]
    assert runs_table("out")["true_p99"].tolist() == result.runs["true_p99"].tolist()
    assert Path("out/experiment.toml").exists()
