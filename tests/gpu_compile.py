"""Compiles kernels for GPUs without a GPU: with clang and libclc, for NVIDIA's PTX and AMD's instruction sets.

test_gpu_compile.py reads what each kernel uses; `python tests/gpu_compile.py SCENE...` prints it. tests/README.md says
how to get the compilers.
"""

import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

from isonoise.device.drivers import GPU_OPTIONS, ROUNDING_OPTION
from isonoise.device.form import FORMS
from isonoise.device.program import stage_source
from isonoise.integrator.build_constants import build_constants
from isonoise.integrator.features import features
from isonoise.integrator.generated_headers import generated_headers
from isonoise.integrator.kernel_table import STRUCTS, kernel_table, programs
from isonoise.scene import builtin_scenes, compile_scene, load_description
from isonoise.statistics import Needs
from isonoise.strategies.registry import make_strategy

PTXAS_VARIABLE = "PTXAS"
CLANGS = ("clang-19", "clang-20", "clang-21", "clang-18", "clang-17", "clang-16", "clang")
"""In the order of preference: the limits of test_gpu_compile.py were measured with 19, and sm_90 needs 16."""
LIBRARY_FOLDERS = ("/usr/lib/clc", "/usr/local/lib/clc", "/usr/share/clc", "/usr/lib64/clc")


class Target(NamedTuple):
    """A kind of GPU as clang and libclc name it."""

    triple: str
    options: tuple[str, ...]
    library: str  # file of libclc


TARGETS = {
    "sm_90": Target("nvptx64-unknown-nvidiacl", ("-march=sm_90",), "nvptx64--nvidiacl.bc"),
    "gfx90a": Target("amdgcn-unknown-amdhsa", ("-mcpu=gfx90a", "-nogpulib"), "amdgcn--amdhsa.bc"),
    "gfx1030": Target("amdgcn-unknown-amdhsa", ("-mcpu=gfx1030", "-nogpulib"), "amdgcn--amdhsa.bc"),
}
"""sm_90: Hopper. gfx90a: CDNA 2, 64 work-items a wave. gfx1030: RDNA 2, 32 work-items a wave."""


class Usage(NamedTuple):
    """What a work-item of a kernel uses, and a work-group."""

    registers: int  # of AMD the vector registers
    stack_bytes: int  # private memory, spilled registers included
    spills: int  # NVIDIA: bytes that are stored and loaded; AMD: registers
    local_bytes: int  # of a work-group


class MissingCompilerError(Exception):
    """A compiler is not installed; the message says which, and how to get it."""


def find_clang() -> str:
    """Path of clang. Raises MissingCompilerError."""
    for name in CLANGS:
        if path := shutil.which(name):
            return path
    raise MissingCompilerError("clang is not installed (Debian, Ubuntu: apt install clang-19 libclc-19)")


def find_library(name: str) -> Path:
    """Path of a file of libclc. Raises MissingCompilerError."""
    for folder in LIBRARY_FOLDERS:
        if (path := Path(folder, name)).is_file():
            return path
    raise MissingCompilerError(f"libclc has no {name} (Debian, Ubuntu: apt install libclc-19)")


def find_ptxas() -> str:
    """Path of NVIDIA's assembler. Raises MissingCompilerError."""
    spec = find_spec("nvidia")
    folders = spec.submodule_search_locations if spec else ()
    wheels = [str(path) for folder in folders for path in Path(folder).glob("*/bin/ptxas")]
    for candidate in (os.environ.get(PTXAS_VARIABLE), "ptxas", *wheels):
        if candidate and (path := shutil.which(candidate)):
            return path
    raise MissingCompilerError(
        f"ptxas is not installed (pip install nvidia-cuda-nvcc-cu12), nor named by the variable {PTXAS_VARIABLE}"
    )


def check_compilers(target: str) -> None:
    """Raise MissingCompilerError if kernels cannot be compiled for the target."""
    find_clang()
    find_library(TARGETS[target].library)
    if is_nvidia(target):
        find_ptxas()


def is_nvidia(target: str) -> bool:
    return target.startswith("sm_")


