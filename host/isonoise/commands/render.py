"""`isonoise render`: checks the files, sets up, renders, writes images and log, reports."""

import argparse
import traceback
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from isonoise.command_output import logger, print_json
from isonoise.commands import EXIT_BAD_INPUT, EXIT_DONE, EXIT_ERROR_NOT_MET
from isonoise.commands.render_checkpoint import Checkpoints
from isonoise.commands.render_result import image_header, print_result, print_settings, print_setup_times, result_fields
from isonoise.commands.render_viewers import Viewers
from isonoise.commands.shared_options import cluster_of
from isonoise.errors import UserError
from isonoise.film.exr import film_windows, read_reference
from isonoise.film.fallback import WrittenFile, write_elsewhere
from isonoise.film.files import check_no_input
from isonoise.film.log import LogRow, LogWriter, write_log
from isonoise.film.output import ImageFiles
from isonoise.loop import Periodic, RenderLoop
from isonoise.outcome import Outcome
from isonoise.progress import ProgressBar, RenderProgressBar
from isonoise.renderer import Renderer
from isonoise.scene.view import view_of
from isonoise.signals import deferred, raise_if_received
from isonoise.stops import Stops


def run(options: argparse.Namespace) -> int:
    """Run the command; return the exit code."""
    images = ImageFiles(options.output)
    if options.denoise:
        options.layers = (*(options.layers or ()), "denoised")
    _check_files(options)
    reference = read_reference(options.reference) if options.reference else None
    with ExitStack() as stack:
        checkpoints = Checkpoints(options)
        stack.callback(checkpoints.close)
        log = _Log(options.log, reference is not None, checkpoints.rows)
        stack.callback(log.close)
        viewers = Viewers(options)
        stack.callback(viewers.close)
        cluster = stack.enter_context(cluster_of(options))
        renderer = stack.enter_context(_make_renderer(options, cluster))
        check_no_input([*options.output, options.log, options.checkpoint], renderer.files)
        checkpoints.check(renderer)
        _check_reference_size(options, reference, renderer)
        raise_if_received()
        print_setup_times(renderer)
        with deferred() as received:
            return _Render(options, renderer, reference, images, log, checkpoints, viewers).run(received)


