"""Buffers of the image that the stages after `reduce` fill and that no later wave reads. Called by `accumulator`."""

from collections.abc import Mapping

import numpy as np

from isonoise.error.shrinkage import TILE_SIZE as ERROR_TILE_SIZE
from isonoise.integrator.stages import Stages
from isonoise.statistics import Needs
from isonoise.strips import LARGE_IMAGE_PIXELS

TILE_SIZE, GRID_BINS = 16, 25
"""Pixels per side of a tile, and bins of the relative variance, over which design effects are pooled."""

_SHARED = ("error_bins", "net_ratios", "design_effect")
"""Arguments that share the buffer `per_pixel`, because each is read before the next is written: the design effect
replaces the ratios that it follows from, and the bins of the errors the design effect."""


def tile_count(shape: tuple[int, int], size: int) -> int:
    """Tiles of this many pixels per side that cover an image (height, width)."""
    return -(-shape[0] // size) * -(-shape[1] // size)


def scratch_bytes(shape: tuple[int, int], needs: Needs) -> dict[str, int]:
    """Name -> bytes of the buffers for an image (height, width)."""
    pixels, sizes = shape[0] * shape[1], {}
    sizes["luminance"] = 8 * pixels
    # `relative_errors` writes whole tiles
    sizes["per_pixel"] = 4 * tile_count(shape, ERROR_TILE_SIZE) * ERROR_TILE_SIZE**2
    if needs.nets:
        sizes["grid"] = 16 * GRID_BINS * tile_count(shape, TILE_SIZE)
        sizes["steps"] = 4 * GRID_BINS * tile_count(shape, TILE_SIZE)
    if needs.neighbours:
        sizes["neighbours"] = 8 * pixels
    return sizes


_LABELS = {
    "luminance": "the luminance",
    "per_pixel": "the errors",
    "grid": "the design effect",
    "steps": "the design effect",
    "neighbours": "the averages of the neighbours",
}


class ImageScratch:
    """The buffers for an image of shape (height, width). They become arguments of `stages`."""

    def __init__(self, stages: Stages, shape: tuple[int, int], needs: Needs):
        self._stages, self._device = stages, stages.device
        self._sizes = scratch_bytes(shape, needs)
        self._is_releasable = shape[0] * shape[1] >= LARGE_IMAGE_PIXELS
        self._buffers: Mapping[str, object] = {}
        if needs.nets:
            stages.arguments["tile_count"] = np.uint32(tile_count(shape, TILE_SIZE))
        self.allocate()

    def allocate(self) -> None:
        """Allocate the buffers if they were released."""
        if not self._buffers:
            self._buffers = {name: self._device.buffer(size, _LABELS[name]) for name, size in self._sizes.items()}
            self._set_arguments(self._buffers)

    def release(self) -> bool:
        """Give the buffers of a large image back; whether it was one. Waits for the device."""
        if self._is_releasable and self._buffers:
            self._set_arguments(dict.fromkeys(self._buffers))
            for buffer in self._buffers.values():
                self._device.release(buffer)
            self._buffers = {}
            self._device.finish()
        return self._is_releasable

    def _set_arguments(self, buffers: Mapping[str, object]) -> None:
        shared = _SHARED if "grid" in buffers else _SHARED[:1]
        self._stages.arguments.update({name: buffer for name, buffer in buffers.items() if name != "per_pixel"})
        self._stages.arguments.update(dict.fromkeys(shared, buffers["per_pixel"]))
