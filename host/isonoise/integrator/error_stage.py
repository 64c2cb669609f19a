"""The distribution of the pixels' errors on the device: the buffers and the result of the stage `relative_errors`."""

import math
from functools import lru_cache

import numpy as np

from isonoise.error import shrinkage
from isonoise.error.distribution import NORMAL_BINS, ErrorDistribution, histogram_position
from isonoise.error.shrinkage import LEVELS, TILE_SIZE
from isonoise.integrator.image_scratch import tile_count
from isonoise.integrator.stages import Stages
from isonoise.strips import pixel_strips

BINS_PER_OCTAVE_LOG2 = 6
"""log2 of the bins of the mean square error per octave; a pixel's error is rounded by at most 0.4 %."""
FIRST_OCTAVE, LAST_OCTAVE = -56, 56
"""log2 of the smallest mean square error that has a bin of its own, and of the largest."""
SQUARE_BINS = (LAST_OCTAVE - FIRST_OCTAVE) << BINS_PER_OCTAVE_LOG2
ERROR_BINS = SQUARE_BINS * (NORMAL_BINS + 1)
TILE_PIXELS = TILE_SIZE * TILE_SIZE
SCRATCH_PYRAMIDS = 14
"""Arrays of a tile (kernels/error/tile.h), each with one element per pixel and group."""
PYRAMID_SIZE = sum(TILE_PIXELS >> 2 * level for level in range(LEVELS + 1))
BINS_STRIP = 2**20
"""Pixels that are counted at a time: numpy converts their bins to 64 bits."""
GROUPS_PER_CORE = 4
"""Work-groups that process tiles at a time: enough to share them evenly."""


def build_constants(work_items: int) -> dict[str, int | str]:
    """Build constants of the stage for so many work-items per tile, which is its local size too."""
    limits = ("MAX_MEAN", "MAX_SCATTER", "MAX_SKEWNESS_SCATTER", "MAX_UNLUCKY_SHARE")
    return {
        **{name: f"{getattr(shrinkage, name)!r}f" for name in limits},
        "TILE_WORK_ITEMS": work_items,
        "NORMAL_BINS": NORMAL_BINS,
        "ERROR_SCRATCH": SCRATCH_PYRAMIDS * PYRAMID_SIZE,
        "ERROR_BINS": ERROR_BINS,
        "ERROR_BIN_SHIFT": 23 - BINS_PER_OCTAVE_LOG2,
        "FIRST_ERROR_SQUARE": f"0x1p{FIRST_OCTAVE}f",
        "LAST_ERROR_SQUARE": f"0x1.fffffep{LAST_OCTAVE - 1}f",
    }


def error_scratch_bytes(shape: tuple[int, int], compute_units: int) -> int:
    """Bytes of the buffer of the stage on a device of so many compute units."""
    return 4 * SCRATCH_PYRAMIDS * PYRAMID_SIZE * _groups(shape, compute_units)


def _groups(shape: tuple[int, int], compute_units: int) -> int:
    return min(GROUPS_PER_CORE * compute_units, tile_count(shape, TILE_SIZE))


class ErrorStage:
    """The stage `relative_errors` for an image of shape (height, width), with so many work-items per tile.

    It writes the buffer `error_bins` (`image_scratch`).
    """

    def __init__(self, stages: Stages, shape: tuple[int, int], work_items: int):
        self._stages, self._device, self._work_items = stages, stages.device, work_items
        self._pixels = shape[0] * shape[1]
        self._groups = _groups(shape, self._device.compute_units)
        self._cells = tile_count(shape, TILE_SIZE) * TILE_PIXELS
        scratch = error_scratch_bytes(shape, self._device.compute_units)
        stages.arguments.update(
            error_groups=np.uint32(self._groups),
            error_floor=np.float32(1),
            inverse_unit=np.float32(1),
            error_scratch=self._device.buffer(scratch, "the tiles of the errors"),
        )

    def distribution(self, floor: float) -> ErrorDistribution:
        """The distribution of |x - r| / max(r, floor) after the stage `summarise`. `floor` > 0 is in device units."""
        unit = 2.0 ** min(max(math.frexp(floor)[1], -100), 100)
        self._stages.launch(
            "relative_errors",
            self._groups * self._work_items,
            error_floor=np.float32(floor / unit),
            inverse_unit=np.float32(1 / unit),
        )
        with self._device.mapped(self._stages.arguments["error_bins"], np.uint32, self._cells) as bins:
            number = np.zeros(ERROR_BINS + 2, np.int64)
            for strip in pixel_strips(bins.size, BINS_STRIP):
                number += np.bincount(bins[strip], minlength=ERROR_BINS + 2)
        result = ErrorDistribution(self._pixels)
        result.noiseless = int(number[ERROR_BINS])
        occupied = np.flatnonzero(number[:ERROR_BINS])
        normal_bin, square_bin = np.divmod(occupied, SQUARE_BINS)
        result.add(_bin_positions()[square_bin], normal_bin, number[occupied])
        return result


@lru_cache(maxsize=1)
def _bin_positions() -> np.ndarray:
    """Centres of the bins of the mean square error, in the bins of the distribution."""
    per_octave = 2**BINS_PER_OCTAVE_LOG2
    edges = np.arange(per_octave + 1) / per_octave + 1
    octave = np.sqrt(edges[:-1] * edges[1:])
    return np.concatenate([histogram_position(np.ldexp(octave, k)) for k in range(FIRST_OCTAVE, LAST_OCTAVE)])
