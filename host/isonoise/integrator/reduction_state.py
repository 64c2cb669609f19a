"""The state of the stage `reduce`: planes of per-pixel sums on the device, and reading and writing them.

`Accumulator` has that of an image, `ShardTracer` that of some pixels of one.
"""

from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from isonoise.errors import UserError
from isonoise.integrator.stages import Stages
from isonoise.layers import first_values, mean_components
from isonoise.statistics import Needs

NET_COUNT_LOG2 = 3
"""log2 of the nets of a pixel whose means are kept at a time."""

MAX_STATISTICS = 2**32
"""Numbers in a buffer of per-pixel statistics: kernels index them with unsigned 32-bit numbers. Only chunk medians have
so many planes that an image of `MAX_PIXELS` can exceed it."""

_LABELS = {
    "count": "the sample counts",
    "rejected": "the counts of rejected samples",
    "sums": "the statistics",
    "sample_block_sums": "the statistics of unfinished sample blocks",
    "medians": "the chunk medians",
    "powers": "the sums of powers",
    "halves": "the sums of every second sample",
    "net_means": "the means over nets",
    **dict.fromkeys(("layer_sums", "layer_indices"), "the layers"),
}


def state_planes(needs: Needs) -> dict[str, int]:
    """Buffers of the state: name -> planes, with one 4-byte value per pixel each."""
    planes = {
        "count": 1,
        "rejected": 1,
        "sums": 10,  # high and low parts of the sums of red, green, blue, x and M2, of x and M2 over full sample blocks
        "sample_block_sums": 2,  # of x - shift and of its square; shift is the mean of x before the unfinished block
        "medians": _median_planes(needs) if needs.median else 0,
        "powers": 2 * (needs.power is not None),
        "halves": 6 * needs.half,
        "net_means": (2**NET_COUNT_LOG2 - 1) * needs.nets,
        "layer_sums": 2 * mean_components(needs.layers),  # two parts of the sum of every channel
        "layer_indices": first_values(needs.layers),
    }
    return {name: number for name, number in planes.items() if number}


def _median_planes(needs: Needs) -> int:
    # two parts of the sum of the chunk medians; entries of the unfinished chunk; two parts of an unfinished entry
    return 2 + needs.chunk - 1 + (2 if needs.batch > 1 else 0)


class _Planes(NamedTuple):
    """A buffer of `number` planes, each with one value of this type per pixel."""

    buffer: object
    number: int
    dtype: type


class ReductionState:
    """The state of so many pixels. Its buffers become arguments of `stages`, without samples at first.

    Raises UserError if the statistics of `needs` are too many numbers.
    """

    def __init__(self, stages: Stages, pixels: int, needs: Needs):
        self._stages, self._device, self._needs = stages, stages.device, needs
        self._planes: dict[str, _Planes] = {}
        self._allocate(pixels)
        if needs.power is not None:
            stages.arguments["power"] = np.float32(needs.power)

    def _allocate(self, pixels: int) -> None:
        self.pixels = self._capacity = pixels
        needs = self._needs
        if needs.median and _median_planes(needs) * pixels > MAX_STATISTICS:
            raise UserError(
                f"chunks of {needs.chunk} entries of {pixels:,} pixels are more than {MAX_STATISTICS:,} numbers; "
                "render a smaller image or choose a smaller chunk"
            )
        self._planes = {
            name: _Planes(
                self._device.buffer(4 * number * pixels, _LABELS[name]),
                number,
                np.uint32 if name in ("count", "rejected", "layer_indices") else np.float32,
            )
            for name, number in state_planes(needs).items()
        }
        self._stages.arguments.update({name: planes.buffer for name, planes in self._planes.items()})
        self._stages.arguments["total_pixels"] = np.uint32(pixels)

    def resize(self, pixels: int) -> None:
        """Become the state of another number of pixels. What it holds is undefined until `write`."""
        if pixels > self._capacity:
            for planes in self._planes.values():
                self._device.release(planes.buffer)
            self._allocate(pixels)
        self.pixels = pixels
        self._stages.arguments["total_pixels"] = np.uint32(pixels)

    def reset(self) -> None:
        """Forget all samples."""
        for planes in self._planes.values():
            self._device.write(planes.buffer, np.zeros(planes.number * self.pixels, np.uint32))

    def read(self, reuse: Mapping[str, np.ndarray] = MappingProxyType({})) -> dict[str, np.ndarray]:
        """Read the state: name -> (planes, pixels) float32 or uint32. Waits for the device.

        Arrays of an earlier state may be given to `reuse`; they are overwritten.
        """
        state = {}
        for name, planes in self._planes.items():
            count = planes.number * self.pixels
            array = self._device.read(planes.buffer, planes.dtype, count, out=reuse.get(name))
            state[name] = array.reshape(planes.number, self.pixels)
        return state

    def write(self, state: Mapping[str, np.ndarray]) -> None:
        """Write what `read` has returned. Raises ValueError if it is that of other statistics or pixels."""
        for name, planes in self._planes.items():
            array = state.get(name)
            expected = (planes.number, self.pixels)
            if array is None or array.shape != expected or array.dtype != planes.dtype:
                raise ValueError(
                    f"the state has no array '{name}' of shape {expected} and type {planes.dtype.__name__}"
                )
            self._device.write(planes.buffer, array)
        self._device.finish()

    @contextmanager
    def mapped(self) -> Iterator[dict[str, np.ndarray]]:
        """The state within the `with` block, to read and to write: name -> (planes, pixels). Waits for the device.

        Nothing is copied if host and device share their memory.
        """
        with ExitStack() as stack:
            yield {
                name: stack.enter_context(
                    self._device.mapped(planes.buffer, planes.dtype, planes.number * self.pixels, writable=True)
                ).reshape(planes.number, self.pixels)
                for name, planes in self._planes.items()
            }
