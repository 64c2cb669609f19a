"""Measures a scene: throughput without profiling, kernels with it, rays by bounce; all in turn, `repeat` times."""

import os
import platform
from collections.abc import Callable
from dataclasses import dataclass

from isonoise import __version__
from isonoise.benchmark.bounces import count_shadow_rays, count_tests, ray_facts, timed_bounces
from isonoise.benchmark.bvh_stats import tree_facts
from isonoise.benchmark.spread import Spread
from isonoise.benchmark.startup import start_facts
from isonoise.benchmark.subject import MeasuredDevice, Run, Subject
from isonoise.device.opencl import LOCAL_SIZE, Device
from isonoise.scene.compile import compile_scene
from isonoise.scene.compiled_scene import CompiledScene
from isonoise.scene.load import load

SCHEMA, SCHEMA_VERSION = "isonoise-bench", 1
"""The version goes up when a field changes its meaning or goes; new fields don't change it."""
SAMPLES_CPU, SAMPLES_GPU = 2**21, 2**24
"""Samples of a run, unless it is said how many: 16 pools, and about a second."""
PATH_BUFFERS = ("paths", "hits", "shadow rays", "flags of the paths")
"""Names of the buffers that hold the state of the paths in flight."""


@dataclass(frozen=True)
class Settings:
    """How to measure; None leaves a choice to the scene or to the device."""

    repeat: int = 5
    size: tuple[int, int] | None = None
    spp: float | None = None
    max_depth: int | None = None
    device: str | None = None
    pool_size: int | None = None

    def render_options(self) -> list[str]:
        """The same for `isonoise render`."""
        size = ["--size", f"{self.size[0]}x{self.size[1]}"] if self.size else []
        depth = ["--max-depth", str(self.max_depth)] if self.max_depth is not None else []
        return [*size, *depth, *(["--device", self.device] if self.device is not None else [])]


def head(settings: Settings, device: Device) -> dict[str, object]:
    """What holds for all scenes: program, device, driver, settings."""
    return {
        "schema": SCHEMA,
        "schema_version": SCHEMA_VERSION,
        "isonoise_version": __version__,
        "system": f"{platform.system()} {platform.release()} {platform.machine()}",
        "load_average": os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
        "device": device_facts(device),
        "repeat": settings.repeat,
        "scenes": [],
    }


def device_facts(device: Device) -> dict[str, object]:
    """Device and driver, in OpenCL's words."""
    of = device.device
    return {
        "name": of.name.strip(),
        "platform": of.platform.name.strip(),
        "opencl_version": of.version.strip(),
        "driver_version": of.driver_version.strip(),
        "is_cpu": device.is_cpu,
        "compute_units": of.max_compute_units,
        "clock_mhz": of.max_clock_frequency,
        "memory_bytes": of.global_mem_size,
        "local_size": LOCAL_SIZE,
    }


def load_subject(source: str, settings: Settings) -> CompiledScene:
    return compile_scene(load(source), size=settings.size, max_depth=settings.max_depth)


def samples_of(scene: CompiledScene, settings: Settings, device: Device) -> int:
    """Samples of a run; as many in every pixel unless --spp is no whole number."""
    pixels = scene.width * scene.height
    if settings.spp is not None:
        return max(1, round(settings.spp * pixels))
    return max(1, (SAMPLES_CPU if device.is_cpu else SAMPLES_GPU) // pixels) * pixels


def identity(name: str, scene: CompiledScene, samples: int) -> dict[str, object]:
    """What has to be the same in two measurements that are compared."""
    return {
        "scene": name,
        "scene_hash": scene.hash,
        "width": scene.width,
        "height": scene.height,
        "max_depth": scene.max_depth,
        "samples": samples,
    }


def measure(
    name: str,
    source: str,
    scene: CompiledScene,
    settings: Settings,
    say: Callable[[float, str], None] = lambda done, what: None,
) -> dict[str, object]:
    """All figures of one scene, as the JSON has them. `say` gets the share that is done, and what is being done.

    `source` is the file or built-in scene that `scene` was compiled from; `name` is how the report calls it.
    """
    say(0.0, "start of a process")
    starts = start_facts(source, settings.render_options(), settings.repeat)
    device = MeasuredDevice(settings.device)
    say(0.2, "set-up")
    subject = Subject(scene, device, samples_of(scene, settings, device), settings.pool_size)
    say(0.25, "warm-up")
    subject.run(profile=False)
    shadow_rays = count_shadow_rays(subject)
    plain, profiled, passes = [], [], []
    for number in range(settings.repeat):
        say(0.3 + 0.7 * number / settings.repeat, f"repeat {number + 1} of {settings.repeat}")
        plain.append(subject.run(profile=False))
        profiled.append(subject.run(profile=True))
        passes.append(timed_bounces(subject))
    tests = count_tests(subject, [bounce.rays for bounce in passes[0]])
    kernels = kernel_facts(profiled)
    intersect = next((kernel for kernel in kernels if kernel["kernel"] == "intersect"), None)
    return {
        **identity(name, scene, subject.samples),
        "rr_depth": scene.rr_depth,
        "triangles": len(scene.faces),
        "analytic_shapes": len(scene.analytics),
        "instances": len(scene.instances),
        "lights": len(scene.lights),
        "features": [feature for feature, on in subject.wavefront.features.items() if on],
        "samples_per_s": Spread.of(subject.samples / run.seconds for run in plain).json(),
        "run_s": Spread.of(run.seconds for run in plain).json(),
        "profiled_run_s": Spread.of(run.seconds for run in profiled).json(),
        "busy_share": Spread.of(
            sum(work.seconds for work in run.kernels.values()) / run.seconds for run in profiled
        ).json(),
        "start": starts,
        "kernels": kernels,
        "rays": ray_facts(passes, shadow_rays, tests),
        "pool_paths": subject.pool_size,
        "occupancy": intersect["items"] / (intersect["launches"] * subject.pool_size) if intersect else None,
        "hierarchy": tree_facts(subject.bvh, scene),
        "memory": memory_facts(device, int(subject.wavefront.stages.arguments["plane_stride"])),
    }


def kernel_facts(runs: list[Run]) -> list[dict[str, object]]:
    """A row a kernel, the one that takes most time first. Shares are those of the medians."""
    times = {name: Spread.of(run.kernels[name].seconds for run in runs) for name in runs[0].kernels}
    total = sum(time.median for time in times.values())
    rows = []
    for name, work in runs[0].kernels.items():  # launches and items are the same in every run
        time = times[name]
        rows.append(
            {
                "kernel": name,
                "launches": work.launches,
                "items": work.items,
                "time_s": time.json(),
                "share": time.median / total if total else 0.0,
                "ns_per_item": 1e9 * time.median / work.items,
            }
        )
    return sorted(rows, key=lambda row: -row["share"])


def memory_facts(device: MeasuredDevice, paths: int) -> dict[str, object]:
    """Bytes on the device, by buffer; there is room for so many paths."""
    return {
        "total_bytes": sum(device.bytes_of.values()),
        "state_bytes_per_path": sum(device.bytes_of[name] for name in PATH_BUFFERS) / paths,
        "buffers_bytes": dict(device.bytes_of.most_common()),
    }
