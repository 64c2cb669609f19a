"""The per-pixel statistics of an image on the device, and reading them on the host."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from types import MappingProxyType

import numpy as np

from isonoise.device.form import DeviceForm
from isonoise.integrator.image_scratch import GRID_BINS, TILE_SIZE, ImageScratch, tile_count
from isonoise.integrator.layer_planes import layer_images
from isonoise.integrator.reduction_state import NET_COUNT_LOG2, ReductionState
from isonoise.integrator.stages import Stages
from isonoise.statistics import Needs, Statistics

SAMPLE_BLOCK_SIZE = 16
"""Samples that are summed before they are merged into the statistics (kernels/stages/reduce.cl). A power of two."""

SUMMARY_STRIP_PIXELS = 2**16
"""Pixels that are summarised and read at a time, so that a strip stays in a CPU's cache."""

_SUMMARIES = 2  # the host reads one while the device fills the other


def summary_bytes(needs: Needs) -> int:
    """Bytes of the buffers of the stage `summarise`, whatever the image."""
    return _SUMMARIES * 4 * _summary_planes(needs) * SUMMARY_STRIP_PIXELS


def _summary_planes(needs: Needs) -> int:
    return 3 + needs.median + 2 * (needs.power is not None) + 3 * needs.half  # kernels/stages/summarise.cl


def build_constants(needs: Needs, form: DeviceForm) -> dict[str, int]:
    """Build constants of the stages of the statistics on a device of this form."""
    return {
        "PIXELS_PER_ITEM": form.pixels_per_item,
        "SAMPLE_BLOCK_SIZE": SAMPLE_BLOCK_SIZE,
        "NEIGHBOUR_RUN": form.neighbour_run,
        "NET_COUNT": 2**NET_COUNT_LOG2,
        "NET_COUNT_LOG2": NET_COUNT_LOG2,
        "TILE_SIZE": TILE_SIZE,
        "GRID_BINS": GRID_BINS,
        "CHUNK_SIZE": needs.chunk,
        "BATCH_SIZE": needs.batch,
    }


