"""Folders of finished comparisons with simulated errors instead of renders, so that the true figures are known."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from isonoise.comparison.checked_files import write_image
from isonoise.comparison.identity import reference_identity, run_identity
from isonoise.comparison.plan import Plan, SceneEntry, StrategyEntry, run_path, variance_path, write_plan
from isonoise.comparison.recorder import SNAPSHOTS, Recorder
from isonoise.comparison.reference_files import ImageDigests, read_digests
from isonoise.error.true_error import true_error
from isonoise.film.log import LogRow
from isonoise.loop import Stops

QUANTILES = {"p50": 0.5, "p95": 0.95, "p99": 0.99}


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
    warm_up_spp: float | None = None,
    wanted: Collection[tuple[str, str]] | None = None,
) -> Path:
    """Write plan, references and runs to `directory`.

    Errors are normal with variance V / n. The relative variance V rises from left to right by a factor of 100. Stated
    errors are 0.98 times the errors against the true image.

    Parameters
    ----------
    strategies : mapping
        Spec -> function of V (height, width) that returns weights of the allocation.
    speed, bias : float
        Of all strategies but the first: samples over those of the first, and mean relative error.
    reference_se : float, optional
        The reference's relative standard error; its errors are normal. None: it is exact and says nothing about it.
    warm_up_spp : float, optional
        Of all strategies.
    wanted : collection of (scene, spec), optional
        The pairs that have runs. None: all.
    """
    slugs = {spec: spec.replace(":", "-").replace("=", "-").replace(",", "-") for spec in strategies}
    height, width = shape
    plan = Plan(
        version="",
        scenes=tuple(SceneEntry(s, s, s, f"hash of {s}", width, height, f"references/{s}.exr", None) for s in scenes),
        strategies=tuple(StrategyEntry(slugs[spec], spec, spec, spec) for spec in strategies),
        seeds=tuple(seeds),
        time=seconds,
        spp=None,
        device="a simulated device",
        reference_time=20 * seconds,
    )
    (directory / "references").mkdir(parents=True)
    write_plan(directory, plan)
    for number, entry in enumerate(plan.scenes):
        rng = np.random.default_rng([number, 0])
        variance = np.broadcast_to(np.geomspace(0.04, 4, width), shape) * rng.uniform(0.9, 1.1, shape)
        rgb = 0.5 + rng.random((height, width, 1)) * [0.9, 1.0, 1.1]
        noise = 1 + (reference_se or 0) * rng.normal(size=(height, width, 1))
        reference, se = (rgb * noise).astype(np.float32), ((reference_se or 0) * rgb).astype(np.float32)
        given = (reference, None if reference_se is None else se)
        digests = _write_references(directory, plan, entry, *given, variance)
        for index, (strategy, weights) in enumerate(zip(plan.strategies, strategies.values(), strict=True)):
            if wanted is not None and (entry.name, strategy.spec) not in wanted:
                continue
            weight = weights(variance)
            count = np.maximum(1, np.rint(spp * weight / weight.mean() * (speed if index else 1))).astype(np.uint32)
            for seed in seeds:
                path = run_path(directory, entry, strategy, seed)
                path.parent.mkdir(parents=True, exist_ok=True)
                identity = run_identity(plan, entry, strategy, seed, digests)
                seed_rng = np.random.default_rng([number, index, seed])
                facts = _facts(path, count, seconds, warm_up_spp)
                write_run(path, rgb, given, variance, count, seed_rng, bias * (index > 0), facts, identity)
    return directory


def _write_references(directory, plan, entry, reference, se, variance) -> ImageDigests:
    """Write a scene's reference and its variances; return what `read_digests` reads."""
    layers = {"": reference} | ({} if se is None else {"stderr": se})
    write_image(directory / entry.reference, layers, {}, reference_identity(plan, entry, "reference"))
    layers = {"variance": variance.astype(np.float32)}
    write_image(variance_path(directory, entry), layers, {}, reference_identity(plan, entry, "variance"))
    return read_digests(directory, plan, entry)


def _facts(path, count, seconds, warm_up_spp) -> dict:
    return {
        "strategy": path.parent.name,
        "scene": path.parent.parent.name,
        "seed": int(path.stem),
        "device": "a simulated device",
        "setup_s": 0.5,
        "samples": int(count.sum()),
        "elapsed_s": seconds,
        "warm_up_spp": warm_up_spp,
    }


def write_run(path, rgb, reference, variance, count, rng, bias, facts, identity) -> None:
    """One run with `SNAPSHOTS` waves, each of which doubles samples and time; `rgb` is the true image."""
    seconds = facts["elapsed_s"]
    recorder = Recorder(Stops(time=seconds), *reference)
    for k in range(SNAPSHOTS):
        fraction = 2.0 ** (k + 1 - SNAPSHOTS)
        e = bias + rng.normal(size=variance.shape) * np.sqrt(variance / (count * fraction))
        image = (rgb * (1 + e[..., None])).astype(np.float32)
        row = LogRow(
            elapsed_s=seconds * fraction,
            wave=k + 1,
            kind="adaptive" if k % 2 else "uniform",
            samples=int(count.sum() * fraction),
            spp=float(count.mean() * fraction),
            **{f"stated_{q}": float(0.98 * np.quantile(np.abs(e), p)) for q, p in QUANTILES.items()},
            true=replace(true_error(image, *reference), coverage=0.95),
            rejected=0,
        )
        recorder.wave(row, image, seconds * fraction * 0.97)
    path.write_bytes(recorder.pack(row, image, count, facts, identity))
