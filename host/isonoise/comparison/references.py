"""Renders references and single-sample variances in reference batches; called by `runner`; resumes from stored ones.

Both are unbiased: every reference batch is an independent render, with a seed that no run has, of an allocation map
that is fixed before its first sample. So no sample influences the number of samples.
"""

import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Protocol

import numpy as np

from isonoise.comparison.checked_files import (
    InvalidFileError,
    pack_npz,
    read_image,
    read_npz,
    write_image,
    write_packed,
)
from isonoise.comparison.identity import reference_identity
from isonoise.comparison.plan import FIRST_REFERENCE_SEED, Plan, SceneEntry, variance_path
from isonoise.comparison.reference_batch import BATCHES, PILOT_SHARE, Batch, Pilot
from isonoise.loop import Stops
from isonoise.luminance import luminance
from isonoise.progress import format_duration, format_number, format_percent
from isonoise.statistics import Statistics
from isonoise.strategies.measures import image_floor

MIN_BATCHES = 8
"""Rendered even if the time is over."""
_PILOT_SEEDS = {"reference": FIRST_REFERENCE_SEED, "variance": FIRST_REFERENCE_SEED + 2**62}
"""Seed of the pilot run; the batches have the next ones."""

Show = Callable[[float, float, str], None]


class RenderBatches(Protocol):
    """What `LocalBatches` and `ClusterBatches` have in common. Methods raise UserError."""

    def allocation(self, scene: SceneEntry, pilot: Pilot) -> np.ndarray:
        """The allocation map of a batch."""

    def render(self, scene: SceneEntry, allocation: np.ndarray, seeds: range) -> Iterable[Batch]:
        """Batches with the first of these seeds, at least one, in their order."""


@dataclass
class BatchSums:
    """Running statistics of the batches. All batches have the same map, so their means have equal weight."""

    allocation: np.ndarray  # uint32 (height, width): samples per pixel of a batch
    seconds: float = 0.0
    batches: int = 0
    rgb: np.ndarray | float = 0.0  # mean over the batches, float64 (height, width, 3)
    rgb_m2: np.ndarray | float = 0.0  # sum over the batches of squared deviations
    count: np.ndarray | float = 0.0  # samples, float64 (height, width)
    mean: np.ndarray | float = 0.0  # luminance, mean over the batches
    mean_m2: np.ndarray | float = 0.0  # sum over the batches of squared deviations of the luminance

    def add(self, statistics: Statistics | Batch, seconds: float) -> None:
        """Add a batch (Welford 1962)."""
        self.seconds += seconds
        self.batches += 1
        deviation = statistics.rgb - self.rgb
        self.rgb = self.rgb + deviation / self.batches
        self.rgb_m2 = self.rgb_m2 + deviation * (statistics.rgb - self.rgb)

        deviation = statistics.mean - self.mean
        self.mean = self.mean + deviation / self.batches
        self.mean_m2 = self.mean_m2 + deviation * (statistics.mean - self.mean)
        self.count = self.count + statistics.count.astype(np.float64)

    def standard_error(self) -> np.ndarray:
        """Standard error of `rgb` from the variance between batches, float64 (height, width, 3)."""
        return np.sqrt(self.rgb_m2 / (self.batches * (self.batches - 1)))

    def relative_variance(self) -> np.ndarray:
        """n times the variance of the mean of a batch of n samples, over max(mean, floor)^2, float64 (height, width).

        That is the variance of one sample if samples are independent.
        """
        variance = self.allocation * self.mean_m2 / (self.batches - 1)
        scale = np.maximum(self.mean, image_floor(self.mean))
        return np.divide(variance, scale**2, out=np.zeros_like(variance), where=scale > 0)


