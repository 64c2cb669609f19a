"""What a strategy is: a schedule of waves, the statistics it reads, and a rule that makes allocation maps of them."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from isonoise.statistics import BASIC_NEEDS, Needs, Statistics


@dataclass(frozen=True)
class Wave:
    """One wave as the strategy plans it; the renderer cuts the last one to the sample budget or the deadline.

    - `spp`: mean samples per pixel. None, in an adaptive wave alone: as many as the map that `allocate` returns.
    """

    kind: Literal["uniform", "adaptive"]
    spp: float | None


class Strategy:
    """Base of all strategies. Parameters are keyword arguments of `__init__`, documented in its docstring."""

    name: ClassVar[str]
    needs: Needs = BASIC_NEEDS
    """Statistics it reads beyond those every render keeps; of the class, or of the instance where parameters decide."""

    def waves(self) -> Iterator[Wave]:
        """The schedule: an endless iterator; the renderer stops drawing from it when the render is done."""
        raise NotImplementedError

    def allocate(self, statistics: Statistics, budget: int | None) -> np.ndarray:
        """Samples per pixel of the next adaptive wave: uint32, shape (height, width).

        With a `budget` they sum to it exactly. It is None where the wave's spp is: then they are any that sum to 1 or
        more, and where that is more than may be taken the renderer scales them down in proportion.
        """
        raise NotImplementedError
