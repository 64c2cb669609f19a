"""The wavefront loop: traces the samples of an allocation map and reduces them, slice by slice.

A slice is a run of a wave's samples, in pixel order, that fits the sample buffer (`sample_list`). Its paths run in a
pool: every bounce launches `intersect`, `shade` and `shadow` over the paths in flight, compacts the paths that
continue, and generates the paths of the next samples behind them. After its last path the samples of the slice are
reduced to statistics.
"""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from isonoise.device.form import DeviceForm
from isonoise.device.opencl import LOCAL_SIZE, SMALL_LOCAL_SIZE, Device
from isonoise.device.pool_size import SAMPLES_PER_PATH, default_pool_size
from isonoise.device.precompile import OnCompile
from isonoise.integrator import error_stage
from isonoise.integrator.accumulator import Accumulator
from isonoise.integrator.brute_force import use_brute_force
from isonoise.integrator.build_constants import build_constants
from isonoise.integrator.features import features
from isonoise.integrator.kernel_table import (
    BOUNCE_BUFFERS,
    BRUTE_FORCE_KERNELS,
    COMPACTION_KERNELS,
    IMAGE_KERNELS,
    LANE_KERNELS,
    SEQUENTIAL_KERNELS,
    STRUCTS,
    kernel_table,
)
from isonoise.integrator.memory_plan import PLANE_PADDING, MemoryPlan, fit_pool, path_buffers, sample_buffers
from isonoise.integrator.reduction_state import ReductionState
from isonoise.integrator.sample_list import SampleList
from isonoise.integrator.scene_buffers import measure_scene, scene_arguments, scene_bytes
from isonoise.integrator.stages import Stages
from isonoise.scene.accel.build import build_scene_bvh
from isonoise.scene.accel.bvh import Bvh
from isonoise.scene.compiled_scene import CompiledScene
from isonoise.statistics import BASIC_NEEDS, Needs

MAX_COMPILED_ITEMS = 2**17
"""Items of the launches for which kernels are compiled: PoCL has one form for global sizes from 2^16 on."""

_BUFFER_LABELS = {
    "hit": "the hits",
    "alive": "the flags of the paths",
    "holes": "the slots of dead paths",
    "tests": "the counts of tests",
    **dict.fromkeys(("shadow_origin", "shadow_direction", "shadow_radiance", "shadow_stream"), "the shadow rays"),
    **dict.fromkeys(("path_block_alive", "total_alive"), "the compaction"),
    "samples": "the sample buffer",
    **dict.fromkeys(("sample_pixel", "sample_index"), "the sample list"),
    "pixel_offset": "the allocation",
}
"""Labels of the path buffers in errors and reports; the others are `the paths`."""


class _Run(NamedTuple):
    """Consecutive samples of a slice."""

    first: int
    samples: int


def scene_form(device: Device, features: Mapping[str, bool]) -> DeviceForm:
    """How kernels with these features divide their work among work-items."""
    # `shade_lanes` does not support VOLPATH
    return device.form._replace(lanes=1, shade_lanes=1) if features["VOLPATH"] else device.form


def tests_all_primitives(form: DeviceForm, features: Mapping[str, bool], scene: CompiledScene) -> bool:
    """Whether rays are tested against all primitives, without the BVH."""
    needs_bvh = features["INSTANCES"] or features["COUNT_TESTS"]
    return form.lanes > 1 and not needs_bvh and use_brute_force(scene)


def plan_memory(device: Device, scene: CompiledScene, needs: Needs) -> MemoryPlan:
    """What a render of the scene takes with the device's default pool; nothing is allocated."""
    used, bvh = features(scene, needs), build_scene_bvh(scene)
    form = scene_form(device, used)
    scene_size, bvh_size = measure_scene(scene, bvh, used, tests_all_primitives(form, used, scene))
    return _memory_plan(device, scene, (scene_size, bvh_size), used, needs, default_pool_size(device.device))


def _memory_plan(device, scene, scene_sizes, used, needs, pool_size, is_adaptive=True, has_image=True) -> MemoryPlan:
    return MemoryPlan(
        *scene_sizes,
        features=used,
        needs=needs,
        shape=(scene.height, scene.width),
        pool_size=pool_size,
        path_block_size=device.form.path_block_size,
        compute_units=device.compute_units,
        is_adaptive=is_adaptive,
        has_image=has_image,
    )


