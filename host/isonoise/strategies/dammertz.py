"""The strategy `dammertz`: blocks of pixels that split and stop."""

from dataclasses import dataclass, field

import numpy as np

from isonoise.statistics import Needs, Statistics
from isonoise.strategies.measures import half_buffer
from isonoise.strategies.parameter_checks import check_range
from isonoise.strategies.stopping import Retiring

SPLIT = 256
"""A block splits when its error is less than this many times the threshold at which it stops."""


@dataclass(kw_only=True, eq=False)
class Dammertz(Retiring):
    """Samples blocks of pixels; one with a small error splits in two, and one with a very small error stops.

    From: Dammertz, Hanika, Keller, Lensch, "A hierarchical automatic stopping condition for Monte Carlo global
    illumination", WSCG 2010. With e_p of `measures.half_buffer` a block's error is

        e_b = sqrt(A_b / A_i) / A_b * sum of e_p over its pixels,

    A_b its area and A_i that of the image. The image is the first block. After every `step` samples per pixel a
    block with e_b < e_t stops; else one with e_b < e_s = 256 e_t splits across its longer side, where both parts
    have the same error as nearly as can be, and goes on; others go on as they are. e_t = 0.0002 is the paper's
    value, as Photon-v2 quotes it. Both thresholds, the place of the split and a least size are as in two renderers
    that implement the paper, github.com/TzuChieh/Photon-v2 (`DammertzDispatcher`) and
    github.com/appleseedhq/appleseed (`adaptivetilerenderer`).

    e_p goes with the square root of the light, so results depend on the scene's brightness, as published.

    Differences: when all blocks have stopped, the threshold is halved and the image is the first block again, tested
    with the statistics that are there at once on all levels, so that a deadline is used. Where few blocks are active
    tests are further apart (`Retiring`). A pixel of fewer than two samples counts as the worst known.

    - `threshold`: e_t, 1e-9 to 1.
    - `step`: samples per pixel before the first test and of an active pixel between two tests, 2 to 65536.
    - `smallest`: no block becomes narrower than this many pixels, 1 to 4096; 8 as in appleseed.
    """

    name = "dammertz"
    needs = Needs(half=True)

    threshold: float = 0.0002
    step: int = 16
    smallest: int = 8

    _blocks: list["Block"] = field(default_factory=list, init=False, repr=False)  # that are active

    def __post_init__(self):
        check_range("threshold", self.threshold, 1e-9, 1)
        check_range("step", self.step, 2, 65536)
        check_range("smallest", self.smallest, 1, 4096)

    @property
    def first(self) -> int:
        return self.step

    def error(self, statistics: Statistics) -> np.ndarray:
        error = half_buffer(statistics)
        unknown = np.isinf(error)
        error[unknown] = np.max(error, where=~unknown, initial=0)
        return error

    def active(self, error: np.ndarray, statistics: Statistics, scale: float, before: np.ndarray | None) -> np.ndarray:
        height, width = error.shape
        blocks = [Block(0, height, 0, width)] if before is None else self._blocks
        on_all_levels = before is None and scale < 1  # a new round
        self._blocks = []
        while blocks:
            parts = []
            for block in blocks:
                size = block.error(error) / (self.threshold * scale)
                halves = block.split(error, self.smallest) if 1 <= size < SPLIT else None
                if halves:
                    parts += halves
                elif size >= 1:
                    self._blocks.append(block)
            if not on_all_levels:
                self._blocks += parts
                break
            blocks = parts
        active = np.zeros(error.shape, dtype=bool)
        for block in self._blocks:
            active[block.pixels] = True
        return active


@dataclass(frozen=True)
class Block:
    """Pixels from row `top` to before `bottom`, column `left` to before `right`."""

    top: int
    bottom: int
    left: int
    right: int

    @property
    def pixels(self) -> tuple[slice, slice]:
        return slice(self.top, self.bottom), slice(self.left, self.right)

    def error(self, error: np.ndarray) -> float:
        """e_b of `Dammertz`."""
        own = error[self.pixels]
        return float(own.sum()) / (own.size * error.size) ** 0.5

    def split(self, error: np.ndarray, smallest: int) -> tuple["Block", "Block"] | None:
        """Two parts, of the same error as nearly as can be; None if one had to be narrower than `smallest`."""
        along_x = self.right - self.left >= self.bottom - self.top
        size = max(self.right - self.left, self.bottom - self.top)
        if size < 2 * smallest:
            return None
        sums = np.cumsum(error[self.pixels].sum(axis=0 if along_x else 1))
        first = np.arange(smallest, size - smallest + 1)  # pixels of the first part along the longer side
        below = sums[first - 1]
        difference = below / np.sqrt(first) - (sums[-1] - below) / np.sqrt(size - first)
        at = int(first[np.argmin(np.abs(difference))])
        if along_x:
            middle = self.left + at
            return Block(self.top, self.bottom, self.left, middle), Block(self.top, self.bottom, middle, self.right)
        middle = self.top + at
        return Block(self.top, middle, self.left, self.right), Block(middle, self.bottom, self.left, self.right)
