"""Columns of a comparison's tables: the figure of summary.json, its format and its meaning."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace

from isonoise.tables import Cell, Column

DASH = "\u2013"  # en dash
EMPTY = Cell(DASH)

MakeCell = Callable[[Mapping, Mapping], Cell]
"""From a row and its scene, both as in summary.json."""


@dataclass(frozen=True)
class MetricColumn(Column):
    """A column whose cells are made from the rows of summary.json.

    `in_terminal`: the terminal shows it, too. `is_optional`: it is left out if all its cells are empty.
    """

    cell: MakeCell = lambda row, scene: EMPTY
    in_terminal: bool = False
    is_optional: bool = False


def shown_columns(columns: Iterable[MetricColumn], scenes: Iterable[Mapping]) -> list[MetricColumn]:
    """The columns without optional ones that are empty in all these scenes of summary.json."""
    rows = [(row, scene) for scene in scenes for row in scene["rows"]]
    return [column for column in columns if not column.is_optional or any(column.cell(*row) != EMPTY for row in rows)]


def format_number(value: float | None, digits: int = 3) -> str:
    """A number with `digits` significant digits, without exponent from 1e-5 to 1e7."""
    if value is None:
        return DASH
    scientific = f"{value:.{digits - 1}e}"
    exponent = int(scientific.split("e")[1])  # after rounding
    if value != 0 and not -5 <= exponent < 7:
        return scientific
    return f"{value:,.{max(digits - 1 - exponent, 0)}f}" if value else "0"


def format_percent(value: float | None, digits: int = 3) -> str:
    return DASH if value is None else f"{format_number(100 * value, digits)} %"


def format_ratio(value: float | None) -> str:
    """A ratio with two decimals, or with two significant digits below 0.1."""
    return DASH if value is None else f"{value:.2f}" if value >= 0.1 or value == 0 else format_number(value, 2)


def _format_coverage(value: float | None) -> str:
    return DASH if value is None else f"{100 * value:.1f} %"


def _value(*keys: str, form: Callable[[float | None], str] = format_number) -> MakeCell:
    """Cell of the number at `keys` of a row."""

    def cell(row: Mapping, scene: Mapping) -> Cell:
        value = _lookup(row, *keys)
        return Cell(form(value), value=value)

    return cell


def _interval(*keys: str, form: Callable[[float | None], str] = format_number) -> MakeCell:
    """Cell of a number with its interval."""

    def cell(row: Mapping, scene: Mapping) -> Cell:
        interval = _lookup(row, *keys)
        if interval is None:
            return EMPTY
        return Cell(form(interval["value"]), _format_interval(interval, form), interval["value"])

    return cell


def _with_range(value: MakeCell, *keys: str, form: Callable[[float | None], str]) -> MakeCell:
    """The cell of `value`, its detail replaced by the lowest and highest value of the waves at `keys` of a row."""

    def cell(row: Mapping, scene: Mapping) -> Cell:
        low, high = (_lookup(row, *keys[:-1], keys[-1] + end) for end in ("lowest", "highest"))
        return replace(value(row, scene), detail=_format_interval({"low": low, "high": high}, form))

    return cell


def ratio_cell(row: Mapping | None, *keys: str) -> Cell:
    """Cell of the ratio at `keys` of a row with its interval; smaller is better."""
    ratio = _lookup(row, *keys)
    if ratio is None or ratio["value"] is None:
        return EMPTY
    return Cell(format_ratio(ratio["value"]), _format_interval(ratio), ratio["value"], _tone(ratio))


def _ratio(*keys: str) -> MakeCell:
    return lambda row, scene: ratio_cell(row, *keys)


def _format_interval(ratio: Mapping, form: Callable[[float | None], str] = format_ratio) -> str:
    if ratio["low"] is None or ratio["high"] is None or ratio["low"] == ratio["high"]:
        return ""
    return f"({form(ratio['low']).removesuffix(' %')}{DASH}{form(ratio['high']).removesuffix(' %')})"


def _tone(ratio: Mapping) -> str:
    if ratio["high"] is not None and ratio["high"] < 1:
        return "good"
    return "bad" if ratio["low"] is not None and ratio["low"] > 1 else ""


def _uniformity(row: Mapping, scene: Mapping) -> Cell:
    value, ideal = row["uniformity"], scene["ideal_uniformity"]
    return Cell(format_ratio(value), f"({format_ratio(ideal)})", value)


def _image_mean(row: Mapping, scene: Mapping) -> Cell:
    ratio = row["image_mean_ratio"]
    if ratio["value"] is None:
        return EMPTY
    has_interval = ratio["high"] is not None
    detail = f"±{(ratio['high'] - ratio['low']) / 2:.4f}" if has_interval else ""
    tone = "bad" if has_interval and not ratio["low"] <= 1 <= ratio["high"] else ""
    return Cell(f"{ratio['value']:.4f}", detail, ratio["value"], tone)


def _bias(row: Mapping, scene: Mapping) -> Cell:
    z, critical = row["bias"]["z"], row["bias"]["critical"]
    if z is None:
        return EMPTY
    return Cell(f"{z:+.1f}", "", z, "bad" if critical is not None and abs(z) > critical else "")


def _metric(head: str, meaning: str, cell: MakeCell, in_terminal: bool = False) -> MetricColumn:
    return MetricColumn(head, meaning=meaning, cell=cell, in_terminal=in_terminal)


_FLIP = MetricColumn(
    "FLIP",
    meaning="mean LDR-FLIP of single images, tone-mapped like PNG outputs with the reference's exposure; mean over the "
    "seeds with its 95 % interval. The reference's error is included",
    cell=_interval("flip"),
    in_terminal=True,
    is_optional=True,
)

SCENE_COLUMNS = (
    _metric("spp", "samples per pixel, mean over the image and the seeds", _value("spp"), True),
    _metric("wall s", "seconds of rendering, set-up excluded", _value("elapsed_s")),
    _metric("device s", "seconds of these during which the device was busy", _value("device_s")),
    _metric(
        "RMS p50",
        "median over the pixels of the RMS over the seeds of (x - r) / max(r, floor), where x is the luminance of the "
        "image, r that of the reference, and the floor 1 % of the reference's log-average luminance. The reference's "
        "own error is removed by simulation extrapolation, here and in all figures that do not say otherwise",
        _value("rms", "p50", form=format_percent),
    ),
    _metric("RMS p95", "the same, 95 % quantile", _value("rms", "p95", form=format_percent)),
    _metric(
        "RMS p99",
        "the same, 99 % quantile: the worst pixels, with its 95 % interval (jackknife over the seeds)",
        _interval("rms_p99", form=format_percent),
        True,
    ),
    _metric(
        "RMS p99 ratio",
        "RMS p99 over the baseline's, with its 95 % interval (jackknife over the seeds, paired)",
        _ratio("rms_ratio", "p99"),
        True,
    ),
    _metric(
        "p99/p50",
        "uniformity of the error: RMS p99 over RMS p50. In brackets the value for equal errors in all pixels, at this "
        "number of seeds",
        _uniformity,
        True,
    ),
    _metric(
        "relMSE",
        "mean of (x - r)² / (r² + 0.01) over pixels, RGB and seeds, less that of the reference's standard errors; with "
        "its 95 % interval (jackknife over the seeds)",
        _interval("rel_mse"),
        True,
    ),
    _metric(
        "trimmed relMSE",
        "the same without the worst 0.1 % of each image's pixels; the reference's error is included",
        _value("rel_mse_trimmed"),
    ),
    _metric(
        "relMSE ratio",
        "relMSE over the baseline's, with its 95 % interval (geometric mean over the seeds, paired)",
        _ratio("rel_mse_ratio"),
        True,
    ),
    _metric(
        "image mean",
        "mean luminance over the reference's, ± half of the 95 % interval, which includes the reference's error. Below "
        "1 the image has lost energy",
        _image_mean,
        True,
    ),
    _metric(
        "bias z",
        "mean of (x - r) / max(m, floor) over pixels and seeds, over its standard error, which includes the "
        "reference's; m is the mean of r over the pixel's 24 neighbours, because a denominator with the pixel's own "
        "noise would make unbiased images too bright. Marked if significant at 5 % by Student's t; without any bias "
        "one in twenty is marked",
        _bias,
        True,
    ),
    _metric(
        "coverage",
        "share of the pixels with |x - r| <= sqrt(h² + (1.96 se)²), h half the width of the stated 95 % interval, se "
        "the standard error of the reference",
        _value("coverage", form=_format_coverage),
    ),
    _metric(
        "stated/true",
        "stated error at p99 over the true error, geometric mean over the seeds. Below 1 the stated error is too small",
        _value("stated_over_true", "p99", "value", form=format_ratio),
        True,
    ),
    _FLIP,
)
"""Figures of a strategy on a scene at the end of its budget."""

SINGLE_IMAGE_COLUMNS = (
    _metric(
        "stated p50",
        "stated error of a single image, median over the pixels, mean over the seeds",
        _value("stated", "p50", form=format_percent),
    ),
    _metric(
        "true p50",
        "median over the pixels of |x - r| / max(r, floor) in a single image, without the reference's own error, mean "
        "over the seeds",
        _value("true", "p50", form=format_percent),
    ),
    _metric("stated p95", "the same, 95 % quantile", _value("stated", "p95", form=format_percent)),
    _metric("true p95", "the same, 95 % quantile", _value("true", "p95", form=format_percent)),
    _metric("stated p99", "the same, 99 % quantile", _value("stated", "p99", form=format_percent)),
    _metric("true p99", "the same, 99 % quantile", _value("true", "p99", form=format_percent)),
    _metric(
        "true p99 ratio",
        "true p99 over the baseline's, with its 95 % interval (geometric mean over the seeds, paired). A method that "
        "misses or dilutes fireflies has smaller quantiles and a darker image",
        _ratio("true_p99_ratio"),
    ),
    *(
        _metric(
            f"stated/true {quantile}",
            f"stated over true error at {quantile}, geometric mean over the seeds; in brackets the lowest and highest "
            "value of all waves after the first",
            _with_range(
                _value("stated_over_true", quantile, "value", form=format_ratio),
                *("stated_over_true", quantile, ""),
                form=format_ratio,
            ),
        )
        for quantile in ("p50", "p95", "p99")
    ),
    _metric(
        "coverage of the waves",
        "as above; in brackets the lowest and highest value of all waves after the first",
        _with_range(_value("coverage", form=_format_coverage), "coverage_", form=_format_coverage),
    ),
    _metric(
        "true max",
        "error of the worst pixel; the reference's error is included",
        _value("true", "max", form=format_percent),
    ),
    _metric(
        "relMSE, floor²",
        "mean of (x - r)² / (r² + floor²): relMSE without an absolute constant; the reference's error is included",
        _value("rel_mse_floor"),
    ),
    _metric(
        "trimmed, floor²",
        "the same without the worst 0.1 % of each image's pixels",
        _value("rel_mse_floor_trimmed"),
    ),
    _metric(
        "MSE",
        "mean of (x - r)² over pixels and RGB, in squared units of the scene; the reference's error is included",
        _value("mse"),
    ),
    _metric("set-up s", "seconds before the first sample: load, build, compile", _value("setup_s")),
)
"""Stated and true errors of single images, and secondary figures."""


def time_cell(row: Mapping | None, metric: str) -> Cell:
    """Time to equal error of a row; `metric` is `rms_p99` or `rel_mse`.

    If the baseline's error was not reached, the detail is the ratio at the larger of the two final errors.
    """
    ratio = _lookup(row, "time_to_equal_error", metric)
    if not ratio:
        return EMPTY
    common = ratio["at_common_error"]
    if ratio["high"] is None:
        has_value = common["value"] is not None
        detail = f"{format_ratio(common['value'])} {_format_interval(common)}".strip() if has_value else ""
        return Cell(f"> {format_ratio(ratio['low'])}", detail, common["value"] or ratio["low"], _tone(common))
    if ratio["low"] != ratio["high"]:
        return Cell(f"< {format_ratio(ratio['high'])}", "", ratio["high"], "good" if ratio["high"] < 1 else "")
    return Cell(format_ratio(ratio["low"]), _format_interval(common), ratio["low"], _tone(common))


def summary_cell(row: Mapping | None, scene: Mapping) -> Cell:
    """Ratios of RMS p99 and of relMSE to the baseline's, and the ratio of the image means."""
    rms, rel_mse = _lookup(row, "rms_ratio", "p99", "value"), _lookup(row, "rel_mse_ratio", "value")
    mean = _lookup(row, "image_mean_ratio", "value")
    if rms is None or rel_mse is None or mean is None:
        return EMPTY
    return Cell(f"{format_ratio(rms)} / {format_ratio(rel_mse)} / {mean:.4f}", value=rms)


def sampler_cell(row: Mapping | None) -> Cell:
    """Ratios of RMS p99 and of relMSE to those with independent samples, with the interval of the latter."""
    rms, rel_mse = _lookup(row, "sampler_ratio", "rms_p99", "value"), _lookup(row, "sampler_ratio", "rel_mse")
    if rms is None or rel_mse["value"] is None:
        return EMPTY
    text = f"{format_ratio(rms)} / {format_ratio(rel_mse['value'])}"
    return Cell(text, _format_interval(rel_mse), rel_mse["value"], _tone(rel_mse))


def _lookup(row: Mapping | None, *keys: str):
    for key in keys:
        row = None if row is None else row.get(key)
    return row
