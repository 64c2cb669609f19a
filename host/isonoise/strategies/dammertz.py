"""The strategy `dammertz`: blocks of pixels that split and stop."""

from dataclasses import astuple, dataclass, field

import numpy as np

from isonoise.statistics import Needs, Statistics
from isonoise.strategies.measures import half_buffer
from isonoise.strategies.parameters import ranged
from isonoise.strategies.stopping import StoppingStrategy

SPLIT_FACTOR = 256
"""A block splits when its error is less than this many times the threshold at which it stops."""


@dataclass(kw_only=True, eq=False)
class Dammertz(StoppingStrategy):
    """Samples blocks of pixels; a block with a small error splits in two, one with a very small error stops.

    From: Dammertz, Hanika, Keller, Lensch, "A hierarchical automatic stopping condition for Monte Carlo global
    illumination", WSCG 2010. With e_p of `measures.half_buffer` a block's error is

        e_b = sqrt(A_b / A_i) / A_b * sum of e_p over its pixels,

    A_b its area and A_i that of the image. The image is the first block. After every `step` samples per pixel a block
    with e_b < e_t stops. One with e_b < e_s = 256 e_t splits across its longer side, where both parts have nearly the
    same error, and both continue. Others continue as they are. e_t = 0.0002 is the paper's value, as Photon-v2 quotes
    it. Both thresholds, the position of the split and the smallest size follow two renderers that implement the paper,
    github.com/TzuChieh/Photon-v2 (`DammertzDispatcher`) and github.com/appleseedhq/appleseed (`adaptivetilerenderer`).

    e_p is proportional to the square root of the light, so results depend on the scene's brightness, as published.

    Differences: when all blocks have stopped, the threshold is halved and the image is the first block again; the
    statistics so far then test blocks of all levels at once. With few active blocks, tests are further apart
    (`StoppingStrategy`). A pixel with fewer than two samples counts as the worst known one.

    Parameters
    ----------
    threshold : float
        e_t, 1e-9 to 1.
    step : int
        Samples per pixel before the first test and of an active pixel between two tests, 2 to 65536.
    smallest : int
        No block becomes narrower than this many pixels, 1 to 4096; 8 as in appleseed.
    """

    name = "dammertz"
    needs = Needs(half=True)

    threshold: float = ranged(0.0002, 1e-9, 1)
    step: int = ranged(16, 2, 65536)
    smallest: int = ranged(8, 1, 4096)

    _active_blocks: list["Block"] = field(default_factory=list, init=False, repr=False)

    @property
    def first_test_spp(self) -> int:
        return self.step

    def state(self) -> dict[str, object]:
        blocks = [astuple(block) for block in self._active_blocks]
        return super().state() | {"_active_blocks": np.array(blocks, np.int64).reshape(-1, 4)}

    def set_state(self, state: dict[str, object]) -> None:
        blocks = [Block(*block) for block in state["_active_blocks"].tolist()]
        super().set_state(state | {"_active_blocks": blocks})

    def pixel_error(self, statistics: Statistics) -> np.ndarray:
        error = half_buffer(statistics)
        unknown = np.isinf(error)
        error[unknown] = np.max(error, where=~unknown, initial=0)
        return error

    def active_pixels(
        self, error: np.ndarray, statistics: Statistics, threshold_scale: float, previous: np.ndarray | None
    ) -> np.ndarray:
        threshold = self.threshold * threshold_scale
        if previous is not None:
            active, halves = self._test_blocks(self._active_blocks, error, threshold)
        else:
            active, halves = self._test_blocks([Block(0, error.shape[0], 0, error.shape[1])], error, threshold)
            while halves and threshold_scale < 1:  # a new round: test blocks of all levels
                more_active, halves = self._test_blocks(halves, error, threshold)
                active += more_active
        self._active_blocks = active + halves
        mask = np.zeros(error.shape, dtype=bool)
        for block in self._active_blocks:
            mask[block.pixels] = True
        return mask

    def _test_blocks(
        self, blocks: list["Block"], error: np.ndarray, threshold: float
    ) -> tuple[list["Block"], list["Block"]]:
        """The blocks that continue as they are, and the halves of those that split."""
        active, halves = [], []
        for block in blocks:
            relative_error = block.error(error) / threshold
            if relative_error < 1:
                continue
            parts = block.split(error, self.smallest) if relative_error < SPLIT_FACTOR else None
            if parts:
                halves += parts
            else:
                active.append(block)
        return active, halves


@dataclass(frozen=True)
class Block:
    """Pixels in rows [top, bottom) and columns [left, right)."""

    top: int
    bottom: int
    left: int
    right: int

    @property
    def pixels(self) -> tuple[slice, slice]:
        return slice(self.top, self.bottom), slice(self.left, self.right)

    def error(self, error: np.ndarray) -> float:
        """e_b of `Dammertz` from the e_p of all pixels."""
        inside = error[self.pixels]
        return float(inside.sum()) / (inside.size * error.size) ** 0.5

    def split(self, error: np.ndarray, smallest: int) -> tuple["Block", "Block"] | None:
        """Two parts with nearly the same error; None if one would be narrower than `smallest`."""
        along_x = self.right - self.left >= self.bottom - self.top
        size = max(self.right - self.left, self.bottom - self.top)
        if size < 2 * smallest:
            return None
        sums = np.cumsum(error[self.pixels].sum(axis=0 if along_x else 1))
        first_size = np.arange(smallest, size - smallest + 1)
        first_sum = sums[first_size - 1]
        difference = first_sum / np.sqrt(first_size) - (sums[-1] - first_sum) / np.sqrt(size - first_size)
        cut = int(first_size[np.argmin(np.abs(difference))]) + (self.left if along_x else self.top)
        if along_x:
            return Block(self.top, self.bottom, self.left, cut), Block(self.top, self.bottom, cut, self.right)
        return Block(self.top, cut, self.left, self.right), Block(cut, self.bottom, self.left, self.right)
