"""The wavefront loop: traces the samples of an allocation map and reduces them, slice by slice.

A slice is a run of a wave's samples, in pixel order, that fits the sample buffer. Its paths run in a pool: every bounce
launches intersect, shade and shadow over the paths in flight, then moves those that go on to the front and generates
the next samples' paths behind them. After the last path the samples enter the statistics.
"""

from collections.abc import Callable, Mapping
from functools import partial

import numpy as np

from isonoise.device.opencl import LOCAL_SIZE, Device
from isonoise.device.pool_size import default_pool_size
from isonoise.integrator.accumulator import Accumulator, build_constants
from isonoise.integrator.brute_force import MAX_CORNERS, distinct_corners, use_brute_force
from isonoise.integrator.features import features
from isonoise.integrator.kernel_table import (
    BATCH_KERNELS,
    BOUNCE_BUFFERS,
    BRUTE_FORCE_KERNELS,
    LANE_KERNELS,
    PATH_STATE,
    STRUCTS,
    is_present,
    kernel_table,
    path_bytes,
)
from isonoise.integrator.pixel_filter import CELLS, inverse_cdf
from isonoise.integrator.stages import Stages
from isonoise.scene import structs
from isonoise.scene.accel.bvh import Bvh
from isonoise.scene.compiled_scene import CompiledScene
from isonoise.scene.light import light_list
from isonoise.scene.light.light_tree import build_light_tree
from isonoise.scene.material import bsdfs, textures
from isonoise.scene.mesh.triangle_records import corner_normals, triangle_records
from isonoise.statistics import BASIC_NEEDS, Needs

PLANE_PADDING = 80
"""Numbers by which a plane of the paths is longer than the pool: else the members of a path, a power of two apart,
would all compete for the same few places of a cache."""

RAYS_PER_ITEM = 32
"""Rays that a work-item of a CPU follows at most: PoCL gives every item of a group a stack, too many for the cache."""

SHADE_LANES = 256
"""Paths that a work-item shades, if it takes several: enough that the lists by what they meet are long (with 64, shade
takes 1.2 times as long on a scene of four kinds of material), and what is kept of them fits the second cache."""

_HELD = {
    "hit": "the hits",
    "alive": "the flags of the paths",
    "tests": "the counts of tests",
    **dict.fromkeys(("shadow_origin", "shadow_direction", "shadow_radiance"), "the shadow rays"),
}
"""What the buffers of the paths hold, in errors and reports; `the paths` where it isn't here."""


