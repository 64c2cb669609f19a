"""Start-up time: `isonoise render` with one sample per pixel, timed from outside; called by `measure`."""

import contextlib
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from isonoise.benchmark.spread import spread
from isonoise.device.program_cache import FOLDER_VARIABLE
from isonoise.errors import UserError

CACHE_FOLDERS = {
    FOLDER_VARIABLE: "programs",
    "XDG_CACHE_HOME": "cache",
    "POCL_CACHE_DIR": "pocl",
    "CUDA_CACHE_PATH": "nvidia",
    "NEO_CACHE_DIR": "intel",
    "MESA_SHADER_CACHE_DIR": "mesa",
    "AMD_COMGR_CACHE_DIR": "amd",
}
"""Environment variables with the folders where isonoise and drivers cache compiled programs; names for empty ones."""
PHASES = ("load", "build", "compile")


@contextlib.contextmanager
def empty_caches() -> Iterator[dict[str, str]]:
    """An environment in which all program caches are empty folders; they are deleted at the end."""
    with tempfile.TemporaryDirectory(prefix="isonoise-bench-") as folder:
        caches = {variable: Path(folder) / name for variable, name in CACHE_FOLDERS.items()}
        for path in caches.values():
            path.mkdir()
        yield os.environ | {variable: str(path) for variable, path in caches.items()}


def run_process(arguments: list[str], environment: dict[str, str]) -> str:
    """Output of `python ARGUMENTS`. Raises UserError with the process's message if it fails."""
    done = subprocess.run([sys.executable, *arguments], env=environment, capture_output=True, text=True)
    if done.returncode:
        raise UserError(f"the process `python {' '.join(arguments[:3])} ...` failed:\n{done.stderr.strip()}")
    return done.stdout


def startup_times(source: str, options: list[str], repeat: int) -> dict[str, object]:
    """Seconds of whole processes and of their phases: once with empty caches, then `repeat` times with warm ones.

    `options` are those of `isonoise render`. Raises UserError if a process fails.
    """
    with empty_caches() as environment:
        uncached, *cached = [_time_render(source, options, environment) for _ in range(1 + repeat)]
    return {"uncached": uncached, "cached": {name: spread(times[name] for times in cached) for name in uncached}}


def _time_render(source: str, options: list[str], environment: dict[str, str]) -> dict[str, float]:
    with tempfile.TemporaryDirectory(prefix="isonoise-bench-") as folder:
        output = str(Path(folder) / "image.exr")
        command = ["-m", "isonoise", "render", source, "--spp", "1", "--strategy", "uniform", "--json", "-o", output]
        start = time.perf_counter()
        printed = run_process([*command, *options], environment)
        seconds = time.perf_counter() - start
    phases = json.loads(printed)["setup_s"]
    return {"process_s": seconds, **{f"{name}_s": phases[name] for name in PHASES}}
