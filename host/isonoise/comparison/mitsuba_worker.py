"""Mitsuba 3 as a strategy: the same scene file, size and depth, its own sampler, a pass for the whole budget.

Mitsuba's samplers are stratified within a pass only, so every image is a pass of its own: that of the whole budget, and
those of halved budgets for the curve of error against time. Mitsuba runs in its own process: OpenCL drivers load an
LLVM of their own, and Mitsuba aborts the process if it loads a libLLVM that is too old. That process measures the time
of rendering alone. Called by `local_runs` and by `bench --peers`.
"""

import contextlib
import multiprocessing
import signal
import time
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from isonoise.comparison.mitsuba_scene import mitsuba_xml
from isonoise.comparison.plan import SceneEntry
from isonoise.comparison.recorder import SNAPSHOTS, Recorder
from isonoise.comparison.strategy_specs import MITSUBA_SAMPLERS
from isonoise.error.true_error import true_error
from isonoise.errors import UserError
from isonoise.film.log import LogRow
from isonoise.loop import Stops

VARIANTS = ("llvm_ad_rgb", "scalar_rgb")
"""Tried in this order. The first needs libLLVM; DRJIT_LIBLLVM_PATH may have to name it."""
FIRST_MEASURED_SPP = 16
"""Samples per pixel of the first pass that measures the speed."""
MIN_MEASURED_SHARE = 0.25
"""The speed is known once a pass takes this share of the time of a run."""
MAX_CORRECTIONS = 4
"""Further sizes that are measured, because the time of a sample depends on the size of the pass: multijitter permutes
numbers by walking cycles of the next power of two, so 32 x 33 samples take 1.4 times as long as 32 x 32."""
PASS_TOLERANCE = 0.03
"""A pass may take longer than planned by this share: times repeat to about as much."""
SNAPSHOT_MARGIN = 1.05
"""A pass for an earlier moment of the curve is planned for this multiple of its time, so that it is not before it."""
MAX_PASS_SAMPLES = 2**31
"""Mitsuba splits passes from 2^32 samples on. The memory of a pass does not grow with its samples."""


class MitsubaWorkers:
    """Mitsuba's processes for one scene, started on first use and ended with the `with` block."""

    def __init__(self, scene: SceneEntry):
        self._scene = scene
        self._workers: dict[str, MitsubaWorker] = {}
        self._schedules: dict[str, list[list[int]]] = {}

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
        identity: Mapping,
        on_progress: Callable[[float, int], None],
    ) -> bytes:
        """Render one run; returns the content of its file. Stated errors are nan. Raises UserError if it fails.

        Every row is an image of its own, with its own time. Passes of an image are weighted by their samples.
        """
        pixels = self._scene.width * self._scene.height
        worker = self._workers.get(strategy)
        if worker is None:
            scene = self._scene
            xml = mitsuba_xml(Path(scene.source), MITSUBA_SAMPLERS[strategy], scene.size, scene.max_depth)
            worker = self._workers[strategy] = MitsubaWorker(self._scene.name, xml, pixels)
            self._schedules[strategy] = worker.schedule(stops)
        recorder = Recorder(stops, *reference)
        for number, passes in enumerate(self._schedules[strategy]):
            total, elapsed, spp = 0.0, 0.0, sum(passes)
            seeds = np.random.SeedSequence([seed, number]).generate_state(len(passes))
            for size, pass_seed in zip(passes, seeds, strict=True):
                image, seconds = worker.render(size, int(pass_seed))
                elapsed += seconds
                total = total + size * image.astype(np.float64)
            elapsed = max([elapsed, *(earlier["elapsed_s"] for earlier in recorder.rows)])  # no smaller pass is slower
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
            "strategy": f"{strategy}: Mitsuba {worker.version}, {worker.variant}, {_describe(passes)}",
            "scene": self._scene.name,
            "seed": seed,
            "device": f"CPU (Mitsuba 3, {worker.variant})",
            "setup_s": worker.setup_s,
            "samples": spp * pixels,
            "elapsed_s": elapsed,
            "stopped_by": "time" if stops.time is not None else "spp",
        }
        return recorder.pack(row, rgb, np.full(rgb.shape[:2], spp, np.uint32), facts, identity)