class Wavefront:
    """A scene on a device, ready to trace. `needs` are the statistics that the strategy reads.

    `feature_override`: features of the program, to test or to measure what it does with more of them than scene and
    `needs` ask for; by default those. With COUNT_TESTS the buffer `tests` has, after a bounce, the nodes and blocks
    of triangles that each ray of `intersect` was tested against.
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
    ):
        self.device, self.scene = device, scene
        self.features = dict(feature_override or features(scene, needs))
        self.pool_size = pool_size or default_pool_size(device.device)
        self.slice_samples = 16 * self.pool_size
        self.block_size = 512 if device.is_cpu else 64
        self.lanes = 1 if self.features["VOLPATH"] else device.lanes  # kernels/path/shade_lanes.h knows no media
        self.shade_lanes = SHADE_LANES if self.lanes > 1 else 1
        hierarchy = self.features["INSTANCES"] or self.features["COUNT_TESTS"]
        self.brute_force = self.lanes > 1 and not hierarchy and use_brute_force(scene)
        table = kernel_table(self.features, self.brute_force)
        self._shadow = next((name for name in ("shadow", "shadow_transmittance") if name in table), None)
        self._stages = Stages(
            device,
            table,
            self.features,
            structs.CONSTANTS
            | textures.CONSTANTS
            | build_constants(needs)
            | {
                "LANES": self.lanes,
                "PATHS_PER_BLOCK": self.block_size,
                "MAX_CORNERS": MAX_CORNERS,
                "MAX_LISTED_LIGHTS": light_list.MAX_LISTED_LIGHTS,
            },
            STRUCTS,
            file_constants={"stages/shade.cl": {"LANES": self.shade_lanes}},
            small_groups=(BATCH_KERNELS | LANE_KERNELS if self.lanes > 1 else BATCH_KERNELS)
            if device.lanes > 1
            else (),
        )
        self._arguments = self._stages.arguments
        self.accumulator = Accumulator(self._stages, (scene.height, scene.width), needs)
        self._path_state = [name for name in PATH_STATE if is_present(name, self.features)]
        self._arguments.update(self._upload(bvh, seed))
        if feature_override:
            from isonoise.integrator.feature_superset import dummy_buffers

            self._arguments.update(dummy_buffers(device, scene, self.features, self._arguments, self.brute_force))
        self.on_bounce: Callable[[int], None] | None = None  # gets how many paths took part, after every bounce

    @property
    def stages(self) -> Stages:
        """The kernels, to be launched one by one by whoever measures them."""
        return self._stages

    def _upload(self, bvh: Bvh, seed: int) -> dict[str, object]:
        scene, device, on = self.scene, self.device, self.features
        paths, samples = self.pool_size, self.slice_samples
        plane = paths + PLANE_PADDING
        pixels = self.accumulator.pixels
        endless = 0xFFFFFFFF

        def table(array: np.ndarray, what: str):
            return device.buffer(array, what) if array.size else None

        camera = scene.camera[0]
        filter_table = nothing = np.zeros(0, np.float32)
        if on["FILTER_TABLE"]:
            filter_table = inverse_cdf(scene.filter, float(camera["filter_radius"]), float(camera["filter_stddev"]))
        return {
            "camera": device.buffer(scene.camera, "the camera"),
            "inverse_cdf": table(filter_table, "the pixel filter"),
            "inverse_cdf_cells": np.uint32(CELLS),
            "nodes": table(bvh.nodes, "the hierarchy's nodes"),
            "blocks": table(bvh.blocks, "the hierarchy's triangles"),
            **self._corners(),
            "triangle_count": np.uint32(len(scene.faces)),
            "analytic_count": np.uint32(len(scene.analytics)),
            "first_analytic": np.uint32(bvh.first_analytic),
            "triangles": table(triangle_records(scene), "the triangles"),
            "faces": table(scene.faces if on["UVS"] else nothing, "the faces"),
            "uvs": table(scene.uvs, "the texture coordinates"),
            "textures": table(scene.textures, "the textures"),
            "texel_bytes": table(scene.texel_bytes, "the texels"),
            "texel_floats": table(scene.texel_floats, "the texels"),
            "srgb": table(textures.SRGB if on["BITMAPS"] else nothing, "the table of sRGB"),
            "attributes": table(scene.attributes, "the mesh attributes"),
            "textured_slots": np.uint32(bsdfs.textured_slots(scene.bsdfs)),
            "corner_normals": table(corner_normals(scene) if on["VERTEX_NORMALS"] else nothing, "the vertex normals"),
            "analytics": table(scene.analytics, "the analytic shapes"),
            "shapes": table(scene.shapes if on["ANALYTICS"] else nothing, "the shapes"),
            "instances": table(scene.instances, "the instances"),
            "world_triangles": np.uint32(scene.group_offsets[0, 0]),
            "first_instance": np.uint32(bvh.first_analytic + len(scene.analytics)),
            "bsdfs": table(scene.bsdfs, "the materials"),
            "media": table(scene.media, "the media"),
            "sensor_medium": np.uint32(scene.sensor_medium),
            "scene_sphere": _sphere_around(scene.bounds),
            "rough_transmittances": table(scene.rough_transmittances, "the tables of rough plastics"),
            "lights": table(scene.lights, "the lights"),
            "light_alias": table(scene.light_alias, "the light table"),
            "light_count": np.uint32(len(scene.lights)),
            **self._environment(),
            **self._weighed_lights(),
            "environment_light": np.uint32(scene.environment_light & 0xFFFFFFFF),
            "max_depth": np.uint32(scene.max_depth if scene.max_depth >= 0 else endless),
            "rr_depth": np.uint32(scene.rr_depth),
            "seed": np.array([seed & 0xFFFFFFFF, seed >> 32 & 0xFFFFFFFF], np.uint32),
            "plane_stride": np.uint32(plane),
            "block_alive": device.buffer(4 * -(-paths // self.block_size), "the compaction"),
            "total_alive": device.buffer(4, "the compaction"),
            **dict.fromkeys(BOUNCE_BUFFERS),
            **{
                name: device.buffer(size * plane, _HELD.get(name, "the paths")) for name, size in path_bytes(on).items()
            },
            "samples": device.buffer(12 * samples, "the sample buffer"),
            "sample_pixel": device.buffer(4 * samples, "the sample list"),
            "pixel_offset": device.buffer(4 * pixels, "the allocation"),
        }

    def _corners(self) -> dict[str, object]:
        """The corners of the triangles, where they are so few that there is no hierarchy."""
        if not self.brute_force or not len(self.scene.faces):
            return {"corners": None, "corner_indices": None, "corner_count": np.uint32(0)}
        corners, numbers = distinct_corners(self.scene)
        return {
            "corners": self.device.buffer(corners, "the triangles"),
            "corner_indices": self.device.buffer(numbers, "the triangles"),
            "corner_count": np.uint32(len(corners)),
        }

    def _environment(self) -> dict[str, object]:
        """The buffers of the environment map, if there is one."""
        sky, device = self.scene.environment, self.device
        if sky is None:
            return {}
        return {
            "environment": device.buffer(sky.record, "the environment map"),
            "environment_texels": device.buffer(sky.texels, "the environment map"),
            "environment_rows": device.buffer(sky.rows, "the environment map"),
            "environment_aliases": device.buffer(sky.aliases, "the environment map"),
        }

    def _weighed_lights(self) -> dict[str, object]:
        """The buffers by which one of many lights is picked, if there are as many."""
        if self.features["LIGHT_LIST"]:
            return {"light_bounds": self.device.buffer(light_list.build_light_list(self.scene), "the light list")}
        if not self.features["LIGHT_TREE"]:
            return {}
        tree = build_light_tree(self.scene)
        return {
            "light_nodes": self.device.buffer(tree.nodes, "the light tree"),
            "light_parents": self.device.buffer(tree.parents, "the light tree"),
        }

    def warm_up(self) -> None:
        """Launches every kernel on nothing: some drivers compile only now, for the local size and the class of grid.

        Large grids first: what PoCL compiles for them, of 2^16 work-items or more, serves small ones too, not the other
        way round.
        """
        bounds = ("pixels", "slice_samples", "count_new", "path_count", "rays_per_item", "blocks_in_use")
        nothing = dict.fromkeys((*bounds, "first_pixel", "first_slot", "first_sample"), np.uint32(0))
        for items in (min(self.pool_size, 2**17), 1):
            for name in self._stages:
                self._launch(name, items, **nothing)
        self.device.finish()
        self.device.reset_profile()

    def trace(self, allocation: np.ndarray, should_continue: Callable[[int], bool] = lambda entered: True) -> int:
        """Traces the allocation map, uint32 of shape (height, width); returns how many samples entered the statistics.

        `should_continue` is asked after every bounce, with the samples that have entered so far. Once it says no, no
        path begins any more; those in flight come to their end and count. What has entered is always a first part of
        the map, in pixel order.
        """
        ends = np.cumsum(allocation.ravel(), dtype=np.int64)
        total, entered = int(ends[-1]), 0
        while entered < total and should_continue(entered):
            end = min(entered + self.slice_samples, total)
            first, last = np.searchsorted(ends, [entered, end - 1], side="right")
            starts = ends[first : last + 1] - allocation.ravel()[first : last + 1]
            offsets = np.maximum(starts - entered, 0).astype(np.uint32)
            traced = self._trace_slice(int(first), offsets, end - entered, partial(should_continue, entered))
            entered += traced
            if entered < end:
                break
        return entered

    def _trace_slice(
        self, first_pixel: int, offsets: np.ndarray, samples: int, should_continue: Callable[[], bool]
    ) -> int:
        """One slice: pixels first_pixel... whose samples begin at `offsets` of its `samples`; returns those traced."""
        pixels = len(offsets)
        self.device.write(self._arguments["pixel_offset"], offsets, offset=4 * first_pixel)
        of_slice = {"first_pixel": np.uint32(first_pixel), "pixels": np.uint32(pixels)}
        self._stages.launch("list_samples", pixels, slice_samples=np.uint32(samples), **of_slice)
        if self.scene.max_depth == 0:
            self.device.write(self._arguments["samples"], np.zeros(3 * samples, np.float32))
        else:
            samples = self._trace_paths(samples, should_continue)
        self._stages.launch("reduce", pixels, slice_samples=np.uint32(samples), **of_slice)
        self.device.finish()
        return samples

    def _trace_paths(self, samples: int, should_continue: Callable[[], bool]) -> int:
        paths = begun = 0  # in flight; samples whose path has begun
        while paths or begun < samples:
            new = min(self.pool_size - paths, samples - begun)
            if new:
                places = {"first_slot": np.uint32(paths), "first_sample": np.uint32(begun)}
                self._launch("generate", new, count_new=np.uint32(new), **places)
            begun += new
            paths = self._bounce(paths + new)
            if begun < samples and not should_continue():
                samples = begun
        return begun

    def _launch(self, kernel: str, items: int, **given) -> None:
        """Runs a kernel over at least `items`, of which a work-item of some kernels takes several."""
        lanes = self.lanes if kernel in LANE_KERNELS or (self.brute_force and kernel in BRUTE_FORCE_KERNELS) else 1
        lanes = self.shade_lanes if kernel == "shade" else lanes
        self._stages.launch(kernel, items, lanes, **given)

    def _bounce(self, paths: int) -> int:
        """One bounce of all paths in flight; returns how many go on. Waits for the device."""
        bound = {"path_count": np.uint32(paths)}
        self.trace_rays("intersect", paths)
        self._launch("shade", paths, **bound)
        if self._shadow:
            self.trace_rays(self._shadow, paths)
        blocks = -(-paths // self.block_size)
        self._stages.launch("count_alive", blocks, **bound)
        self._stages.launch("scan_blocks", 1, blocks_in_use=np.uint32(blocks))
        self._stages.launch("move_paths", blocks, **bound)
        of = self._arguments
        for name in self._path_state:
            of[name], of[f"next_{name}"] = of[f"next_{name}"], of[name]
        alive = int(self.device.read(of["total_alive"], np.uint32, 1)[0])
        if self.on_bounce:
            self.on_bounce(paths)
        return alive

    def trace_rays(self, stage: str, paths: int) -> None:
        """Launches a stage that follows rays. On a CPU a work-item takes several, one after the other."""
        if self.brute_force:
            self._launch(stage, paths, path_count=np.uint32(paths))
            return
        rays = 1
        if (
            self.device.is_cpu and stage != "shadow_transmittance"
        ):  # and every core has some groups, as long as there are enough
            rays = min(max(paths // (LOCAL_SIZE * 4 * self.device.compute_units), 1), RAYS_PER_ITEM)
        self._stages.launch(stage, paths, rays, path_count=np.uint32(paths), rays_per_item=np.uint32(rays))


def _sphere_around(bounds: np.ndarray) -> np.ndarray:
    """Center and radius (4,) float32 of the sphere around a box (2, 3)."""
    radius = 0.5 * np.linalg.norm(np.ptp(bounds.astype(float), axis=0))
    return np.append(bounds.mean(axis=0), radius).astype(np.float32)
