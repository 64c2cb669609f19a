"""From the start of a process to its first image: `isonoise render` with one sample per pixel, timed from outside."""

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from isonoise.benchmark.spread import Spread
from isonoise.device.program_cache import FOLDER_VARIABLE
from isonoise.errors import UserError

CACHES = {
    FOLDER_VARIABLE: "programs",
    "XDG_CACHE_HOME": "cache",
    "POCL_CACHE_DIR": "pocl",
    "CUDA_CACHE_PATH": "nvidia",
    "NEO_CACHE_DIR": "intel",
    "MESA_SHADER_CACHE_DIR": "mesa",
    "AMD_COMGR_CACHE_DIR": "amd",
}
"""Where drivers, and we, keep what was compiled: variables, and folders for them that are empty at first."""
PHASES = ("load", "build", "compile")


def start_facts(source: str, options: list[str], repeat: int) -> dict[str, object]:
    """Seconds of whole processes and of their phases: where nothing was compiled before, then `repeat` times more.

    `options`: of `isonoise render`. Raises UserError with the process's message if it fails.
    """
    with tempfile.TemporaryDirectory(prefix="isonoise-bench-") as folder:
        caches = {name: str(Path(folder) / place) for name, place in CACHES.items()}
        for place in caches.values():
            Path(place).mkdir()
        first, *later = [_start(source, options, Path(folder), caches) for _ in range(1 + repeat)]
    warm = {name: Spread.of(each[name] for each in later).json() for name in first}
    return {"uncached": first, "cached": warm}


def _start(source: str, options: list[str], folder: Path, caches: dict[str, str]) -> dict[str, float]:
    command = [sys.executable, "-m", "isonoise", "render", source, "--spp", "1", "--strategy", "uniform", "--json"]
    command += ["-o", str(folder / "image.exr"), *options]
    begun = time.perf_counter()
    done = subprocess.run(command, env=os.environ | caches, capture_output=True, text=True)
    seconds = time.perf_counter() - begun
    if done.returncode:
        raise UserError(f"a render in a process of its own failed:\n{done.stderr.strip()}")
    phases = json.loads(done.stdout)["setup_s"]
    return {"process_s": seconds, **{f"{name}_s": phases[name] for name in PHASES}}
