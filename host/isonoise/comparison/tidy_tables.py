"""The tidy tables of a comparison, one row per run (`runs`) or per run and wave (`waves`); tables as files.

`summary` writes them to the folder of a comparison, `series` to that of an experiment with several; `runs_table` and
`waves_table` read them from the finished runs. `table_columns` documents every column.
"""

import csv
import io
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from isonoise.comparison.checked_files import read_npz
from isonoise.comparison.flip_values import FlipValues
from isonoise.comparison.plan import PLAN_FILE, Plan, SceneEntry, StrategyEntry
from isonoise.comparison.request import text_of
from isonoise.comparison.results import Results, Run
from isonoise.comparison.table_columns import (
    SCENE_SETTING,
    SCHEMA,
    STRATEGY_SETTING,
    TableColumn,
    setting_column,
)
from isonoise.film.files import write_atomically

if TYPE_CHECKING:
    import pyarrow

SCHEMA_VERSION = 1
"""In the metadata of the Parquet files. Goes up when a column is removed or changes its meaning."""
_QUANTILES = ("p50", "p95", "p99")


def runs_table(directory: Path | str) -> dict[str, np.ndarray]:
    """A row per finished run of a comparison, in the order of its plan.

    Parameters
    ----------
    directory : path
        Folder of a comparison, or of an experiment that has several.

    Returns
    -------
    dict of str to 1-D array
        By name those of the columns `SCHEMA["runs"]` that the metrics of the plan choose, then a column for every
        parameter that the experiment sets: `setting_column`. Missing numbers are nan, missing texts empty.

    Raises
    ------
    UserError
        If the folder has no readable plan, or a reference cannot be read.
    """
    directory = Path(directory)
    comparisons = _comparisons(directory)
    rows = [run[-1] for results in comparisons for run in _runs(results, directory)]
    return _table("runs", rows, comparisons)


def waves_table(directory: Path | str) -> dict[str, np.ndarray]:
    """A row per wave of every finished run: the columns `SCHEMA["waves"]`, as `runs_table`."""
    directory = Path(directory)
    comparisons = _comparisons(directory)
    rows = [row for results in comparisons for run in _runs(results, directory) for row in run]
    return _table("waves", rows, comparisons)


def write_tables(directory: Path) -> None:
    """Write the tables `runs` and `waves` to the folder with `write_table`. Raises UserError as they do."""
    comparisons = _comparisons(directory)
    runs = [run for results in comparisons for run in _runs(results, directory)]
    write_table(directory, "runs", _table("runs", [run[-1] for run in runs], comparisons))
    write_table(directory, "waves", _table("waves", [row for run in runs for row in run], comparisons))


def write_table(directory: Path, name: str, table: Mapping[str, np.ndarray]) -> None:
    """Write NAME.csv and, if pyarrow is installed, NAME.parquet to the folder, each file atomically.

    Without pyarrow, a Parquet file of an earlier call is removed: it would not agree with the CSV file. Raises
    UserError if a file cannot be written.
    """
    text = csv_text(table)
    path = directory / f"{name}.csv"
    write_atomically(path, lambda file: file.write_text(text, encoding="utf-8", newline="\n"))
    path = directory / f"{name}.parquet"
    try:
        from pyarrow import parquet
    except ImportError:
        path.unlink(missing_ok=True)
        return
    write_atomically(path, lambda file: parquet.write_table(arrow_table(name, table), file))


