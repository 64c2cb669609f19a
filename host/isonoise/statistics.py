"""Per-pixel sample statistics: which of them a strategy needs, and the arrays that the host reads from the device."""

import math
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from numbers import Real
from typing import TYPE_CHECKING, Any

import numpy as np

from isonoise.errors import UserError
from isonoise.layers import device_layers

if TYPE_CHECKING:
    from numpy.typing import DTypeLike


@dataclass(frozen=True)
class Needs:
    """Optional statistics that a strategy reads. The device keeps only those that are needed.

    Count, mean and variance are always kept.

    Parameters
    ----------
    median : bool
        Keep M_x, the running mean of chunk medians.
    chunk : int
        Entries per chunk, odd, 1 to 31. An entry is the mean of `batch` consecutive samples.
    batch : int
        Samples per entry, 1 to 65536.
    power : float or None
        Keep the mean of x^q for this q > 0 (of x ln x for q = 1), in float32. Not needed for q = 2: mean and variance
        hold the same information.
    half : bool
        Keep the mean of every second sample.
    neighbours : int or None
        Average mean and variance of the neighbours: of the pixels in a square of this odd number of pixels per side, 3
        to 31, around each pixel.
    nets : bool
        Keep means over nets, from which the design effect is estimated. Set by the renderer for the sampler sobol.
    uniform : bool
        Keep count, mean and variance of the samples of uniform waves. Not on the device but on the host, which reads
        the statistics before and after every uniform wave.
    layers : tuple of str
        Layers that the device makes (`isonoise.layers.device_layers`). Set by the renderer.

    Raises
    ------
    UserError
        If a value is out of range.
    """

    median: bool = False
    chunk: int = 5
    batch: int = 1
    power: float | None = None
    half: bool = False
    neighbours: int | None = None
    nets: bool = False
    uniform: bool = False
    layers: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "layers", tuple(self.layers))  # JSON has lists only
        if self.chunk not in range(1, 32, 2):
            raise UserError(f"Needs: chunk = {self.chunk} must be an odd number from 1 to 31, so that it has a median")
        if self.batch not in range(1, 65537):
            raise UserError(f"Needs: batch = {self.batch} must be a whole number from 1 to 65536")
        if self.power is not None and not (isinstance(self.power, Real) and 0 < self.power < math.inf):
            raise UserError(f"Needs: power = {self.power} must be a finite number above 0")
        if self.neighbours is not None and self.neighbours not in range(3, 32, 2):
            raise UserError(f"Needs: neighbours = {self.neighbours} must be an odd number from 3 to 31")

    def with_sampler(self, sampler: str) -> "Needs":
        """These statistics, and those that the error of samples from this sampler needs."""
        return replace(self, nets=sampler == "sobol")

    def with_layers(self, names: tuple[str, ...]) -> "Needs":
        """These statistics, and the layers that the device makes for those of these names."""
        return replace(self, layers=device_layers(names))


BASIC_NEEDS = Needs()
"""Only the statistics that are always kept."""


class _ReadWhenUsed:
    """An array attribute that may be set to a function: it is called at the first use, for the array."""

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    def __set__(self, instance: object, value: np.ndarray | Callable[[], np.ndarray]) -> None:
        vars(instance)[self._name] = value

    def __get__(self, instance: object, owner: type) -> np.ndarray:
        if instance is None:
            raise AttributeError(self._name)  # so that a dataclass has no default
        value: np.ndarray | Callable[[], np.ndarray] = vars(instance)[self._name]
        if callable(value):
            value = vars(instance)[self._name] = value()
        return value


