"""`isonoise merge`: adds renders of one scene with different seeds, from their checkpoints."""

import argparse
from collections.abc import Mapping
from pathlib import Path

from isonoise import __version__
from isonoise.command_output import logger, print_json
from isonoise.commands import EXIT_BAD_INPUT, EXIT_DONE
from isonoise.commands.render_result import denoiser, denoiser_header
from isonoise.device.opencl import Device
from isonoise.error.stated_error import stated_error
from isonoise.errors import UserError
from isonoise.film.exr import film_windows
from isonoise.film.files import check_writable
from isonoise.film.layers import check_host_layers, make_layers
from isonoise.film.output import ImageFiles
from isonoise.progress import format_duration, format_number, format_percent
from isonoise.state.checkpoint import read_checkpoint, write_checkpoint
from isonoise.state.merge import merge_states, state_statistics
from isonoise.state.merge_layers import state_layers
from isonoise.state.state import State
from isonoise.strategies.measures import image_floor
from isonoise.tables import label_lines

_QUANTILE = 0.99


def run(options: argparse.Namespace) -> int:
    """Run the command; return the exit code."""
    images = ImageFiles(options.output)
    _check_files(options)
    device = Device(options.device)
    merged = merge_states((read_checkpoint(path) for path in options.checkpoints), options.checkpoints, device)
    statistics = state_statistics(merged, device)
    if statistics.samples == 0:
        raise UserError("the renders have no samples yet; there is nothing to merge")
    floor = image_floor(statistics.mean)
    header = _header(merged) | {
        "isonoise.samples": statistics.samples,
        "isonoise.rejected": int(statistics.rejected.sum(dtype=int)),
        "isonoise.floor": floor,
        **film_windows(*map(tuple, merged.settings["film_window"])),
    }
    names = tuple(merged.settings["layers"])
    check_host_layers(names)
    layers = make_layers(names, state_layers(merged), statistics, strategy=None)
    views = {"exposure": merged.settings["exposure"], "layers": layers, "stops": options.exposure}
    written = images.write(statistics, floor, header | denoiser_header(denoiser(layers)), may_be_partial=True, **views)
    if options.checkpoint:
        write_checkpoint(options.checkpoint, merged)
    renders = merged.values["merged"]["renders"]
    result = {
        "renders": len(renders),
        "time_s": sum(render["elapsed_s"] for render in renders),
        "samples": statistics.samples,
        "spp": statistics.samples / statistics.count.size,
        "seeds": [render["seed"] for render in renders],
        "quantile": _QUANTILE,
        "stated_error": float(stated_error(statistics, [_QUANTILE], floor)[0]),
        "output": [image.path for image in written if image.path],
        "checkpoint": options.checkpoint,
    }
    if options.json:
        print_json(result)
    else:
        print(label_lines(_lines(result)))
    failures = [image for image in written if image.failure]
    for image in failures:
        logger.error(image.message())
    return EXIT_BAD_INPUT if failures else EXIT_DONE


def _lines(result: Mapping) -> list[tuple[str, str]]:
    """The result as text, by label."""
    time, per_pixel = format_duration(result["time_s"]), format_number(result["spp"], 4)
    return [
        ("merged", f"{result['renders']} renders, {time}, {result['samples']:,} samples, {per_pixel} per pixel"),
        ("seeds", ", ".join(map(str, result["seeds"]))),
        ("error", f"{format_percent(result['stated_error'])} (stated, quantile {_QUANTILE:g})"),
        *(("image", path) for path in result["output"]),
        *([("state", result["checkpoint"])] if result["checkpoint"] else []),
    ]


def _header(merged: State) -> dict[str, object]:
    """Header of the image: the settings of all renders, those that may differ one after the other."""
    renders = merged.values["merged"]["renders"]
    different = {
        name: ", ".join(dict.fromkeys(str(render[name]) for render in renders))
        for name in ("strategy", "sampler", "seed", "device")
    }
    fields = {
        "version": __version__,
        "scene": merged.settings["scene"],
        "scene_hash": merged.settings["scene_hash"],
        **different,
        "time_s": sum(render["elapsed_s"] for render in renders),
        "stopped_by": "merge",
    }
    return {f"isonoise.{name}": value for name, value in fields.items()}


def _check_files(options: argparse.Namespace) -> None:
    """Check that the checkpoint can be written, and that no file is named twice."""
    if options.checkpoint:
        check_writable(options.checkpoint)
    seen = set()
    for path in [*options.checkpoints, *options.output, options.checkpoint]:
        if path and Path(path).resolve() in seen:
            raise UserError(f"'{path}' is named twice")
        seen.add(Path(path).resolve() if path else None)
