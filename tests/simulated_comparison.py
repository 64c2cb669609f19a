"""Folders of finished comparisons with simulated errors instead of renders, so that the true figures are known."""

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from isonoise.comparison.plan import Plan, SceneEntry, StrategyEntry, write_plan
from isonoise.comparison.recorder import SNAPSHOTS
from isonoise.film.exr import write_exr
from isonoise.film.log import columns
from isonoise.luminance import luminance
from isonoise.strategies.measures import image_floor


def make_comparison(
    directory: Path,
    scenes: Sequence[str],
    strategies: Mapping[str, Callable[[np.ndarray], np.ndarray]],
    seeds: Sequence[int] = (1, 2, 3, 4),
    shape: tuple[int, int] = (24, 32),
    spp: int = 64,
    seconds: float = 4.0,
    speed: float = 1.0,
    bias: float = 0.0,
    reference_se: float | None = 1e-4,
) -> Path:
    """Write plan, references and runs to `directory`.

    Errors are normal with variance V / n. The relative variance V rises from left to right by a factor of 100.

    Parameters
    ----------
    strategies : mapping
        Spec -> function of V (height, width) that returns weights of the allocation.
    speed, bias : float
        Samples over those of the first strategy, and mean relative error, of all other strategies.
    reference_se : float, optional
        The reference's stated relative standard error; None for none.
    """
    slugs = {spec: spec.replace(":", "-").replace("=", "-").replace(",", "-") for spec in strategies}
    height, width = shape
    plan = Plan(
        version="",
        scenes=tuple(SceneEntry(s, s, s, "", width, height, f"references/{s}.exr", None) for s in scenes),
        strategies=tuple(StrategyEntry(slugs[spec], spec, spec, spec) for spec in strategies),
        seeds=tuple(seeds),
        time=seconds,
        spp=None,
        size=None,
        max_depth=None,
        device="a simulated device",
        reference_time=None,
    )
    (directory / "references").mkdir(parents=True)
    write_plan(directory, plan)
    for number, scene in enumerate(scenes):
        rng = np.random.default_rng([number, 0])
        variance = np.broadcast_to(np.geomspace(0.04, 4, width), shape) * rng.uniform(0.9, 1.1, shape)
        rgb = (0.5 + rng.random((height, width, 1)) * [0.9, 1.0, 1.1]).astype(np.float32)
        layers = {"": rgb} | ({} if reference_se is None else {"stderr": (reference_se * rgb).astype(np.float32)})
        write_exr(directory / "references" / f"{scene}.exr", layers, {})
        write_exr(directory / "references" / f"{scene}-variance.exr", {"variance": variance.astype(np.float32)}, {})
        for index, (spec, weights) in enumerate(strategies.items()):
            weight = weights(variance)
            count = np.maximum(1, np.rint(spp * weight / weight.mean() * (speed if index else 1))).astype(np.uint32)
            for seed in seeds:
                path = directory / "runs" / scene / slugs[spec] / f"{seed}.npz"
                write_run(
                    path,
                    rgb,
                    variance,
                    count,
                    np.random.default_rng([number, index, seed]),
                    seconds,
                    bias * (index > 0),
                )
    return directory


def write_run(path, rgb, variance, count, rng, seconds, bias) -> None:
    """One run with `SNAPSHOTS` waves, each of which doubles samples and time."""
    r = luminance(rgb)
    scale = np.maximum(r, image_floor(r))
    errors, rows = [], []
    for k in range(SNAPSHOTS):
        fraction = 2.0 ** (k + 1 - SNAPSHOTS)
        e = bias + rng.normal(size=r.shape) * np.sqrt(variance / (count * fraction))
        errors.append(e.astype(np.float16))
        difference = e * scale
        p50, p95, p99 = np.quantile(np.abs(e), (0.5, 0.95, 0.99))
        squares = np.sort((difference[..., None] ** 2 / (rgb**2 + 0.01)).mean(axis=-1).ravel())
        row = dict.fromkeys(columns(true_errors=True), 0.0)
        row |= {
            "elapsed_s": seconds * fraction,
            "wave": k + 1,
            "kind": "adaptive" if k % 2 else "uniform",
            "samples": int(count.sum() * fraction),
            "spp": float(count.mean() * fraction),
            "stated_p50": p50 * 0.98,
            "stated_p95": p95 * 0.98,
            "stated_p99": p99 * 0.98,
            "true_p50": p50,
            "true_p95": p95,
            "true_p99": p99,
            "true_max": float(np.abs(e).max()),
            "true_rel_mse": float(squares.mean()),
            "true_rel_mse_trimmed": float(squares[: -max(1, squares.size // 1000)].mean()),
            "true_energy_ratio": float((r + difference).mean() / r.mean()),
            "true_coverage": 0.95,
            "device_s": seconds * fraction * 0.97,
        }
        rows.append({key: float(value) if isinstance(value, np.floating) else value for key, value in row.items()})
    facts = {
        "strategy": path.parent.name,
        "scene": path.parent.parent.name,
        "seed": int(path.stem),
        "device": "a simulated device",
        "setup_s": 0.5,
        "samples": int(count.sum()),
        "elapsed_s": seconds,
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(
        path,
        rows=json.dumps(rows),
        snapshot_s=np.array([row["elapsed_s"] for row in rows]),
        snapshot_samples=np.array([row["samples"] for row in rows]),
        errors=np.array(errors),
        count=count,
        facts=json.dumps(facts),
    )
