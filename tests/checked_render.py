"""Small renders under Oclgrind, which interprets kernels and reports races and memory wrongly read or written.

`python tests/checked_render.py CASE` runs itself under it; tests/README.md says what the options are for, and
`test_oclgrind.py` asks for all of `CASES`.
"""

import os
import re
import shutil
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scene_generator
from small_scene import lamp_over_floor

import isonoise.renderer
from isonoise.device import program
from isonoise.device.opencl import Device
from isonoise.device.program_cache import FOLDER_VARIABLE
from isonoise.renderer import Renderer

COMMAND = ["oclgrind", "--data-races", "--uniform-writes", "--uninitialized", "--check-api", "--max-errors", "100000"]
BUILD_OPTIONS = "-cl-opt-disable -DINLINE=static -DHAS_BUILTIN(name)=0"
WIDTH, HEIGHT = 9, 7


@dataclass(frozen=True)
class Case:
    """What is rendered. A number is a file of `scene_generator`, text a built-in scene."""

    scene: int | str | dict
    strategy: str = "uniform"
    many: bool = False  # many paths a work-item, as on PoCL; else one, as on a GPU
    pool: int = 150
    spp: int = 2

    def source(self, folder: Path):
        return str(scene_generator.write_scene(folder, self.scene)) if isinstance(self.scene, int) else self.scene


def filtered_lamp() -> dict:
    """The tiny scene of other tests, with a pixel filter that needs a table."""
    scene = lamp_over_floor()
    scene["sensor"]["film"]["rfilter"] = {"type": "gaussian"}
    return scene


# Together they have every feature, in the kernels with one path a work-item and, where there are such, in those with
# many. The large pool is for work-items that follow several rays, and for more than one block of paths.
CASES = {
    **{f"file {seed}": Case(seed) for seed in (1, 31, 50, 51, 90, 98)},
    **{f"file {seed}, many": Case(seed, many=True) for seed in (1, 20, 51, 75)},
    "file 50, many": Case(50, many=True, pool=600, spp=10),
    "cornell": Case("cornell", "relative-median", spp=1),
    "cornell, many": Case("cornell", "pooled", many=True, spp=1),
    "penumbra": Case("penumbra", "tsallis:q=3"),
    "bright-spots": Case("bright-spots", "dammertz"),
    "bright-spots, many": Case("bright-spots", many=True),
    "lamp": Case(filtered_lamp(), "relative-median:batch=1", spp=4),
    "lamp, many": Case(filtered_lamp(), "relative-median", many=True, pool=600, spp=10),
}

# What the checks have to find: what a file's text is spoiled by, and what Oclgrind then says.
FAULTS = {
    "uninitialised": ("stages/intersect.cl", "hit_u = 0.0f, hit_v = 0.0f;", "hit_u, hit_v;", "Uninitialized value"),
    "not written": (
        "stages/generate.cl",
        "PLANE(PATH_DEPTH, path, plane_stride)[slot] = 0u;",
        "",
        "Uninitialized value",
    ),
    "race": ("stages/compact.cl", "block_alive[block] = sum;", "block_alive[0] = sum;", "Write-write data race"),
    "outside": (
        "stages/generate.cl",
        "STORE3(splat3(0.0f), sample,",
        "STORE3(splat3(0.0f), sample + 4000u,",
        "Invalid write",
    ),
}

_POISON = "__kernel void poison(__global uint16* buffer) { uint16 nothing; buffer[get_global_id(0)] = nothing; }"
_NOT_YET_WRITTEN = (
    "the flags of the paths",
    "the hits",
    "the paths",
    "the sample buffer",
    "the sample list",
    "the shadow rays",
)


class CheckedDevice(Device):
    """A device of which Oclgrind knows what is initialised.

    What the host writes to a part of a buffer makes Oclgrind 21.10 forget the rest: its table is then as long as that
    part. So buffers are written as a whole; and those that no kernel may read before another one has written them are
    filled, by a kernel, with what is not initialised.
    """

    many = False

    @property
    def lanes(self) -> int:
        return 64 if self.many else 1

    @property
    def is_cpu(self) -> bool:
        return self.many

    @property
    def shares_memory(self) -> bool:
        return False  # Oclgrind takes what stands in the host's memory for not initialised

    def buffer(self, size: int | np.ndarray, what: str):
        if isinstance(size, np.ndarray):
            return super().buffer(size, what)
        rows = -(-size // 64)
        buffer = super().buffer(np.zeros(16 * rows, np.uint32), what)
        if what in _NOT_YET_WRITTEN:
            self.build(_POISON, ())["poison"](self.queue, (rows,), (1,), buffer)
        return buffer

    def write(self, buffer, array: np.ndarray, offset: int = 0) -> None:
        whole = self.read(buffer, np.uint8, buffer.size)
        part = np.ascontiguousarray(array).view(np.uint8).ravel()
        whole[offset : offset + len(part)] = part
        super().write(buffer, whole)


def render(case: Case) -> Renderer:
    """Two waves, with a pool smaller than a wave, so that paths of different depths share launches."""
    CheckedDevice.many = case.many
    isonoise.renderer.Device = CheckedDevice
    with tempfile.TemporaryDirectory() as folder:
        source = case.source(Path(folder))
        renderer = Renderer(source, strategy=case.strategy, size=(WIDTH, HEIGHT), pool_size=case.pool)
    for _ in range(2):
        renderer.step(case.spp * WIDTH * HEIGHT)
    return renderer


def spoil(fault: str) -> None:
    """From now on kernels are built with this one of `FAULTS`."""
    spoiled, before, after, _ = FAULTS[fault]
    original = program.kernel_source

    def read(name: str) -> str:
        text = original(name)
        assert name != spoiled or before in text
        return text.replace(before, after) if name == spoiled else text

    program.kernel_source = read


def findings(log: str) -> list[str]:
    """What Oclgrind has found, without what it is told to find and what is not the kernels' or the host's.

    pyopencl asks devices for properties that OpenCL 1.2 does not have.
    """
    reports = [report.strip() for report in re.split(r"\n\s*\n", log) if report.strip()]
    expected = re.compile(r"Kernel: poison\b|Function: clGetDeviceInfo\b")
    return [report for report in reports if not expected.search(report)]


def under_oclgrind(*arguments: str) -> list[str]:
    """The command that runs this file under Oclgrind."""
    return [*COMMAND, "--build-options", BUILD_OPTIONS, sys.executable, __file__, *arguments]


def main(arguments: list[str]) -> None:
    """Renders the case, after spoiling the kernels if a fault is named as well."""
    if COMMAND[0] not in os.environ.get("LD_PRELOAD", ""):
        if not shutil.which(COMMAND[0]):
            sys.exit("there is no oclgrind: apt install oclgrind")
        command = under_oclgrind(*arguments)
        os.execvpe(command[0], command, os.environ | {FOLDER_VARIABLE: "off"})
    case, *faults = arguments
    for fault in faults:
        spoil(fault)
    done = render(CASES[case])
    assert "oclgrind" in done.device_name.lower()
    print(f"rendered {case}: mean {done.image().mean():.6g}")


if __name__ == "__main__":
    main(sys.argv[1:])