@dataclass(frozen=True, repr=False)
class Statistics:
    """Statistics of the samples of every pixel, in the scene's units.

    x is a sample's luminance (Rec. 709), n the pixel's sample count. Samples that are negative or not finite count
    in `rejected` alone. A renderer returns read-only arrays, the same ones until its next wave.

    Attributes
    ----------
    count : (height, width) uint32
        n, samples that entered.
    rejected : (height, width) uint32
        Samples that were negative or not finite.
    rgb : (height, width, 3) float32
        Mean linear RGB; 0 where n = 0. A renderer reads it when it is first used, or before its next wave.
    mean : (height, width) float64
        Mean of x; 0 where n = 0.
    variance : (height, width) float32 or float64
        Sample variance s^2 of x, with n - 1; 0 where n < 2.
    median : (height, width) float64 or None
        M_x, the running mean of the chunk medians; None unless needed. Before the first full chunk it is the median of
        the entries so far, before the first entry the mean of the samples.
    power : (height, width) float64 or None
        Mean of max(x, 0)^q, or of x ln x for q = 1; None unless needed.
    half : (height, width, 3) float32 or None
        Mean RGB of samples 2, 4, 6, ...; None unless needed.
    design_effect : (height, width) float32 or None
        Variance of the mean over that of as many independent samples (Kish 1965, "Survey sampling"). None: 1
        everywhere.
    neighbour_mean : (height, width) float32 or float64, or None
        Average mean of x over the neighbours with two samples or more (`Needs.neighbours`), without the pixel itself; 0
        without such neighbours. None unless needed.
    neighbour_variance : (height, width) float32 or float64, or None
        Average of d s^2 over them, d the design effect; inf without such neighbours. None unless needed.
    uniform : Statistics or None
        Count, mean and variance of the samples of uniform waves, without RGB and design effect; None unless needed.
    """

    count: np.ndarray
    rejected: np.ndarray
    if TYPE_CHECKING:
        rgb: np.ndarray
    else:
        rgb: np.ndarray = _ReadWhenUsed()
    mean: np.ndarray
    variance: np.ndarray
    median: np.ndarray | None
    power: np.ndarray | None = None
    half: np.ndarray | None = None
    design_effect: np.ndarray | None = None
    neighbour_mean: np.ndarray | None = None
    neighbour_variance: np.ndarray | None = None
    uniform: "Statistics | None" = None

    def __repr__(self) -> str:
        """Size, samples and the names of the arrays that are there; reads nothing from the device."""
        height, width = self.shape
        names = [field.name for field in fields(self) if vars(self).get(field.name) is not None]
        return f"<isonoise.Statistics: {width}x{height} pixels, {self.samples:,} samples; {', '.join(names)}>"

    def variance_of_mean(self, rows: slice = slice(None)) -> np.ndarray:
        """d s^2 / n, d the design effect: the squared standard error of the mean of x, a new array; inf where n < 2.

        Parameters
        ----------
        rows : slice
            Rows of the image.

        Returns
        -------
        (height, width) float64, of these rows, in the scene's squared units
        """
        count = self.count[rows]
        result = np.full(count.shape, np.inf)
        np.divide(self.variance_per_sample(rows), count, out=result, where=count >= 2)
        return result

    def variance_per_sample(self, rows: slice = slice(None), dtype: "DTypeLike" = np.float64) -> np.ndarray:
        """d s^2: the variance of independent samples, as many, with the same error of the mean. Do not write to it.

        Parameters
        ----------
        rows : slice
            Rows of the image.
        dtype : numpy type
            Of the result.

        Returns
        -------
        (height, width), of these rows, in the scene's squared units
        """
        if self.design_effect is None:
            return self.variance[rows].astype(dtype, copy=False)
        factors = self.design_effect[rows], self.variance[rows]
        variance: np.ndarray = np.multiply(*factors, dtype=dtype, casting="same_kind")
        return variance

    def planes(self) -> dict[str, np.ndarray]:
        """The arrays by name, without those that are None."""
        planes = {field.name: getattr(self, field.name) for field in fields(self) if field.name != "uniform"}
        return {name: plane for name, plane in planes.items() if plane is not None}

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width)."""
        return self.count.shape

    @property
    def samples(self) -> int:
        """Samples that entered so far, over the whole image."""
        return int(self.count.sum(dtype=np.int64))


class UniformSamples:
    """Sums over every pixel's samples that came in uniform waves, from the statistics before and after each wave.

    Attributes
    ----------
    sums : (3, height, width) float64
        Count, sum of x and sum of x^2; during a uniform wave without the samples before it.
    """

    def __init__(self, shape: tuple[int, int]):
        self.sums = np.zeros((3, *shape))

    def begin_wave(self, before: Statistics) -> None:
        """Begin a uniform wave; `before` are the statistics before it."""
        self.sums -= _sums(before)

    def end_wave(self, after: Statistics) -> None:
        """Add the samples of the uniform wave; `after` are the statistics after it."""
        self.sums += _sums(after)

    def statistics(self, statistics: Statistics) -> Statistics:
        """Count, mean and variance of the samples so far; what else `statistics` has is left out."""
        count, total, squares = self.sums
        mean = np.divide(total, count, out=np.zeros_like(total), where=count > 0)
        variance = np.zeros_like(mean)
        np.divide(squares - total * mean, count - 1, out=variance, where=count >= 2)
        np.maximum(variance, 0, out=variance)  # below 0 by rounding only
        no_rgb: Any = None
        return Statistics(count.astype(np.uint32), statistics.rejected, no_rgb, mean, variance, None)


def _sums(statistics: Statistics) -> np.ndarray:
    count, mean = statistics.count.astype(np.float64), statistics.mean
    return np.stack([count, count * mean, np.maximum(count - 1, 0) * statistics.variance + count * mean * mean])
