"""The columns of a comparison's tidy tables: type, unit, meaning. For `tidy_tables` and `summary_table`."""

from collections.abc import Sequence
from dataclasses import dataclass

from isonoise.errors import UserError
from isonoise.film.log import columns
from isonoise.suggestions import suggestion

METRICS = {
    "rel-mse": "relMSE, with and without the worst 0.1 % of the pixels",
    "mse": "mean square error",
    "quantiles": "relative error of the pixels: p50, p95, p99, max",
    "uniformity": "p99 / p50 of that error",
    "bias": "image mean over the reference's; mean relative error with its standard error and z",
    "coverage": "share of the pixels whose stated 95 % interval has the reference",
    "stated": "stated error, and stated over true error",
    "flip": "FLIP of the run's final image; needs the extra `flip` and some seconds per million pixels",
}
"""Name -> what its columns have."""
ALL = "all"
"""Names all metrics."""
DEFAULT_METRICS = tuple(name for name in METRICS if name != "flip")

_LOG = columns(true_errors=True)
"""Name -> meaning of the columns of a render's log."""
_RADIANCE = "radiance"
"""The unit of the scene's RGB values."""


@dataclass(frozen=True)
class TableColumn:
    """A column.

    Attributes
    ----------
    name : str
        As in the file.
    dtype : str
        `string`, `int64` or `float64`. Only the latter can have missing values: nan in arrays, empty in CSV files, null
        in Parquet files.
    unit : str
        `1` for ratios and numbers without unit, empty for texts.
    meaning : str
        A line.
    metric : str
        The metric of `--metrics` that it belongs to; empty if every table has it.
    """

    name: str
    dtype: str
    unit: str
    meaning: str
    metric: str = ""


def checked_metrics(names: Sequence[str]) -> tuple[str, ...]:
    """The names in the order of `METRICS`; `all` names all. Raises UserError if one is unknown, or there is none."""
    known = [*METRICS, ALL]
    for name in names:
        if name not in known:
            raise UserError(f"there is no metric '{name}'{suggestion(name, known)}; known are {', '.join(known)}")
    if not names:
        raise UserError(f"no metric is named; known are {', '.join(known)}")
    return tuple(name for name in METRICS if name in names or ALL in names)


def _text(name: str, meaning: str) -> TableColumn:
    return TableColumn(name, "string", "", meaning)


def _number(name: str, unit: str, meaning: str = "", metric: str = "") -> TableColumn:
    return TableColumn(name, "float64", unit, meaning or _LOG[name], metric)


def _integer(name: str, meaning: str = "") -> TableColumn:
    return TableColumn(name, "int64", "1", meaning or _LOG[name])


