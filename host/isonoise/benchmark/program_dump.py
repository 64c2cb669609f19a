"""Writes the programs of measured scenes to a folder: source, build log and binary (`bench --dump`)."""

import json
import os
import re
import secrets
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from isonoise.benchmark.prepared_scene import MeasuredDevice
from isonoise.device.drivers import load_pyopencl
from isonoise.errors import UserError

SCHEMA, SCHEMA_VERSION = "isonoise-programs", 1
_FIRST_STAGE = re.compile(r'^#line 1 "stages/(\w+)\.cl"', re.MULTILINE)


@dataclass(frozen=True)
class DumpedProgram:
    """What the driver says about a program; `binary` is empty if it gives none."""

    name: str
    kernels: list[str]
    source: str
    options: tuple[str, ...]
    log: str
    binary: bytes


def dump_programs(device: MeasuredDevice) -> list[DumpedProgram]:
    """The programs that the device has built. PoCL compiles every kernel once more if asked for a binary."""
    return [_dump(device, *program) for program in device.programs]


def _dump(device: MeasuredDevice, source: str, options: tuple[str, ...], kernels: Mapping) -> DumpedProgram:
    cl = load_pyopencl()
    program = next(iter(kernels.values())).program
    stage = _FIRST_STAGE.search(source)
    try:
        binary = program.get_info(cl.program_info.BINARIES)[0]
    except cl.Error:
        binary = b""
    log = program.get_build_info(device.device, cl.program_build_info.LOG)
    return DumpedProgram(stage[1] if stage else "program", sorted(kernels), source, options, log, binary)


def check_folder(folder: str) -> Path:
    """The folder to write to. Raises UserError if it cannot be created or exists already."""
    path = Path(folder)
    if not path.absolute().parent.is_dir():
        raise UserError(f"cannot write '{folder}': there is no folder '{path.absolute().parent}'; create it first")
    if path.exists() or path.is_symlink():
        raise UserError(f"cannot write '{folder}': it exists already; give the name of a new folder")
    return path


def write_dump(folder: Path, header: Mapping, scenes: Mapping[str, list[DumpedProgram]]) -> None:
    """Write `SCENE/PROGRAM.cl`, `.log` and `.bin` for every program, and `index.json`: all of it or nothing.

    Raises
    ------
    UserError
        If the folder cannot be written.
    """
    target = folder.absolute()
    temporary = target.with_name(f".{secrets.token_hex(6)}.tmp")
    try:
        temporary.mkdir()
        rows, used = [], set()
        for scene, programs in scenes.items():
            scene_folder = _unique(re.sub(r"[^\w.-]+", "_", Path(scene).name).strip("._") or "scene", used)
            (temporary / scene_folder).mkdir()
            names: set[str] = set()
            for program in programs:
                rows.append({"scene": scene} | _write_program(temporary, scene_folder, program, names))
        index = {**header, "schema": SCHEMA, "schema_version": SCHEMA_VERSION, "programs": rows}
        text = json.dumps(index, indent=1, allow_nan=False) + "\n"
        (temporary / "index.json").write_text(text, encoding="utf-8")
        os.replace(temporary, target)
    except OSError as error:
        raise UserError(f"cannot write '{folder}': {error.strerror or error}") from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _write_program(root: Path, scene_folder: str, program: DumpedProgram, used: set[str]) -> dict[str, object]:
    """Write a program's files; returns its entry of the index."""
    name = f"{scene_folder}/{_unique(program.name, used)}"
    (root / f"{name}.cl").write_text(program.source, encoding="utf-8")
    (root / f"{name}.log").write_text(program.log, encoding="utf-8", errors="replace")
    if program.binary:
        (root / f"{name}.bin").write_bytes(program.binary)
    return {
        "kernels": program.kernels,
        "options": list(program.options),
        "source_file": f"{name}.cl",
        "log_file": f"{name}.log",
        "binary_file": f"{name}.bin" if program.binary else None,
    }


def _unique(name: str, used: set[str]) -> str:
    """`name`, with a number behind it if it is in `used`; adds it there."""
    candidates = (name if number == 1 else f"{name}-{number}" for number in range(1, len(used) + 2))
    chosen = next(candidate for candidate in candidates if candidate.lower() not in used)
    used.add(chosen.lower())
    return chosen
