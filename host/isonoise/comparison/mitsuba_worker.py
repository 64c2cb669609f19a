"""Mitsuba 3 as a strategy: the same scene file, size and depth, its own sampler, passes of growing size.

Mitsuba runs in its own process: OpenCL drivers load an LLVM of their own, and Mitsuba aborts the process if it loads a
libLLVM that is too old. That process measures the time of rendering alone. Called by `runner` and by `bench --peers`.
"""

import contextlib
import multiprocessing
import signal
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from isonoise.comparison.mitsuba_scene import mitsuba_xml
from isonoise.comparison.plan import SceneEntry
from isonoise.comparison.recorder import Recorder
from isonoise.comparison.strategy_specs import MITSUBA_SAMPLERS
from isonoise.error.true_error import true_error
from isonoise.errors import UserError
from isonoise.film.log import LogRow
from isonoise.loop import LAST_WAVE_SHARE, MAX_SHARE_OF_TIME_LEFT, Stops

VARIANTS = ("llvm_ad_rgb", "scalar_rgb")
"""Tried in this order. The first needs libLLVM; DRJIT_LIBLLVM_PATH may have to name it."""
FIRST_PASS_SPP = 16
"""Samples per pixel of the first pass, as in the strategy `uniform`."""
GROWTH = {"independent": 0.5, "multijitter": 1.0}
"""Maximum samples of a later pass over those so far; a pass of multijitter has as many strata as samples."""
MAX_PASS_SAMPLES = 2**23
"""The compiled variants hold all samples of a pass in memory."""


class MitsubaWorkers:
    """Mitsuba's processes for one scene, started on first use and ended with the `with` block."""

    def __init__(self, scene: SceneEntry, size: tuple[int, int] | None, max_depth: int | None):
        self._scene, self._size, self._max_depth = scene, size, max_depth
        self._workers: dict[str, MitsubaWorker] = {}

    def __enter__(self) -> "MitsubaWorkers":
        return self

    def __exit__(self, *exception) -> None:
        for worker in self._workers.values():
            worker.close()

    def run(
        self,
        strategy: str,
        seed: int,
        stops: Stops,
        reference: tuple[np.ndarray, np.ndarray | None],
        path: Path,
        on_progress: Callable[[float, int], None],
    ) -> dict:
        """Render one run to `path`; returns its last row. Stated errors are nan. Raises UserError if it fails."""
        pixels = self._scene.width * self._scene.height
        worker = self._workers.get(strategy)
        if worker is None:
            xml = mitsuba_xml(Path(self._scene.source), MITSUBA_SAMPLERS[strategy], self._size, self._max_depth)
            worker = self._workers[strategy] = MitsubaWorker(self._scene.name, xml, pixels)
            worker.warm_up(stops)
        recorder = Recorder(stops, reference[0])
        total, spp, elapsed, speed = 0.0, 0, 0.0, None
        while (limit := _max_pass_spp(stops, GROWTH[MITSUBA_SAMPLERS[strategy]], spp, elapsed, speed)) >= 1:
            number, size = len(recorder.rows), max(size for size in worker.sizes if size <= limit)
            (pass_seed,) = np.random.SeedSequence([seed, number]).generate_state(1)
            image, seconds = worker.render(size, int(pass_seed))
            elapsed, spp, speed = elapsed + seconds, spp + size, size / seconds
            total = total + size * image.astype(np.float64)
            rgb = (total / spp).astype(np.float32)
            row = LogRow(
                elapsed_s=elapsed,
                wave=number + 1,
                kind="uniform",
                samples=spp * pixels,
                spp=float(spp),
                stated_p50=np.nan,
                stated_p95=np.nan,
                stated_p99=np.nan,
                true=true_error(rgb, *reference),
                rejected=0,
            )
            recorder.wave(row, rgb, None)
            on_progress(elapsed, row.samples)
        facts = {
            "strategy": f"{strategy}: Mitsuba {worker.version}, {worker.variant}, passes of growing size",
            "scene": self._scene.name,
            "seed": seed,
            "device": f"CPU (Mitsuba 3, {worker.variant})",
            "setup_s": worker.setup_s,
            "samples": spp * pixels,
            "elapsed_s": elapsed,
            "stopped_by": "time" if stops.time is not None else "spp",
        }
        recorder.write(path, row, rgb, np.full(rgb.shape[:2], spp, np.uint32), facts)
        return recorder.rows[-1]