def csv_text(table: Mapping[str, np.ndarray]) -> str:
    """A table as CSV: numbers with all their digits, missing ones empty, inf as `inf`."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(table)
    writer.writerows(zip(*(map(_csv_field, column.tolist()) for column in table.values()), strict=True))
    return text.getvalue()


def arrow_table(
    name: str, table: Mapping[str, np.ndarray], columns: Sequence[TableColumn] | None = None
) -> "pyarrow.Table":
    """A table for pyarrow; every field has `unit` and `meaning` as metadata. Missing numbers are null.

    `columns` describe those of the table; None: they are those of `SCHEMA`, of which `name` is a key. Needs pyarrow.
    """
    import pyarrow

    arrays, fields = [], []
    for column in columns or columns_of(name, table):
        arrow_type = pyarrow.type_for_alias(column.dtype)
        arrays.append(pyarrow.array(table[column.name].tolist(), arrow_type, from_pandas=True))
        metadata = {"unit": column.unit, "meaning": column.meaning}
        fields.append(pyarrow.field(column.name, arrow_type, metadata=metadata))
    about = {"isonoise.table": name, "isonoise.schema_version": str(SCHEMA_VERSION)}
    return pyarrow.Table.from_arrays(arrays, schema=pyarrow.schema(fields, metadata=about))


def columns_of(name: str, table: Mapping[str, np.ndarray]) -> list[TableColumn]:
    """The description of each column of the table `name`, in its order."""
    known = {column.name: column for column in SCHEMA[name]}
    return [known.get(key) or setting_column(key, values.dtype.kind == "f") for key, values in table.items()]


def _table(name: str, rows: Sequence[Mapping], comparisons: Sequence[Results]) -> dict[str, np.ndarray]:
    return table_of_rows(name, rows, [results.plan for results in comparisons])


def table_of_rows(name: str, rows: Sequence[Mapping], plans: Sequence[Plan]) -> dict[str, np.ndarray]:
    """The columns of the table `name`, from rows that are mappings, for the metrics and settings of the plans."""
    chosen = {"", *(metric for plan in plans for metric in plan.metrics)}
    columns = [column for column in SCHEMA[name] if column.metric in chosen] + _setting_columns(plans)
    return {column.name: _array(column, rows) for column in columns}


def _comparisons(directory: Path) -> list[Results]:
    """The comparison in the folder, or those of an experiment below it, by folder and budget."""
    if (directory / PLAN_FILE).is_file():
        return [Results(directory)]
    found = [Results(path.parent) for pattern in ("*", "*/*") for path in directory.glob(f"{pattern}/{PLAN_FILE}")]
    if not found:
        return [Results(directory)]  # raises the error
    return sorted(found, key=lambda each: (each.directory.parent, each.plan.time or 0, each.plan.spp or 0))


def _setting_columns(plans: Sequence[Plan]) -> list[TableColumn]:
    values: dict[str, list] = {}
    for plan in plans:
        for entry in (*plan.scenes, *plan.strategies):
            for key, value in _settings(entry).items():
                values.setdefault(key, []).append(value)
    return [setting_column(key, all(map(_is_number, found))) for key, found in values.items()]


def _settings(entry: SceneEntry | StrategyEntry) -> dict[str, object]:
    """The values of an experiment's settings by column."""
    prefix = SCENE_SETTING if isinstance(entry, SceneEntry) else STRATEGY_SETTING
    return {f"{prefix}{key}": value for key, value in entry.settings.items()}


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _array(column: TableColumn, rows: Sequence[Mapping]) -> np.ndarray:
    values = [row.get(column.name) for row in rows]
    if column.dtype == "string":
        return np.array(["" if value is None else text_of(value) for value in values], np.str_)
    if column.dtype == "float64":
        return np.array([math.nan if value is None else float(value) for value in values], np.float64)
    return np.array(values, column.dtype)


def _runs(results: Results, directory: Path) -> Iterator[list[dict]]:
    """For every finished run the rows of its waves, each with all columns of both tables."""
    strategies = {strategy.slug: strategy for strategy in results.plan.strategies}
    flip_values = FlipValues(results.directory)
    for scene in results.plan.scenes:
        for slug, runs in results.runs(scene).items():
            for run in runs.values():
                strategy = strategies[slug]
                common = about_plan(results.plan, scene, strategy) | {
                    "seed": run.seed,
                    "flip": flip_values.get(run),
                    "run_file": run.path.relative_to(directory).as_posix(),
                }
                yield _rows(run, common)


def about_plan(plan: Plan, scene: SceneEntry, strategy: StrategyEntry) -> dict:
    """The columns that the plan has the values of."""
    settings = _settings(scene) | _settings(strategy)
    return settings | {
        "scene": scene.slug,
        "strategy": strategy.slug,
        "budget_s": plan.time,
        "budget_spp": plan.spp,
        "spec": strategy.spec,
        "width": scene.width,
        "height": scene.height,
        "max_depth": scene.max_depth,
    }


def _rows(run: Run, common: Mapping) -> list[dict]:
    file = read_npz(run.path, run.identity)
    waves, facts = json.loads(str(file["rows"])), json.loads(str(file["facts"]))
    of_run = {"description": facts.get("strategy"), "waves": len(waves)}
    for name in ("device", "worker", "stopped_by", "setup_s", "warm_up_spp"):
        of_run[name] = facts.get(name)
    return [common | of_run | wave | _derived(wave) for wave in waves]


def _derived(wave: Mapping) -> dict:
    """Columns that follow from those of the run's file."""
    corrected = {quantile: wave[f"true_{quantile}_corrected"] for quantile in _QUANTILES}
    ratios = {f"stated_over_true_{q}": _ratio(wave[f"stated_{q}"], corrected[q]) for q in _QUANTILES}
    return ratios | {
        "true_uniformity": _ratio(corrected["p99"], corrected["p50"]),
        "true_bias_z": _ratio(wave["true_bias"], wave["true_bias_se"]),
    }


def _ratio(numerator: float, denominator: float) -> float:
    return numerator / denominator if denominator > 0 else math.nan


def _csv_field(value: float | int | str) -> str:
    if isinstance(value, float):
        return "" if math.isnan(value) else repr(value)
    return str(value)
