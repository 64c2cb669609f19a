"""summary.json of a comparison, computed from the finished runs; called by `report` and the command."""

import json
import math
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import numpy as np

from isonoise import __version__
from isonoise.comparison import metrics, reference_error
from isonoise.comparison.flip_values import FlipValues
from isonoise.comparison.plan import SceneEntry
from isonoise.comparison.report_tables import markdown_tables, text_tables
from isonoise.comparison.results import Reference, Results, Run, common_seeds
from isonoise.comparison.strategy_specs import MITSUBA_SAMPLERS, independent_counterpart
from isonoise.comparison.summary_table import summary_table
from isonoise.comparison.tidy_tables import write_table, write_tables
from isonoise.comparison.timing import timing_rows
from isonoise.film.files import write_atomically
from isonoise.strategies.registry import DEFAULT_STRATEGY

SCHEMA, SCHEMA_VERSION = "isonoise-compare", 3
"""The version goes up when a field is removed or changes its meaning; fields may be added."""

QUANTILES = {"p50": 0.5, "p95": 0.95, "p99": 0.99}


def summarise(directory: Path) -> dict:
    """Everything that the tables show, as plain dicts and lists; numbers that are not finite are None.

    | field | meaning |
    |---|---|
    | `schema`, `schema_version`, `isonoise_version` | version of this layout, of the program |
    | `budget` | `time` (seconds per run) and `spp` (samples per pixel per run); one of them is None |
    | `seeds`, `strategies`, `baseline`, `default` | as planned; slugs of the two strategies (`default` may be None) |
    | `scenes` | list of the scenes with finished runs: `slug`, `name`, `width`, `height`, `floor`, `devices`, and: |
    | .. `timing` | where isonoise's own runs were timed: `timing.timing_rows` |
    | .. `seeds`, `runs`, `planned_runs` | seeds that all strategies with runs have: the figures use only these |
    | .. `reference` | `has_standard_error`; `p50`, `p95`, `p99` of se / max(r, floor); `mean_relative_se` of the mean;
      `rel_mse`, what it adds to the relMSE |
    | .. `ideal_uniformity` | `uniformity` if all pixels had the same error, at this number of seeds |
    | .. `rel_mse_lower_bound` | of any allocation, over the mean relMSE of uniform sampling with as many samples |
    | .. `rows` | list, one row per strategy with runs |

    Fields of a row. Means are over the seeds. An interval is `value`, `low`, `high` (95 %). Ratios are to the baseline.
    Figures marked * are free of the reference's own error (`reference_error`).

    | field | meaning |
    |---|---|
    | `strategy`, `description`, `seeds` | slug, spec with all parameters, number of finished runs |
    | `samples`, `spp`, `waves`, `elapsed_s`, `device_s`, `setup_s` | means; `device_s` None if unknown |
    | `warm_up_spp` | samples per pixel before the first adaptive wave; None if there is none |
    | `rms` * | p50, p95, p99 of the RMS over the seeds |
    | `rms_p99` *, `rms_ratio` * | interval; p50, p95, p99: ratio. By the jackknife over the seeds, paired |
    | `uniformity` * | p99/p50 of `rms` |
    | `reference_too_noisy` | the reference's p99 is over a quarter of the row's (of `rms` or `true`, the smaller) |
    | `rel_mse` * | interval by the jackknife of the logarithm |
    | `rel_mse_trimmed`, `_floor`, `_floor_trimmed` | means, as in the log |
    | `mse`, `flip` | mean square error, means; FLIP: interval over the seeds, if it is a metric of the comparison |
    | `rel_mse_ratio` *, `true_p99_ratio` * | paired over the seeds: exp of the mean log ratio |
    | `stated`, `true` * | p50, p95, p99 (`true`: also max, as in the log) of single images, means |
    | `stated_over_true` * | p50, p95, p99: geometric mean over the seeds, interval; `lowest`, `highest` of all waves |
    | `coverage` | mean; `coverage_lowest`, `coverage_highest` of all waves |
    | `image_mean_ratio`, `bias` | over the reference's mean; `metrics.bias`: interval, `z`, `critical` value |
    | `sampler_ratio` * | `rms_p99`, `rel_mse`: over the same strategy with independent samples, if it was compared |
    | `time_to_equal_error` * | `rms_p99`, `rel_mse`: time to the baseline's final error over the baseline's time |
    | `curves` * | `rms_p99`, `rel_mse`: lists `time`, `error`, `low`, `high` (95 %): error against seconds |

    `lowest` and `highest` are over the waves that have more samples per pixel than the first, of the mean of the seeds.

    A time to equal error has `low` = `high`, the ratio; or `high` None: not reached, the ratio is above `low`; or `low`
    0: the ratio is below `high`. `at_common_error` is the ratio at the larger of the two final errors, an interval.
    """
    results = Results(directory)
    plan = results.plan
    if "flip" in plan.metrics:
        FlipValues(directory).update(results)
    slugs = {strategy.spec: strategy.slug for strategy in plan.strategies}
    return _to_json(
        {
            "schema": SCHEMA,
            "schema_version": SCHEMA_VERSION,
            "isonoise_version": __version__,
            "budget": {"time": plan.time, "spp": plan.spp},
            "seeds": list(plan.seeds),
            "strategies": [{"slug": s.slug, "spec": s.spec, "title": s.title} for s in plan.strategies],
            "baseline": results.baseline,
            "default": slugs.get(DEFAULT_STRATEGY),
            "scenes": [_scene(results, scene, runs) for scene in plan.scenes if (runs := results.runs(scene))],
        }
    )


