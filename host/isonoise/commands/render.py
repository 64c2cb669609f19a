"""`isonoise render`: check what can be checked, set up, render, write, report."""

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
from isonoise.error.stated_error import stated_error
from isonoise.errors import UserError
from isonoise.film.exr import read_reference
from isonoise.film.log import LogRow, LogWriter, row_values
from isonoise.film.output import check_output, image_layers, write_image
from isonoise.loop import Outcome, Stops, render_loop
from isonoise.progress import RenderProgressBar, format_duration, format_percent
from isonoise.renderer import Renderer
from isonoise.strategies import describe

HEADER = (
    "version",
    "scene",
    "scene_hash",
    "strategy",
    "seed",
    "device",
    "time_s",
    "samples",
    "rejected",
    "floor",
    "stopped_by",
)
"""Facts that the header of an .exr file holds, each with the prefix 'isonoise.'."""


def run(options: argparse.Namespace) -> int:
    """Render as the options say; returns the exit code. Raises UserError for what is the user's to mend."""
    _check_files(options)
    reference = read_reference(options.reference) if options.reference else None
    log = _Log(options.log, true_errors=reference is not None)
    renderer = _renderer(options)
    _check_shape(options, reference, renderer)
    say = _say_nothing if options.json else _say
    _say_what(say, options, renderer)

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
    interrupted = 128 + (received or [signal.SIGINT])[0]
    if outcome.statistics.samples == 0:
        print("isonoise: stopped before the first sample; no image is written", file=sys.stderr)
        return interrupted

    facts = _facts(options, renderer, stops, outcome)
    layers = image_layers(outcome.statistics, outcome.floor)
    for path in options.output:
        write_image(path, layers, {f"isonoise.{key}": facts[key] for key in HEADER})
    _say_result(say, facts)
    if options.json:
        print(json.dumps(_finite(facts)))
    log.finish()
    if outcome.reason == "interrupted":
        return interrupted
    return EXIT_ERROR_NOT_MET if options.error and outcome.reason != "error" else EXIT_DONE


def _check_files(options: argparse.Namespace) -> None:
    """Every output can be written, and none takes the place of another or of an input."""
    for path in options.output:
        check_output(path)
    taken = {}
    files = [("the scene", options.scene), ("--reference", options.reference), ("--log", options.log)]
    for what, path in [*files, *(("-o", path) for path in options.output)]:
        if path:
            other = taken.setdefault(Path(path).resolve(), f"{what} {path}")
            if other != f"{what} {path}" or options.output.count(path) > 1:
                raise UserError(f"{what} {path} is the same file as {other}")


def _renderer(options: argparse.Namespace) -> Renderer:
    chosen = {"strategy": options.strategy} if options.strategy else {}
    return Renderer(
        options.scene,
        device=options.device,
        seed=options.seed,
        size=options.size,
        max_depth=options.max_depth,
        parameters=dict(options.parameters),
        **chosen,
    )


def _stops(options: argparse.Namespace, renderer: Renderer) -> Stops:
    """The limits asked for; with none of them the scene's samples per pixel."""
    asked = options.spp or options.time or options.error
    spp = options.spp if asked else float(renderer.scene.sample_count)
    return Stops(spp=spp, time=options.time, error=options.error, quantile=options.quantile)


def _check_shape(options: argparse.Namespace, reference, renderer: Renderer) -> None:
    expected = (renderer.scene.height, renderer.scene.width)
    if reference is not None and reference[0].shape[:2] != expected:
        height, width = reference[0].shape[:2]
        raise UserError(
            f"reference '{options.reference}' is {width}x{height} and the image {expected[1]}x{expected[0]}: "
            f"render with --size {width}x{height}, or give another reference"
        )


@contextmanager
def _stop_signals() -> Iterator[list[int]]:
    """Collects Ctrl-C and a batch system's SIGTERM in a list, so that the render ends after the work in flight.

    A second signal acts as it did before: a second Ctrl-C interrupts at once.
    """
    received = []
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    before = {number: handler for number, handler in before.items() if handler != signal.SIG_IGN}  # as under nohup

    def note(number, frame):
        received.append(number)
        restore()

    def restore():
        for number, handler in before.items():
            signal.signal(number, handler)

    for number in before:
        signal.signal(number, note)
    try:
        yield received
    finally:
        restore()


class _Log:
    """The log, if one was asked for. A disk that fills up ends the log, not the render; `finish` says so."""

    def __init__(self, path: str | None, true_errors: bool):
        self._writer = LogWriter(path, true_errors) if path else None
        self._failure = None

    def write(self, row: LogRow) -> None:
        if self._writer and not self._failure:
            try:
                self._writer.write(row)
            except UserError as error:
                self._failure = error

    def finish(self) -> None:
        if self._failure:
            raise UserError(f"{self._failure}; the log ends early, the image is whole")


def _facts(options: argparse.Namespace, renderer: Renderer, stops: Stops, outcome: Outcome) -> dict[str, object]:
    """What there is to say about a finished render: the fields of --json, those of `HEADER` among them."""
    statistics = outcome.statistics
    return {
        "version": __version__,
        "scene": options.scene,
        "scene_hash": renderer.scene.hash,
        "width": renderer.scene.width,
        "height": renderer.scene.height,
        "strategy": describe(renderer.strategy),
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
        "stated_error": float(stated_error(statistics, [stops.quantile], outcome.floor)[0]),
        "waves": len(outcome.rows),
        "last_wave": row_values(outcome.rows[-1]) if outcome.rows else None,
        "output": options.output,
        "log": options.log,
    }


def _finite(value):
    """The same with None for every number that JSON has no word for."""
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _say(label: str, text: str) -> None:
    print(f"{label:9} {text}", flush=True)


def _say_nothing(label: str, text: str) -> None:
    pass


def _say_what(say, options: argparse.Namespace, renderer: Renderer) -> None:
    scene = renderer.scene
    say("scene", f"{options.scene}, {scene.width}x{scene.height}")
    say("strategy", f"{describe(renderer.strategy)}, seed {options.seed}")
    say("device", renderer.device_name)
    say("set-up", ", ".join(f"{name} {format_duration(seconds)}" for name, seconds in renderer.setup_times.items()))


def _say_result(say, facts: dict[str, object]) -> None:
    say("rendered", f"{format_duration(facts['time_s'])}, {facts['samples']:,} samples, {facts['spp']:.4g} per pixel")
    say(
        "stopped",
        {"interrupted": "on request", "full": "as a pixel's count of samples is full"}.get(
            facts["stopped_by"], f"by --{facts['stopped_by']}"
        ),
    )
    say("error", f"{format_percent(facts['stated_error'])} (stated, quantile {facts['quantile']:g})")
    last = facts["last_wave"] or {}
    if "true_p99" in last:
        quantiles = ", ".join(f"p{q} {format_percent(last[f'true_p{q}'])}" for q in (50, 95, 99))
        stated = ", ".join(f"p{q} {format_percent(last[f'stated_p{q}'])}" for q in (50, 95, 99))
        say(
            "",
            f"true    {quantiles}; relMSE {last['true_rel_mse']:.3g}, image mean ratio {last['true_energy_ratio']:.4f}",
        )
        say("", f"stated  {stated}")
    if facts["rejected"]:
        say("rejected", f"{facts['rejected']:,} samples were negative or not finite and are left out")
    for path in facts["output"]:
        say("image", path)
    if facts["log"]:
        say("log", facts["log"])
