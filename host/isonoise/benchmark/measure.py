"""Measures a scene: throughput without profiling, kernels with it, rays by bounce; in turn, `repeat` times.

Called by `isonoise bench`; the other measurements use its header and settings.
"""

import os
import platform
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from isonoise import __version__
from isonoise.benchmark.bounces import count_shadow_rays, count_tests, ray_rows, time_bounces
from isonoise.benchmark.bvh_stats import bvh_statistics
from isonoise.benchmark.kernel_rows import kernel_rows
from isonoise.benchmark.origin import origin_fields
from isonoise.benchmark.prepared_scene import MeasuredDevice, PreparedScene, Run
from isonoise.benchmark.spread import spread
from isonoise.benchmark.startup import startup_times
from isonoise.benchmark.wave_costs import measure_wave_costs
from isonoise.device.drivers import driver_fields
from isonoise.device.opencl import LOCAL_SIZE, Device
from isonoise.integrator.kernel_table import path_bytes
from isonoise.progress import ProgressBar
from isonoise.scene.compile import compile_scene
from isonoise.scene.compiled_scene import CompiledScene
from isonoise.scene.load import load_description

SCHEMA, SCHEMA_VERSION = "isonoise-bench", 2
"""The version goes up when a field is removed or changes its meaning; fields may be added."""
CPU_SAMPLES, GPU_SAMPLES = 2**21, 2**24
"""Default number of samples of a run: 16 pools, and about a second."""

ShowProgress = Callable[[float, str], None]
"""Gets the finished share of a measurement and the current activity."""


@dataclass(frozen=True)
class Settings:
    """Options of the command; None stands for the default of the scene or of the device."""

    repeat: int = 5
    size: tuple[int, int] | None = None
    spp: float | None = None
    max_depth: int | None = None
    device: str | None = None
    pool_size: int | None = None
    allow_outside: bool = False  # as for `isonoise.load`

    def render_options(self) -> list[str]:
        """The same settings as options of `isonoise render`."""
        size = ["--size", f"{self.size[0]}x{self.size[1]}"] if self.size else []
        depth = ["--max-depth", str(self.max_depth)] if self.max_depth is not None else []
        outside = ["--allow-outside"] if self.allow_outside else []
        return [*size, *depth, *outside, *(["--device", self.device] if self.device is not None else [])]


def report_header(schema: str, schema_version: int, settings: Settings, device: Device) -> dict[str, object]:
    """The JSON fields that do not depend on the scene; `scenes` is an empty list."""
    return {
        "schema": schema,
        "schema_version": schema_version,
        "isonoise_version": __version__,
        **origin_fields(),
        "system": f"{platform.system()} {platform.release()} {platform.machine()}",
        "load_average": os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
        "device": _device_fields(device),
        "repeat": settings.repeat,
        "scenes": [],
    }


def _device_fields(device: Device) -> dict[str, object]:
    return {
        **driver_fields(device.device),
        "is_cpu": device.is_cpu,
        "compute_units": device.device.max_compute_units,
        "clock_mhz": device.device.max_clock_frequency,
        "memory_bytes": device.device.global_mem_size,
        "form": device.form.name,
        "local_size": LOCAL_SIZE,
    }


def measure_each(sources: Mapping[str, str], measure: Callable[[str, str, ShowProgress], None]) -> None:
    """Call `measure` with name, source and progress function of each scene, under one progress bar."""
    with ProgressBar() as bar:
        for index, (name, source) in enumerate(sources.items()):

            def show(done: float, activity: str, index=index, name=name) -> None:
                bar.show(index + done, len(sources), f"{name}: {activity}")

            measure(name, source, show)


def load_scene(source: str, settings: Settings) -> CompiledScene:
    """The compiled scene of a file or built-in scene."""
    description = load_description(source, allow_outside=settings.allow_outside, size=settings.size)
    return compile_scene(description, size=settings.size, max_depth=settings.max_depth)


