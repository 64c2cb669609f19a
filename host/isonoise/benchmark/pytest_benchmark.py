"""A measurement in the format of pytest-benchmark's files, for `pytest-benchmark compare` (`bench --pytest-benchmark`).

https://pytest-benchmark.readthedocs.io: its plugin writes what `Stats.as_dict` and `pytest_benchmark_generate_json`
return. A round is a run; a scene's time is that of a run without profiling, a kernel's that of all its launches.
"""

import platform
import statistics
from collections.abc import Mapping, Sequence

FORMAT_VERSION = "5.3.1"
"""Version of pytest-benchmark that this form follows."""


def pytest_benchmark_json(result: Mapping) -> dict[str, object]:
    """The content of the file. `result` is what `isonoise bench --json` writes."""
    device = result["device"]
    benchmarks = []
    for scene in result["scenes"]:
        name = scene["scene"]
        facts = {key: scene[key] for key in ("scene_hash", "width", "height", "max_depth", "samples")}
        benchmarks.append(_benchmark("scenes", name, scene["runs_s"], facts))
        benchmarks += [
            _benchmark("kernels", f"{name}/{row['kernel']}", row["runs_s"], facts | {"items": row["items"]})
            for row in scene["kernels"]
        ]
    return {
        "machine_info": {
            "node": result["host"],
            "processor": platform.processor(),
            "machine": platform.machine(),
            "python_implementation": platform.python_implementation(),
            "python_version": platform.python_version(),
            "release": platform.release(),
            "system": platform.system(),
            "cpu": {"brand_raw": result["cpu_model"]},
            "opencl_device": dict(device),
        },
        "commit_info": {
            "id": result["commit"] or "unversioned",
            "time": None,
            "author_time": None,
            "dirty": bool(result["has_local_changes"]),
            "project": "isonoise",
            "branch": "(unknown)",
        },
        "benchmarks": benchmarks,
        "datetime": result["date"],
        "version": FORMAT_VERSION,
    }


def _benchmark(group: str, name: str, seconds: Sequence[float], facts: Mapping) -> dict[str, object]:
    return {
        "group": group,
        "name": name,
        "fullname": f"isonoise bench::{name}",
        "params": None,
        "param": None,
        "extra_info": dict(facts),
        "options": {},
        "stats": _statistics(seconds),
    }


def _statistics(seconds: Sequence[float]) -> dict[str, object]:
    """Figures of the seconds of the rounds, by pytest-benchmark's names; quartiles interpolate between rounds."""
    mean, rounds = statistics.mean(seconds), len(seconds)
    stddev = statistics.stdev(seconds) if rounds > 1 else 0
    q1, median, q3 = statistics.quantiles(seconds, n=4, method="inclusive") if rounds > 1 else [seconds[0]] * 3
    low, high = q1 - 1.5 * (q3 - q1), q3 + 1.5 * (q3 - q1)
    stddev_outliers = sum(not mean - stddev <= each <= mean + stddev for each in seconds)
    iqr_outliers = sum(not low <= each <= high for each in seconds)
    return {
        "min": min(seconds),
        "max": max(seconds),
        "mean": mean,
        "stddev": stddev,
        "rounds": rounds,
        "median": median,
        "iqr": q3 - q1,
        "q1": q1,
        "q3": q3,
        "iqr_outliers": iqr_outliers,
        "stddev_outliers": stddev_outliers,
        "outliers": f"{stddev_outliers};{iqr_outliers}",
        "ld15iqr": min(each for each in seconds if each >= low),
        "hd15iqr": max(each for each in seconds if each <= high),
        "ops": 1 / mean if mean else 0,
        "total": sum(seconds),
        "data": list(seconds),
        "iterations": 1,
    }
