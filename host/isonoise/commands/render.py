"""`isonoise render`: checks the files, sets up, renders, writes images and log, reports."""

import argparse
import json
import math
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from isonoise import __version__
from isonoise.commands import EXIT_DONE, EXIT_ERROR_NOT_MET
from isonoise.errors import UserError
from isonoise.film.exr import read_reference
from isonoise.film.log import LogRow, LogWriter, row_values
from isonoise.film.output import check_output, image_layers, write_image
from isonoise.loop import Outcome, Stops, render_loop
from isonoise.progress import RenderProgressBar, format_duration, format_percent
from isonoise.renderer import Renderer
from isonoise.strategies import describe

HEADER_FIELDS = (
    "version",
    "scene",
    "scene_hash",
    "strategy",
    "sampler",
    "seed",
    "device",
    "time_s",
    "samples",
    "rejected",
    "floor",
    "stopped_by",
)
"""Fields of the result that are written to the header of an .exr file, with the prefix 'isonoise.'."""


def run(options: argparse.Namespace) -> int:
    """Run the command; return the exit code."""
    _check_files(options)
    reference = read_reference(options.reference) if options.reference else None
    log = _Log(options.log, true_errors=reference is not None)
    renderer = _make_renderer(options)
    _check_reference_size(options, reference, renderer)
    if not options.json:
        _print_settings(options, renderer)

    stops = _stops(options, renderer)
    with _stop_signals() as received, RenderProgressBar() as bar:
        outcome = render_loop(
            renderer,
            stops,
            on_wave=lambda row, _: log.write(row),
            on_progress=bar.update,
            reference=reference,
            should_stop=lambda: bool(received),
        )
    exit_interrupted = 128 + (received or [signal.SIGINT])[0]
    if outcome.statistics.samples == 0:
        print("isonoise: stopped before the first sample; no image is written", file=sys.stderr)
        return exit_interrupted

    result = _result(options, renderer, stops, outcome)
    layers = image_layers(outcome.statistics, outcome.floor)
    for path in options.output:
        write_image(path, layers, {f"isonoise.{key}": result[key] for key in HEADER_FIELDS})
    if options.json:
        print(json.dumps(_without_nan(result)))
    else:
        _print_result(result)
    log.raise_failure()
    if outcome.reason == "interrupted":
        return exit_interrupted
    return EXIT_ERROR_NOT_MET if options.error and outcome.reason != "error" else EXIT_DONE


def _check_files(options: argparse.Namespace) -> None:
    """Check that every output can be written and overwrites neither an input nor another output."""
    for path in options.output:
        check_output(path)
    roles = {}
    files = [("the scene", options.scene), ("--reference", options.reference), ("--log", options.log)]
    for name, path in [*files, *(("-o", path) for path in options.output)]:
        if path:
            role = f"{name} {path}"
            other = roles.setdefault(Path(path).resolve(), role)
            if other != role or options.output.count(path) > 1:
                raise UserError(f"{role} is the same file as {other}")


def _make_renderer(options: argparse.Namespace) -> Renderer:
    strategy = {"strategy": options.strategy} if options.strategy else {}
    return Renderer(
        options.scene,
        device=options.device,
        seed=options.seed,
        size=options.size,
        max_depth=options.max_depth,
        sampler=options.sampler,
        parameters=dict(options.parameters),
        allow_outside=options.allow_outside,
        **strategy,
    )


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


@contextmanager
def _stop_signals() -> Iterator[list[int]]:
    """Collect Ctrl-C and SIGTERM (of batch systems) in a list, so that the render can end after the paths in flight.

    After the first signal the previous handlers are restored: a second Ctrl-C interrupts at once.
    """
    received = []
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    handlers = {number: handler for number, handler in handlers.items() if handler != signal.SIG_IGN}  # under nohup

    def on_signal(number, frame):
        received.append(number)
        restore()

    def restore():
        for number, handler in handlers.items():
            signal.signal(number, handler)

    for number in handlers:
        signal.signal(number, on_signal)
    try:
        yield received
    finally:
        restore()


