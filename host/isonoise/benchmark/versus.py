"""Compares samples/s with another checkout's or another device's, run by run in turn (`isonoise bench --versus`).

Each side has a process that stays alive (`versus_worker`), so that runs alternate within a second and a busy machine
slows down both.
"""

import contextlib
import json
import os
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import isonoise
from isonoise.benchmark import versus_worker
from isonoise.benchmark.measure import (
    Settings,
    ShowProgress,
    load_scene,
    measure_each,
    report_header,
    samples_per_run,
    scene_identity,
)
from isonoise.benchmark.origin import NO_COMMIT, checkout_folder, commit_fields, is_checkout
from isonoise.benchmark.spread import spread
from isonoise.device.drivers import driver_fields
from isonoise.device.opencl import Device
from isonoise.errors import UserError
from isonoise.scene.compiled_scene import CompiledScene

SCHEMA, SCHEMA_VERSION = "isonoise-versus", 1
DEVICE_PREFIX = "device:"


@dataclass(frozen=True)
class Subject:
    """What one side measures: an isonoise on a device."""

    package: Path
    checkout: Path | None  # None: an installed package
    device: str | None
    label: str


def this_subject(device: str | None) -> Subject:
    """The isonoise that runs."""
    return Subject(Path(isonoise.__file__).resolve().parent, checkout_folder(), device, "this side")


def other_subject(other: str, device: str | None) -> Subject:
    """The other side: `device:CHOICE` or the folder of a checkout. Raises UserError if it is neither."""
    if other.startswith(DEVICE_PREFIX):
        mine = this_subject(None)
        return Subject(mine.package, mine.checkout, other.removeprefix(DEVICE_PREFIX), f"'{other}'")
    folder = Path(other).resolve()
    if not is_checkout(folder):
        raise UserError(
            f"--versus: '{other}' is not a checkout of isonoise: it has no pyproject.toml and host/isonoise; "
            f"give such a folder, or {DEVICE_PREFIX}D for another device"
        )
    return Subject(folder / "host" / "isonoise", folder, device, f"'{other}'")


def measure_versus(sources: Mapping[str, str], settings: Settings, other: str) -> dict[str, object]:
    """All speed ratios, as in the JSON file. `sources` maps names to files or built-in scenes.

    Raises
    ------
    UserError
        `other` is no checkout and no device, or one side cannot render a scene.
    """
    subjects = this_subject(settings.device), other_subject(other, settings.device)
    device = Device(settings.device)
    result = report_header(SCHEMA, SCHEMA_VERSION, settings, device)
    is_device = other.startswith(DEVICE_PREFIX)
    result["other"] = {
        "checkout": None if is_device else str(subjects[1].checkout),
        **(commit_fields(subjects[1].checkout) if subjects[1].checkout else NO_COMMIT),
        "isonoise_version": None,
        "device": driver_fields(Device(subjects[1].device).device),
    }

    def measure(name: str, source: str, show: ShowProgress) -> None:
        scene = load_scene(source, settings)
        samples = samples_per_run(scene, settings, device)
        row, result["other"]["isonoise_version"] = _measure_scene(
            name, source, scene, samples, subjects, settings, show
        )
        result["scenes"].append(row)

    measure_each(sources, measure)
    return result


def is_slower(scene: Mapping, threshold: float) -> bool:
    """Whether this side's speed is below `threshold` times the other's, and below it in every pair of runs."""
    return scene["speedup"]["median"] < threshold and scene["speedup"]["max"] < 1


def _measure_scene(
    name: str,
    source: str,
    scene: CompiledScene,
    samples: int,
    subjects: tuple[Subject, Subject],
    settings: Settings,
    show: ShowProgress,
) -> tuple[dict[str, object], str]:
    """An entry of the JSON field `scenes`, and the version of the other side."""
    with contextlib.ExitStack() as stack:
        sides = []
        for index, subject in enumerate(subjects):
            show(0.25 * index, f"warm-up of {subject.label}")
            sides.append(stack.enter_context(WorkerProcess(subject, name, source, scene, samples, settings)))
        pairs = []
        for index in range(settings.repeat):
            show(0.5 + 0.5 * index / settings.repeat, f"pair {index + 1} of {settings.repeat}")
            pairs.append([side.request("run") for side in sides])
        means = [side.request("mean")["mean"] for side in sides]
        version = sides[1].version
    row = {
        **scene_identity(name, scene, samples),
        "samples_per_s": spread(samples / mine["seconds"] for mine, _ in pairs),
        "other_samples_per_s": spread(samples / theirs["seconds"] for _, theirs in pairs),
        "speedup": spread(theirs["seconds"] / mine["seconds"] for mine, theirs in pairs),
        "cpu_speedup": spread(theirs["cpu_seconds"] / mine["cpu_seconds"] for mine, theirs in pairs),
        "image_mean_ratio": means[0] / means[1] if means[1] else None,
    }
    return row, version


class WorkerProcess:
    """A process that has set up and warmed up one side. Raises UserError with the side's message if it fails."""

    def __init__(
        self, subject: Subject, name: str, source: str, scene: CompiledScene, samples: int, settings: Settings
    ):
        self._where = f"{subject.label} cannot render {name}"
        # isonoise compiles programs in processes of its own, which have to find the same isonoise
        paths = [str(subject.package.parent), *filter(None, [os.environ.get("PYTHONPATH")])]
        self._process = subprocess.Popen(
            [sys.executable, versus_worker.__file__],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=os.environ | {"PYTHONPATH": os.pathsep.join(paths)},
        )
        job = {
            "package": str(subject.package),
            "checkout": str(subject.checkout) if subject.checkout else None,
            "device": subject.device,
            "scene": source,
            "size": [scene.width, scene.height],
            "max_depth": scene.max_depth,
            "samples": samples,
            "options": {"allow_outside": True} if settings.allow_outside else {},  # an old checkout has no such option
        }
        try:
            self.version = self.request(json.dumps(job))["version"]
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> "WorkerProcess":
        return self

    def __exit__(self, *exception) -> None:
        self.close()

    def request(self, line: str) -> dict:
        """The answer to a line."""
        with contextlib.suppress(OSError):  # the process has ended; its last answer says why
            self._process.stdin.write(f"{line}\n")
            self._process.stdin.flush()
        text = self._process.stdout.readline()
        if not text:
            raise UserError(f"{self._where}: its process ended with exit code {self._process.wait()}")
        answer = json.loads(text)
        if "error" in answer:
            raise UserError(f"{self._where}: {answer['error']}")
        return answer

    def close(self) -> None:
        """End the process."""
        with contextlib.suppress(OSError):
            self._process.stdin.close()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(timeout=5)
        if self._process.poll() is None:
            self._process.kill()
            self._process.wait()
        self._process.stdout.close()