def write_summary(directory: Path, summary: dict) -> None:
    """Write summary.json, tables.md and the tidy tables (`tidy_tables`) to `directory`, each file atomically."""
    directory = Path(directory)
    write_tables(directory)
    write_table(directory, "summary", summary_table(directory, {"": summary}))
    _write_text(directory / "summary.json", json.dumps(summary, indent=1, allow_nan=False, ensure_ascii=False) + "\n")
    _write_text(directory / "tables.md", markdown_tables(summary))


def summary_text(directory: Path) -> str:
    """The tables for a terminal, from summary.json if it exists, else from the runs."""
    path = Path(directory) / "summary.json"
    return text_tables(json.loads(path.read_text(encoding="utf-8")) if path.is_file() else summarise(directory))


def _scene(results: Results, scene: SceneEntry, runs: dict[str, dict[int, Run]]) -> dict:
    reference = results.reference(scene)
    variance = results.variance(scene)
    seeds = common_seeds(runs)
    height, width = reference.luminance.shape
    specs = {strategy.slug: strategy.spec for strategy in results.plan.strategies}
    measured = (
        {slug: _Measurement([by_seed[seed] for seed in seeds], reference) for slug, by_seed in runs.items()}
        if seeds
        else {}
    )
    baseline = measured.get(results.baseline)
    reference_quantiles = _quantiles(np.zeros(1) if reference.relative_se is None else reference.relative_se)
    return {
        "slug": scene.slug,
        "name": scene.name,
        "width": width,
        "height": height,
        "floor": reference.floor,
        "devices": sorted({str(run.facts.get("device")) for by_seed in runs.values() for run in by_seed.values()}),
        "timing": timing_rows(
            run.facts for slug in runs if specs[slug] not in MITSUBA_SAMPLERS for run in runs[slug].values()
        ),
        "seeds": seeds,
        "runs": sum(len(by_seed) for by_seed in runs.values()),
        "planned_runs": len(results.plan.strategies) * len(results.plan.seeds),
        "reference": {
            "has_standard_error": reference.relative_se is not None,
            **reference_quantiles,
            "mean_relative_se": reference.mean_relative_se,
            "rel_mse": reference.rel_mse,
        },
        "ideal_uniformity": metrics.ideal_uniformity(len(seeds)) if seeds else math.nan,
        "rel_mse_lower_bound": math.nan if variance is None else metrics.rel_mse_lower_bound(variance),
        "rows": [
            {"strategy": slug, "seeds": len(runs[slug])}
            | measurement.row(baseline, reference_quantiles["p99"])
            | _sampler_ratio(results, slug, measured)
            | _flip(results, [runs[slug][seed] for seed in seeds])
            for slug, measurement in measured.items()
        ],
    }


def _sampler_ratio(results: Results, slug: str, measured: "dict[str, _Measurement]") -> dict:
    """The field `sampler_ratio` of a row; empty without the strategy with independent samples."""
    specs = {strategy.slug: strategy.spec for strategy in results.plan.strategies}
    wanted = independent_counterpart(specs[slug])
    other = next((measured[other] for other in measured if specs[other] == wanted), None)
    if other is None or wanted == specs[slug]:
        return {}
    measurement = measured[slug]
    return {
        "sampler_ratio": {"rms_p99": measurement.rms_ratio(other)["p99"], "rel_mse": measurement.rel_mse_ratio(other)}
    }