def _max_pass_spp(stops: Stops, growth: float, spp: int, elapsed: float, speed: float | None) -> float:
    """Maximum samples per pixel of the next pass, as the render loop sizes waves; below 1 the run is finished.

    `spp` and `elapsed` are those of the run so far, `speed` is in samples per pixel and second.
    """
    limit = max(growth * spp, 1) if spp else FIRST_PASS_SPP
    if stops.spp is not None:
        return min(limit, max(round(stops.spp), 1) - spp)
    if speed is None:
        return limit
    remaining = stops.time - elapsed
    share = MAX_SHARE_OF_TIME_LEFT if remaining > LAST_WAVE_SHARE * stops.time else 1.0
    return min(limit, share * speed * remaining)


class MitsubaWorker:
    """Mitsuba in its own process, with one scene. Raises UserError if no variant can render it.

    `sizes` are the samples per pixel that a pass may have, ascending: near powers of two that the sampler does not
    round up. There are few, because the compiled variants may recompile for each.
    """

    def __init__(self, name: str, xml: str, pixels: int):
        start = time.perf_counter()
        failures = []
        for variant in VARIANTS:
            self._connection, other = multiprocessing.Pipe()
            spawn = multiprocessing.get_context("spawn")
            self._process = spawn.Process(target=_worker_main, args=(other, variant, xml), daemon=True)
            self._process.start()
            other.close()
            try:
                self.version = self._receive()
                self.variant = variant
                self.sizes = self._request("sizes", max(MAX_PASS_SAMPLES // pixels, 1))
                self.render(1, 0)  # compiles
                self.setup_s = time.perf_counter() - start
                return
            except _FailedError as error:
                failures.append(f"{variant}: {error}")
                self.close()
        raise UserError(f"Mitsuba cannot render {name}: {'; '.join(failures)}")

    def warm_up(self, stops: Stops) -> None:
        """Render a pass of every size that fits into half of a run, so that all are compiled before the clock starts;
        larger sizes are removed."""
        for number, size in enumerate(self.sizes, 1):
            _, seconds = self.render(size, 0)
            if stops.time is None:
                enough = 2 * size >= stops.spp
            else:  # repeated if it took long: the first pass may have compiled
                enough = 2 * seconds >= stops.time and 2 * self.render(size, 1)[1] >= stops.time
            if enough and size >= FIRST_PASS_SPP:
                self.sizes = self.sizes[:number]
                break

    def render(self, spp: int, seed: int) -> tuple[np.ndarray, float]:
        """Linear RGB float32 (height, width, 3), and the seconds it took."""
        return self._request("render", spp, seed)

    def close(self) -> None:
        self._connection.close()
        self._process.join(timeout=5)
        if self._process.is_alive():
            self._process.kill()

    def _request(self, *message):
        with contextlib.suppress(OSError):  # the process has ended; its last message says why
            self._connection.send(message)
        return self._receive()

    def _receive(self):
        try:
            kind, content = self._connection.recv()
        except (EOFError, OSError):
            self._process.join()
            raise _FailedError(f"its process ended ({self._process.exitcode})") from None
        if kind == "failed":
            raise _FailedError(content)
        return content


class _FailedError(UserError):
    """Mitsuba raised an error, or its process ended."""


def _worker_main(connection, variant: str, xml: str) -> None:
    """Main function of the process: answers requests until the connection is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches all processes; the parent handles it
    try:
        import mitsuba

        mitsuba.set_variant(variant)
        mitsuba.set_log_level(mitsuba.LogLevel.Error)
        scene = mitsuba.load_string(xml)
        sampler = scene.sensors()[0].sampler()
        connection.send(("version", mitsuba.__version__))
        while True:
            command, *arguments = connection.recv()
            if command == "sizes":
                connection.send(("sizes", _pass_sizes(sampler, *arguments)))
                continue
            spp, seed = arguments
            start = time.perf_counter()
            image = np.array(mitsuba.render(scene, spp=spp, seed=seed))  # the conversion waits for the render
            seconds = time.perf_counter() - start
            connection.send(("image", (image[..., :3].astype(np.float32), seconds)))
    except (EOFError, BrokenPipeError, ConnectionResetError):
        return
    except Exception as error:
        connection.send(("failed", str(error)))


def _pass_sizes(sampler, max_spp: int) -> list[int]:
    """For each power of two up to `max_spp` the largest sample count that the sampler does not round."""
    sizes = {1}
    for power in range(1, max_spp.bit_length()):
        for candidate in range(2**power, 2 ** (power - 1), -1):
            sampler.set_sample_count(candidate)
            if sampler.sample_count() == candidate:
                sizes.add(candidate)
                break
    return sorted(sizes)
