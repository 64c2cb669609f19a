"""`Statistics` made of numbers or of samples, for tests of strategies and of errors."""

import numpy as np

from isonoise.luminance import luminance
from isonoise.statistics import Statistics


def grey(values) -> np.ndarray:
    """RGB float32 of the same value in all channels."""
    return np.repeat(np.asarray(values, dtype=np.float32)[..., None], 3, axis=-1)


def _as_rgb(image) -> np.ndarray:
    image = np.asarray(image, dtype=np.float32)
    return grey(image) if image.ndim == 2 else image


def make_statistics(count, mean, variance=0.0, *, median=None, half=None, rejected=0, design_effect=None) -> Statistics:
    """Statistics of the shape of `mean`, which is grey (height, width) or RGB. `half` is the mean unless given."""
    rgb = _as_rgb(mean)
    shape = rgb.shape[:2]
    mean = np.array(mean, dtype=np.float64) if np.ndim(mean) == 2 else luminance(rgb)
    count, rejected = (np.broadcast_to(np.asarray(values, np.uint32), shape).copy() for values in (count, rejected))
    variance = np.broadcast_to(np.asarray(variance, np.float64), shape).copy()
    median = None if median is None else np.broadcast_to(np.asarray(median, np.float64), shape).copy()
    half = rgb if half is None else _as_rgb(half)
    return Statistics(count, rejected, rgb, mean, variance, median, None, half, design_effect)


def statistics_of_samples(x: np.ndarray, chunk: int | None = None) -> Statistics:
    """Statistics of samples, grey (n, height, width) or RGB (n, height, width, 3).

    With `chunk`, M_x is the mean of the medians of chunks of so many samples (grey only).
    """
    y = x if x.ndim == 3 else luminance(x)
    variance = y.var(axis=0, ddof=1) if len(x) > 1 else 0.0
    half = x[1::2].mean(axis=0) if len(x) > 1 else np.zeros(x.shape[1:])
    median = None
    if chunk:
        median = np.median(x[: len(x) // chunk * chunk].reshape(-1, chunk, *x.shape[1:]), axis=1).mean(axis=0)
    statistics = make_statistics(len(x), x.mean(axis=0), variance, median=median, half=half)
    return statistics if x.ndim == 3 else Statistics(**(vars(statistics) | {"mean": y.mean(axis=0)}))


def noisy_statistics(shape, n=16, seed=1, scale=1.0) -> Statistics:
    """Of n gamma-distributed RGB samples around a brightness that varies strongly from pixel to pixel."""
    rng = np.random.default_rng(seed)
    brightness = np.exp(rng.normal(-1, 1.5, size=(*shape, 1)))
    return statistics_of_samples(scale * brightness * rng.gamma(0.5, 2.0, size=(n, *shape, 3)))