class Accumulator:
    """State of the stage `reduce` for an image of shape (height, width), read through the stage `summarise`.

    Its buffers become arguments of `stages`. Statistics that `needs` does not name have no buffer.
    """

    def __init__(self, stages: Stages, shape: tuple[int, int], needs: Needs):
        self._stages, self._device = stages, stages.device
        self._shape, self._needs = shape, needs
        self.pixels = shape[0] * shape[1]

        self.reduction = ReductionState(stages, self.pixels, needs)
        self.count, self.rejected = (stages.arguments[name] for name in ("count", "rejected"))
        self._summary_floats = _summary_planes(needs) * SUMMARY_STRIP_PIXELS
        self._summaries = [
            self._device.buffer(4 * self._summary_floats, "the summary of the statistics") for _ in range(_SUMMARIES)
        ]
        stages.arguments.update(
            summary=self._summaries[0], image_width=np.uint32(shape[1]), stride=np.uint32(SUMMARY_STRIP_PIXELS)
        )
        if needs.neighbours:
            stages.arguments["neighbour_radius"] = np.uint32(needs.neighbours // 2)
        self._scratch = ImageScratch(stages, shape, needs)
        self._has_luminance = False  # whether `luminance` is that of the present samples

    def _launch_dependent_stages(self) -> None:
        """Design effect and averages of the neighbours, which need the summary of the whole image."""
        height, width = self._shape
        if self._needs.nets:
            tiles = tile_count(self._shape, TILE_SIZE)
            self._stages.launch("sum_tiles", tiles)
            self._stages.launch("fit_steps", tiles)
            self._stages.launch("compute_design_effect", height * (-(-width // TILE_SIZE) + 1))
        if self._needs.neighbours:
            self._stages.launch("average_neighbours", height * -(-width // self._device.form.neighbour_run))

    def reset(self) -> None:
        """Forget all samples."""
        self.reduction.reset()
        self.expire_luminance()

    def state(self, reuse: Mapping[str, np.ndarray] = MappingProxyType({})) -> dict[str, np.ndarray]:
        """Read the state of `reduce`: name -> (planes, height, width) float32 or uint32. Waits for the device.

        With it and the sample counts, later samples have the same effect as without a stop. Arrays of an earlier state
        may be given to `reuse`; they are overwritten.
        """
        return {name: array.reshape(-1, *self._shape) for name, array in self.reduction.read(reuse).items()}

    def set_state(self, state: Mapping[str, np.ndarray]) -> None:
        """Write what `state` has returned. Raises ValueError if it is that of other statistics or another size."""
        for name, array in state.items():
            if array.shape[1:] != self._shape:
                raise ValueError(f"the array '{name}' of the state has the shape {array.shape}")
        self.reduction.write({name: array.reshape(len(array), -1) for name, array in state.items()})
        self.expire_luminance()

    def layers(self) -> dict[str, np.ndarray]:
        """The layers of `Needs.layers` by name, as `layer_images` returns them. Waits for the device."""
        with self.reduction.mapped() as state:
            planes = {name: array.reshape(-1, *self._shape) for name, array in state.items()}
            return layer_images(planes, self._needs.layers)

    @contextmanager
    def mapped_state(self) -> Iterator[dict[str, np.ndarray]]:
        """The state within the `with` block, to read and to add samples: name -> (planes, pixels)."""
        self.expire_luminance()
        with self.reduction.mapped() as state:
            yield state

    def statistics(self, scale: float = 1.0, defer_rgb: bool = False) -> Statistics:
        """Read the statistics as read-only arrays, in the scene's units. Waits for the device.

        `scale`: samples on the device are this power of two times those of the scene. `defer_rgb`: read `rgb` when it
        is first asked for, which has to be before samples are added.
        """
        n, needs = self.pixels, self._needs
        self._scratch.allocate()
        flat = Statistics(
            count=self._device.read(self.count, np.uint32, n),
            rejected=self._read_rejected(),
            rgb=None,
            mean=np.empty(n),
            variance=np.empty(n, _plane_type(1 / scale)),
            median=np.empty(n) if needs.median else None,
            power=np.empty(n) if needs.power is not None else None,
            half=np.empty((n, 3), np.float32) if needs.half else None,
        )
        for strip, summary in self._summary_strips("summarise", self._launch_dependent_stages):
            self._read_strip(flat, strip, summary.reshape(-1, SUMMARY_STRIP_PIXELS), scale)
        self._has_luminance = True
        if needs.nets:
            design_effect = self._device.read(self._stages.arguments["design_effect"], np.float32, n)
            flat = replace(flat, design_effect=design_effect)
        if needs.neighbours:
            flat = self._with_neighbours(flat, 1 / scale)
        planes = flat.planes()
        for name, plane in planes.items():
            planes[name] = plane.reshape(*self._shape, *plane.shape[1:])
            planes[name].flags.writeable = False
        planes["rgb"] = partial(self.rgb, scale) if defer_rgb else self.rgb(scale)
        return Statistics(**{"median": None} | planes)

    def update_luminance(self) -> None:
        """Make `luminance` that of the present samples, for the stage `relative_errors`."""
        if self._has_luminance:
            return
        self._scratch.allocate()
        for begin in range(0, self.pixels, SUMMARY_STRIP_PIXELS):
            self._launch_strip("summarise", begin)
        self._launch_dependent_stages()
        self._has_luminance = True

    def release_scratch(self) -> None:
        """Give back what only `statistics` needs, if the image is large; it is allocated again when it is needed."""
        if self._scratch.release():
            self._has_luminance = False

    def expire_luminance(self) -> None:
        """Samples are added: `luminance` no longer belongs to them."""
        self._has_luminance = False

    def _read_rejected(self) -> np.ndarray:
        """The counts of rejected samples: without any, an array that takes no memory."""
        with self._device.mapped(self.rejected, np.uint32, self.pixels) as rejected:
            return rejected.copy() if rejected.any() else np.broadcast_to(np.uint32(0), rejected.shape)

    def rgb(self, scale: float) -> np.ndarray:
        """The mean RGB, in the scene's units: planes, which are written to a file without a copy.

        Large images release the scratch buffers first.
        """
        self.release_scratch()
        rgb = np.empty((3, self.pixels), np.float32)
        for strip, summary in self._summary_strips("summarise_rgb"):
            planes = summary[: 3 * SUMMARY_STRIP_PIXELS].reshape(3, -1)
            _in_scene_units(planes[:, : strip.stop - strip.start], 1 / scale, rgb[:, strip])
        rgb.flags.writeable = False
        return rgb.reshape(3, *self._shape).transpose(1, 2, 0)

    def _summary_strips(
        self, stage: str, launch_last: Callable[[], None] = lambda: None
    ) -> Iterator[tuple[slice, np.ndarray]]:
        """Launch a stage that fills `summary` strip by strip, and `launch_last` behind it: pixels and their summary."""
        begins = range(0, self.pixels, SUMMARY_STRIP_PIXELS)
        self._launch_strip(stage, 0)
        for begin in begins:
            buffer = self._summaries[begin // SUMMARY_STRIP_PIXELS % 2]
            with self._device.mapped(buffer, np.float32, self._summary_floats) as summary:
                if begin != begins[-1]:
                    self._launch_strip(stage, begin + SUMMARY_STRIP_PIXELS)
                else:
                    launch_last()
                self._device.flush()
                yield slice(begin, min(begin + SUMMARY_STRIP_PIXELS, self.pixels)), summary

    def _with_neighbours(self, flat: Statistics, unit: float) -> Statistics:
        dtype = _plane_type(unit)
        with self._device.mapped(self._stages.arguments["neighbours"], np.float32, 2 * self.pixels) as planes:
            mean, variance = planes.reshape(2, -1)
            mean = np.multiply(mean, unit, dtype=dtype)
            variance = np.multiply(variance, unit, dtype=dtype)
        variance *= unit
        return replace(flat, neighbour_mean=mean, neighbour_variance=variance)

    def _launch_strip(self, stage: str, begin: int) -> None:
        """Launch a stage that fills `summary` for the strip of pixels from `begin` on."""
        pixels = min(SUMMARY_STRIP_PIXELS, self.pixels - begin)
        bounds = {"first_pixel": np.uint32(begin), "pixels": np.uint32(pixels)}
        summary = self._summaries[begin // SUMMARY_STRIP_PIXELS % 2]
        self._stages.launch(stage, pixels, self._device.form.pixels_per_item, summary=summary, **bounds)

    def _read_strip(self, statistics: Statistics, strip: slice, summary: np.ndarray, scale: float) -> None:
        """Fill the pixels `strip` of `statistics`, in the scene's units, from the planes of `summary`."""
        unit, pixels, next_plane = 1 / scale, strip.stop - strip.start, 0

        def planes(number: int) -> np.ndarray:
            nonlocal next_plane
            next_plane += number
            return summary[next_plane - number : next_plane]

        def read_mean(out: np.ndarray) -> None:
            high, low = planes(2)[:, :pixels]
            np.add(high, low, out=out, dtype=np.float64)

        read_mean(statistics.mean[strip])
        statistics.mean[strip] *= unit
        variance = statistics.variance[strip]
        with np.errstate(over="ignore"):
            np.multiply(planes(1)[0, :pixels], unit, out=variance, dtype=variance.dtype)
            variance *= unit
        np.minimum(variance, np.finfo(variance.dtype).max, out=variance)
        if statistics.median is not None:
            np.multiply(planes(1)[0, :pixels], unit, out=statistics.median[strip], dtype=np.float64)
        if statistics.power is not None:
            read_mean(statistics.power[strip])
            self._power_in_scene_units(statistics.power[strip], statistics.mean[strip], scale)
        if statistics.half is not None:
            _in_scene_units(planes(3).reshape(-1, 3)[:pixels], unit, statistics.half[strip])

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


def _plane_type(unit: float) -> type:
    """Type of the variances, which the device has in float32: their squared units may be beyond it."""
    return np.float32 if 2.0**-30 <= unit <= 2.0**30 else np.float64


def _in_scene_units(colours: np.ndarray, unit: float, out: np.ndarray) -> None:
    """Write colours times a power of two to `out`."""
    # float32 rounds as float64 would, and takes a quarter of the time
    dtype = np.float32 if 2.0**-100 <= unit <= 2.0**100 else np.float64
    np.multiply(colours, unit, out=out, dtype=dtype, casting="same_kind")
