"""What a checkpoint holds, as text; called by `isonoise info`."""

import math
import os
from collections.abc import Mapping
from zipfile import is_zipfile

import numpy as np

from isonoise.errors import UserError
from isonoise.progress import format_duration, format_number
from isonoise.state.checkpoint import read_description


def is_checkpoint(path: str | os.PathLike) -> bool:
    """Whether a regular file looks like a checkpoint; other files are scenes or images."""
    name = os.fspath(path).lower()
    return os.path.isfile(path) and not name.endswith((".xml", ".exr")) and (name.endswith(".npz") or is_zipfile(path))


def describe_checkpoint(path: str | os.PathLike) -> list[tuple[str, str]]:
    """Labels and texts. Raises UserError if the file cannot be read or is damaged."""
    description = read_description(path)
    try:
        settings, values = description["settings"], description["values"]
        renders = values["merged"]["renders"] if "merged" in values else [_render(settings, values)]
        samples, width, height = sum(render["samples"] for render in renders), *settings["size"]
        seconds = sum(render["elapsed_s"] for render in renders)
        lines = [
            ("kind", "merged renders" if "merged" in values else "render"),
            ("scene", settings["scene"]),
            ("scene_hash", settings["scene_hash"]),
            ("size", f"{width}x{height}"),
            ("samples", f"{samples:,}, {format_number(samples / (width * height), 4)} per pixel"),
            ("time", format_duration(seconds)),
            *(
                (name, _joined(render[name] for render in renders))
                for name in ("strategy", "sampler", "seed", "device")
            ),
            ("version", settings["version"]),
        ]
        if values.get("loop", {}).get("rows"):
            lines.append(("waves", str(len(values["loop"]["rows"]))))
        lines += [(name, _array_text(*form)) for name, form in description["arrays"].items()]
        return lines
    except (KeyError, TypeError, ValueError, AttributeError, ArithmeticError) as error:
        raise UserError(f"cannot read '{os.fspath(path)}': the checkpoint is damaged ({error!r})") from error


def _render(settings: Mapping[str, object], values: Mapping[str, dict]) -> dict[str, object]:
    return {**settings, "samples": values["renderer"]["samples"], "elapsed_s": values.get("loop", {})["elapsed_s"]}


def _joined(texts) -> str:
    return ", ".join(dict.fromkeys(map(str, texts)))


def _array_text(dtype: str, shape: list[int], _crc: int) -> str:
    size = math.prod(shape) * np.dtype(dtype).itemsize
    return f"{np.dtype(dtype).name} {'x'.join(map(str, shape))}, {size / 2**20:.1f} MiB"