_KEYS = (
    _text("scene", "the scene's name in the folder"),
    _text("strategy", "the strategy's name in the folder"),
    _integer("seed", "seed of the run"),
    _number("budget_s", "s", "time of a run, if that is the budget"),
    _number("budget_spp", "samples/pixel", "samples per pixel of a run, if they are the budget"),
    _text("device", "device and driver"),
)
_ABOUT_RUNS = (
    _text("spec", "the strategy as it was given"),
    _text("description", "the strategy with all its parameters"),
    _integer("width", "pixels of the image's rows"),
    _integer("height", "rows of the image"),
    _number("max_depth", "1", "path segments at most, as the comparison sets them; missing if the scene says it"),
    _text("worker", "address of the worker of a cluster; empty without one"),
    _text("stopped_by", "what ended the run: time or spp"),
    _number("setup_s", "s", "time before the first sample: load, build, compile"),
    _number(
        "warm_up_spp",
        "samples/pixel",
        "samples per pixel before the first adaptive wave; missing if the first waves are uniform",
    ),
    _integer("waves", "number of waves"),
)
_PROGRESS = (
    _number("elapsed_s", "s"),
    _number("device_s", "s", "part of elapsed_s in which the device was busy; missing if it cannot measure it"),
    _integer("samples"),
    _number("spp", "samples/pixel"),
    _integer("rejected"),
    _number("energy_loss", "1"),
    _number("energy_loss_se", "1", "standard error of energy_loss"),
)
_REL_MSE = "mean over pixels and RGB of (x - r)^2 / (r^2 + 0.01), x the image, r the reference"
_REL_MSE_FLOOR = "mean over pixels and RGB of (x - r)^2 / (r^2 + floor^2), x the image, r the reference"
_TRIMMED = ", without the worst 0.1 % of the pixels"
_ERROR = "of the pixels' |x - r| / max(r, floor), luminance x of the image, r of the reference"
_METRICS = (
    _number("true_rel_mse", "1", _REL_MSE, "rel-mse"),
    _number("true_rel_mse_trimmed", "1", _REL_MSE + _TRIMMED, "rel-mse"),
    _number("true_rel_mse_floor", "1", _REL_MSE_FLOOR, "rel-mse"),
    _number("true_rel_mse_floor_trimmed", "1", _REL_MSE_FLOOR + _TRIMMED, "rel-mse"),
    _number("true_mse", f"{_RADIANCE}^2", "mean over pixels and RGB of (x - r)^2", "mse"),
    _number("true_p50", "1", f"median {_ERROR}", "quantiles"),
    _number("true_p95", "1", f"quantile 0.95 {_ERROR}", "quantiles"),
    _number("true_p99", "1", f"quantile 0.99 {_ERROR}", "quantiles"),
    _number("true_max", "1", f"largest {_ERROR}", "quantiles"),
    _number("true_p50_corrected", "1", "true_p50 without the reference's own error", "quantiles"),
    _number("true_p95_corrected", "1", "true_p95 without the reference's own error", "quantiles"),
    _number("true_p99_corrected", "1", "true_p99 without the reference's own error", "quantiles"),
    _number(
        "true_uniformity",
        "1",
        "true_p99_corrected / true_p50_corrected: 3.82 if all pixels have normal errors of the same size",
        "uniformity",
    ),
    _number("true_energy_ratio", "1", metric="bias"),
    _number("true_energy_ratio_se", "1", metric="bias"),
    _number(
        "true_bias",
        "1",
        "mean over the pixels of (x - r) / max(m, floor), m the mean of r over the pixel's 24 neighbours",
        "bias",
    ),
    _number("true_bias_se", "1", "standard error of true_bias, from those of image and reference", "bias"),
    _number("true_bias_z", "1", "true_bias / true_bias_se: standard normal if the image is unbiased", "bias"),
    _number("true_coverage", "1", metric="coverage"),
    _number("stated_p50", "1", "stated error at quantile 0.5: an estimate of true_p50 without a reference", "stated"),
    _number("stated_p95", "1", "stated error at quantile 0.95", "stated"),
    _number("stated_p99", "1", "stated error at quantile 0.99", "stated"),
    _number("stated_over_true_p50", "1", "stated_p50 / true_p50_corrected", "stated"),
    _number("stated_over_true_p95", "1", "stated_p95 / true_p95_corrected", "stated"),
    _number("stated_over_true_p99", "1", "stated_p99 / true_p99_corrected", "stated"),
)
_FILES = (_text("run_file", "path of the run's file below the folder"),)

SCENE_SETTING, STRATEGY_SETTING = "scene.", "strategy."
"""Beginnings of the names of columns with the settings of an experiment; the parameter's name follows."""

