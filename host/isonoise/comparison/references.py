"""References and single-sample variances that a comparison renders for itself, in batches that are kept as they come.

Both are unbiased: a batch is an independent render, with a seed of its own that no run has, of an allocation map that
was fixed before its first sample. So no sample decides how many others there are.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from isonoise.comparison.plan import REFERENCE_SHARE, SEEDS, SceneEntry
from isonoise.errors import UserError
from isonoise.film.exr import write_exr
from isonoise.film.files import write_atomically
from isonoise.loop import Stops, render_loop
from isonoise.luminance import luminance
from isonoise.progress import format_duration, format_percent
from isonoise.renderer import Renderer
from isonoise.statistics import Statistics
from isonoise.strategies import Strategy, Wave
from isonoise.strategies.allocation import deficit
from isonoise.strategies.measures import image_floor, relative_mean, variance_of_one

BATCHES = 32
"""Independent renders that a reference is made of: its standard errors have 31 degrees of freedom, good to 13 %."""
FEWEST = 8
"""Batches that there are at least, however slow they turn out."""
PILOT_SHARE = 0.05
"""Of a reference's budget, for the render that decides its map."""
SPREAD = 16
"""A pixel gets at most this many times the samples of the uniform half of the map. In the penumbra 16 takes the p99 of
the relative standard error to 0.41 of a uniform map's and 4 to 0.71; among bright spots 64 makes it worse than uniform,
because the pilot has not seen most of them."""
CLIP = 0.999
"""Quantile over the pixels at which the pilot's variance is cut for the map."""
_STREAMS = {"reference": SEEDS, "variance": SEEDS + 2**62}
"""First seed of each; it is the pilot's, the next ones are the batches'."""

MakeRenderer = Callable[..., Renderer]
Show = Callable[[float, float, str], None]


@dataclass
class Sums:
    """All batches so far. Batches have the same map, so their means count alike."""

    allocation: np.ndarray  # uint32 (height, width): the map of a batch
    seconds: float = 0.0
    batches: int = 0
    rgb: np.ndarray | float = 0.0  # mean over the batches, float64 (height, width, 3)
    rgb_m2: np.ndarray | float = 0.0  # sum over the batches of squared differences from it
    count: np.ndarray | float = 0.0  # samples, float64 (height, width)
    mean: np.ndarray | float = 0.0  # luminance over all samples
    m2: np.ndarray | float = 0.0  # sum over all samples of squared differences from it

    def add(self, statistics: Statistics, seconds: float) -> None:
        """Takes in a batch: Welford 1962 over the batches; Chan, Golub, LeVeque 1983 over the samples."""
        self.seconds += seconds
        self.batches += 1
        off = statistics.rgb - self.rgb
        self.rgb = self.rgb + off / self.batches
        self.rgb_m2 = self.rgb_m2 + off * (statistics.rgb - self.rgb)

        n = statistics.count.astype(np.float64)
        total = self.count + n
        difference = statistics.mean - self.mean
        share = n / np.maximum(total, 1)
        self.m2 = self.m2 + statistics.variance * np.maximum(n - 1, 0) + difference**2 * self.count * share
        self.mean = self.mean + difference * share
        self.count = total

    def standard_error(self) -> np.ndarray:
        """Of `rgb`, from the spread of the batches; float64 (height, width, 3)."""
        return np.sqrt(self.rgb_m2 / (self.batches * (self.batches - 1)))

    def relative_variance(self) -> np.ndarray:
        """s^2 / max(mean, floor)^2 of the luminance of one sample, float64 (height, width)."""
        variance = self.m2 / np.maximum(self.count - 1, 1)
        scale = np.maximum(self.mean, image_floor(self.mean))
        return np.divide(variance, scale**2, out=np.zeros_like(variance), where=scale > 0)


def ensure_reference(
    make: MakeRenderer, scene: SceneEntry, directory: Path, budget: Stops, say: Callable[[str], None], show: Show
) -> None:
    """Render the scene's reference below `directory` unless it is there or was given; goes on where it was stopped.

    A pilot run of the strategy relative-mean decides the map: half of a batch's samples are uniform, the other half
    fills up the pixels whose relative error would be largest. The file has R, G, B, the standard errors stderr.R,
    stderr.G, stderr.B from the spread of the batches, and `samples`.

    - `make`: makes a renderer of the scene from keyword arguments of `Renderer`.
    - `budget`: seconds, or the samples per pixel of a run; these are taken REFERENCE_SHARE times.

    Raises UserError if a file cannot be read or written.
    """
    path = directory / scene.reference
    if scene.reference_sha256 is None and not path.exists():
        sums = _accumulate(make, scene, path, budget, "reference", show)
        rgb, error = sums.rgb, sums.standard_error()
        samples = np.minimum(sums.count, 2**32 - 1).astype(np.uint32)
        _finish(path, {"": rgb, "stderr": error, "samples": samples}, scene, sums)
        r = luminance(rgb)
        floor = image_floor(r)
        scale = np.maximum(r, floor)
        relative = np.divide(luminance(error), scale, out=np.zeros_like(scale), where=scale > 0)
        say(
            f"{scene.name}  reference  {format_duration(sums.seconds)}  {sums.count.mean():.4g} samples per pixel  "
            f"p99 of its standard error {format_percent(float(np.quantile(relative, 0.99)))}"
        )


