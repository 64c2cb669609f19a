"""Mitsuba 3 as a strategy: the same scene file, size and depth, its own sampler, in passes of growing size.

Mitsuba works in a process of its own: OpenCL drivers bring an LLVM of theirs, and a libLLVM that is too old for Mitsuba
ends the process that loads it. The clock runs there, around rendering alone.
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
from isonoise.comparison.recording import Recorder
from isonoise.comparison.specs import PEERS
from isonoise.error.true_error import true_error
from isonoise.errors import UserError
from isonoise.film.log import LogRow
from isonoise.loop import LAST_WAVE_SHARE, MAX_SHARE_OF_TIME_LEFT, Stops

VARIANTS = ("llvm_ad_rgb", "scalar_rgb")
"""Tried in this order: the first needs a libLLVM that DRJIT_LIBLLVM_PATH may have to name."""
FIRST_PASS = 16
"""Samples per pixel of the first pass: that of the strategy `uniform`."""
GROWTH = {"independent": 0.5, "multijitter": 1.0}
"""Later passes bring up to this many times the samples so far; a pass of multijitter has as many strata as samples."""
LARGEST_PASS = 2**23
"""Samples of a pass: the compiled variants keep them all in memory at once."""


class Peers:
    """Mitsuba's processes for one scene, begun when first needed and ended with the `with` block."""

    def __init__(self, scene: SceneEntry, size: tuple[int, int] | None, max_depth: int | None):
        self._scene, self._size, self._max_depth = scene, size, max_depth
        self._workers: dict[str, Worker] = {}

    def __enter__(self) -> "Peers":
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
        """One run, written to `path`; returns its last row. Stated errors are nan. Raises UserError if it fails."""
        pixels = self._scene.width * self._scene.height
        worker = self._workers.get(strategy)
        if worker is None:
            xml = mitsuba_xml(Path(self._scene.source), PEERS[strategy], self._size, self._max_depth)
            worker = self._workers[strategy] = Worker(self._scene.name, xml, pixels)
            worker.warm_up(stops)
        recorder = Recorder(stops, reference[0])
        total, spp, elapsed, speed = 0.0, 0, 0.0, None
        while (wanted := _wanted(stops, GROWTH[PEERS[strategy]], spp, elapsed, speed)) >= 1:
            number, size = len(recorder.rows), max(size for size in worker.sizes if size <= wanted)
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


def _wanted(stops: Stops, growth: float, spp: int, elapsed: float, speed: float | None) -> float:
    """Samples per pixel of the next pass at most, as the render loop sizes waves; below 1 there is none.

    `spp` and `elapsed` are those so far, `speed` the last pass's samples per pixel and second.
    """
    wanted = max(growth * spp, 1) if spp else FIRST_PASS
    if stops.spp is not None:
        return min(wanted, max(round(stops.spp), 1) - spp)
    if speed is None:
        return wanted
    left = stops.time - elapsed
    share = MAX_SHARE_OF_TIME_LEFT if left > LAST_WAVE_SHARE * stops.time else 1.0
    return min(wanted, share * speed * left)


class Worker:
    """Mitsuba in a process of its own, with one scene. Raises UserError if no variant can render it.

    `sizes`: samples per pixel that a pass may have, rising: near powers of two, where the sampler does not round them
    up. They are few because the compiled variants may compile anew for each.
    """

    def __init__(self, name: str, xml: str, pixels: int):
        begun = time.perf_counter()
        failures = []
        for variant in VARIANTS:
            self._connection, other = multiprocessing.Pipe()
            spawn = multiprocessing.get_context("spawn")
            self._process = spawn.Process(target=_serve, args=(other, variant, xml), daemon=True)
            self._process.start()
            other.close()
            try:
                self.version = self._receive()
                self.variant = variant
                self.sizes = self._ask("sizes", max(LARGEST_PASS // pixels, 1))
                self.render(1, 0)  # compiles
                self.setup_s = time.perf_counter() - begun
                return
            except _FailedError as error:
                failures.append(f"{variant}: {error}")
                self.close()
        raise UserError(f"Mitsuba cannot render {name}: {'; '.join(failures)}")

    def warm_up(self, stops: Stops) -> None:
        """Render a pass of every size that a run may come to, and leave out the larger ones: what is compiled for them
        is compiled before the clock runs. No pass takes more than half of a run."""
        for number, size in enumerate(self.sizes, 1):
            _, seconds = self.render(size, 0)
            if stops.time is None:
                enough = 2 * size >= stops.spp
            else:  # once more where it took long: the first time may have compiled
                enough = 2 * seconds >= stops.time and 2 * self.render(size, 1)[1] >= stops.time
            if enough and size >= FIRST_PASS:
                self.sizes = self.sizes[:number]
                break

    def render(self, spp: int, seed: int) -> tuple[np.ndarray, float]:
        """Linear RGB float32 (height, width, 3), and the seconds it took."""
        return self._ask("render", spp, seed)

    def close(self) -> None:
        self._connection.close()
        self._process.join(timeout=5)
        if self._process.is_alive():
            self._process.kill()

    def _ask(self, *question):
        with contextlib.suppress(OSError):  # it is gone; what it said last tells why
            self._connection.send(question)
        return self._receive()

    def _receive(self):
        try:
            kind, answer = self._connection.recv()
        except (EOFError, OSError):
            self._process.join()
            raise _FailedError(f"its process ended ({self._process.exitcode})") from None
        if kind == "failed":
            raise _FailedError(answer)
        return answer


class _FailedError(UserError):
    """Mitsuba said no, or its process died."""


def _serve(connection, variant: str, xml: str) -> None:
    """Answers until the other end is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C goes to all; the other process decides what it means
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
                connection.send(("sizes", _sizes(sampler, *arguments)))
                continue
            spp, seed = arguments
            begun = time.perf_counter()
            image = np.array(mitsuba.render(scene, spp=spp, seed=seed))  # the array waits for it
            seconds = time.perf_counter() - begun
            connection.send(("image", (image[..., :3].astype(np.float32), seconds)))
    except (EOFError, BrokenPipeError, ConnectionResetError):
        return
    except Exception as error:
        connection.send(("failed", str(error)))


def _sizes(sampler, largest: int) -> list[int]:
    """The largest sample count of the sampler's own up to each power of two, up to `largest`."""
    sizes = {1}
    for power in range(1, largest.bit_length()):
        for candidate in range(2**power, 2 ** (power - 1), -1):
            sampler.set_sample_count(candidate)
            if sampler.sample_count() == candidate:
                sizes.add(candidate)
                break
    return sorted(sizes)
