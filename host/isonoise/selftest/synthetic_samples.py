"""Feeds given samples to the kernels `reduce` and `summarise`, and computes the expected statistics in float64."""

import numpy as np

from isonoise.device.opencl import Device
from isonoise.integrator.accumulator import Accumulator
from isonoise.integrator.statistics_stages import make_statistics_stages
from isonoise.luminance import REC709_LUMINANCE
from isonoise.statistics import BASIC_NEEDS, Needs, Statistics


class Reducer:
    """The kernels `reduce` and `summarise` for an image of `pixels`, in rows of `width`; without it, in one row."""

    def __init__(self, device: Device, pixels: int, needs: Needs = BASIC_NEEDS, width: int | None = None):
        self.device = device
        self.stages = make_statistics_stages(device, needs)
        self.accumulator = Accumulator(self.stages, (pixels // (width or pixels), width or pixels), needs)
        self.stages.arguments["pixel_offset"] = self.device.buffer(4 * pixels, "the offsets")

    def add(self, samples: list[np.ndarray], repeats: int = 1) -> None:
        """Reduces one slice, `repeats` times in a row. `samples`: for each pixel (n,) grey values or (n, 3) colours."""
        flat = np.concatenate([to_rgb32(s) for s in samples])
        ends = np.cumsum([len(s) for s in samples])
        offsets = (ends - [len(s) for s in samples]).astype(np.uint32)
        self.device.write(self.stages.arguments["pixel_offset"], offsets)
        buffer = self.device.buffer(flat, "the samples")
        bounds = {"pixels": np.uint32(len(samples)), "slice_samples": np.uint32(len(flat))}
        for _ in range(repeats):
            self.stages.launch("reduce", len(samples), samples=buffer, first_pixel=np.uint32(0), **bounds)
            self.device.finish()
        buffer.release()

    def statistics(self, scale: float = 1.0) -> Statistics:
        """Returns the statistics of all samples. `scale`: the samples are `scale` times the radiance."""
        return self.accumulator.statistics(scale)


def to_rgb32(samples: np.ndarray) -> np.ndarray:
    """Returns float32 (n, 3)."""
    return (samples if samples.ndim == 2 else np.repeat(samples[:, None], 3, axis=1)).astype(np.float32)


def luminance32(samples: np.ndarray) -> np.ndarray:
    """Returns the luminance as the kernel computes it: float32, left to right."""
    v = samples.astype(np.float32)
    r, g, b = (v, v, v) if v.ndim == 1 else v.T
    weight_r, weight_g, weight_b = np.float32(REC709_LUMINANCE)
    return (r * weight_r + g * weight_g + b * weight_b).astype(np.float64)


def chunk_median_mean(x: np.ndarray, needs: Needs) -> float:
    """Returns M_x, the mean of the medians of full chunks, of samples x in float64."""
    full = len(x) // needs.batch
    if full == 0:
        return float(x.mean())
    entries = x[: full * needs.batch].reshape(full, -1).mean(axis=1)
    if full < needs.chunk:
        return float(np.median(entries))
    return float(np.median(entries[: full // needs.chunk * needs.chunk].reshape(-1, needs.chunk), axis=1).mean())
