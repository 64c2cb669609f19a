"""Figures of a comparison: waves.csv, summary.json and the tables, made from the finished runs."""

import csv
import io
import json
import math
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path

import numpy as np

from isonoise import __version__
from isonoise.comparison import metrics
from isonoise.comparison.results import Reference, Results, Run, common_seeds
from isonoise.film.files import write_atomically
from isonoise.film.log import columns
from isonoise.strategies.registry import DEFAULT_STRATEGY

SCHEMA = 1
"""Version of summary.json: a new one if a name goes or changes its meaning; names may be added."""

QUANTILES = {"p50": 0.5, "p95": 0.95, "p99": 0.99}


def summarise(directory: Path) -> dict:
    """Everything that the tables show, as plain dicts and lists; what is not a finite number is None.

    | key | what |
    |---|---|
    | `schema`, `version` | version of this layout, of isonoise |
    | `budget` | `time` (seconds a run) and `spp` (samples per pixel a run); one of them is None |
    | `seeds`, `strategies`, `baseline`, `default` | as planned; slugs of the two strategies (`default` may be None) |
    | `scenes` | list, those with finished runs: `slug`, `name`, `width`, `height`, `floor`, `devices`, and: |
    | .. `seeds`, `runs`, `planned_runs` | seeds that all strategies with runs have: the figures are from these alone |
    | .. `reference` | `states_error`; `p50`, `p95`, `p99` of se / max(r, floor); `mean_relative_se` of the mean |
    | .. `perfect_uniformity` | `uniformity` if all pixels had one error, at this number of seeds |
    | .. `rel_mse_bound` | what any allocation can make of uniform sampling's mean relMSE at equal samples |
    | .. `rows` | list, one a strategy with runs; below |

    Rows (means are over the seeds; an interval is `value`, `low`, `high`, 95 %; ratios are to the baseline):

    | key | what |
    |---|---|
    | `strategy`, `description`, `seeds` | slug, every parameter written out, number of finished runs |
    | `samples`, `spp`, `waves`, `elapsed_s`, `device_s`, `setup_s` | means; device_s None where not known |
    | `rms`, `rms_freed` | p50, p95, p99 of the RMS over the seeds as measured, and freed of the reference's error |
    | `rms_ratio` | p50, p95, p99: ratio, interval by the jackknife over the seeds, paired |
    | `uniformity` | p99/p50 of `rms` |
    | `below_reference` | the reference's p99 is over a quarter of the row's (of `rms` or `true`, the smaller) |
    | `rel_mse`, `_trimmed`, `_floor`, `_floor_trimmed` | means, as in the log |
    | `rel_mse_ratio`, `p99_ratio` | paired over the seeds: exp of the mean log ratio; of relMSE, of `true` p99 |
    | `stated`, `true` | p50, p95, p99 (true: and max) of single images, means |
    | `stated_over_true` | p50, p95, p99: geometric mean over the seeds |
    | `coverage` | mean |
    | `energy`, `bias` | ratio of the image means; mean relative error: interval, `z` (against 1; 0), `critical` |
    | `time_ratio` | `rms_p99`, `rel_mse`: time to the baseline's final error over its own; below |
    | `curves` | `rms_p99`, `rel_mse`: `time`, `error`, `low`, `high` (95 %): error against seconds |

    A time ratio has `low` = `high`, the ratio; or `high` None: not reached, it is over `low`; or `low` 0: it is under
    `high`. `common` is the ratio at the larger of the two final errors, an interval.
    """
    results = Results(directory)
    slugs = {strategy["spec"]: strategy["slug"] for strategy in results.strategies}
    return _plain(
        {
            "schema": SCHEMA,
            "version": __version__,
            "budget": {"time": results.plan.get("time"), "spp": results.plan.get("spp")},
            "seeds": list(results.plan["seeds"]),
            "strategies": [{key: s[key] for key in ("slug", "spec", "title")} for s in results.strategies],
            "baseline": results.baseline,
            "default": slugs.get(DEFAULT_STRATEGY),
            "scenes": [
                _scene(results, scene, runs) for scene in results.scenes if (runs := results.runs(scene["slug"]))
            ],
        }
    )