class _Log:
    """The log, if there is one. A write error, such as a full disk, ends the log but not the render."""

    def __init__(self, path: str | None, true_errors: bool):
        self._writer = LogWriter(path, true_errors) if path else None
        self._failure = None

    def write(self, row: LogRow) -> None:
        if self._writer and not self._failure:
            try:
                self._writer.write(row)
            except UserError as error:
                self._failure = error

    def raise_failure(self) -> None:
        if self._failure:
            raise UserError(f"{self._failure}; the log is incomplete, the image is complete")


def _result(options: argparse.Namespace, renderer: Renderer, stops: Stops, outcome: Outcome) -> dict[str, object]:
    """The fields of --json; they include `HEADER_FIELDS`."""
    statistics = outcome.statistics
    return {
        "version": __version__,
        "scene": options.scene,
        "scene_hash": renderer.scene.hash,
        "width": renderer.scene.width,
        "height": renderer.scene.height,
        "strategy": describe(renderer.strategy),
        "sampler": renderer.scene.sampler,
        "seed": options.seed,
        "device": renderer.device_name,
        "setup_s": renderer.setup_times,
        "time_s": outcome.elapsed_s,
        "samples": statistics.samples,
        "spp": statistics.samples / statistics.count.size,
        "rejected": int(statistics.rejected.sum(dtype=int)),
        "floor": outcome.floor,
        "stopped_by": outcome.reason,
        "quantile": stops.quantile,
        "confidence": stops.confidence,
        "error_bound": outcome.error_bound,
        "stated_error": outcome.stated_error,
        "waves": len(outcome.rows),
        "last_wave": row_values(outcome.rows[-1]) if outcome.rows else None,
        "output": options.output,
        "log": options.log,
    }


def _without_nan(value):
    """The value with None for NaN and infinity, which JSON does not have."""
    if isinstance(value, dict):
        return {key: _without_nan(item) for key, item in value.items()}
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _print_line(label: str, text: str) -> None:
    print(f"{label:9} {text}", flush=True)


def _print_settings(options: argparse.Namespace, renderer: Renderer) -> None:
    scene = renderer.scene
    _print_line("scene", f"{options.scene}, {scene.width}x{scene.height}")
    _print_line("strategy", f"{describe(renderer.strategy)}, sampler {scene.sampler}, seed {options.seed}")
    _print_line("device", renderer.device_name)
    times = (f"{name} {format_duration(seconds)}" for name, seconds in renderer.setup_times.items())
    _print_line("set-up", ", ".join(times))


def _print_result(result: dict[str, object]) -> None:
    time, samples, spp = format_duration(result["time_s"]), f"{result['samples']:,}", f"{result['spp']:.4g}"
    _print_line("rendered", f"{time}, {samples} samples, {spp} per pixel")
    reasons = {"interrupted": "by a signal", "full": "because a pixel's sample count is full"}
    _print_line("stopped", reasons.get(result["stopped_by"], f"by --{result['stopped_by']}"))
    _print_line("error", f"{format_percent(result['stated_error'])} (stated, quantile {result['quantile']:g})")
    if result["error_bound"] is not None:
        bound, confidence = format_percent(result["error_bound"]), format_percent(result["confidence"])
        _print_line("", f"true error below {bound} with {confidence} confidence, as far as samples show")
    last = result["last_wave"] or {}
    if last.get("energy_loss_se"):
        loss, error = (format_percent(last[name]) for name in ("energy_loss", "energy_loss_se"))
        _print_line("energy", f"loss of the image mean {loss}, standard error {error} (from the uniform waves)")
    if "true_p99" in last:
        true, stated = (
            ", ".join(f"p{q} {format_percent(last[f'{kind}_p{q}'])}" for q in (50, 95, 99))
            for kind in ("true", "stated")
        )
        rel_mse, energy_ratio = f"{last['true_rel_mse']:.3g}", f"{last['true_energy_ratio']:.4f}"
        _print_line("", f"true    {true}; relMSE {rel_mse}, image mean ratio {energy_ratio}")
        _print_line("", f"stated  {stated}")
    if result["rejected"]:
        _print_line("rejected", f"{result['rejected']:,} samples were negative or not finite and were left out")
    for path in result["output"]:
        _print_line("image", path)
    if result["log"]:
        _print_line("log", result["log"])