_ENDS = {"": "value", "_low": "low", "_high": "high"}
"""End of a column's name -> key of an interval in summary.json."""
_INTERVALS = {
    "rms_p99": (
        ("rms_p99",),
        "1",
        "quantile 0.99 over the pixels of the RMS over the seeds of (x - r) / max(r, floor)",
    ),
    "rms_p99_ratio": (("rms_ratio", "p99"), "1", "rms_p99 over that of the baseline"),
    "rel_mse": (("rel_mse",), "1", f"{_REL_MSE}, mean over the seeds, without the reference's own error"),
    "rel_mse_ratio": (("rel_mse_ratio",), "1", "rel_mse over that of the baseline, paired by seed"),
    "image_mean_ratio": (("image_mean_ratio",), "1", "mean luminance over that of the reference"),
    "bias": (("bias",), "1", "mean over pixels and seeds of (x - r) / max(m, floor), as true_bias"),
    "stated_over_true_p50": (("stated_over_true", "p50"), "1", "stated over true error at quantile 0.5"),
    "stated_over_true_p95": (("stated_over_true", "p95"), "1", "stated over true error at quantile 0.95"),
    "stated_over_true_p99": (("stated_over_true", "p99"), "1", "stated over true error at quantile 0.99"),
    "time_to_equal_rms_p99": (
        ("time_to_equal_error", "rms_p99", "at_common_error"),
        "1",
        "time to the larger of the two final rms_p99 over the baseline's time to it",
    ),
    "time_to_equal_rel_mse": (
        ("time_to_equal_error", "rel_mse", "at_common_error"),
        "1",
        "time to the larger of the two final rel_mse over the baseline's time to it",
    ),
    "flip": (("flip",), "1", "mean LDR-FLIP of single images, mean over the seeds"),
}
"""Figures with 95 % intervals: name -> keys in a row of summary.json, unit, meaning."""
_MEANS = {
    "spp": (("spp",), "samples/pixel", "mean over the seeds"),
    "elapsed_s": (("elapsed_s",), "s", "time of rendering, mean over the seeds"),
    "device_s": (("device_s",), "s", "part of elapsed_s in which the device was busy; missing if it cannot measure it"),
    "setup_s": (("setup_s",), "s", "time before the first sample, mean over the seeds"),
    "warm_up_spp": (("warm_up_spp",), "samples/pixel", "samples per pixel before the first adaptive wave, if any"),
    "rms_p50": (("rms", "p50"), "1", "as rms_p99, quantile 0.5"),
    "rms_p95": (("rms", "p95"), "1", "as rms_p99, quantile 0.95"),
    "uniformity": (("uniformity",), "1", "rms_p99 / rms_p50"),
    "rel_mse_trimmed": (("rel_mse_trimmed",), "1", f"{_REL_MSE}{_TRIMMED}, mean over the seeds"),
    "mse": (("mse",), f"{_RADIANCE}^2", "mean over pixels, RGB and seeds of (x - r)^2"),
    "bias_z": (("bias", "z"), "1", "bias / its standard error"),
    "bias_z_critical": (("bias", "critical"), "1", "bias_z beyond which the bias is significant at 5 %"),
    "coverage": (("coverage",), "1", "true_coverage, mean over the seeds"),
    "stated_p50": (("stated", "p50"), "1", "stated error at quantile 0.5, mean over the seeds"),
    "stated_p95": (("stated", "p95"), "1", "stated error at quantile 0.95, mean over the seeds"),
    "stated_p99": (("stated", "p99"), "1", "stated error at quantile 0.99, mean over the seeds"),
    "true_p50": (("true", "p50"), "1", "true_p50_corrected, mean over the seeds"),
    "true_p95": (("true", "p95"), "1", "true_p95_corrected, mean over the seeds"),
    "true_p99": (("true", "p99"), "1", "true_p99_corrected, mean over the seeds"),
    "true_max": (("true", "max"), "1", "true_max, mean over the seeds"),
}

SUMMARY_KEYS: dict[str, tuple[str, ...]] = {
    "seeds": ("seeds",),
    **{name: keys for name, (keys, _, _) in _MEANS.items()},
    **{f"{name}{end}": (*keys, key) for name, (keys, _, _) in _INTERVALS.items() for end, key in _ENDS.items()},
}
"""Column of the table `summary` -> keys in a row of summary.json."""


def _interval_columns() -> list[TableColumn]:
    columns = []
    for name, (_, unit, meaning) in _INTERVALS.items():
        metric = "flip" if name == "flip" else ""
        columns += [
            _number(name, unit, meaning, metric),
            _number(f"{name}_low", unit, f"lower bound of the 95 % interval of {name}", metric),
            _number(f"{name}_high", unit, f"upper bound of the 95 % interval of {name}", metric),
        ]
    return columns


SCHEMA: dict[str, tuple[TableColumn, ...]] = {
    "runs": (
        *_KEYS,
        *_ABOUT_RUNS,
        *_PROGRESS,
        *_METRICS,
        _number("true_floor", _RADIANCE),
        _number(
            "flip",
            "1",
            "mean LDR-FLIP of the final image, tone-mapped like PNG outputs with the exposure of the reference",
            "flip",
        ),
        *_FILES,
    ),
    "waves": (*_KEYS, _integer("wave"), _text("kind", _LOG["kind"]), *_PROGRESS, *_METRICS),
    "summary": (
        *(column for column in _KEYS if column.name != "seed"),
        _text("spec", "the strategy as it was given"),
        _text("folder", "of the comparison below that of an experiment with several; empty if there is one"),
        _integer("seeds", "number of finished runs"),
        *(_number(name, unit, meaning) for name, (_, unit, meaning) in _MEANS.items()),
        *_interval_columns(),
        _number("reference_p99", "1", "quantile 0.99 of the reference's standard error over max(r, floor)"),
    ),
}
"""The columns of each table with all metrics, in their order. Those of `runs` have the values after the last wave.

Those of an experiment's settings follow: `setting_column`.
"""


def setting_column(name: str, is_number: bool) -> TableColumn:
    """The column of a parameter that an experiment sets: `scene.PATH` or `strategy.PARAMETER`.

    Its values are numbers if all values of the parameter are, else texts.
    """
    subject, _, parameter = name.partition(".")
    meaning = f"the {subject}'s {parameter}, as the experiment sets it"
    return TableColumn(name, "float64", "1", meaning) if is_number else TableColumn(name, "string", "", meaning)
