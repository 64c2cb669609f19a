"""The per-pixel statistics on the device: the planes that the stage `reduce` updates, and how the host reads them."""

import numpy as np

from isonoise.integrator.stages import Stages
from isonoise.statistics import Needs, Statistics

SAMPLES_PER_BLOCK = 16
"""Samples that are summed before they are merged into the statistics, a power of two (kernels/stages/reduce.cl)."""

STRIP = 2**16
"""Pixels that are summarised and read at a time: what a strip holds stays in a CPU's cache."""

_SUMS = 10  # planes: high and low parts of the sums of red, green, blue, x, and of M2, over the full blocks
_OPEN = 6  # planes of the unfinished block: sums of red, green, blue; shift; sums of x - shift and its square


def build_constants(needs: Needs) -> dict[str, int]:
    """What the kernels of the statistics are built with."""
    return {"SAMPLES_PER_BLOCK": SAMPLES_PER_BLOCK, "CHUNK_SIZE": needs.chunk, "BATCH_SIZE": needs.batch}


class Accumulator:
    """State of the stage `reduce` for an image of shape (height, width), and of `summarise`, which closes the sums.

    It enters its buffers into the arguments of `stages`. What `needs` doesn't ask for has no buffer.
    """

    def __init__(self, stages: Stages, shape: tuple[int, int], needs: Needs):
        self._stages, self._device = stages, stages.device
        self._shape, self._needs = shape, needs
        self.pixels = shape[0] * shape[1]

        self._planes: list[tuple] = []  # every buffer of the state and its size

        def planes(number: int, what: str):
            self._planes.append((self._device.buffer(4 * number * self.pixels, what), number * self.pixels))
            return self._planes[-1][0]

        self.count = planes(1, "the sample counts")
        self.rejected = planes(1, "the counts of rejected samples")
        # two parts of the sum of the chunk medians; entries of the unfinished chunk; two parts of an unfinished entry
        medians = 2 + needs.chunk - 1 + (2 if needs.batch > 1 else 0)
        summary = 6 + needs.median + 2 * (needs.power is not None) + 3 * needs.half  # kernels/stages/summarise.cl
        self._summary = self._device.buffer(4 * summary * STRIP, "the summary of the statistics")
        self._summary_floats = summary * STRIP
        stages.arguments.update(
            total_pixels=np.uint32(self.pixels),
            count=self.count,
            rejected=self.rejected,
            sums=planes(_SUMS, "the statistics"),
            block_sums=planes(_OPEN, "the statistics of unfinished blocks"),
            summary=self._summary,
            stride=np.uint32(STRIP),
        )
        if needs.median:
            stages.arguments["medians"] = planes(medians, "the chunk medians")
        if needs.power is not None:
            stages.arguments["powers"] = planes(2, "the sums of powers")
            stages.arguments["power"] = np.float32(needs.power)
        if needs.half:
            stages.arguments["halves"] = planes(6, "the sums of every second sample")

    def forget(self) -> None:
        """Begins anew, as if no sample had entered: the next samples are the first ones again."""
        for buffer, size in self._planes:
            self._device.write(buffer, np.zeros(size, np.uint32))

    def statistics(self, scale: float = 1.0) -> Statistics:
        """Reads the statistics; samples on the device are `scale` (a power of two) times those of the scene.

        The arrays cannot be written to. Waits for the device.
        """
        n, needs = self.pixels, self._needs
        flat = Statistics(
            count=self._device.read(self.count, np.uint32, n),
            rejected=self._device.read(self.rejected, np.uint32, n),
            rgb=np.empty((n, 3), np.float32),
            mean=np.empty(n),
            variance=np.empty(n),
            median=np.empty(n) if needs.median else None,
            power=np.empty(n) if needs.power is not None else None,
            half=np.empty((n, 3), np.float32) if needs.half else None,
        )
        for begin in range(0, n, STRIP):
            pixels = min(STRIP, n - begin)
            bounds = {"first_pixel": np.uint32(begin), "pixels": np.uint32(pixels)}
            self._stages.launch("summarise", pixels, **bounds)
            with self._device.mapped(self._summary, np.float32, self._summary_floats) as summary:
                self._read_strip(flat, slice(begin, begin + pixels), summary.reshape(-1, STRIP), scale)
        planes = {name: plane for name, plane in vars(flat).items() if plane is not None}
        for name, plane in planes.items():
            planes[name] = plane.reshape(*self._shape, *plane.shape[1:])
            planes[name].flags.writeable = False
        return Statistics(**{"median": None} | planes)

    def _read_strip(self, into: Statistics, strip: slice, summary: np.ndarray, scale: float) -> None:
        """Fills the pixels `strip` of the planes of `into`, in the scene's units, from the planes of `summary`."""
        unit, pixels, place = 1 / scale, strip.stop - strip.start, 0

        def planes(number: int) -> np.ndarray:
            nonlocal place
            place += number
            return summary[place - number : place]

        def mean(to: np.ndarray) -> None:
            high, low = planes(2)[:, :pixels]
            np.add(high, low, out=to, dtype=np.float64)

        def colour(to: np.ndarray) -> None:
            rgb = planes(3).reshape(-1, 3)[:pixels]
            np.multiply(rgb, unit, out=to, dtype=np.float64, casting="same_kind")

        mean(into.mean[strip])
        into.mean[strip] *= unit
        np.multiply(planes(1)[0, :pixels], unit, out=into.variance[strip], dtype=np.float64)
        into.variance[strip] *= unit
        colour(into.rgb[strip])
        if into.median is not None:
            np.multiply(planes(1)[0, :pixels], unit, out=into.median[strip], dtype=np.float64)
        if into.power is not None:
            mean(into.power[strip])
            self._power_in_scene_units(into.power[strip], into.mean[strip], scale)
        if into.half is not None:
            colour(into.half[strip])

    def _power_in_scene_units(self, power: np.ndarray, mean: np.ndarray, scale: float) -> None:
        """In place; `mean` is that of x, in the scene's units."""
        exponent, q = float(np.log2(scale)), float(np.float32(self._needs.power))
        if q == 1:
            power *= 1 / scale
            power -= mean * (exponent * np.log(2.0))  # x ln x = x' ln x' / scale - x ln(scale) with x' = scale x
        else:
            with np.errstate(over="ignore"):
                power *= 2.0 ** min(max(-exponent * q, -1022), 1023)
            np.minimum(power, np.finfo(np.float64).max, out=power)