def _window_arguments(scene: CompiledScene) -> dict[str, np.uint32]:
    """Where the pixels of the image are in the film, of which the image may be a window."""
    (film_width, _), (left, top), (width, _) = scene.film_window
    offset = top * film_width + left
    return {"film_width": np.uint32(film_width), "film_offset": np.uint32(offset), "crop_width": np.uint32(width)}


class Wavefront:
    """A scene on a device, ready to trace.

    Parameters
    ----------
    needs : statistics that the strategy reads beyond the basic ones
    seed : whole number from 0 to 2^64 - 1
    pool_size : paths in flight; None takes the device's default
    feature_override : features that the kernels are built with in place of those that `scene` and `needs` ask for, to
        test or to measure more of them. With COUNT_TESTS the buffer `tests` holds, after a bounce, how many nodes and
        triangle blocks each ray of `intersect` was tested against.
    memory : most bytes to take, with the host's arrays if the device shares its memory; the pool is made smaller to fit
    is_adaptive : whether the strategy plans adaptive waves, which take more memory of the host
    has_image : whether the statistics are those of the image. If not, only of the pixels that `set_pixels` names, and
        there are no `accumulator` and `errors`.
    on_compile : called before each program is compiled, with its name, how many are done, and how many there are
    """

    def __init__(
        self,
        device: Device,
        scene: CompiledScene,
        bvh: Bvh,
        needs: Needs = BASIC_NEEDS,
        seed: int = 0,
        pool_size: int | None = None,
        feature_override: Mapping[str, bool] | None = None,
        memory: int | None = None,
        is_adaptive: bool = True,
        has_image: bool = True,
        on_compile: OnCompile = lambda name, done, total: None,
    ):
        self.device, self.scene = device, scene
        self.features = dict(feature_override or features(scene, needs))
        self.bvh_stack = bvh.stack
        self._form = form = scene_form(device, self.features)
        self.brute_force = tests_all_primitives(form, self.features, scene)
        scene_buffers = scene_arguments(device, scene, bvh, self.features, self.brute_force)
        sizes = scene_bytes(scene_buffers)
        self.memory_plan = fit_pool(
            lambda pool: _memory_plan(device, scene, sizes, self.features, needs, pool, is_adaptive, has_image),
            pool_size or default_pool_size(device.device),
            device,
            memory,
        )
        self.pool_size = self.memory_plan.pool_size
        self.slice_samples = SAMPLES_PER_PATH * self.pool_size
        table = kernel_table(self.features, self.brute_force)
        self._shadow = next((name for name in ("shadow", "shadow_transmittance") if name in table), None)
        small_groups = SEQUENTIAL_KERNELS | (LANE_KERNELS if form.lanes > 1 else set())
        local_sizes = dict.fromkeys(small_groups if device.form.lanes > 1 else (), SMALL_LOCAL_SIZE)
        if form.block_work_items > 1:
            local_sizes |= dict.fromkeys(COMPACTION_KERNELS, form.block_work_items)
        lane_kernels = LANE_KERNELS | (set(BRUTE_FORCE_KERNELS) if self.brute_force else set())
        self._stages = Stages(
            device,
            table,
            self.features,
            build_constants(needs, form, bvh.stack),
            STRUCTS,
            file_constants={"stages/shade.cl": {"LANES": form.shade_lanes}},
            local_sizes=local_sizes | {"relative_errors": form.tile_work_items},
            items_per_work_item=dict.fromkeys(lane_kernels, form.lanes) | {"shade": form.shade_lanes},
            compiled_items=min(self.pool_size, MAX_COMPILED_ITEMS),
            on_compile=on_compile,
        )
        self._arguments = self._stages.arguments
        self._arguments |= {
            **dict.fromkeys(("pixel_list", "layer_sums", "layer_indices")),
            **_window_arguments(scene),
        }
        if has_image:
            shape = (scene.height, scene.width)
            self.accumulator = Accumulator(self._stages, shape, needs)
            self.errors = error_stage.ErrorStage(self._stages, shape, form.tile_work_items)
            self.reduction = self.accumulator.reduction
        else:
            self.accumulator = self.errors = None
            self.reduction = ReductionState(self._stages, 1, needs)
        self._arguments.update(scene_buffers)
        self._arguments.update(self._path_arguments())
        self.set_seed(seed)
        if feature_override:
            from isonoise.integrator.feature_superset import dummy_buffers

            self._arguments.update(dummy_buffers(device, scene, self.features, self._arguments, self.brute_force))
        self.on_bounce: Callable[[int], None] | None = None  # called after every bounce with its paths

    @property
    def stages(self) -> Stages:
        """The kernels, for measurements that launch them one by one."""
        return self._stages

    def _path_arguments(self) -> dict[str, object]:
        """Buffers of the paths in flight and of the samples of a slice."""
        sizes = {
            **path_buffers(self.features, self.pool_size, self._form.path_block_size),
            **sample_buffers(self.pool_size, self.scene.width * self.scene.height),
        }
        return {
            "plane_stride": np.uint32(self.pool_size + PLANE_PADDING),
            **dict.fromkeys(BOUNCE_BUFFERS),
            **{name: self.device.buffer(size, _BUFFER_LABELS.get(name, "the paths")) for name, size in sizes.items()},
        }

    def set_seed(self, seed: int) -> None:
        """Trace samples of this seed from now on."""
        self._arguments["seed"] = np.array([seed & 0xFFFFFFFF, seed >> 32 & 0xFFFFFFFF], np.uint32)

    def reset(self, seed: int) -> None:
        """Forget all samples of the image; those that follow are of this seed."""
        self.set_seed(seed)
        self.accumulator.reset()

    def set_pixels(self, pixels: np.ndarray, state: Mapping[str, np.ndarray]) -> None:
        """Trace samples of these pixels of the image from now on, which have this state. Not with `has_image`.

        Parameters
        ----------
        pixels : (n,) uint32, their numbers, row by row
        state : name -> (planes, n), as of `ReductionState`
        """
        pixel_list = self._arguments["pixel_list"]
        if pixel_list is None or pixel_list.size < pixels.nbytes:
            if pixel_list is not None:
                self.device.release(pixel_list)
            self._arguments["pixel_list"] = self.device.buffer(pixels, "the list of pixels")
        else:
            self.device.write(pixel_list, pixels)
        self.reduction.resize(len(pixels))
        self.reduction.write(state)

    def warm_up(self, on_compile: OnCompile = lambda name, done, total: None) -> None:
        """Launch every kernel on nothing, because some drivers compile only now."""
        self._stages.warm_up(on_compile, () if self.accumulator else IMAGE_KERNELS)

    def trace(
        self,
        remaining: np.ndarray,
        should_continue: Callable[[], bool] = lambda: True,
        on_reduced: Callable[[int], None] = lambda samples: None,
    ) -> None:
        """Trace the samples that remain of a wave, in pixel order, and reduce them.

        Parameters
        ----------
        remaining : uint32 (height, width), C-contiguous, samples per pixel; those that enter the statistics are
            subtracted from it, slice by slice, also if an exception ends the call
        should_continue : called before every slice, and after every bounce while paths of the slice are left to start;
            once it returns False no new path starts, and the paths in flight finish
        on_reduced : called with the samples of every slice, once they are subtracted
        """
        samples, is_stopped = SampleList(remaining.reshape(-1)), False
        while samples.total and not is_stopped and should_continue():
            pixel, offsets, number = samples.first_slice(self.slice_samples)
            traced = self._trace_slice(pixel, offsets, number, should_continue)
            samples.remove_first(traced)
            on_reduced(traced)
            is_stopped = traced < number

    def _trace_slice(
        self, first_pixel: int, offsets: np.ndarray, samples: int, should_continue: Callable[[], bool]
    ) -> int:
        """Trace and reduce one slice; returns the samples traced.

        `offsets` (pixels,): where in the slice the samples of its pixels begin, from `first_pixel` on.
        """
        pixels = len(offsets)
        self.device.write(self._arguments["pixel_offset"], offsets)
        self._arguments["first_pixel"] = np.uint32(first_pixel)
        slice_pixels = {"pixels": np.uint32(pixels)}
        self._stages.launch("list_samples", pixels, slice_samples=np.uint32(samples), **slice_pixels)
        if self.scene.max_depth == 0:
            self.device.write(self._arguments["samples"], np.zeros(3 * samples, np.float32))
        else:
            samples = self._trace_paths(offsets, samples, should_continue)
        if self.accumulator is not None:
            self.accumulator.expire_luminance()
        self._stages.launch("reduce", pixels, slice_samples=np.uint32(samples), **slice_pixels)
        self.device.finish()
        return samples

    def _trace_paths(self, offsets: np.ndarray, samples: int, should_continue: Callable[[], bool]) -> int:
        """Trace the paths of a slice to their ends; returns how many were started."""
        in_flight, started, is_stopped = 0, 0, False
        while in_flight or (started < samples and not is_stopped):
            new = 0 if is_stopped else min(self.pool_size - in_flight, samples - started)
            if new:
                first = {"first_slot": np.uint32(in_flight), "first_sample": np.uint32(started)}
                self._stages.launch("generate", new, count_new=np.uint32(new), **first)
            in_flight = self._bounce(in_flight, _Run(started, new), offsets)
            started += new
            is_stopped = is_stopped or (started < samples and not should_continue())
        return started

    def _bounce(self, old_paths: int, new: "_Run", offsets: np.ndarray) -> int:
        """Trace all paths in flight, of which some are `new`, for one bounce; returns how many continue.

        Waits for the device.
        """
        paths = old_paths + new.samples
        self.trace_rays("intersect", paths)
        if self.features["LAYERS"] and new.samples:
            self._accumulate_layers(old_paths, new, offsets)
        self._stages.launch("shade", paths, path_count=np.uint32(paths))
        if self._shadow:
            self.trace_rays(self._shadow, paths)
        alive = self._compact(paths)
        if self.on_bounce:
            self.on_bounce(paths)
        return alive

    def _accumulate_layers(self, first_slot: int, new: "_Run", offsets: np.ndarray) -> None:
        """Add what new camera rays have hit to the layers of their pixels. `offsets` as for `_trace_slice`."""
        ends = np.array([new.first, new.first + new.samples - 1], offsets.dtype)
        first, last = np.searchsorted(offsets, ends, side="right") - 1
        self._stages.launch(
            "accumulate_layers",
            int(last - first + 1),
            first_slot=np.uint32(first_slot),
            first_sample=np.uint32(new.first),
            count_new=np.uint32(new.samples),
            pixels=np.uint32(len(offsets)),
            first_layer_pixel=np.uint32(first),
            layer_pixels=np.uint32(last - first + 1),
        )

    def _compact(self, paths: int) -> int:
        """Move live paths into the slots of dead ones; returns how many are alive."""
        form, path_count = self._form, np.uint32(paths)
        path_blocks = -(-paths // form.path_block_size)
        work_items = path_blocks * form.block_work_items
        self._stages.launch("count_alive", work_items, path_count=path_count)
        self._stages.launch("scan_blocks", form.block_work_items, path_block_count=np.uint32(path_blocks))
        end_read = self.device.begin_read(self._arguments["total_alive"], np.uint32, 1)
        self._stages.launch("list_holes", work_items, path_count=path_count)
        self._stages.launch("fill_holes", work_items, path_count=path_count)
        self.device.flush()
        return int(end_read()[0])  # the host prepares the next bounce while the device fills the holes

    def trace_rays(self, stage: str, paths: int) -> None:
        """Launch a stage that traces rays. A work-item may trace several, one after the other."""
        path_count = np.uint32(paths)
        if self.brute_force:
            self._stages.launch(stage, paths, path_count=path_count)
            return
        rays = 1
        if stage != "shadow_transmittance":  # leaves at least 4 groups for each core
            rays = max(paths // (LOCAL_SIZE * 4 * self.device.compute_units), 1)
            rays = min(rays, self._form.max_rays_per_item)
        self._stages.launch(stage, paths, rays, path_count=path_count, rays_per_item=np.uint32(rays))