class _Render:
    """A render with its files. However it ends, `_end` writes what has been rendered."""

    def __init__(
        self,
        options: argparse.Namespace,
        renderer: Renderer,
        reference,
        images: ImageFiles,
        log: "_Log",
        checkpoints: Checkpoints,
        viewers: Viewers,
    ):
        self._options, self._renderer, self._reference = options, renderer, reference
        self._images, self._log, self._checkpoints, self._viewers = images, log, checkpoints, viewers
        self._stops = _stops(options, renderer)
        self._warned: set[str] = set()  # of images that could not be written during the render

    def run(self, received: list[int]) -> int:
        """Render until a limit, or a signal in `received`; return the exit code."""
        with RenderProgressBar() as bar:
            loop = RenderLoop(
                self._renderer,
                self._stops,
                on_wave=lambda row, _: self._log.write(row),
                on_progress=lambda *progress: bar.update(*progress, self._count_workers()),
                reference=self._reference,
                should_stop=lambda: bool(received),
                periodic=self._periodic(),
                on_end=self._checkpoints.keep,
                state=self._checkpoints.state,
            )
            failure = None
            try:
                outcome = loop.run()
            except BaseException as error:  # no signal raises here
                failure = error
                traceback.clear_frames(error.__traceback__)  # frees what the loop has allocated
                outcome = _outcome_or_none(loop)
                self._keep_after_failure(loop)
                if outcome is None:
                    raise
        return self._end(outcome, failure)

    def _count_workers(self) -> int:
        """How many workers are there; 0 on one device."""
        return sum(worker.is_ready for worker in self._renderer.worker_reports())

    def _periodic(self) -> list[Periodic]:
        images = [Periodic(self._options.save_every, self._save)] if self._options.save_every else []
        return [*self._checkpoints.periodic(), *images, *self._viewers.periodic(self._save)]

    def _keep_after_failure(self, loop: RenderLoop) -> None:
        """Write a checkpoint, or say that the last one stays."""
        try:
            self._checkpoints.keep(loop)
        except Exception as error:
            logger.error(f"no new checkpoint is written, an earlier one stays: {error}")

    def _save(self, loop: RenderLoop) -> list[str]:
        """Write the images in the middle of the render; return the paths that were written."""
        outcome = loop.outcome_so_far("unfinished")
        images = self._write_images(outcome, has_ended=False) if outcome.statistics.samples else []
        for path, image in zip(self._options.output, images, strict=False):
            if image.failure and path not in self._warned:
                self._warned.add(path)
                logger.warning(f"{image.failure}; the render goes on")
        return [image.path for image in images if image.path]

    def _write_images(self, outcome: Outcome, has_ended: bool) -> list[WrittenFile]:
        result = result_fields(self._options, self._renderer, self._stops, outcome)
        layers = _made_layers(outcome.layers, has_ended)
        header = image_header(result | {"denoiser": result["denoiser"] if "denoised" in layers else None})
        header |= film_windows(*self._renderer.scene.film_window)
        may_be_partial = outcome.reason not in ("unfinished", "interrupted", "failed")
        exposure = self._renderer.scene.exposure
        views = {"exposure": exposure, "layers": layers, "stops": self._options.exposure}
        return self._images.write(outcome.statistics, outcome.floor, header, has_ended, may_be_partial, **views)

    def _end(self, outcome: Outcome, failure: BaseException | None) -> int:
        """Write images and log, report, and return the exit code; or raise the `failure` that has ended the render."""
        options = self._options
        if outcome.statistics.samples == 0:
            logger.error("stopped before the first sample; no image is written")
            self._viewers.show(outcome)
            if failure:
                raise failure
            return EXIT_DONE  # `cli` adds the signal
        checkpoint = self._checkpoints.end()
        images = self._write_images(outcome, has_ended=True)
        failures = [image for image in images if image.failure]
        log = self._log.end(outcome.rows)
        self._viewers.show(outcome)
        result = result_fields(options, self._renderer, self._stops, outcome)
        result |= {"output": [image.path for image in images if image.path], "live_page": self._viewers.url}
        if options.json:
            print_json(result)
        else:
            print_result(result)
        for path, image in zip(options.output, images, strict=True):
            if image.failure:
                logger.error(image.message())
            elif image.path != path:
                logger.error(f"'{path}' stays as it was: the new image lacks pixels")
        if checkpoint and checkpoint.failure:
            logger.error(checkpoint.message())
        if log:
            state = "incomplete" if failures else "incomplete, the image is complete"
            logger.error(f"{log.failure}; the log is {state}; {log.place()}")
        internal = [image.failure for image in failures if not isinstance(image.failure, (UserError, MemoryError))]
        if failure or internal:
            raise failure or internal[0]
        if failures or log or (checkpoint and checkpoint.failure):
            return EXIT_BAD_INPUT
        return EXIT_ERROR_NOT_MET if options.error and outcome.reason != "error" else EXIT_DONE


def _made_layers(layers: Mapping[str, np.ndarray], has_ended: bool) -> dict[str, np.ndarray]:
    """The layers; during the render, and if the denoiser fails, without the denoised image. That takes seconds."""
    made = {name: layers[name] for name in layers if name != "denoised"}
    if has_ended and "denoised" in layers:
        try:
            made["denoised"] = layers["denoised"]
        except (UserError, MemoryError) as error:
            logger.error(f"{str(error) or type(error).__name__}; there is no denoised image")
    return made


def _outcome_or_none(loop: RenderLoop) -> Outcome | None:
    """What has been rendered before an exception; None if the device does not give it any more."""
    try:
        return loop.outcome_so_far("failed")
    except Exception:
        return None