def write_summary(directory: Path, summary: dict) -> None:
    """Write waves.csv, summary.json and tables.md below `directory`, each whole or not at all."""
    from isonoise.comparison.tables import markdown

    directory = Path(directory)
    _write_text(directory / "waves.csv", _waves(Results(directory)))
    _write_text(directory / "summary.json", json.dumps(summary, indent=1, allow_nan=False, ensure_ascii=False) + "\n")
    _write_text(directory / "tables.md", markdown(summary))


def text_table(directory: Path) -> str:
    """The tables for a terminal, from summary.json where it is written already, else from the runs."""
    from isonoise.comparison.tables import text

    path = Path(directory) / "summary.json"
    return text(json.loads(path.read_text(encoding="utf-8")) if path.is_file() else summarise(directory))


def _scene(results: Results, scene: Mapping, runs: dict[str, dict[int, Run]]) -> dict:
    reference = results.reference(scene)
    variance = results.variance(scene["slug"])
    seeds = common_seeds(runs)
    height, width = reference.luminance.shape
    found = {
        "slug": scene["slug"],
        "name": scene["name"],
        "width": width,
        "height": height,
        "floor": reference.floor,
        "devices": sorted({str(run.facts.get("device")) for of in runs.values() for run in of.values()}),
        "seeds": seeds,
        "runs": sum(len(of_strategy) for of_strategy in runs.values()),
        "planned_runs": len(results.strategies) * len(results.plan["seeds"]),
        "reference": {
            "states_error": reference.relative_se is not None,
            **_quantiles(np.zeros(1) if reference.relative_se is None else reference.relative_se),
            "mean_relative_se": reference.mean_relative_se,
        },
        "perfect_uniformity": metrics.perfect_uniformity(len(seeds)) if seeds else math.nan,
        "rel_mse_bound": math.nan if variance is None else metrics.allocation_bound(variance),
    }
    measured = {slug: _Measured([of[seed] for seed in seeds], reference) for slug, of in runs.items()} if seeds else {}
    baseline = measured.get(results.baseline)
    found["rows"] = [
        {"strategy": slug, "seeds": len(runs[slug])} | of_strategy.row(baseline, found["reference"]["p99"])
        for slug, of_strategy in measured.items()
    ]
    return found