def compile_program(target: str, text: str, options: Iterable[str]) -> dict[str, Usage]:
    """Compile a program with warnings as errors; what each of its kernels uses."""
    with tempfile.TemporaryDirectory() as folder:
        source, assembly = Path(folder, "program.cl"), Path(folder, "program.s")
        source.write_text(text, encoding="utf-8")
        triple, target_options, library = TARGETS[target]
        command = [find_clang(), "-x", "cl", "-target", triple, *target_options, "-O3", "-Werror", *options]
        command += [*GPU_OPTIONS, ROUNDING_OPTION]
        for argument in ("-mlink-builtin-bitcode", str(find_library(library))):
            command += ["-Xclang", argument]
        _run([*command, "-S", "-o", str(assembly), str(source)])
        if not is_nvidia(target):
            return parse_amdgpu(assembly.read_text(encoding="utf-8"))
        return parse_ptxas(_run([find_ptxas(), f"-arch={target}", "-v", str(assembly), "-o", os.devnull]))


def _run(command: list[str]) -> str:
    """What the command writes to standard error; a failure is raised with it."""
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"{' '.join(command)}\n{done.stderr[:4000]}")
    return done.stderr


def parse_ptxas(log: str) -> dict[str, Usage]:
    """What each kernel uses, from the output of `ptxas -v`."""
    usages = {}
    for kernel, report in re.findall(r"entry function '(\w+)' for .*\n((?:.*\n?)*?)(?=.*entry function|\Z)", log):
        stack, stores, loads = map(
            int,
            re.search(r"(\d+) bytes stack frame, (\d+) bytes spill stores, (\d+) bytes spill loads", report).groups(),
        )
        registers = int(re.search(r"Used (\d+) registers", report)[1])
        local = re.search(r"(\d+) bytes smem", report)
        usages[kernel] = Usage(registers, stack, stores + loads, int(local[1]) if local else 0)
    return usages


def parse_amdgpu(assembly: str) -> dict[str, Usage]:
    """What each kernel uses, from the metadata at the end of the assembly."""
    usages = {}
    for kernel in assembly[assembly.index("amdhsa.kernels:") :].split("\n  - .")[1:]:
        number = {key: int(value) for key, value in re.findall(r"\.(\w+):\s+(\d+)", kernel)}
        name = re.search(r"^    \.name:\s+(\w+)", kernel, re.MULTILINE)
        usages[name[1]] = Usage(
            number["vgpr_count"],
            number["private_segment_fixed_size"],
            number["vgpr_spill_count"],
            number["group_segment_fixed_size"],
        )
    return usages


def compile_features(target: str, on: Mapping[str, bool], needs: Needs, bvh_stack: int = 60) -> dict[str, Usage]:
    """Compile all kernels of a set of features in the form `gpu`; what each uses.

    `bvh_stack` is the number of stack entries that a traversal may need, some 50 for 82,000 triangles.
    """
    constants, usages = build_constants(needs, FORMS["gpu"], bvh_stack), {}
    for files in programs(row.file for row in kernel_table(on, brute_force=False).values()):
        usages |= compile_program(target, *stage_source(files, STRUCTS, constants, on, generated_headers()))
    return usages


def scene_features(scene: str) -> tuple[Mapping[str, bool], Needs]:
    """Features of a scene and needs of the default strategy."""
    compiled = compile_scene(load_description(scene))
    needs = make_strategy("pooled").needs.with_sampler(compiled.sampler)
    return features(compiled, needs), needs


def main(scenes: list[str]) -> None:
    """Print what the kernels of the scenes use, on every target whose compilers are there."""
    for target in TARGETS:
        try:
            check_compilers(target)
        except MissingCompilerError as missing:
            print(f"{target}: {missing}")
            continue
        for scene in scenes or builtin_scenes():
            print(f"{target}, {scene}\n{'':24}{'registers':>10}{'stack':>10}{'spills':>10}{'local':>10}")
            for kernel, usage in compile_features(target, *scene_features(scene)).items():
                print(f"{kernel:24}" + "".join(f"{number:>10}" for number in usage))


if __name__ == "__main__":
    main(sys.argv[1:])
