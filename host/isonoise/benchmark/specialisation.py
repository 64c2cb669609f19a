"""`bench --specialisation`: a scene's own program against programs with more features than it uses, in turn.

Run as a module it compiles one program, in a process and with caches of its own, and prints how long that takes.
"""

import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path

import numpy as np

from isonoise import __version__
from isonoise.benchmark.measure import Settings, device_facts, identity, load_subject, samples_of
from isonoise.benchmark.spread import Spread
from isonoise.benchmark.startup import CACHES
from isonoise.benchmark.subject import MeasuredDevice, Subject
from isonoise.errors import UserError
from isonoise.integrator.feature_superset import feature_superset
from isonoise.integrator.features import features
from isonoise.integrator.kernel_table import path_bytes
from isonoise.progress import ProgressBar
from isonoise.scene.compiled_scene import CompiledScene
from isonoise.statistics import BASIC_NEEDS, Needs, Statistics

SCHEMA, SCHEMA_VERSION = "isonoise-specialisation", 1
EVERY_STATISTIC = Needs(median=True, batch=4, power=2.0, half=True)
SPECIALISED = "specialised"
SAME = ("count", "rejected", "rgb", "mean", "variance")
"""Statistics that every program keeps."""

Build = tuple[Needs, dict[str, bool] | None]


def builds(scene: CompiledScene) -> dict[str, Build]:
    """The programs that a scene is measured with, by name: needs and features, None for those that it uses.

    `path` has all that scenes for the integrator `path` may use, `everything` what those for `volpath` may
    besides: there a work-item takes one path. A scene of `path` with surfaces that let paths through looks another way
    under `volpath`, so it has no such program; one of `volpath` has no other.
    """
    used = features(scene)
    found: dict[str, Build] = {SPECIALISED: (BASIC_NEEDS, None)}
    if not used["VOLPATH"]:
        found["path"] = (EVERY_STATISTIC, feature_superset(used, volpath=False))
    if used["VOLPATH"] or not (used["NULL"] or used["MASK"]):
        found["everything"] = (EVERY_STATISTIC, feature_superset(used, volpath=True))
    return found


def measure_specialisation(sources: Mapping[str, str], settings: Settings) -> dict[str, object]:
    """All figures, as the JSON has them. `sources`: name -> file or built-in scene."""
    result = {
        "schema": SCHEMA,
        "schema_version": SCHEMA_VERSION,
        "isonoise_version": __version__,
        "system": f"{platform.system()} {platform.release()} {platform.machine()}",
        "device": device_facts(MeasuredDevice(settings.device)),
        "repeat": settings.repeat,
        "scenes": [],
    }
    with ProgressBar() as bar:
        for number, (name, source) in enumerate(sources.items()):

            def say(done: float, what: str, number=number, name=name) -> None:
                bar.show(number + done, len(sources), f"{name}: {what}")

            result["scenes"].append(_measure(name, source, settings, say))
    return result


def _measure(name: str, source: str, settings: Settings, say: Callable[[float, str], None]) -> dict[str, object]:
    scene = load_subject(source, settings)
    chosen = builds(scene)
    compile_s = {}
    for number, build in enumerate(chosen):
        say(0.5 * number / len(chosen), f"compiling, {build}")
        compile_s[build] = compile_seconds(source, build, settings)
    subjects, images, launches = {}, {}, {}
    for number, (build, (needs, feature_override)) in enumerate(chosen.items()):
        say(0.5 + 0.2 * number / len(chosen), f"warm-up, {build}")
        device = MeasuredDevice(settings.device)
        samples = samples_of(scene, settings, device)
        subject = subjects[build] = Subject(scene, device, samples, settings.pool_size, needs, feature_override)
        launches[build] = sum(work.launches for work in subject.run(profile=True).kernels.values())
        images[build] = subject.wavefront.accumulator.statistics(scene.radiance_scale)
    seconds: dict[str, list[float]] = {build: [] for build in chosen}
    for turn in range(settings.repeat):
        say(0.7 + 0.3 * turn / settings.repeat, f"repeat {turn + 1} of {settings.repeat}")
        for build, subject in subjects.items():
            seconds[build].append(subject.run(profile=False).seconds)
    rows = []
    for build, subject in subjects.items():
        on, ratios = subject.wavefront.features, zip(seconds[build], seconds[SPECIALISED], strict=True)
        rows.append(
            {
                "build": build,
                "features": int(sum(on.values())),
                "samples_per_s": Spread.of(subject.samples / time for time in seconds[build]).json(),
                "specialised_ratio": Spread.of(theirs / ours for theirs, ours in ratios).json(),
                "compile_s": compile_s[build],
                "state_bytes_per_path": sum(path_bytes(on).values()),
                "total_bytes": sum(subject.device.bytes_of.values()),
                "stages": list(subject.wavefront.stages),
                "launches": launches[build],
                **_difference(images[build], images[SPECIALISED]),
            }
        )
    return {**identity(name, scene, subjects[SPECIALISED].samples), "builds": rows}


def _difference(image: Statistics, other: Statistics) -> dict[str, object]:
    """Whether two images are the same bits, and by how much a number differs at most, over the largest one."""
    largest = float(np.abs(other.rgb).max())
    return {
        "same_bits": all(getattr(image, name).tobytes() == getattr(other, name).tobytes() for name in SAME),
        "largest_difference": float(np.abs(image.rgb - other.rgb).max()) / largest if largest else None,
    }


def compile_seconds(source: str, build: str, settings: Settings) -> float:
    """Seconds for programs, buffers and the first launches where nothing was compiled before."""
    with tempfile.TemporaryDirectory(prefix="isonoise-bench-") as folder:
        caches = {name: str(Path(folder) / place) for name, place in CACHES.items()}
        for place in caches.values():
            Path(place).mkdir()
        command = [sys.executable, "-m", __name__, source, build, json.dumps(asdict(settings))]
        done = subprocess.run(command, env=os.environ | caches, capture_output=True, text=True)
    if done.returncode:
        raise UserError(f"compiling in a process of its own failed:\n{done.stderr.strip()}")
    return float(done.stdout)


def main(arguments: list[str]) -> None:
    """Compiles one program: `SOURCE BUILD SETTINGS`."""
    source, build, settings = arguments[0], arguments[1], Settings(**json.loads(arguments[2]))
    scene = load_subject(source, settings)
    needs, feature_override = builds(scene)[build]
    device = MeasuredDevice(settings.device)
    begun = time.perf_counter()
    Subject(scene, device, scene.width * scene.height, settings.pool_size, needs, feature_override)
    print(time.perf_counter() - begun)
    os.environ["ISONOISE_PROGRAM_CACHE"] = "off"  # nobody will ask for what was compiled


if __name__ == "__main__":
    main(sys.argv[1:])