class _Measured:
    """One strategy on one scene: what its runs say, small enough to keep while the others are read."""

    def __init__(self, runs: list[Run], reference: Reference):
        self._rows = [run.rows for run in runs]
        self._last = [rows[-1] for rows in self._rows]
        self._facts = [run.facts for run in runs]
        self._reference = reference
        errors = [run.errors for run in runs]
        final = np.stack([e[-1] for e in errors])
        self._bias = metrics.bias(final, reference.relative_se)
        self._freed = metrics.rms_over_seeds(final)
        if reference.relative_se is not None:
            self._freed = metrics.freed_of_reference(self._freed, reference.relative_se)
        self._freed = _quantiles(self._freed)
        self._rms, self._rms_without = metrics.rms_quantiles(final, list(QUANTILES.values()))
        worst = [metrics.rms_quantiles(np.stack(at), [QUANTILES["p99"]]) for at in zip(*errors, strict=True)]
        times = np.stack([run.snapshot_s for run in runs])
        self._curves = {
            "rms_p99": metrics.Curve(
                times.mean(axis=0),
                np.concatenate([of_all_seeds for of_all_seeds, _ in worst]),
                np.array([np.delete(times, i, axis=0).mean(axis=0) for i in range(len(times)) if len(times) > 1]),
                np.concatenate([without for _, without in worst], axis=1),
            ),
            "rel_mse": metrics.curve_of_means(
                [np.array([row["elapsed_s"] for row in rows]) for rows in self._rows],
                [np.array([row["true_rel_mse"] for row in rows]) for rows in self._rows],
            ),
        }

    def row(self, baseline: "_Measured | None", reference_p99: float) -> dict:
        rms = dict(zip(QUANTILES, self._rms, strict=True))
        true = {q: self._mean(f"true_{q}") for q in (*QUANTILES, "max")}
        energy = metrics.mean_over_seeds(self._each("true_energy_ratio"), self._reference.mean_relative_se)
        found = {
            "description": str(self._facts[0].get("strategy")),
            "below_reference": reference_p99 > min(rms["p99"], true["p99"]) / 4,
            "samples": self._mean("samples"),
            "spp": self._mean("spp"),
            "waves": float(np.mean([len(rows) for rows in self._rows])),
            "elapsed_s": self._mean("elapsed_s"),
            "device_s": self._mean("device_s"),
            "setup_s": float(np.mean([_number(facts.get("setup_s")) for facts in self._facts])),
            "rms": rms,
            "rms_freed": self._freed,
            "uniformity": rms["p99"] / rms["p50"] if rms["p50"] > 0 else math.nan,
            "stated": {q: self._mean(f"stated_{q}") for q in QUANTILES},
            "true": true,
            "stated_over_true": {q: self._stated_over_true(q) for q in QUANTILES},
            "coverage": self._mean("true_coverage"),
            "energy": _tested(energy, 1.0),
            "bias": _tested(self._bias, 0.0),
            "curves": {name: _band(curve) for name, curve in self._curves.items()},
        }
        found |= {
            name: self._mean(f"true_{name}")
            for name in ("rel_mse", "rel_mse_trimmed", "rel_mse_floor", "rel_mse_floor_trimmed")
        }
        return found | ({} if baseline is None else self._against(baseline))

    def _against(self, baseline: "_Measured") -> dict:
        with np.errstate(all="ignore"):
            ratio = np.log(self._rms / baseline._rms)
            without = np.log(self._rms_without / baseline._rms_without)
        curves = {name: (curve, baseline._curves[name]) for name, curve in self._curves.items()}
        return {
            "rms_ratio": {
                q: asdict(metrics.jackknife(ratio[i], without[:, i]).ratio()) for i, q in enumerate(QUANTILES)
            },
            "p99_ratio": self._paired(baseline, "true_p99"),
            "rel_mse_ratio": self._paired(baseline, "true_rel_mse"),
            "time_ratio": {name: asdict(metrics.time_ratio(*both)) for name, both in curves.items()},
        }

    def _paired(self, baseline: "_Measured", column: str) -> dict:
        return asdict(metrics.paired_ratio(self._each(column), baseline._each(column)))

    def _each(self, column: str) -> np.ndarray:
        return np.array([_number(row.get(column)) for row in self._last])

    def _mean(self, column: str) -> float:
        return float(self._each(column).mean())

    def _stated_over_true(self, quantile: str) -> float:
        with np.errstate(all="ignore"):
            return float(np.exp(np.log(self._each(f"stated_{quantile}") / self._each(f"true_{quantile}")).mean()))


def _band(curve: metrics.Curve) -> dict:
    """A curve with its 95 % interval: the jackknife's, of the logarithm."""
    with np.errstate(all="ignore"):
        logs, without = np.log(curve.error), np.log(curve.error_without)
    points = [metrics.jackknife(logs[k], without[:, k]).ratio() for k in range(len(logs))]
    return {
        "time": curve.time.tolist(),
        "error": curve.error.tolist(),
        "low": [point.low for point in points],
        "high": [point.high for point in points],
    }


def _tested(estimate: metrics.Estimate, null: float) -> dict:
    return asdict(estimate.interval()) | {"z": estimate.z(null), "critical": estimate.critical()}


def _quantiles(image: np.ndarray) -> dict[str, float]:
    return dict(zip(QUANTILES, np.quantile(image, list(QUANTILES.values())).tolist(), strict=True))


def _waves(results: Results) -> str:
    """Text of waves.csv: one row a wave of every finished run, in the plan's order."""
    names = [*columns(true_errors=True), "device_s"]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["scene", "strategy", "seed", *names])
    for scene in results.scenes:
        for strategy, runs in results.runs(scene["slug"]).items():
            for seed, run in runs.items():
                for row in run.rows:
                    writer.writerow([scene["slug"], strategy, seed, *(_cell(row.get(name)) for name in names)])
    return text.getvalue()


def _cell(value: object) -> str:
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return ""
    return format(value, ".9g") if isinstance(value, float) else str(value)


def _number(value: object) -> float:
    return math.nan if value is None else float(value)


def _plain(value):
    """Numpy's numbers as Python's, and None for what JSON has no number for."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _write_text(path: Path, text: str) -> None:
    write_atomically(path, lambda temporary: temporary.write_text(text, encoding="utf-8", newline="\n"))