def _flip(results: Results, runs: list[Run]) -> dict:
    """The field `flip` of a row; empty unless it is a metric of the comparison."""
    if "flip" not in results.plan.metrics:
        return {}
    values = FlipValues(results.directory)
    return {"flip": asdict(metrics.mean_over_seeds([_to_float(values.get(run)) for run in runs]).interval())}


class _Measurement:
    """One strategy on one scene: its runs reduced to a few arrays, so that all strategies fit in memory."""

    def __init__(self, runs: list[Run], reference: Reference):
        self._rows = [run.rows for run in runs]
        self._last = [rows[-1] for rows in self._rows]
        self._facts = [run.facts for run in runs]
        self._reference = reference
        errors = [run.errors for run in runs]
        final = np.stack([e[-1] for e in errors])
        self._bias = metrics.bias(final, reference.bias_weight, reference.relative_se)
        self._rms, self._rms_leave_one_out = self._rms_quantiles(final, list(QUANTILES.values()))
        p99 = [self._rms_quantiles(np.stack(images), [QUANTILES["p99"]]) for images in zip(*errors, strict=True)]
        times = np.stack([run.snapshot_s for run in runs])
        self._curves = {
            "rms_p99": metrics.Curve(
                times.mean(axis=0),
                np.concatenate([all_seeds for all_seeds, _ in p99]),
                np.array([np.delete(times, i, axis=0).mean(axis=0) for i in range(len(times)) if len(times) > 1]),
                np.concatenate([leave_one_out for _, leave_one_out in p99], axis=1),
            ),
            "rel_mse": metrics.curve_of_means(
                [np.array([row["elapsed_s"] for row in rows]) for rows in self._rows],
                [np.array([row["true_rel_mse"] for row in rows]) - reference.rel_mse for rows in self._rows],
            ),
        }

    def _rms_quantiles(self, errors: np.ndarray, quantiles: list[float]) -> tuple[np.ndarray, np.ndarray]:
        return reference_error.rms_quantiles(errors, quantiles, self._reference.relative_se)

    def row(self, baseline: "_Measurement | None", reference_p99: float) -> dict:
        rms = dict(zip(QUANTILES, self._rms, strict=True))
        rel_mse = self._rel_mse()
        true = {q: self._mean(f"true_{q}_corrected") for q in QUANTILES} | {"max": self._mean("true_max")}
        mean_ratio = metrics.mean_over_seeds(self._values("true_energy_ratio"), self._reference.mean_relative_se)
        fields = {
            "description": str(self._facts[0].get("strategy")),
            "reference_too_noisy": reference_p99 > min(rms["p99"], true["p99"]) / 4,
            "samples": self._mean("samples"),
            "spp": self._mean("spp"),
            "waves": float(np.mean([len(rows) for rows in self._rows])),
            "elapsed_s": self._mean("elapsed_s"),
            "device_s": self._mean("device_s"),
            "setup_s": float(np.mean([_to_float(facts.get("setup_s")) for facts in self._facts])),
            "warm_up_spp": _to_float(self._facts[0].get("warm_up_spp")),
            "rms": rms,
            "rms_p99": self._rms_interval("p99"),
            "uniformity": rms["p99"] / rms["p50"] if rms["p50"] > 0 else math.nan,
            "stated": {q: self._mean(f"stated_{q}") for q in QUANTILES},
            "true": true,
            "stated_over_true": {q: self._stated_over_true(q) for q in QUANTILES},
            "mse": self._mean("true_mse"),
            "coverage": self._mean("true_coverage"),
            **_range("coverage_", self._over_waves(lambda row: _to_float(row.get("true_coverage"))).mean(axis=0)),
            "rel_mse": asdict(_interval_of_log(rel_mse.mean(), metrics.leave_one_out_means(rel_mse))),
            "image_mean_ratio": _with_test(mean_ratio, 1.0),
            "bias": _with_test(self._bias, 0.0),
            "curves": {name: _with_band(curve) for name, curve in self._curves.items()},
        }
        fields |= {
            name: self._mean(f"true_{name}") for name in ("rel_mse_trimmed", "rel_mse_floor", "rel_mse_floor_trimmed")
        }
        return fields | ({} if baseline is None else self._ratios(baseline))

    def _ratios(self, baseline: "_Measurement") -> dict:
        p99 = "true_p99_corrected"
        return {
            "rms_ratio": self.rms_ratio(baseline),
            "true_p99_ratio": asdict(metrics.paired_ratio(self._values(p99), baseline._values(p99))),
            "rel_mse_ratio": self.rel_mse_ratio(baseline),
            "time_to_equal_error": {
                name: asdict(metrics.time_ratio(curve, baseline._curves[name])) for name, curve in self._curves.items()
            },
        }

    def rms_ratio(self, other: "_Measurement") -> dict:
        with np.errstate(all="ignore"):
            ratio = self._rms / other._rms
            leave_one_out = self._rms_leave_one_out / other._rms_leave_one_out
        return {q: asdict(_interval_of_log(ratio[i], leave_one_out[:, i])) for i, q in enumerate(QUANTILES)}

    def rel_mse_ratio(self, other: "_Measurement") -> dict:
        return asdict(metrics.paired_ratio(self._rel_mse(), other._rel_mse()))

    def _rms_interval(self, quantile: str) -> dict:
        index = list(QUANTILES).index(quantile)
        return asdict(_interval_of_log(self._rms[index], self._rms_leave_one_out[:, index]))

    def _rel_mse(self) -> np.ndarray:
        """relMSE of every run, without the reference's share."""
        return self._values("true_rel_mse") - self._reference.rel_mse

    def _values(self, column: str) -> np.ndarray:
        """The column's value in the last row of every run."""
        return np.array([_to_float(row.get(column)) for row in self._last])

    def _mean(self, column: str) -> float:
        return float(self._values(column).mean())

    def _over_waves(self, figure: Callable[[dict], float]) -> np.ndarray:
        """A figure of every seed and wave, (S, K): waves with more samples than the first that all seeds have."""
        count = min(map(len, self._rows))
        first_wave_spp = self._facts[0].get("first_wave_spp", 0)
        first = next((k for k in range(count) if self._rows[0][k]["spp"] > first_wave_spp), count - 1)
        return np.array([[figure(row) for row in rows[first:count]] for rows in self._rows])

    def _stated_over_true(self, quantile: str) -> dict:
        names = f"stated_{quantile}", f"true_{quantile}_corrected"
        with np.errstate(all="ignore"):
            interval = metrics.paired_ratio(*map(self._values, names))
            waves = np.exp(
                np.log(self._over_waves(lambda row: _divide(*(_to_float(row.get(name)) for name in names)))).mean(
                    axis=0
                )
            )
        return asdict(interval) | _range("", waves)


