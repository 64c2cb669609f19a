"""The form for GPUs without a GPU: compilers for NVIDIA and AMD accept every kernel, and no kernel uses too much."""

import pytest
from feature_sets import PARTS, needs_of, part_of_rows
from gpu_compile import (
    TARGETS,
    MissingCompilerError,
    Usage,
    check_compilers,
    compile_features,
    is_nvidia,
    parse_amdgpu,
    parse_ptxas,
    scene_features,
)

from isonoise.integrator.kernel_table import kernel_table
from isonoise.scene import builtin_scenes

MAX_REGISTERS = {"sm_90": 128, "gfx90a": 256, "gfx1030": 256}
"""Of a kernel of a built-in scene. With 128 a multiprocessor of sm_90 runs 512 work-items at a time, a quarter of the
most it can. On AMD's GPUs traversal takes up to 211: their compiler spends free registers on early loads, and changes
of the source move the number by 20. With 256 two waves (gfx90a) or four (gfx1030) share a SIMD unit."""
_LARGE_KERNELS = ("shade", "shadow_transmittance", "reduce", "accumulate_layers", "intersect", "shadow")
MAX_REGISTERS_OF_ALL_FEATURES = {
    "sm_90": dict(zip(_LARGE_KERNELS, (248, 216, 164, 255, 136, 132), strict=True)),
    "gfx90a": dict.fromkeys(_LARGE_KERNELS, 320),
    "gfx1030": dict.fromkeys(_LARGE_KERNELS, 256),
}
"""Of kernels of the covering array that may use more than 128. `shade` and `shadow_transmittance` then have every kind
of material and medium, `reduce` every statistic, `accumulate_layers` the albedo of every kind of material; it runs once
for each path. For sm_90 those of all features at once, and a few for other versions of the compilers."""
MAX_SPILLS_OF_ALL_FEATURES = {"sm_90": 0, "gfx90a": 16, "gfx1030": 32}
MAX_STACK_BYTES = 800
"""Private memory of a kernel of a built-in scene: a traversal stack of 66 entries takes 528, the arrays of
`average_neighbours` 748."""
EVERY_TARGET = [pytest.param(name, marks=[] if is_nvidia(name) else pytest.mark.long) for name in TARGETS]


def compiled(target: str, on, needs) -> dict[str, Usage]:
    """What the kernels of these features use; each has compiled without a warning."""
    try:
        check_compilers(target)
    except MissingCompilerError as missing:
        pytest.skip(str(missing))
    usages = compile_features(target, on, needs)
    assert set(usages) >= set(kernel_table(on, brute_force=False))
    return usages


@pytest.mark.parametrize("scene", builtin_scenes())
@pytest.mark.parametrize("target", EVERY_TARGET)
def test_kernels_of_built_in_scenes_fit_the_registers(target, scene):
    usages = compiled(target, *scene_features(scene))
    assert {kernel: usage for kernel, usage in usages.items() if usage.spills} == {}
    assert {kernel: usage for kernel, usage in usages.items() if usage.registers > MAX_REGISTERS[target]} == {}
    assert {kernel: usage for kernel, usage in usages.items() if usage.stack_bytes > MAX_STACK_BYTES} == {}


@pytest.mark.long
@pytest.mark.parametrize("number", range(PARTS))
@pytest.mark.parametrize("target", TARGETS)
def test_every_pair_of_features_compiles(target, number):
    limits, max_spills = MAX_REGISTERS_OF_ALL_FEATURES[target], MAX_SPILLS_OF_ALL_FEATURES[target]
    for on in part_of_rows(number):
        usages = compiled(target, on, needs_of(on))
        assert {kernel: usage for kernel, usage in usages.items() if usage.spills > max_spills} == {}
        assert {kernel: usage for kernel, usage in usages.items() if usage.registers > limits.get(kernel, 128)} == {}


def test_the_log_of_ptxas_is_read():
    log = """ptxas info    : 0 bytes gmem
ptxas info    : Compiling entry function 'intersect' for 'sm_90'
ptxas info    : Function properties for intersect
    2192 bytes stack frame, 4 bytes spill stores, 8 bytes spill loads
ptxas info    : Used 132 registers, used 0 barriers, 2192 bytes cumulative stack size
ptxas info    : Compile time = 272.206 ms
ptxas info    : Compiling entry function 'count_alive' for 'sm_90'
ptxas info    : Function properties for count_alive
    0 bytes stack frame, 0 bytes spill stores, 0 bytes spill loads
ptxas info    : Used 12 registers, used 1 barriers, 1024 bytes smem
ptxas info    : Compile time = 2.206 ms
ptxas info    : Function properties for a_function
    0 bytes stack frame, 0 bytes spill stores, 0 bytes spill loads
"""
    assert parse_ptxas(log) == {"intersect": Usage(132, 2192, 12, 0), "count_alive": Usage(12, 0, 0, 1024)}


def test_the_metadata_of_amd_is_read():
    assembly = """
amdhsa.kernels:
  - .agpr_count:     0
    .args:
      - .address_space:  global
        .name:           hit
    .group_segment_fixed_size: 1024
    .language_version:
      - 1
      - 2
    .name:           count_alive
    .private_segment_fixed_size: 16
    .sgpr_count:     13
    .sgpr_spill_count: 2
    .symbol:         count_alive.kd
    .vgpr_count:     5
    .vgpr_spill_count: 1
amdhsa.target:   amdgcn-unknown-amdhsa--gfx90a
amdhsa.version:
  - 1
  - 2
"""
    assert parse_amdgpu(assembly) == {"count_alive": Usage(5, 16, 1, 1024)}
