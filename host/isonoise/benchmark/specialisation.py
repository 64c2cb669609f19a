"""Compares a scene's own program with programs that have more features (`isonoise bench --specialisation`).

Run as a module it compiles one program and prints the seconds; so compilation is timed in its own process, with empty
caches.
"""

import json
import os
import sys
import time
from collections.abc import Mapping
from dataclasses import asdict

import numpy as np

from isonoise.benchmark.measure import (
    Settings,
    ShowProgress,
    load_scene,
    measure_each,
    report_header,
    samples_per_run,
    scene_identity,
)
from isonoise.benchmark.prepared_scene import MeasuredDevice, PreparedScene
from isonoise.benchmark.spread import spread
from isonoise.benchmark.startup import empty_caches, run_process
from isonoise.device.program_cache import FOLDER_VARIABLE
from isonoise.integrator.feature_superset import feature_superset
from isonoise.integrator.features import features
from isonoise.integrator.kernel_table import path_bytes
from isonoise.scene.compiled_scene import CompiledScene
from isonoise.statistics import BASIC_NEEDS, Needs, Statistics

SCHEMA, SCHEMA_VERSION = "isonoise-specialisation", 2
ALL_STATISTICS = Needs(median=True, batch=4, power=2.0, half=True, neighbours=5, nets=True)
SPECIALISED, ALL_PATH, ALL_VOLPATH = "specialised", "all-path", "all-volpath"
COMMON_STATISTICS = ("count", "rejected", "rgb", "mean", "variance")
"""Statistics that every program computes."""

Program = tuple[Needs, dict[str, bool] | None]
"""Statistics and features, None for those of the scene."""


def programs(scene: CompiledScene) -> dict[str, Program]:
    """The programs that are measured for a scene, by name.

    `all-path` has all features of the integrator `path`, `all-volpath` also those of `volpath`, with which a work-item
    traces one path. A scene of `path` with pass-through surfaces has no program `all-volpath`, because `volpath`
    samples its light differently. A scene of `volpath` has no program `all-path`.
    """
    used = features(scene)
    found: dict[str, Program] = {SPECIALISED: (BASIC_NEEDS, None)}
    if not used["VOLPATH"]:
        found[ALL_PATH] = (ALL_STATISTICS, feature_superset(used, volpath=False))
    if used["VOLPATH"] or not (used["NULL"] or used["MASK"]):
        found[ALL_VOLPATH] = (ALL_STATISTICS, feature_superset(used, volpath=True))
    return found


def measure_specialisation(sources: Mapping[str, str], settings: Settings) -> dict[str, object]:
    """All figures, as in the JSON file. `sources` maps names to files or built-in scenes."""
    result = report_header(SCHEMA, SCHEMA_VERSION, settings, MeasuredDevice(settings.device))

    def measure(name: str, source: str, show: ShowProgress) -> None:
        result["scenes"].append(_measure_programs(name, source, settings, show))

    measure_each(sources, measure)
    return result


def _measure_programs(name: str, source: str, settings: Settings, show: ShowProgress) -> dict[str, object]:
    scene = load_scene(source, settings)
    chosen = programs(scene)
    compile_s = {}
    for index, program in enumerate(chosen):
        show(0.5 * index / len(chosen), f"compiling, {program}")
        compile_s[program] = compile_seconds(source, program, settings)
    prepared, images, launches = {}, {}, {}
    for index, (program, (needs, feature_override)) in enumerate(chosen.items()):
        show(0.5 + 0.2 * index / len(chosen), f"warm-up, {program}")
        device = MeasuredDevice(settings.device)
        samples = samples_per_run(scene, settings, device)
        prepared[program] = PreparedScene(scene, device, samples, settings.pool_size, needs, feature_override)
        kernels = prepared[program].run(profile=True).kernels()
        launches[program] = sum(totals.launches for totals in kernels.values())
        images[program] = prepared[program].wavefront.accumulator.statistics(scene.radiance_scale)
    seconds: dict[str, list[float]] = {program: [] for program in chosen}
    for turn in range(settings.repeat):
        show(0.7 + 0.3 * turn / settings.repeat, f"repeat {turn + 1} of {settings.repeat}")
        for program in chosen:
            seconds[program].append(prepared[program].run(profile=False).seconds)
    rows = [
        {
            "program": program,
            "feature_count": int(sum(prepared[program].wavefront.features.values())),
            "samples_per_s": spread(samples / s for s in seconds[program]),
            "specialised_speedup": spread(
                s / specialised for s, specialised in zip(seconds[program], seconds[SPECIALISED], strict=True)
            ),
            "compile_s": compile_s[program],
            "state_bytes_per_path": sum(path_bytes(prepared[program].wavefront.features).values()),
            "total_bytes": sum(prepared[program].device.buffer_bytes.values()),
            "stages": list(prepared[program].wavefront.stages),
            "launches": launches[program],
            **image_difference(images[program], images[SPECIALISED]),
        }
        for program in chosen
    ]
    return {**scene_identity(name, scene, samples), "programs": rows}


def image_difference(image: Statistics, other: Statistics) -> dict[str, object]:
    """Whether all bits are equal; the largest difference of a channel over the largest channel value of `other`."""
    largest = float(np.abs(other.rgb).max())
    return {
        "bit_identical": all(
            getattr(image, name).tobytes() == getattr(other, name).tobytes() for name in COMMON_STATISTICS
        ),
        "max_relative_difference": float(np.abs(image.rgb - other.rgb).max()) / largest if largest else None,
    }


def compile_seconds(source: str, program: str, settings: Settings) -> float:
    """Seconds for programs, buffers and first launches in a process with empty caches."""
    with empty_caches() as environment:
        return float(run_process(["-m", __name__, source, program, json.dumps(asdict(settings))], environment))


def main(arguments: list[str]) -> None:
    """Compile one program: `SOURCE PROGRAM SETTINGS`."""
    source, program, settings = arguments[0], arguments[1], Settings(**json.loads(arguments[2]))
    scene = load_scene(source, settings)
    needs, feature_override = programs(scene)[program]
    device = MeasuredDevice(settings.device)
    start = time.perf_counter()
    PreparedScene(scene, device, scene.width * scene.height, settings.pool_size, needs, feature_override)
    print(time.perf_counter() - start)
    os.environ[FOLDER_VARIABLE] = "off"  # do not store the programs at exit: the cache is deleted


if __name__ == "__main__":
    main(sys.argv[1:])
