"""One side of `bench --versus`: a process that renders a scene with the isonoise of a given folder.

`versus` runs this file as a script. It uses only what old versions of isonoise have, too: `Renderer`, `step`,
`statistics`, `image`. Reads lines, each a JSON object: first the job, then `run` or `mean`. Answers each with one line:
the result, or `error`.
"""

import importlib.util
import json
import os
import signal
import sys
import time
from pathlib import Path


def import_isonoise(package: Path, checkout: Path | None) -> object:
    """The module isonoise in the folder `package`. A checkout has kernels and scenes in its own folder."""
    folders = [str(package), *([str(checkout)] if checkout else [])]
    spec = importlib.util.spec_from_file_location(
        "isonoise", package / "__init__.py", submodule_search_locations=folders
    )
    module = sys.modules["isonoise"] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


class Side:
    """A renderer that traces `samples` samples per run, in waves of equal size."""

    def __init__(self, isonoise, job: dict):
        width, height = job["size"]
        self._samples = job["samples"]
        wave_spp = -(-self._samples // (width * height))
        self._renderer = isonoise.Renderer(
            job["scene"],
            device=job["device"],
            strategy=f"uniform:wave_spp={wave_spp}",
            size=(width, height),
            max_depth=job["max_depth"],
            **job["options"],
        )

    def run(self) -> dict[str, float]:
        """Seconds of wall-clock and CPU time for samples and statistics."""
        start, cpu_start = time.perf_counter(), time.process_time()
        traced = 0
        while traced < self._samples:
            traced += self._renderer.step(self._samples - traced).samples
        self._renderer.statistics()
        return {"seconds": time.perf_counter() - start, "cpu_seconds": time.process_time() - cpu_start}

    def mean(self) -> dict[str, float]:
        """Mean of the image so far."""
        return {"mean": float(self._renderer.image().mean())}


def main() -> None:
    """Answer requests until the input ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches all processes; the parent handles it
    sys.path.pop(0)  # the folder of this file: its modules are not for import by these names
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what drivers print is no answer

    def answer(content: dict) -> None:
        print(json.dumps(content), file=answers, flush=True)

    try:
        job = json.loads(sys.stdin.readline())
        checkout = Path(job["checkout"]) if job["checkout"] else None
        isonoise = import_isonoise(Path(job["package"]), checkout)
        side = Side(isonoise, job)
        side.run()  # warm-up
        answer({"version": isonoise.__version__})
        for line in sys.stdin:
            answer({"run": side.run, "mean": side.mean}[line.strip()]())
    except Exception as error:
        answer({"error": f"{type(error).__name__}: {error}"})


if __name__ == "__main__":
    main()
