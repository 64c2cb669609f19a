"""The main figures of summary.json as a table, a row per scene and strategy; for `summary`, `series` and `compare`."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from isonoise.comparison.plan import Plan, read_plan
from isonoise.comparison.table_columns import SUMMARY_KEYS
from isonoise.comparison.tidy_tables import about_plan, table_of_rows


def summary_table(directory: Path, summaries: Mapping[str, Mapping[str, Any]]) -> dict[str, np.ndarray]:
    """The table of one or several comparisons: the columns `SCHEMA["summary"]`, and those of settings.

    Parameters
    ----------
    directory : Path
        The folder of the experiment.
    summaries : mapping
        Folder of a comparison below it -> what `summarise` has returned.

    Raises
    ------
    UserError
        If a plan cannot be read.
    """
    rows, plans = [], []
    for folder, summary in summaries.items():
        plan = read_plan(directory / folder)
        if plan is not None:
            plans.append(plan)
            rows += [row | {"folder": folder} for row in _rows(plan, summary)]
    return table_of_rows("summary", rows, plans)


def _rows(plan: Plan, summary: Mapping[str, Any]) -> Iterator[dict[str, object]]:
    strategies = {strategy.slug: strategy for strategy in plan.strategies}
    for scene in summary["scenes"]:
        of_scene = {"device": "; ".join(scene["devices"]), "reference_p99": scene["reference"]["p99"]}
        for row in scene["rows"]:
            figures = {name: _lookup(row, *keys) for name, keys in SUMMARY_KEYS.items()}
            yield about_plan(plan, plan.scene(scene["slug"]), strategies[row["strategy"]]) | of_scene | figures


def _lookup(row: Mapping[str, object], *keys: str) -> object:
    value: object = row
    for key in keys:
        value = value.get(key) if isinstance(value, Mapping) else None
    return value
