"""Small renders under Oclgrind, which interprets kernels and reports races and invalid memory accesses.

`python tests/checked_render.py CASE [FAULT]` starts itself under it; test_oclgrind.py runs all `CASES`. tests/README.md
explains the options.
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
from kernel_faults import source_with_fault
from small_scene import lamp_over_floor

import isonoise.integrator.set_up
import isonoise.renderer
from isonoise.device import program
from isonoise.device.form import FORMS, DeviceForm
from isonoise.device.opencl import Device
from isonoise.device.program_cache import FOLDER_VARIABLE
from isonoise.renderer import Renderer

COMMAND = ["oclgrind", "--data-races", "--uniform-writes", "--uninitialized", "--check-api", "--max-errors", "100000"]
BUILD_OPTIONS = "-cl-opt-disable -DINLINE=static -DHAS_BUILTIN(name)=0"
WIDTH, HEIGHT = 9, 7


@dataclass(frozen=True)
class Case:
    """One render. A scene number is a file of `scene_generator`, text a built-in scene."""

    scene: int | str | dict
    strategy: str = "uniform"
    many: bool = False  # many paths per work-item, as on PoCL; else one, as on a GPU
    pool: int = 150
    spp: int = 2
    layers: tuple[str, ...] = ()

    def source(self, folder: Path):
        return str(scene_generator.write_scene(folder, self.scene)) if isinstance(self.scene, int) else self.scene


def filtered_lamp() -> dict:
    """The tiny scene of other tests, with a pixel filter that needs a table."""
    scene = lamp_over_floor()
    scene["sensor"]["film"]["rfilter"] = {"type": "gaussian"}
    return scene


def lamp_over_smoke() -> dict:
    """The tiny scene of other tests, with smoke on the floor."""
    values = np.linspace(0, 3, 4 * 3 * 5, dtype=np.float32).reshape(4, 3, 5)
    volume = {"type": "gridvolume", "data": values, "to_world": np.diag([0.8, 0.8, 0.7, 1.0])}
    albedo = {"type": "gridvolume", "data": np.full((2, 2, 2, 3), 0.7), "wrap_mode": "mirror", "filter_type": "nearest"}
    medium = {"type": "heterogeneous", "sigma_t": volume, "albedo": albedo}
    scene = lamp_over_floor()
    scene["integrator"]["type"] = "volpath"
    return scene | {"smoke": {"type": "sphere", "radius": 0.9, "bsdf": {"type": "null"}, "interior": medium}}


def projections_over_floor() -> dict:
    """The tiny scene of other tests, lit by projected images too."""
    texture = {"type": "checkerboard"}
    down = np.diag([1.0, -1.0, -1.0, 1.0])
    down[2, 3] = 2.0
    projector = {"type": "projector", "irradiance": texture, "to_world": down, "fov": 30.0}
    return lamp_over_floor() | {"projector": projector, "spot": {"type": "spot", "texture": texture, "to_world": down}}


LAYERS = ("albedo", "normal", "geometric_normal", "depth", "position", "uv", "coverage", "shape_index")

# Together they cover every feature, in the kernels with one path per work-item and, where they exist, with many.
# The large pool is for work-items that trace several rays, and for more than one block of paths.
CASES = {
    **{f"file {seed}": Case(seed) for seed in (23, 50, 54, 74, 97, 103, 104, 117)},
    **{f"file {seed}, many": Case(seed, many=True) for seed in (24, 34, 39, 50, 72, 97, 126, 127)},
    "large pool, many": Case(50, many=True, pool=600, spp=10),
    "file 31": Case(31, "pooled"),
    "cornell": Case("cornell", "relative-median", spp=1),
    "cornell, many": Case("cornell", "pooled", many=True, spp=1),
    "penumbra": Case("penumbra", "tsallis:q=3"),
    "bright-spots": Case("bright-spots", "dammertz"),
    "bright-spots, many": Case("bright-spots", many=True),
    "smoke": Case(lamp_over_smoke(), spp=4),
    "projections": Case(projections_over_floor()),
    "projections, many": Case(projections_over_floor(), many=True),
    "lamp": Case(filtered_lamp(), "relative-median:batch=1", pool=600, spp=10),
    "lamp, many": Case(filtered_lamp(), "relative-median", many=True, pool=600, spp=10),
    "layers": Case(31, layers=LAYERS),
    "layers, many": Case(24, many=True, layers=LAYERS),
}

# Deliberate faults: kernel file, text, its replacement, and a part of Oclgrind's report.
FAULTS = {
    "uninitialised": ("stages/intersect.cl", "closest.u = closest.v = 0.0f;", "", "Uninitialized value"),
    "not written": (
        "stages/generate.cl",
        "PLANE(PATH_DEPTH, path_ids, plane_stride)[slot] = 0u;",
        "",
        "Uninitialized value",
    ),
    "race": (
        "stages/compact.cl",
        "path_block_alive[get_group_id(0)] = sum;",
        "path_block_alive[0] = sum;",
        "Write-write data race",
    ),
    "outside": (
        "stages/generate.cl",
        "STORE3(splat3(0.0f), sample,",
        "STORE3(splat3(0.0f), sample + 40000u,",
        "Invalid write",
    ),
}

_POISON = "__kernel void poison(__global uint16* buffer) { uint16 nothing; buffer[get_global_id(0)] = nothing; }"
# Labels of the buffers that a kernel has to write before another one reads them.
WRITTEN_BY_KERNELS = (
    "the flags of the paths",
    "the hits",
    "the paths",
    "the sample buffer",
    "the sample list",
    "the shadow rays",
    "the slots of dead paths",
)


class CheckedDevice(Device):
    """A device on which Oclgrind knows which memory is initialised.

    When the host writes a part of a buffer, Oclgrind 21.10 forgets the rest: its table is then as long as that part. So
    buffers are written as a whole. Buffers that a kernel has to write before another one reads them are filled with
    uninitialised values by a kernel.
    """

    many = False

    @property
    def form(self) -> DeviceForm:
        return FORMS["lanes" if self.many else "gpu"]

    @property
    def shares_memory(self) -> bool:
        return False  # Oclgrind treats the host's memory as uninitialised

    def buffer(self, content: int | np.ndarray, label: str):
        if isinstance(content, np.ndarray):
            return super().buffer(content, label)
        rows = -(-content // 64)
        buffer = super().buffer(np.zeros(16 * rows, np.uint32), label)
        if label in WRITTEN_BY_KERNELS:
            self.build(_POISON, ())["poison"](self.queue, (rows,), (1,), buffer)
        return buffer

    def write(self, buffer, array: np.ndarray, offset: int = 0) -> None:
        content = self.read(buffer, np.uint8, buffer.size)
        part = np.ascontiguousarray(array).view(np.uint8).ravel()
        content[offset : offset + len(part)] = part
        super().write(buffer, content)


def render(case: Case) -> Renderer:
    """Render two waves with a pool smaller than a wave, so that paths of different depths share launches."""
    CheckedDevice.many = case.many
    isonoise.renderer.Device = CheckedDevice
    isonoise.integrator.set_up.check_driver = lambda *_: None  # its paths would take minutes here
    with tempfile.TemporaryDirectory() as folder:
        source = case.source(Path(folder))
        size = WIDTH, HEIGHT
        renderer = Renderer(source, strategy=case.strategy, size=size, pool_size=case.pool, layers=case.layers)
    for _ in range(2):
        renderer.step(case.spp * WIDTH * HEIGHT)
    renderer.error_distribution(0.01)
    return renderer


def inject_fault(fault: str) -> None:
    """Build all further kernels with one of `FAULTS`."""
    program.kernel_source = source_with_fault(*FAULTS[fault][:3])


def fault_reports(log: str) -> list[str]:
    """Oclgrind's reports, without the expected ones.

    Expected are the uninitialised values of `poison`, and device properties that pyopencl queries but OpenCL 1.2 lacks.
    """
    reports = [report.strip() for report in re.split(r"\n\s*\n", log) if report.strip()]
    expected = re.compile(r"Kernel: poison\b|Function: clGetDeviceInfo\b")
    return [report for report in reports if not expected.search(report)]


def oclgrind_command(*arguments: str) -> list[str]:
    """The command line that runs this file under Oclgrind."""
    return [*COMMAND, "--build-options", BUILD_OPTIONS, sys.executable, __file__, *arguments]


def main(arguments: list[str]) -> None:
    """Render the case, with a fault if one is named."""
    if COMMAND[0] not in os.environ.get("LD_PRELOAD", ""):
        if not shutil.which(COMMAND[0]):
            sys.exit("oclgrind is not installed: apt install oclgrind")
        command = oclgrind_command(*arguments)
        os.execvpe(command[0], command, os.environ | {FOLDER_VARIABLE: "off"})
    case, *faults = arguments
    for fault in faults:
        inject_fault(fault)
    renderer = render(CASES[case])
    assert "oclgrind" in renderer.device_name.lower()
    print(f"rendered {case}: mean {renderer.image().mean():.6g}")


if __name__ == "__main__":
    main(sys.argv[1:])
