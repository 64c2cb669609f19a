"""A task, part of a wave, and its result: what the coordinator and the workers exchange."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Task:
    """Some pixels of a wave. Its result depends on the scene, the seed and these arrays alone.

    Attributes
    ----------
    number : int
        Of the task, unique in a render.
    pixels : (n,) uint32
        Numbers of the pixels in the image, row * width + column, each once.
    allocation : (n,) uint32
        Samples to trace for each of them, 1 or more.
    state : dict of str to array
        Their state of the stage `reduce`: name -> (planes, n) float32 or uint32, as of `ReductionState`.
    seed : int
        Of the render, 0 to 2^64 - 1.
    """

    number: int
    pixels: np.ndarray
    allocation: np.ndarray
    state: Mapping[str, np.ndarray]
    seed: int

    @property
    def samples(self) -> int:
        """Samples to trace."""
        return int(self.allocation.sum(dtype=np.int64))


@dataclass(frozen=True)
class TaskResult:
    """What a worker returns for a task.

    Attributes
    ----------
    number : int
        Of the task.
    state : dict of str to array
        State of the task's pixels after the samples, as in `Task`.
    remaining : (n,) uint32 or None
        Samples that were not traced, because the worker was asked to stop; None: all were traced.
    seconds : float
        Wall-clock time that the worker took.
    """

    number: int
    state: Mapping[str, np.ndarray]
    remaining: np.ndarray | None
    seconds: float