def _interval_of_log(value: float, leave_one_out: np.ndarray) -> metrics.Interval:
    """95 % interval of a positive figure by the jackknife of its logarithm."""
    with np.errstate(all="ignore"):
        return metrics.jackknife(float(np.log(value)), np.log(leave_one_out)).ratio()


def _with_band(curve: metrics.Curve) -> dict:
    """A curve with its 95 % interval by the jackknife of the logarithm."""
    points = [_interval_of_log(error, curve.leave_one_out_error[:, k]) for k, error in enumerate(curve.error)]
    return {
        "time": curve.time.tolist(),
        "error": curve.error.tolist(),
        "low": [point.low for point in points],
        "high": [point.high for point in points],
    }


def _range(prefix: str, values: np.ndarray) -> dict:
    return {f"{prefix}lowest": values.min(), f"{prefix}highest": values.max()}


def _divide(numerator: float, denominator: float) -> float:
    return numerator / denominator if denominator > 0 else math.nan


def _with_test(estimate: metrics.Estimate, null: float) -> dict:
    return asdict(estimate.interval()) | {"z": estimate.z(null), "critical": estimate.critical()}


def _quantiles(image: np.ndarray) -> dict[str, float]:
    return dict(zip(QUANTILES, np.quantile(image, list(QUANTILES.values())).tolist(), strict=True))


def _to_float(value: object) -> float:
    return math.nan if value is None else float(value)


def _to_json(value):
    """Numpy scalars become Python numbers; nan and inf become None."""
    if isinstance(value, dict):
        return {key: _to_json(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_to_json(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _write_text(path: Path, text: str) -> None:
    write_atomically(path, lambda temporary: temporary.write_text(text, encoding="utf-8", newline="\n"))
