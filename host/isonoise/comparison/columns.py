"""The columns of a comparison's tables: what each shows of a row of the summary, and how to read it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

DASH = "\u2013"  # en dash

NONE = DASH


@dataclass(frozen=True)
class Cell:
    """What a table shows in one place: a text, its interval in brackets, a number to sort by, and how it is meant.

    `tone`: 'good' or 'bad' where the figure differs significantly from the baseline's or from no bias, else ''.
    """

    text: str = NONE
    detail: str = ""
    value: float | None = None
    tone: str = ""


@dataclass(frozen=True)
class Column:
    """`brief`: whether the terminal shows it too; `meaning` says how to read it."""

    head: str
    meaning: str
    brief: bool
    cell: Callable[[Mapping, Mapping], Cell]


def number(value: float | None, digits: int = 3) -> str:
    """A figure with `digits` significant digits, without exponent where it is legible so."""
    if value is None:
        return NONE
    scientific = f"{value:.{digits - 1}e}"
    exponent = int(scientific.split("e")[1])  # after rounding
    if value != 0 and not -5 <= exponent < 7:
        return scientific
    return f"{value:,.{max(digits - 1 - exponent, 0)}f}" if value else "0"


def percent(value: float | None, digits: int = 3) -> str:
    return NONE if value is None else f"{number(100 * value, digits)} %"


def _plain(*keys: str, form: Callable[[float | None], str] = number) -> Callable[[Mapping, Mapping], Cell]:
    """Cell of the number that a row holds under the keys."""

    def cell(row: Mapping, scene: Mapping) -> Cell:
        value = _at(row, keys)
        return Cell(form(value), value=value)

    return cell


def _ratio(*keys: str) -> Callable[[Mapping, Mapping], Cell]:
    """Cell of a ratio to the baseline with its interval; smaller is better."""

    def cell(row: Mapping, scene: Mapping) -> Cell:
        ratio = _at(row, keys)
        return Cell() if ratio is None else _ratio_cell(ratio)

    return cell


def _ratio_cell(ratio: Mapping) -> Cell:
    return Cell(two(ratio["value"]), _interval(ratio, two), ratio["value"], _tone(ratio))


def two(value: float | None) -> str:
    """A ratio: two digits behind the point, more where it is small."""
    return NONE if value is None else f"{value:.2f}" if value >= 0.1 or value == 0 else number(value, 2)


def _interval(ratio: Mapping, form: Callable[[float | None], str]) -> str:
    if ratio["low"] is None or ratio["high"] is None or ratio["low"] == ratio["high"]:
        return ""
    return f"({form(ratio['low'])}{DASH}{form(ratio['high'])})"


def _tone(ratio: Mapping) -> str:
    if ratio["high"] is not None and ratio["high"] < 1:
        return "good"
    return "bad" if ratio["low"] is not None and ratio["low"] > 1 else ""


def _uniformity(row: Mapping, scene: Mapping) -> Cell:
    value, perfect = row["uniformity"], scene["perfect_uniformity"]
    return Cell(two(value), f"({two(perfect)})", value)


def _energy(row: Mapping, scene: Mapping) -> Cell:
    energy = row["energy"]
    if energy["value"] is None:
        return Cell()
    known = energy["high"] is not None
    detail = f"±{(energy['high'] - energy['low']) / 2:.4f}" if known else ""
    tone = "bad" if known and not energy["low"] <= 1 <= energy["high"] else ""
    return Cell(f"{energy['value']:.4f}", detail, energy["value"], tone)


def _bias(row: Mapping, scene: Mapping) -> Cell:
    z, critical = row["bias"]["z"], row["bias"]["critical"]
    if z is None:
        return Cell()
    return Cell(f"{z:+.1f}", "", z, "bad" if critical is not None and abs(z) > critical else "")


SCENE_COLUMNS = (
    Column("spp", "samples per pixel, mean over the image and the seeds", True, _plain("spp")),
    Column("wall s", "seconds of rendering, without set-up", False, _plain("elapsed_s")),
    Column("device s", "seconds of these in which the device worked", False, _plain("device_s")),
    Column(
        "RMS p50",
        "median over the pixels of the RMS over the seeds of (x - r) / max(r, floor), luminance x of the image and r "
        "of the reference; floor: 1 % of the log-average luminance. As measured: the reference's own error is in it",
        False,
        _plain("rms", "p50", form=percent),
    ),
    Column("RMS p95", "the same at quantile 0.95", False, _plain("rms", "p95", form=percent)),
    Column("RMS p99", "the same at quantile 0.99: the worst pixels", True, _plain("rms", "p99", form=percent)),
    Column(
        "RMS p99 ratio",
        "to the baseline, with its 95 % interval: jackknife over the seeds, paired",
        True,
        _ratio("rms_ratio", "p99"),
    ),
    Column(
        "p99/p50",
        "uniformity: RMS p99 over RMS p50; in brackets what it is where all pixels have the same error, at this number "
        "of seeds",
        True,
        _uniformity,
    ),
    Column("relMSE", "mean over pixels, RGB and seeds of (x - r)² / (r² + 0.01)", True, _plain("rel_mse")),
    Column(
        "without worst",
        "the same without the worst 0.1 % of the pixels of every image",
        False,
        _plain("rel_mse_trimmed"),
    ),
    Column(
        "relMSE ratio",
        "to the baseline: geometric mean over the seeds, paired, with its 95 % interval",
        True,
        _ratio("rel_mse_ratio"),
    ),
    Column(
        "image mean",
        "mean luminance over the reference's ± half of the 95 % interval, the reference's error included; what it "
        "lacks to 1 is energy lost",
        True,
        _energy,
    ),
    Column(
        "bias z",
        "mean over pixels and seeds of (x - r) / max(r, floor), over its standard error, the reference's included; "
        "marked where it is significant at 5 % by Student's t, as one in twenty is without any bias",
        True,
        _bias,
    ),
    Column(
        "coverage",
        "share of the pixels with the reference in their stated 95 % interval",
        False,
        _plain("coverage", form=lambda value: NONE if value is None else f"{100 * value:.1f} %"),
    ),
    Column(
        "stated/true",
        "stated error at p99 over the true one, geometric mean over the seeds: below 1 is too confident",
        True,
        _plain("stated_over_true", "p99", form=two),
    ),
)
"""What matters about a strategy on a scene, at the end of its budget."""

SINGLE_COLUMNS = (
    Column(
        "stated p50",
        "stated error of a single image at quantile 0.5, mean over the seeds",
        False,
        _plain("stated", "p50", form=percent),
    ),
    Column(
        "true p50",
        "median over the pixels of |x - r| / max(r, floor) in a single image, mean over the seeds",
        False,
        _plain("true", "p50", form=percent),
    ),
    Column("stated p95", "at quantile 0.95", False, _plain("stated", "p95", form=percent)),
    Column("true p95", "at quantile 0.95", False, _plain("true", "p95", form=percent)),
    Column("stated p99", "at quantile 0.99", False, _plain("stated", "p99", form=percent)),
    Column("true p99", "at quantile 0.99", False, _plain("true", "p99", form=percent)),
    Column(
        "true p99 ratio",
        "to the baseline: geometric mean over the seeds, paired, with its 95 % interval. A method that misses or "
        "dilutes fireflies has smaller quantiles, and a darker image",
        False,
        _ratio("p99_ratio"),
    ),
    Column("true max", "of the worst pixel", False, _plain("true", "max", form=percent)),
    Column(
        "relMSE, floor²",
        "mean of (x - r)² / (r² + floor²): without an absolute constant",
        False,
        _plain("rel_mse_floor"),
    ),
    Column(
        "floor², without worst",
        "the same without the worst 0.1 % of the pixels",
        False,
        _plain("rel_mse_floor_trimmed"),
    ),
    Column(
        "RMS p99, freed",
        "RMS p99 freed of the reference's error: quantile of sqrt(max(RMS² - se², 0))",
        False,
        _plain("rms_freed", "p99", form=percent),
    ),
    Column("set-up s", "seconds before the first sample: load, build, compile", False, _plain("setup_s")),
)
"""Stated beside true errors of single images, and what else is to be known."""


def time_cell(row: Mapping | None, metric: str) -> Cell:
    """Time to equal error of a row, `metric` `rms_p99` or `rel_mse`; where it is not reached, also that at its own."""
    ratio = row and _at(row, ("time_ratio", metric))
    if not ratio:
        return Cell()
    common = ratio["common"]
    if ratio["high"] is None:
        detail = f"{two(common['value'])} {_interval(common, two)}".strip() if common["value"] is not None else ""
        return Cell(f"> {two(ratio['low'])}", detail, common["value"] or ratio["low"], _tone(common))
    if ratio["low"] != ratio["high"]:
        return Cell(f"< {two(ratio['high'])}", "", ratio["high"], "good" if ratio["high"] < 1 else "")
    return Cell(two(ratio["low"]), _interval(common, two), ratio["low"], _tone(common))


def short_cell(row: Mapping | None, scene: Mapping) -> Cell:
    """The ratios of RMS p99 and of relMSE to the baseline's, and that of the image means."""
    figures = [("rms_ratio", "p99", "value"), ("rel_mse_ratio", "value"), ("energy", "value")]
    values = [_at(row, keys) for keys in figures]
    if None in values:
        return Cell()
    return Cell(f"{two(values[0])} / {two(values[1])} / {values[2]:.4f}", value=values[0])


def _at(row: Mapping, keys: Sequence[str]):
    for key in keys:
        row = None if row is None else row.get(key)
    return row
