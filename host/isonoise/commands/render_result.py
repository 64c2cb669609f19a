"""The result of `isonoise render`: the fields of --json and of image headers, and the lines that it prints."""

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import asdict

from isonoise import __version__
from isonoise.film.log import row_values
from isonoise.outcome import Outcome
from isonoise.progress import format_count, format_duration, format_number, format_percent, shorten_numbers
from isonoise.renderer import Renderer
from isonoise.stops import Stops
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


ERROR_OF_NOISY = "the noisy image, channels R, G, B"
"""What stated errors and the channel `error` belong to if there is a denoised image."""

MAX_WORKER_LINES = 8
"""Workers that the result has a line for; the others share one."""


def result_fields(options: argparse.Namespace, renderer: Renderer, stops: Stops, outcome: Outcome) -> dict[str, object]:
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
        "seed": renderer.seed,
        "device": ", ".join(renderer.devices),
        "setup_s": renderer.setup_times,
        "workers": [asdict(worker) | {"samples_per_s": worker.samples_per_s} for worker in renderer.worker_reports()],
        "client_share": outcome.client_share,
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
        "layers": list(renderer.layer_names),
        "denoiser": denoiser(renderer.layer_names),
        "output": options.output,
        "log": options.log,
        "checkpoint": options.checkpoint or options.resume,
    }


def image_header(result: Mapping[str, object]) -> dict[str, object]:
    """The header of an image with this result."""
    header = {f"isonoise.{key}": result[key] for key in HEADER_FIELDS}
    return header | denoiser_header(result["denoiser"])


def denoiser(layers: Sequence[str]) -> str | None:
    """Name of the denoiser if one of the layers is its image."""
    if "denoised" not in layers:
        return None
    from isonoise.film.denoise import denoiser_name

    return denoiser_name()


def denoiser_header(name: str | None) -> dict[str, str]:
    """What a header says about the denoiser of this name."""
    return {} if name is None else {"isonoise.denoiser": name, "isonoise.error_of": ERROR_OF_NOISY}


def _print_line(label: str, text: str) -> None:
    print(f"{label:9} {text}", flush=True)


def print_settings(options: argparse.Namespace, renderer: Renderer) -> None:
    """Print what is known before the kernels are compiled."""
    scene = renderer.scene
    _print_line("scene", f"{options.scene}, {scene.width}x{scene.height}")
    _print_line(
        "strategy", f"{shorten_numbers(describe(renderer.strategy))}, sampler {scene.sampler}, seed {renderer.seed}"
    )
    _print_line("device", renderer.device_name)


def print_setup_times(renderer: Renderer) -> None:
    times = (f"{name} {format_duration(seconds)}" for name, seconds in renderer.setup_times.items())
    _print_line("set-up", ", ".join(times))


def print_result(result: Mapping[str, object]) -> None:
    """Print the result as text."""
    time, samples, spp = format_duration(result["time_s"]), f"{result['samples']:,}", format_number(result["spp"], 4)
    _print_line("rendered", f"{time}, {samples} samples, {spp} per pixel")
    if result["workers"]:
        _print_workers(result["workers"], result["client_share"])
    reasons = {
        "interrupted": "by a signal or on the live page" if result["live_page"] else "by a signal",
        "full": "because a pixel's sample count is full",
        "failed": "by an error of the program, the device or a file",
    }
    _print_line("stopped", reasons.get(result["stopped_by"], f"by --{result['stopped_by']}"))
    noisy = ", of the noisy image" if result["denoiser"] else ""
    _print_line("error", f"{format_percent(result['stated_error'])} (stated, quantile {result['quantile']:g}{noisy})")
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
        rel_mse, energy_ratio = format_number(last["true_rel_mse"]), f"{last['true_energy_ratio']:.4f}"
        _print_line("", f"true    {true}; relMSE {rel_mse}, image mean ratio {energy_ratio}")
        _print_line("", f"stated  {stated}")
    if result["rejected"]:
        _print_line("rejected", f"{result['rejected']:,} samples were negative or not finite and were left out")
    for path in result["output"]:
        _print_line("image", path)
    if result["checkpoint"]:
        _print_line("state", result["checkpoint"])
    if result["log"]:
        _print_line("log", result["log"])


def _print_workers(workers: Sequence[Mapping[str, object]], client_share: float) -> None:
    """Print a line for each of those that did most."""
    total = max(sum(worker["samples"] for worker in workers), 1)
    several_devices = len({worker["device"] for worker in workers}) > 1
    _print_line("workers", f"{len(workers):,}; the client was busy {format_percent(client_share or 0.0)} of the time")
    ranked = sorted(workers, key=lambda worker: worker["samples"], reverse=True)
    for worker in ranked[:MAX_WORKER_LINES]:
        text = f"{worker['name']}: {format_percent(worker['samples'] / total)} of the samples"
        if worker["samples_per_s"]:
            text += f", {format_count(worker['samples_per_s'])} samples/s"
        if worker["lost"]:
            text += f", {worker['lost']:,} tasks lost"
        if not worker["is_ready"]:
            text += ", no longer there"
        if several_devices:
            text += f"; {worker['device']}"
        _print_line("", text)
    rest = ranked[MAX_WORKER_LINES:]
    if rest:
        share = format_percent(sum(worker["samples"] for worker in rest) / total)
        _print_line("", f"and {len(rest):,} more: {share} of the samples")
