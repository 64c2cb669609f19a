"""The main figures of summary.json as a table, one row per scene and strategy; for `compare_scenes`."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from isonoise.comparison.result_table import ResultTable
from isonoise.comparison.table_columns import TableColumn

_NAMES = (
    ("scene", "the scene's name in the folder"),
    ("strategy", "the strategy's name in the folder"),
    ("folder", "of the comparison below the experiment's folder; empty if it is the only one"),
)
_FIGURES = (
    ("seeds", "1", "finished runs", ("seeds",)),
    ("spp", "samples/pixel", "mean samples per pixel", ("spp",)),
    ("elapsed_s", "s", "mean seconds of rendering", ("elapsed_s",)),
    ("rms_p50", "1", "median over the pixels of the RMS relative error over the seeds", ("rms", "p50")),
    ("rms_p99", "1", "its p99", ("rms", "p99")),
    ("rms_p99_ratio", "1", "rms_p99 over that of the baseline", ("rms_ratio", "p99", "value")),
    ("rms_p99_ratio_low", "1", "lower end of its 95 % interval", ("rms_ratio", "p99", "low")),
    ("rms_p99_ratio_high", "1", "upper end of its 95 % interval", ("rms_ratio", "p99", "high")),
    ("rel_mse", "1", "mean relMSE", ("rel_mse", "value")),
    ("rel_mse_ratio", "1", "rel_mse over that of the baseline", ("rel_mse_ratio", "value")),
    ("rel_mse_ratio_low", "1", "lower end of its 95 % interval", ("rel_mse_ratio", "low")),
    ("rel_mse_ratio_high", "1", "upper end of its 95 % interval", ("rel_mse_ratio", "high")),
    ("uniformity", "1", "p99/p50 of the RMS", ("uniformity",)),
    ("image_mean_ratio", "1", "mean luminance over the reference's", ("image_mean_ratio", "value")),
    ("bias_z", "1", "mean relative error over its standard error", ("bias", "z")),
    ("coverage", "1", "share of the pixels whose stated 95 % interval has the reference", ("coverage",)),
    ("stated_over_true_p99", "1", "stated over true error at quantile 0.99", ("stated_over_true", "p99", "value")),
)
"""Name, unit and meaning of a column; its keys in a row of summary.json, see `summary.summarise`."""


def summary_table(summaries: Mapping[str, Mapping[str, Any]]) -> ResultTable:
    """The table of one or several comparisons; `summaries` are those of `summarise` by folder."""
    rows = [
        (scene, row, folder)
        for folder, summary in summaries.items()
        for scene in summary["scenes"]
        for row in scene["rows"]
    ]
    arrays = {
        "scene": np.array([scene["slug"] for scene, _, _ in rows], np.str_),
        "strategy": np.array([row["strategy"] for _, row, _ in rows], np.str_),
        "folder": np.array([folder for _, _, folder in rows], np.str_),
    }
    for name, _, _, keys in _FIGURES:
        arrays[name] = np.array([_lookup(row, keys) for _, row, _ in rows], np.float64)
    columns = [TableColumn(name, "string", "", meaning) for name, meaning in _NAMES]
    columns += [TableColumn(name, "float64", unit, meaning) for name, unit, meaning, _ in _FIGURES]
    return ResultTable("summary", arrays, columns)


def _lookup(row: Mapping[str, Any], keys: Sequence[str]) -> float:
    value: object = row
    for key in keys:
        value = value.get(key) if isinstance(value, Mapping) else None
    return float(value) if isinstance(value, int | float) else np.nan
