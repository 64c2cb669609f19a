"""The tidy tables of a comparison: values, types, missing values, CSV and Parquet files in pandas and polars."""

import csv
import io
import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from simulated_comparison import SNAPSHOTS, make_comparison

from isonoise.comparison.plan import read_plan, write_plan
from isonoise.comparison.summary import summarise, write_summary
from isonoise.comparison.summary_table import summary_table
from isonoise.comparison.table_columns import DEFAULT_METRICS, METRICS, SCHEMA, SUMMARY_KEYS, checked_metrics
from isonoise.comparison.tidy_tables import arrow_table, csv_text, runs_table, waves_table, write_tables
from isonoise.errors import UserError

SCENES = ("bright", "dim")
STRATEGIES = {"uniform": np.ones_like, "relative-median": lambda v: v}
SEEDS = (1, 2, 3)
TABLES = {
    "runs": runs_table,
    "waves": waves_table,
    "summary": lambda directory: summary_table(directory, {"": summarise(directory)}),
}


def set_metrics(directory, names):
    write_plan(directory, replace(read_plan(directory), metrics=checked_metrics(names)))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Folder of a comparison with the columns of all metrics."""
    directory = make_comparison(tmp_path_factory.mktemp("tidy") / "out", SCENES, STRATEGIES, seeds=SEEDS)
    set_metrics(directory, METRICS)
    with pytest.MonkeyPatch.context() as monkeypatch:
        monkeypatch.setattr("isonoise.comparison.flip_values.flip", lambda image, _: float(image.mean()))
        write_summary(directory, summarise(directory))
    return directory


@pytest.fixture(scope="module")
def tables(folder):
    return {name: read(folder) for name, read in TABLES.items()}


@pytest.mark.parametrize("name", SCHEMA)
def test_columns_have_the_documented_names_and_types(tables, name):
    table = tables[name]
    assert list(table) == [column.name for column in SCHEMA[name]]
    for column in SCHEMA[name]:
        assert table[column.name].dtype.kind == {"string": "U", "int64": "i", "float64": "f"}[column.dtype]
        assert column.meaning
        assert bool(column.unit) == (column.dtype != "string")


def test_the_metrics_of_the_plan_choose_the_columns(tmp_path):
    directory = make_comparison(tmp_path / "out", ["a"], {"uniform": np.ones_like}, seeds=[1])
    every = {column.name for column in SCHEMA["waves"] if column.metric in ("", *DEFAULT_METRICS)}
    assert set(waves_table(directory)) == every
    set_metrics(directory, ["coverage", "mse"])
    for name in ("runs", "waves"):
        common = [column.name for column in SCHEMA[name] if not column.metric]
        assert sorted(TABLES[name](directory)) == sorted([*common, "true_mse", "true_coverage"])


def test_every_metric_has_columns():
    assert {column.metric for column in SCHEMA["runs"]} == {"", *METRICS}
    assert {column.metric for column in SCHEMA["waves"]} == {"", *DEFAULT_METRICS}


@pytest.mark.parametrize(
    ("names", "message"), [(["rel-mes"], "did you mean 'rel-mse'"), (["xyz"], "known are rel-mse"), ([], "no metric")]
)
def test_unknown_metrics_are_messages(names, message):
    with pytest.raises(UserError, match=message):
        checked_metrics(names)
    assert checked_metrics(["all"]) == tuple(METRICS)


def test_the_documents_have_every_column_and_metric():
    page = (Path(__file__).parent.parent / "host/docs/comparison-tables.md").read_text("utf-8").replace("\\|", "|")
    lines = page.splitlines()
    for name in ("runs", "waves"):
        for column in SCHEMA[name]:
            tables = ", ".join(f"`{other}`" for other in ("runs", "waves") if column in SCHEMA[other])
            assert f"`{name}`" in tables
            assert f"| `{column.name}` | {tables} | {column.dtype} | {column.unit} | {column.meaning} |" in lines
    for column in SCHEMA["summary"]:
        if not column.name.endswith(("_low", "_high")) and column not in SCHEMA["runs"]:
            interval = ", interval" if f"{column.name}_low" in SUMMARY_KEYS else ""
            assert f"| `{column.name}`{interval} | {column.dtype} | {column.unit} | {column.meaning} |" in lines
    for metric, meaning in METRICS.items():
        assert f"| `{metric}` | {meaning} |" in lines


def test_rows_are_the_runs_and_their_waves_in_the_order_of_the_plan(tables):
    keys = [(scene, strategy, seed) for scene in SCENES for strategy in STRATEGIES for seed in SEEDS]
    runs, waves = (tables[name] for name in ("runs", "waves"))
    assert list(zip(runs["scene"], runs["strategy"], runs["seed"], strict=True)) == keys
    expected = [(*key, wave) for key in keys for wave in range(1, SNAPSHOTS + 1)]
    assert list(zip(waves["scene"], waves["strategy"], waves["seed"], waves["wave"], strict=True)) == expected
    last = waves["wave"] == SNAPSHOTS
    for name in set(runs) & set(waves):
        np.testing.assert_array_equal(runs[name], waves[name][last])


def test_values_are_those_of_the_runs_files(folder, tables):
    runs, waves = tables["runs"], tables["waves"]
    with np.load(folder / "runs/dim/relative-median/2.npz") as file:
        rows = json.loads(str(file["rows"]))
    chosen = (waves["scene"] == "dim") & (waves["strategy"] == "relative-median") & (waves["seed"] == 2)
    for name in ("elapsed_s", "spp", "true_p99", "true_mse", "true_bias", "stated_p95", "device_s"):
        assert waves[name][chosen].tolist() == [row[name] for row in rows]
    ratio = [row["stated_p50"] / row["true_p50_corrected"] for row in rows]
    assert waves["stated_over_true_p50"][chosen].tolist() == ratio
    uniformity = [row["true_p99_corrected"] / row["true_p50_corrected"] for row in rows]
    assert waves["true_uniformity"][chosen].tolist() == uniformity
    assert set(runs["run_file"]) == {path.relative_to(folder).as_posix() for path in folder.glob("runs/*/*/*.npz")}
    assert set(runs["width"]) == {32}
    assert set(runs["height"]) == {24}
    assert np.isnan(runs["warm_up_spp"]).all()


def test_the_summary_is_that_of_the_report(folder, tables):
    summary, table = json.loads((folder / "summary.json").read_text()), tables["summary"]
    keys = [(scene["slug"], row["strategy"]) for scene in summary["scenes"] for row in scene["rows"]]
    assert list(zip(table["scene"], table["strategy"], strict=True)) == keys
    rows = [row for scene in summary["scenes"] for row in scene["rows"]]
    assert table["seeds"].tolist() == [len(SEEDS)] * len(keys)
    assert table["rms_p99_low"].tolist() == [row["rms_p99"]["low"] for row in rows]
    assert table["flip"].tolist() == [row["flip"]["value"] for row in rows]
    assert table["bias_z"].tolist() == [row["bias"]["z"] for row in rows]
    missing = {name for name, values in table.items() if values.dtype.kind == "f" and np.isnan(values).any()}
    assert missing == {"budget_spp", "warm_up_spp"}  # so the keys of all figures are right
    assert (table["rms_p99"] > table["rms_p50"]).all()


def test_mse_and_bias_of_simulated_errors(tmp_path):
    """Errors 0.1 + normal with variance V / n: the bias is 0.1, the MSE the mean of (0.1^2 + V / n) r^2."""
    folder = make_comparison(tmp_path / "out", ["a"], {"uniform": np.ones_like, "b": np.ones_like}, bias=0.1, spp=64)
    runs = runs_table(folder)
    biased = runs["strategy"] == "b"
    assert runs["true_bias"][biased].mean() == pytest.approx(0.1, abs=0.02)
    assert runs["true_bias"][~biased].mean() == pytest.approx(0, abs=0.02)
    excess = runs["true_mse"][biased].mean() - runs["true_mse"][~biased].mean()
    assert excess == pytest.approx(0.01 * 1.09, rel=0.3)  # E[r^2] of uniform(0.5, 1.5) is 1.083


def test_normal_errors_of_the_same_size_have_the_documented_uniformity(tmp_path):
    folder = make_comparison(tmp_path / "out", ["a"], {"b": lambda v: v}, shape=(60, 80), spp=10000)
    assert runs_table(folder)["true_uniformity"].mean() == pytest.approx(3.82, rel=0.05)


@pytest.mark.parametrize("name", SCHEMA)
def test_csv_files_have_all_digits_and_no_text_for_missing_values(folder, tables, name):
    rows = list(csv.DictReader(io.StringIO((folder / f"{name}.csv").read_text())))
    for column in SCHEMA[name]:
        texts = [row[column.name] for row in rows]
        if column.dtype == "float64":
            np.testing.assert_array_equal([float(text or "nan") for text in texts], tables[name][column.name])
            assert "nan" not in texts
        else:
            assert texts == [str(value) for value in tables[name][column.name]]


def test_infinite_values_stay_infinite():
    assert csv_text({"a": np.array([np.inf, np.nan, 0.1])}) == 'a\ninf\n""\n0.1\n'


@pytest.mark.parametrize("name", SCHEMA)
def test_pandas_reads_both_files_with_the_documented_types(folder, tables, name):
    pandas = pytest.importorskip("pandas")
    pytest.importorskip("pyarrow", reason="pyarrow is in the extra 'tables'")
    frames = pandas.read_parquet(folder / f"{name}.parquet"), pandas.read_csv(folder / f"{name}.csv")
    for column in SCHEMA[name]:
        expected = tables[name][column.name]
        for frame in frames:
            series = frame[column.name]
            if column.dtype == "string":
                assert pandas.api.types.is_string_dtype(series) or series.isna().all()
                assert ["" if pandas.isna(text) else text for text in series] == expected.tolist()
            else:
                assert series.dtype == column.dtype
                np.testing.assert_array_equal(series.to_numpy(), expected)


@pytest.mark.parametrize("name", SCHEMA)
def test_polars_reads_parquet_with_the_documented_types(folder, tables, name):
    polars = pytest.importorskip("polars")
    pytest.importorskip("pyarrow", reason="pyarrow is in the extra 'tables'")
    frame = polars.read_parquet(folder / f"{name}.parquet")
    types = {"string": polars.String, "int64": polars.Int64, "float64": polars.Float64}
    assert dict(frame.schema) == {column.name: types[column.dtype] for column in SCHEMA[name]}
    for column in SCHEMA[name]:
        found, expected = frame[column.name], tables[name][column.name]
        if column.dtype == "float64":
            assert found.null_count() == np.isnan(expected).sum()  # missing is null, not nan
            np.testing.assert_array_equal(found.fill_null(np.nan).to_numpy(), expected)
        else:
            assert found.to_list() == expected.tolist()


def test_parquet_fields_say_their_unit_and_meaning(folder):
    parquet = pytest.importorskip("pyarrow.parquet", reason="pyarrow is in the extra 'tables'")
    schema = parquet.read_schema(folder / "waves.parquet")
    metadata = schema.field("true_mse").metadata
    assert metadata[b"unit"] == b"radiance^2"
    assert metadata[b"meaning"] == b"mean over pixels and RGB of (x - r)^2"
    assert schema.metadata[b"isonoise.table"] == b"waves"


def test_settings_of_an_experiment_have_columns(tmp_path):
    """A number that only one strategy has, and a parameter of the scenes with values of several types."""
    directory = make_comparison(tmp_path / "out", SCENES, STRATEGIES, seeds=[1])
    plan = read_plan(directory)
    values = {"bright": [0.5, 1], "dim": "white"}
    scenes = tuple(replace(scene, settings={"box.bsdf": values[scene.slug]}) for scene in plan.scenes)
    uniform, median = plan.strategies
    write_plan(directory, replace(plan, scenes=scenes, strategies=(uniform, replace(median, settings={"warmup": 8}))))
    table = runs_table(directory)
    assert list(table)[-2:] == ["scene.box.bsdf", "strategy.warmup"]
    assert table["scene.box.bsdf"].tolist() == ["0.5,1", "0.5,1", "white", "white"]
    np.testing.assert_array_equal(table["strategy.warmup"], [np.nan, 8, np.nan, 8])
    assert waves_table(directory)["strategy.warmup"].size == 4 * SNAPSHOTS
    np.testing.assert_array_equal(TABLES["summary"](directory)["strategy.warmup"], [np.nan, 8, np.nan, 8])
    if "pyarrow" in sys.modules:
        schema = arrow_table("runs", table).schema
        assert [str(schema.field(name).type) for name in list(table)[-2:]] == ["string", "double"]
        assert schema.field("strategy.warmup").metadata[b"meaning"].startswith(b"the strategy's warmup")


def test_an_experiment_with_several_budgets_has_one_table(tmp_path):
    for seconds in (4, 16):
        folder = make_comparison(tmp_path / f"time-{seconds}", ["a"], STRATEGIES, seeds=[1, 2], seconds=seconds)
    table = runs_table(tmp_path)
    assert table["budget_s"].tolist() == [4] * 4 + [16] * 4
    assert np.isnan(table["budget_spp"]).all()
    last = runs_table(folder)
    for name in set(table) - {"run_file"}:
        np.testing.assert_array_equal(table[name][4:], last[name])
    assert all((tmp_path / name).is_file() for name in table["run_file"])
    write_tables(tmp_path)
    assert (tmp_path / "waves.csv").read_text() == csv_text(waves_table(tmp_path))


def test_a_folder_without_comparison_is_a_message(tmp_path):
    with pytest.raises(UserError, match="not the folder of a comparison"):
        runs_table(tmp_path)


def test_a_table_without_rows_keeps_its_types(tmp_path):
    folder = make_comparison(tmp_path / "out", ["a"], {"uniform": np.ones_like}, wanted=())
    for name, read in TABLES.items():
        table = read(folder)
        assert {column.size for column in table.values()} == {0}
        assert table["budget_s"].dtype == np.float64
        assert csv_text(table).count("\n") == 1
        if "pyarrow" in sys.modules:
            assert str(arrow_table(name, table).schema.field("budget_s").type) == "double"


def test_parquet_files_of_earlier_runs_are_removed_without_pyarrow(tmp_path, monkeypatch):
    folder = make_comparison(tmp_path / "out", ["a"], {"uniform": np.ones_like})
    stale = folder / "runs.parquet"
    stale.touch()
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    write_tables(folder)
    assert not stale.exists()
    assert (folder / "runs.csv").exists()