def ensure_variance(
    make: MakeRenderer, scene: SceneEntry, directory: Path, budget: Stops, say: Callable[[str], None], show: Show
) -> None:
    """The same for what oracles know: layer `variance`, s^2 / max(mean, floor)^2 of one sample, from uniform batches.

    It takes as long again as a reference.
    """
    path = directory / "references" / f"{scene.slug}-variance.exr"
    if not path.exists():
        sums = _accumulate(make, scene, path, budget, "variance", show)
        _finish(path, {"variance": sums.relative_variance()}, scene, sums)
        say(
            f"{scene.name}  variance for oracles  {format_duration(sums.seconds)}  "
            f"{sums.count.mean():.4g} samples per pixel"
        )


def _accumulate(make: MakeRenderer, scene: SceneEntry, path: Path, budget: Stops, kind: str, show: Show) -> Sums:
    partial = path.with_suffix(".partial.npz")
    sums = _load(partial) if partial.exists() else Sums(_map(make, scene, budget, kind))
    path.parent.mkdir(parents=True, exist_ok=True)
    _save(partial, sums)
    while (missing := _missing(sums, budget)) > 0:
        total = sums.batches + missing
        show(sums.batches, total, f"{scene.name}, {kind}, batch {sums.batches + 1} of {total}")
        seed = _STREAMS[kind] + 1 + sums.batches
        # one wave of the whole map: the renderer's clock has set-up and reading apart
        renderer = make(scene, strategy=_Fixed(sums.allocation), seed=seed)
        seconds = renderer.step().seconds
        sums.add(renderer.statistics(), seconds)
        _save(partial, sums)
    return sums


def _missing(sums: Sums, budget: Stops) -> int:
    """Batches to come."""
    if budget.time is None:
        return BATCHES - sums.batches
    if sums.batches < FEWEST:
        return FEWEST - sums.batches
    left = (1 - PILOT_SHARE) * budget.time - sums.seconds
    return round(left / (sums.seconds / sums.batches))


def _map(make: MakeRenderer, scene: SceneEntry, budget: Stops, kind: str) -> np.ndarray:
    """The allocation map of a batch, by a pilot run whose samples are thrown away."""
    strategy = "relative-mean" if kind == "reference" else "uniform"
    by_time = budget.time is not None
    share = PILOT_SHARE * (1 if by_time else REFERENCE_SHARE)
    stops = Stops(time=share * budget.time) if by_time else Stops(spp=max(share * budget.spp, 16))
    outcome = render_loop(make(scene, strategy=strategy, seed=_STREAMS[kind]), stops)
    statistics = outcome.statistics
    pixels = statistics.count.size
    if by_time:
        speed = statistics.samples / outcome.elapsed_s
        spp = speed * (1 - PILOT_SHARE) * budget.time / BATCHES / pixels
    else:
        spp = REFERENCE_SHARE * budget.spp / BATCHES
    # every pixel needs a sample in every batch, and a batch must be one wave
    spp = min(max(round(spp), 2), 2**20)
    if kind == "variance":
        return np.full(statistics.shape, spp, np.uint32)
    return fixed_map(statistics, spp)


def fixed_map(statistics: Statistics, spp: int) -> np.ndarray:
    """uint32 (height, width), `spp` (from 2) samples per pixel on average: half uniform, half by the pilot's errors."""
    uniform = np.full(statistics.shape, (spp + 1) // 2, np.uint32)
    variance = variance_of_one(statistics, relative_mean(statistics, image_floor(statistics.mean)))
    rest = spp * uniform.size - int(uniform.sum(dtype=np.int64))
    return uniform + deficit(uniform, variance, rest, 0, clip=CLIP, cap=SPREAD)


class _Fixed(Strategy):
    """One map, whatever the samples say."""

    name = "fixed"

    def __init__(self, allocation: np.ndarray):
        self._allocation = allocation

    def waves(self) -> Iterator[Wave]:
        while True:
            yield Wave("adaptive", float(self._allocation.mean(dtype=np.float64)))

    def allocate(self, statistics: Statistics, budget: int) -> np.ndarray:
        return self._allocation


def _load(path: Path) -> Sums:
    try:
        with np.load(path) as file:
            values = {field.name: file[field.name] for field in fields(Sums)}
    except (OSError, ValueError, KeyError) as error:
        raise UserError(f"cannot read '{path}' ({error}); delete it to begin this reference anew") from error
    return Sums(**{name: value if value.ndim else value.item() for name, value in values.items()})


def _save(path: Path, sums: Sums) -> None:
    write_atomically(path, lambda temporary: np.savez(temporary, **vars(sums)))


def _finish(path: Path, layers: dict[str, np.ndarray], scene: SceneEntry, sums: Sums) -> None:
    header = {"scene": scene.name, "scene_hash": scene.hash, "batches": sums.batches, "time_s": sums.seconds}
    write_exr(path, layers, {f"isonoise.{key}": value for key, value in header.items()})
    path.with_suffix(".partial.npz").unlink()
