"""The files of a measurement. Paths are checked first; files are written at the end, complete or not at all.

Called by `isonoise bench`.
"""

import json
from collections.abc import Mapping
from pathlib import Path

from isonoise.benchmark.launch_trace import trace_json
from isonoise.benchmark.prepared_scene import PreparedScene, Run
from isonoise.benchmark.program_dump import DumpedProgram, check_folder, dump_programs, write_dump
from isonoise.benchmark.pytest_benchmark import pytest_benchmark_json
from isonoise.command_output import STANDARD_OUTPUT, print_json
from isonoise.device.opencl import Launch
from isonoise.film.files import check_writable, write_atomically


def write_json(path: str | None, content: Mapping, indent: int | None = 1) -> None:
    """Write an object to a file, or print it if the path is `-`; nothing without a path."""
    if path == STANDARD_OUTPUT:
        print_json(content)
    elif path:
        text = json.dumps(content, indent=indent, allow_nan=False) + "\n"
        write_atomically(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))


class Outputs:
    """Where to write what; None stands for a file that is not wanted. Raises UserError if a path cannot be written."""

    def __init__(self, report: str | None, trace: str | None, dump: str | None, pytest_benchmark: str | None):
        for path in (report, trace, pytest_benchmark):
            if path and path != STANDARD_OUTPUT:
                check_writable(path)
        self._report, self._trace, self._pytest_benchmark = report, trace, pytest_benchmark
        self._dump: Path | None = check_folder(dump) if dump else None
        self._launches: dict[str, list[Launch]] = {}
        self._programs: dict[str, list[DumpedProgram]] = {}

    def add_scene(self, name: str, prepared: PreparedScene, run: Run) -> None:
        """Collect what the files need from a scene on its device and a profiled run."""
        self._launches[name] = run.launches
        if self._dump:
            self._programs[name] = dump_programs(prepared.device)

    def write(self, result: Mapping) -> None:
        """Write all files; `result` is the report."""
        header = {key: value for key, value in result.items() if key != "scenes"}
        write_json(self._report, result)
        write_json(self._trace, trace_json(header, self._launches), indent=None)
        if self._pytest_benchmark:
            write_json(self._pytest_benchmark, pytest_benchmark_json(result))
        if self._dump:
            write_dump(self._dump, header, self._programs)
