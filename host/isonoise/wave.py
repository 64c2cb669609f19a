"""A wave: the one in progress, and the record of one that has ended. Made by `Renderer`."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class WaveRecord:
    """What one call of `Renderer.step` did.

    Attributes
    ----------
    kind : str
        'uniform' or 'adaptive'.
    samples : int
        Samples traced, rejected ones included.
    planned : int
        Samples in the allocation map; more than `samples` if the wave was stopped early.
    seconds : float
        Wall-clock time of the call.
    workers : int
        Devices, or processes of a cluster, that traced samples of it.
    """

    kind: str
    samples: int
    planned: int
    seconds: float
    workers: int = 1


@dataclass
class WaveInProgress:
    """A wave that has begun and has not ended. A checkpoint stores all of it."""

    kind: str
    remaining: np.ndarray  # samples per pixel that are left to trace
    planned: int
    traced: int = 0
    seconds: float = 0.0


WAVE_VALUES = ("kind", "planned", "traced", "seconds")
"""Members of `WaveInProgress` that are no arrays."""