def _describe(passes: list[int]) -> str:
    sizes = " + ".join(map(str, passes))
    return f"a pass of {sizes} spp" if len(passes) == 1 else f"passes of {sizes} spp"


class MitsubaWorker:
    """Mitsuba in its own process, with one scene. Raises UserError if no variant can render it.

    Samplers round samples per pixel up: `multijitter` to a product of two near-equal factors, such as 128 to 11 x 12.
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
                self._max_spp = max(MAX_PASS_SAMPLES // pixels, 1)
                self.render(1, 0)  # compiles
                self.setup_s = time.perf_counter() - start
                return
            except _FailedError as error:
                failures.append(f"{variant}: {error}")
                self.close()
        raise UserError(f"Mitsuba cannot render {name}: {'; '.join(failures)}")

    def schedule(self, stops: Stops) -> list[list[int]]:
        """The images of a run, the last for the whole budget; of each, the samples per pixel of its passes.

        Every pass was rendered once, so that it is compiled before the clock starts. With a time, the last image is the
        largest pass that was measured to take no longer, and every image is one pass. With samples per pixel, the last
        image has exactly these; it is one pass unless the sampler would round them up.
        """
        if stops.time is None:
            last = self._exact_passes(max(round(stops.spp), 1))
            spp, margin = float(sum(last)), 1.0
        else:
            spp, margin = self._most_spp_in(stops.time), SNAPSHOT_MARGIN
            last = [spp]
        images = []
        for halvings in range(SNAPSHOTS - 1, 0, -1):
            size = self._request("rounded_up", max(round(margin * spp / 2**halvings), 1))
            if size < sum(last) and [size] not in images:
                images.append([size])
        images.append(last)
        for size in {size for passes in images for size in passes}:
            self.render(size, 0)
        return images

    def _exact_passes(self, spp: int) -> list[int]:
        """Passes that have `spp` samples per pixel together, each as large as possible."""
        passes = []
        while spp > 0:
            passes.append(self._request("rounded_down", min(spp, self._max_spp)))
            spp -= passes[-1]
        return passes

    def _nearest_spp(self, spp: float) -> int:
        wanted = min(max(round(spp), 1), self._max_spp)
        return min((self._request(f"rounded_{way}", wanted) for way in ("down", "up")), key=lambda n: abs(n - spp))

    def _most_spp_in(self, time_s: float) -> int:
        """The most samples per pixel of all measured passes that take at most `time_s`."""
        spp, measured = FIRST_MEASURED_SPP, {}
        while True:
            measured[spp] = self._measure(spp)
            if measured[spp] >= MIN_MEASURED_SHARE * time_s or 4 * spp > self._max_spp:
                break
            spp *= 4
        for _ in range(MAX_CORRECTIONS):
            spp = self._nearest_spp(spp * time_s / measured[spp])
            if spp in measured:
                break
            measured[spp] = self._measure(spp)
            if abs(measured[spp] / time_s - 1) <= PASS_TOLERANCE:
                break
        in_time = [n for n, seconds in measured.items() if seconds <= (1 + PASS_TOLERANCE) * time_s]
        return max(in_time, default=min(measured))

    def _measure(self, spp: int) -> float:
        """Seconds of a pass: the shorter of two, as other programs may have slowed down the longer one."""
        self.render(spp, 0)  # compiles
        return min(self.render(spp, seed)[1] for seed in (1, 2))

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
            if command in ("rounded_up", "rounded_down"):
                connection.send((command, _rounded_spp(sampler, *arguments, down=command == "rounded_down")))
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


def _rounded_spp(sampler, spp: int, down: bool) -> int:
    """The nearest samples per pixel, `spp` or below or above it, that the sampler can have."""
    sampler.set_sample_count(spp)
    while down and sampler.sample_count() > spp:
        spp -= 1
        sampler.set_sample_count(spp)
    return sampler.sample_count()