def samples_per_run(scene: CompiledScene, settings: Settings, device: Device) -> int:
    """Number of samples of a run; a multiple of the pixels unless --spp is no whole number."""
    pixels = scene.width * scene.height
    if settings.spp is not None:
        return max(1, round(settings.spp * pixels))
    return max(1, (CPU_SAMPLES if device.is_cpu else GPU_SAMPLES) // pixels) * pixels


def scene_identity(name: str, scene: CompiledScene, samples: int) -> dict[str, object]:
    """The JSON fields that must be equal in two measurements to compare them."""
    return {
        "scene": name,
        "scene_hash": scene.hash,
        "width": scene.width,
        "height": scene.height,
        "max_depth": scene.max_depth,
        "samples": samples,
    }


def measure_scene(
    name: str,
    source: str,
    scene: CompiledScene,
    settings: Settings,
    copy_gb_per_s: Mapping[str, float],
    show: ShowProgress = lambda done, activity: None,
    inspect: Callable[[PreparedScene, Run], None] = lambda prepared, run: None,
) -> dict[str, object]:
    """An entry of the JSON field `scenes`.

    Parameters
    ----------
    name : str
        Name in the report.
    source : str
        File or built-in scene that `scene` was compiled from.
    copy_gb_per_s : mapping
        Spread of the device's bandwidth, from `copy_bandwidth`.
    inspect : callable
        Gets the scene on its device and the last profiled run.
    """
    show(0.0, "start of a process")
    startup = startup_times(source, settings.render_options(), settings.repeat)
    device = MeasuredDevice(settings.device)
    show(0.2, "set-up")
    prepared = PreparedScene(scene, device, samples_per_run(scene, settings, device), settings.pool_size)
    show(0.25, "warm-up")
    prepared.run(profile=False)
    shadow_rays = count_shadow_rays(prepared)
    plain, profiled, passes = [], [], []
    for index in range(settings.repeat):
        show(0.3 + 0.65 * index / settings.repeat, f"repeat {index + 1} of {settings.repeat}")
        plain.append(prepared.run(profile=False))
        profiled.append(prepared.run(profile=True))
        passes.append(time_bounces(prepared))
    show(0.95, "costs of a wave")
    options = {"device": settings.device, "size": settings.size, "max_depth": settings.max_depth}
    options["allow_outside"] = settings.allow_outside
    wave_costs = measure_wave_costs(source, settings.repeat, pool_size=settings.pool_size, **options)
    tests = count_tests(prepared, [bounce.rays for bounce in passes[0]])
    kernels = kernel_rows(prepared, profiled, sum(shadow_rays), tests, copy_gb_per_s["median"])
    inspect(prepared, profiled[-1])
    intersect = next((row for row in kernels if row["kernel"] == "intersect"), None)
    return {
        **scene_identity(name, scene, prepared.samples),
        "rr_depth": scene.rr_depth,
        "triangles": len(scene.faces),
        "analytic_shapes": len(scene.analytics),
        "instances": len(scene.instances),
        "lights": len(scene.lights),
        "features": [feature for feature, is_on in prepared.wavefront.features.items() if is_on],
        "samples_per_s": spread(prepared.samples / run.seconds for run in plain),
        "run_s": spread(run.seconds for run in plain),
        "runs_s": [run.seconds for run in plain],
        "profiled_run_s": spread(run.seconds for run in profiled),
        "device_busy_share": spread(sum(launch.seconds for launch in run.launches) / run.seconds for run in profiled),
        "startup": startup,
        "wave_costs": wave_costs,
        "kernels": kernels,
        "rays": ray_rows(passes, shadow_rays, tests),
        "pool_size": prepared.pool_size,
        "pool_occupancy": intersect["items"] / (intersect["launches"] * prepared.pool_size) if intersect else None,
        "bvh": bvh_statistics(prepared.bvh, scene),
        "memory": _memory_fields(device, prepared.wavefront.features),
    }


def _memory_fields(device: MeasuredDevice, features: Mapping[str, bool]) -> dict[str, object]:
    """The JSON field `memory`."""
    return {
        "total_bytes": sum(device.buffer_bytes.values()),
        "state_bytes_per_path": sum(path_bytes(features).values()),
        "buffers_bytes": dict(device.buffer_bytes.most_common()),
    }