class ReferenceRenderer:
    """Renders the references and variances of a comparison that are missing, damaged or of something else.

    Parameters
    ----------
    batches : LocalBatches or ClusterBatches
        Renders pilot runs and batches.
    plan : Plan
        Its `reference_time` is the budget in seconds; None: REFERENCE_BUDGET_FACTOR times the samples of a run.
    directory : Path
        The comparison's folder.
    log, warn : callable
        For a line about a finished file, and about one that is rendered again.
    """

    def __init__(
        self,
        batches: RenderBatches,
        plan: Plan,
        directory: Path,
        log: Callable[[str], None],
        warn: Callable[[str], None],
    ):
        self._batches, self._plan, self._directory, self._log, self._warn = batches, plan, directory, log, warn
        self._budget = Stops(time=plan.reference_time, spp=plan.spp if plan.reference_time is None else None)

    def ensure_reference(self, scene: SceneEntry, show: Show) -> None:
        """Render the scene's reference, unless a valid one exists or one was given; `show` is the progress bar's.

        A pilot run of the strategy relative-mean determines the map: half of a batch's samples are uniform, the other
        half goes to the pixels with the largest relative errors. The file has R, G, B, their standard errors stderr.R,
        stderr.G, stderr.B from the variance between batches, and `samples`. Raises UserError if a file cannot be
        written.
        """
        path = self._directory / scene.reference
        identity = reference_identity(self._plan, scene, "reference")
        if scene.reference_sha256 is not None or self._is_finished(path, identity):
            return
        sums = self._accumulate(scene, path, identity, show)
        rgb, error = sums.rgb, sums.standard_error()
        samples = np.minimum(sums.count, 2**32 - 1).astype(np.uint32)
        _finish(path, {"": rgb, "stderr": error, "samples": samples}, scene, identity, sums)
        r = luminance(rgb)
        floor = image_floor(r)
        scale = np.maximum(r, floor)
        relative = np.divide(luminance(error), scale, out=np.zeros_like(scale), where=scale > 0)
        self._log(
            f"{scene.name}  reference  {format_duration(sums.seconds)}  "
            f"{format_number(sums.count.mean(), 4)} samples per pixel  "
            f"p99 of its standard error {format_percent(float(np.quantile(relative, 0.99)))}"
        )

    def ensure_variance(self, scene: SceneEntry, show: Show) -> None:
        """Render the file of the strategy `oracle`: layer `variance`, d s^2 / max(mean, floor)^2 of one sample.

        The batches are uniform; they have the budget of a reference. Otherwise as `ensure_reference`.
        """
        path = variance_path(self._directory, scene)
        identity = reference_identity(self._plan, scene, "variance")
        if self._is_finished(path, identity):
            return
        sums = self._accumulate(scene, path, identity, show)
        _finish(path, {"variance": sums.relative_variance()}, scene, identity, sums)
        self._log(
            f"{scene.name}  variance for oracles  {format_duration(sums.seconds)}  "
            f"{format_number(sums.count.mean(), 4)} samples per pixel"
        )

    def _is_finished(self, path: Path, identity: Mapping) -> bool:
        try:
            read_image(path, identity)
        except InvalidFileError as error:
            self._warn_of_invalid(path, error)
            return False
        _partial_path(path).unlink(missing_ok=True)  # of a process that was killed before it removed it
        return True

    def _accumulate(self, scene: SceneEntry, path: Path, identity: Mapping, show: Show) -> BatchSums:
        """Render the batches that are missing."""
        partial, kind = _partial_path(path), identity["kind"]
        try:
            sums = _load(partial, identity)
        except InvalidFileError as error:
            self._warn_of_invalid(partial, error)
            pilot = Pilot(kind, _PILOT_SEEDS[kind], self._budget)
            sums = BatchSums(self._batches.allocation(scene, pilot))
            _save(partial, sums, identity)
        while (missing := _missing(sums, self._budget)) > 0:
            total = sums.batches + missing
            first_seed = _PILOT_SEEDS[kind] + 1 + sums.batches
            rendered = self._batches.render(scene, sums.allocation, range(first_seed, first_seed + missing))
            show(sums.batches, total, f"{scene.name}, {kind}, batch {sums.batches + 1} of {total}")
            for batch in rendered:
                sums.add(batch, batch.seconds)
                _save(partial, sums, identity)
                show(sums.batches, total, f"{scene.name}, {kind}, batch {sums.batches + 1} of {total}")
        return sums

    def _warn_of_invalid(self, path: Path, error: InvalidFileError) -> None:
        if os.path.lexists(path):
            self._warn(f"'{path}' is rendered again: {error.reason}")


def _missing(sums: BatchSums, budget: Stops) -> int:
    """Number of batches that are still to be rendered."""
    if budget.time is None:
        return BATCHES - sums.batches
    if sums.batches < MIN_BATCHES:
        return MIN_BATCHES - sums.batches
    remaining = (1 - PILOT_SHARE) * budget.time - sums.seconds
    return round(remaining / (sums.seconds / sums.batches))


def _partial_path(path: Path) -> Path:
    """File of the finished batches of the image `path`."""
    return path.with_suffix(".partial.npz")


def _load(path: Path, identity: Mapping) -> BatchSums:
    file = read_npz(path, identity)
    values = {field.name: file[field.name] for field in fields(BatchSums)}
    return BatchSums(**{name: value if value.ndim else value.item() for name, value in values.items()})


def _save(path: Path, sums: BatchSums, identity: Mapping) -> None:
    arrays = {name: np.asarray(value) for name, value in vars(sums).items()}
    write_packed(path, pack_npz(arrays, identity, compressed=False))


def _finish(
    path: Path, layers: Mapping[str, np.ndarray], scene: SceneEntry, identity: Mapping, sums: BatchSums
) -> None:
    header = {"scene": scene.name, "scene_hash": scene.hash, "batches": sums.batches, "time_s": sums.seconds}
    write_image(path, layers, {f"isonoise.{key}": value for key, value in header.items()}, identity)
    _partial_path(path).unlink(missing_ok=True)
