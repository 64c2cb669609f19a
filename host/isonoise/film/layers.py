"""The layers of an image beside its colour, those that the host makes included, and their channels in files."""

from collections.abc import Callable, Iterator, Mapping
from typing import Protocol, runtime_checkable

import numpy as np

from isonoise.errors import UserError
from isonoise.layers import GUIDES, LAYERS
from isonoise.statistics import Needs, Statistics
from isonoise.strategies.base import Strategy
from isonoise.strategies.measures import image_floor


@runtime_checkable
class HasMeasure(Protocol):
    """A strategy with a measure, such as `isonoise.strategies.adaptive.Adaptive`."""

    needs: Needs

    def variance(self, statistics: Statistics, floor: float) -> np.ndarray:
        """Variance of one sample that the strategy acts on, (height, width)."""


class ImageLayers(Mapping[str, np.ndarray]):
    """Layers by name, (height, width) or (height, width, channels) float32. Each is made when it is first read.

    Parameters
    ----------
    images : mapping
        Name -> array, or a function without arguments that makes it.
    """

    def __init__(self, images: Mapping[str, np.ndarray | Callable[[], np.ndarray]]):
        self._images = dict(images)

    def __getitem__(self, name: str) -> np.ndarray:
        image = self._images[name]
        if callable(image):
            image = self._images[name] = image()
        return image

    def __contains__(self, name: object) -> bool:
        return name in self._images  # that of Mapping would make the image

    def __iter__(self) -> Iterator[str]:
        return iter(self._images)

    def __len__(self) -> int:
        return len(self._images)


def check_host_layers(names: tuple[str, ...], strategy: Strategy | None = None) -> None:
    """Raise UserError unless the host can make the layers of these names, of merged renders without a strategy."""
    if "measure" in names and strategy is not None and not isinstance(strategy, HasMeasure):
        raise UserError(f"the strategy {strategy.name} has no measure, so there is no layer 'measure'")
    if "denoised" in names:
        from isonoise.film.denoise import check_denoiser

        check_denoiser()


def make_layers(
    names: tuple[str, ...], from_device: Mapping[str, np.ndarray], statistics: Statistics, strategy: Strategy | None
) -> ImageLayers:
    """The layers of these names.

    Parameters
    ----------
    names : tuple of str
        Names of `isonoise.layers.LAYERS`; layers that cannot be made are left out.
    from_device : mapping of str to array
        What the device has made of them, as `layer_images` returns it.
    statistics : Statistics
        Of all samples.
    strategy : Strategy or None
        For the layer `measure`.
    """
    images: dict[str, np.ndarray | Callable[[], np.ndarray]] = dict(from_device)
    images["variance"] = lambda: statistics.variance.astype(np.float32)
    if isinstance(strategy, HasMeasure):
        images["measure"] = lambda: measure_image(strategy, statistics)
    if all(name in from_device for name in GUIDES):
        images["denoised"] = lambda: _denoised(statistics.rgb, from_device)
    return ImageLayers({name: images[name] for name in names if name in images})


def measure_image(strategy: HasMeasure, statistics: Statistics) -> np.ndarray:
    """The strategy's measure of every pixel, (height, width) float32; inf below two samples and while it is unknown.

    It is sqrt(V / n): V is the variance of a sample that the strategy acts on, n the sample count.
    """
    if strategy.needs.uniform and statistics.uniform is None:  # in the middle of a uniform wave
        return np.full(statistics.shape, np.inf, np.float32)
    variance = strategy.variance(statistics, image_floor(statistics.mean))
    measure = np.full(statistics.shape, np.inf)
    np.divide(variance, statistics.count, out=measure, where=statistics.count > 0)
    with np.errstate(over="ignore"):
        return np.asarray(np.sqrt(measure), np.float32)


def layer_channels(layers: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Channel name -> (height, width): `NAME.CHANNEL`, as Blender, Nuke and other programs split them."""
    channels: dict[str, np.ndarray] = {}
    for name, image in layers.items():
        planes = image[..., None] if image.ndim == 2 else image
        channels |= {f"{name}.{channel}": planes[..., k] for k, channel in enumerate(LAYERS[name].channels)}
    return channels


def _denoised(rgb: np.ndarray, from_device: Mapping[str, np.ndarray]) -> np.ndarray:
    from isonoise.film.denoise import denoise

    return denoise(rgb, *(from_device[name] for name in GUIDES))
