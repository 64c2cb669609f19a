"""The interface of all strategies: a schedule of waves, the statistics they read, and allocation maps."""

import inspect
from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from isonoise.statistics import BASIC_NEEDS, Needs, Statistics
from isonoise.strategies.parameters import check_ranges


@dataclass(frozen=True)
class Wave:
    """One planned wave. The renderer may shorten it to meet a sample budget or a deadline.

    Parameters
    ----------
    kind : 'uniform' or 'adaptive'
        Whether every pixel gets the same count, or `Strategy.allocate` decides.
    spp : float or None
        Mean samples per pixel. None (adaptive waves only): as many as the map that `Strategy.allocate` returns.
    """

    kind: Literal["uniform", "adaptive"]
    spp: float | None


class Strategy:
    """Base class of all strategies.

    Parameters of a strategy are keyword arguments of its `__init__`. Users set them as `NAME:key=value,key=value`; the
    annotation (bool, int or float) says how the text is converted.

    Attributes
    ----------
    name : str
        The name in messages and, for registered strategies, on the command line.
    is_adaptive : bool
        Whether it plans adaptive waves, for which a render takes more memory.
    needs : Needs
        Optional statistics that `allocate` reads. The renderer reads it once, before the first wave. A class attribute;
        if it depends on parameters, set in `__init__`, or a property.

    Examples
    --------
    Samples in proportion to the standard deviation, after 16 uniform samples per pixel:

    >>> import isonoise, numpy as np
    >>> from isonoise.strategies.allocation import distribute_in_proportion
    >>> class ByDeviation(isonoise.Strategy):
    ...     name = "by-deviation"
    ...
    ...     def waves(self):
    ...         yield isonoise.Wave("uniform", 16)
    ...         while True:
    ...             yield isonoise.Wave("adaptive", 16)
    ...
    ...     def allocate(self, statistics, budget):
    ...         return distribute_in_proportion(np.sqrt(statistics.variance), budget, statistics.samples)
    """

    name: ClassVar[str] = "unnamed"
    is_adaptive: ClassVar[bool] = True
    needs: Needs = BASIC_NEEDS

    def __post_init__(self) -> None:
        check_ranges(self)  # of dataclasses

    def state(self) -> dict[str, object]:
        """Return what the strategy remembers from wave to wave, by name, so that a stopped render can be continued.

        Values are arrays, numbers, texts or None. By default all attributes of the object but its parameters. Override
        this and `set_state` if an attribute has another type, or can be computed again.
        """
        parameters = inspect.signature(type(self)).parameters
        return {name: value for name, value in vars(self).items() if name not in parameters}

    def set_state(self, state: dict[str, object]) -> None:
        """Continue from what `state` has returned. Called after as many waves as then have been taken from `waves`.

        Raises ValueError if a name is missing, or is that of a parameter or method.
        """
        if missing := self.state().keys() - state.keys():
            raise ValueError(f"'{min(missing)}' of the strategy is missing")
        for name in state:
            if name in inspect.signature(type(self)).parameters or callable(getattr(type(self), name, None)):
                raise ValueError(f"the strategy remembers no '{name}'")
        vars(self).update(state)

    def waves(self) -> Iterator[Wave]:
        """Return the schedule, an endless iterator. The renderer takes from it until the render ends."""
        raise NotImplementedError

    def allocate(self, statistics: Statistics, budget: int | None) -> np.ndarray:
        """Return the samples per pixel of the next adaptive wave.

        Parameters
        ----------
        statistics : Statistics
            Statistics of all samples so far.
        budget : int or None
            Samples to distribute; None if the wave's spp is None.

        Returns
        -------
        (height, width) uint32
            The allocation map. It sums to `budget` exactly; without a budget, to 1 or more. If a map without a budget
            exceeds what the renderer may take, the renderer scales it down in proportion.
        """
        raise NotImplementedError