class _Log:
    """The log, if there is one. A write error, such as a full disk, ends the log but not the render."""

    def __init__(self, path: str | None, true_errors: bool, rows: list[LogRow]):
        self._path, self._true_errors = path, true_errors
        self._writer = LogWriter(path, true_errors, rows) if path else None
        self._failure: UserError | None = None

    def write(self, row: LogRow) -> None:
        if self._writer and not self._failure:
            try:
                self._writer.write(row)
            except UserError as error:
                self._failure = error

    def end(self, rows: list[LogRow]) -> WrittenFile | None:
        """After a write error write all rows to another place; None if there was none."""
        if self._writer and not self._failure:
            try:
                self._writer.end()
            except UserError as error:
                self._failure = error
        if not self._failure:
            return None
        return write_elsewhere(self._path, lambda path: write_log(path, rows, self._true_errors), self._failure)

    def close(self) -> None:
        if self._writer:
            self._writer.close()


def _check_files(options: argparse.Namespace) -> None:
    """Check that no output overwrites an input or another output."""
    roles = {}
    files = [("the scene", options.scene), ("--reference", options.reference), ("--log", options.log)]
    files += [("--env", options.env), ("--checkpoint", options.checkpoint or options.resume)]
    for name, path in [*files, *(("-o", path) for path in options.output)]:
        if path:
            role = f"{name} {path}"
            other = roles.setdefault(Path(path).resolve(), role)
            if other != role or options.output.count(path) > 1:
                raise UserError(f"{role} is the same file as {other}")


class _SetUpDisplay:
    """Shows what the set-up of a renderer does: the settings once they are known, and bars on a terminal."""

    def __init__(self, options: argparse.Namespace):
        self._options, self._has_printed = options, False
        self._bar = ProgressBar(f"loading {options.scene}").__enter__()

    def update(self, renderer: Renderer, program: str, done: int, total: int) -> None:
        """Called by `Renderer` before each program is compiled."""
        if not self._has_printed:
            self._has_printed = True
            self.close()  # a bar would take what is printed to standard output
            print_settings(self._options, renderer)
            self._bar = ProgressBar("compiling").__enter__()
        if program:
            self._bar.show_compilation(program, done, total)

    def show_workers(self, number: int) -> None:
        """Called by `Cluster` while no worker is ready."""
        self._bar.show(0, None, f"waiting for the first of {number} workers" if number else "waiting for workers")

    def close(self) -> None:
        self._bar.__exit__()


def _make_renderer(options: argparse.Namespace, cluster) -> Renderer:
    strategy = {"strategy": options.strategy} if options.strategy else {}
    display = _SetUpDisplay(options)
    if cluster:
        cluster.on_wait = display.show_workers
    try:
        return Renderer(
            options.scene,
            device=None if cluster else options.device,  # with a cluster that of its workers
            cluster=cluster,
            seed=options.seed,
            size=options.size,
            max_depth=options.max_depth,
            sampler=options.sampler,
            parameters=dict(options.parameters),
            allow_outside=options.allow_outside,
            memory=options.memory,
            view=view_of(options),
            layers=options.layers,
            on_compile=display.update,
            **strategy,
        )
    finally:
        display.close()


def _stops(options: argparse.Namespace, renderer: Renderer) -> Stops:
    """The given limits; without any, the scene's samples per pixel."""
    has_limit = options.spp or options.time or options.error
    spp = options.spp if has_limit else float(renderer.scene.sample_count)
    return Stops(
        spp=spp, time=options.time, error=options.error, quantile=options.quantile, confidence=options.confidence
    )


def _check_reference_size(options: argparse.Namespace, reference, renderer: Renderer) -> None:
    expected = (renderer.scene.height, renderer.scene.width)
    if reference is not None and reference[0].shape[:2] != expected:
        height, width = reference[0].shape[:2]
        raise UserError(
            f"reference '{options.reference}' is {width}x{height} and the image {expected[1]}x{expected[0]}: "
            f"render with --size {width}x{height}, or give another reference"
        )
