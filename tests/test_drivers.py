"""OpenCL drivers: order of preference, what their version strings say, and advice about them."""

import ctypes.util
import json
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pyopencl
import pytest

from isonoise.cli import main
from isonoise.device import driver_advice, drivers, opencl
from isonoise.device.drivers import (
    GPU_OPTIONS,
    ROUNDING_OPTION,
    Rank,
    build_options,
    compiler_target,
    describe_driver,
    list_devices,
    pocl_version,
    preference,
    rank_of,
)
from isonoise.device.program import flatten
from isonoise.device.selection import select_device

WHEEL_FOLDER = Path(pyopencl.__file__).parent.parent / "pocl_binary_distribution"
CPU, GPU = pyopencl.device_type.CPU, pyopencl.device_type.GPU
POCL_TARGET = "OpenCL 3.0 PoCL HSTR: pthread-x86_64-unknown-linux-gnu-"


def fake_device(platform, driver_version, kind=CPU, vendor="AuthenticAMD", platform_vendor="", target="znver3"):
    """A device as far as the order and the advice look at it."""
    version = POCL_TARGET + target if platform == POCL else "OpenCL 3.0"
    driver = SimpleNamespace(name=platform, vendor=platform_vendor, version="OpenCL 3.0")
    return SimpleNamespace(
        platform=driver, driver_version=driver_version, type=kind, vendor=vendor, version=version, name="a device"
    )


POCL = "Portable Computing Language"
WHEEL = fake_device(POCL, "3.0-rc2")
DEBIAN = fake_device(POCL, "3.1+debian")
NEWEST = fake_device(POCL, "7.1")
INTEL = fake_device("Intel(R) OpenCL", "2026.22.10.0.01_160000")
NVIDIA = fake_device("NVIDIA CUDA", "550.54", GPU, "NVIDIA Corporation")
AMD_GPU = fake_device("AMD Accelerated Parallel Processing", "3590.0", GPU)
RUSTICL = fake_device("rusticl", "22.3.6", CPU, "Mesa/X.org", "Mesa/X.org")
RUSTICL_GPU = fake_device("rusticl", "24.0", GPU, "AMD", "Mesa/X.org")
CLOVER = fake_device("Clover", "22.3.6", GPU, "AMD", "Mesa")


@pytest.mark.parametrize(
    ("found", "expected"),
    [
        ([WHEEL, DEBIAN], [DEBIAN, WHEEL]),
        ([DEBIAN, NEWEST, WHEEL], [NEWEST, DEBIAN, WHEEL]),
        ([fake_device(POCL, "10.0"), NEWEST], ["10.0", "7.1"]),
        ([WHEEL, INTEL], [INTEL, WHEEL]),
        ([INTEL, WHEEL, DEBIAN], [DEBIAN, INTEL, WHEEL]),
        ([RUSTICL, WHEEL, INTEL], [INTEL, WHEEL, RUSTICL]),
        ([RUSTICL_GPU, CLOVER, WHEEL, NVIDIA], [NVIDIA, WHEEL, RUSTICL_GPU, CLOVER]),
        ([NEWEST, NVIDIA, INTEL, AMD_GPU], [NVIDIA, AMD_GPU, NEWEST, INTEL]),
        ([fake_device(POCL, "1.8"), WHEEL, INTEL], ["2026.22.10.0.01_160000", "3.0-rc2", "1.8"]),
        ([fake_device(POCL, "3.1-rc1"), DEBIAN], ["3.1+debian", "3.1-rc1"]),
    ],
)
def test_the_order_of_devices(monkeypatch, found, expected):
    platforms = [SimpleNamespace(get_devices=lambda device=device: [device]) for device in found]
    monkeypatch.setattr(drivers.load_pyopencl(), "get_platforms", lambda: platforms)
    names = [each if isinstance(each, str) else each.driver_version for each in expected]
    assert [device.driver_version for device in list_devices()] == names
    assert select_device().device.driver_version == names[0]
    assert select_device(len(found) - 1).device.driver_version == names[-1]


def test_intels_cpus_prefer_any_pocl():
    wheel, intel = fake_device(POCL, "3.0-rc2", vendor="GenuineIntel"), fake_device("Intel(R) OpenCL", "2026", CPU)
    assert sorted([RUSTICL, intel, wheel, DEBIAN], key=preference) == [DEBIAN, wheel, intel, RUSTICL]


def test_equal_drivers_stay_as_listed():
    """A loader lists a library twice if two files name it."""
    twice = [fake_device(POCL, "3.0-rc2"), fake_device(POCL, "3.0-rc2"), INTEL, fake_device("Other", "1.0")]
    assert [id(each) for each in sorted(twice, key=preference)] == [id(twice[k]) for k in (2, 3, 0, 1)]


def test_pocl_on_a_gpu_is_a_gpu():
    gpu = fake_device(POCL, "7.1", GPU)
    assert rank_of(gpu) == Rank.GPU
    assert sorted([gpu, NVIDIA], key=preference) == [gpu, NVIDIA]
    assert sorted([NVIDIA, gpu], key=preference) == [NVIDIA, gpu]


@pytest.mark.parametrize(
    ("text", "version"),
    [
        ("3.0-rc2", (3, 0, 0)),
        ("3.1+debian", (3, 1, 1)),
        ("1.8-pre", (1, 8, 0)),
        ("7.1", (7, 1, 1)),
        ("6.0-6", (6, 0, 1)),
        ("?", None),
    ],
)
def test_the_version_of_pocl(text, version):
    assert pocl_version(fake_device(POCL, text)) == version
    assert pocl_version(fake_device("Intel(R) OpenCL", text)) is None


@pytest.mark.parametrize(
    ("version", "target"),
    [
        ("OpenCL 3.0 PoCL HSTR: pthread-x86_64-unknown-linux-gnu-rocketlake", "rocketlake"),
        ("OpenCL 3.0 PoCL HSTR: pthread-x86_64-pc-linux-gnu-skylake-avx512", "skylake-avx512"),
        ("OpenCL 3.0 PoCL HSTR: cpu-x86_64-pc-linux-gnu-znver4", "znver4"),
        ("OpenCL 3.0 PoCL HSTR: cpu-aarch64-unknown-linux-gnu-cortex-a76", "cortex-a76"),
        ("OpenCL 3.0 PoCL HSTR: cpu-arm64-apple-darwin23.1.0-apple-m1", "apple-m1"),
        ("OpenCL 3.1 (Build 0)", None),
        ("OpenCL 3.0 CUDA", None),
    ],
)
def test_the_cpu_of_pocls_compiler(version, target):
    assert compiler_target(SimpleNamespace(version=version)) == target


@pytest.mark.parametrize(
    ("flags", "target", "unused"),
    [
        ("fpu avx2 avx512f", "znver3", "AVX-512"),
        ("fpu avx2 avx512f", "znver4", None),
        ("fpu avx2 avx512f", "generic", "AVX-512"),
        ("fpu avx2", "ivybridge", "AVX2"),
        ("fpu avx2", "znver3", None),
        ("fpu avx2 avx512f", "a later CPU", None),
        ("", "znver3", None),
    ],
)
def test_instructions_that_the_compiler_leaves_unused(monkeypatch, tmp_path, flags, target, unused):
    info = tmp_path / "cpuinfo"
    info.write_text(f"processor\t: 0\nflags\t\t: {flags}\n")
    monkeypatch.setattr(driver_advice, "CPU_INFO", info)
    assert driver_advice.unused_instructions(fake_device(POCL, "3.0-rc2", target=target)) == unused
    assert driver_advice.unused_instructions(INTEL) is None
    monkeypatch.setattr(driver_advice, "CPU_INFO", tmp_path / "none")
    assert driver_advice.unused_instructions(fake_device(POCL, "3.0-rc2", target=target)) is None


@pytest.mark.parametrize(
    ("release", "command"),
    [
        ("ID=debian\n", "apt install pocl-opencl-icd"),
        ('NAME="Linux Mint"\nID=linuxmint\nID_LIKE="ubuntu debian"\n', "apt install pocl-opencl-icd"),
        ('ID="rocky"\nID_LIKE="rhel centos fedora"\n', "dnf install pocl"),
        ("ID=arch\n", "pacman -S pocl"),
        ("ID=unknown\n", None),
        (None, None),
    ],
)
def test_advice_names_the_package_of_the_distribution(monkeypatch, tmp_path, release, command):
    path = tmp_path / "os-release"
    if release is not None:
        path.write_text(release)
    monkeypatch.setattr(driver_advice, "OS_RELEASE", path)
    monkeypatch.setattr(driver_advice.platform, "system", lambda: "Linux")
    advice = driver_advice.faster_driver([WHEEL])
    assert advice.startswith("PoCL 3.1 or newer of your distribution")
    assert (f"({command})" in advice) if command else ("distribution," in advice)


def test_no_advice_where_nothing_faster_is_known(monkeypatch):
    on_intel = fake_device(POCL, "3.0-rc2", vendor="GenuineIntel")
    monkeypatch.setattr(driver_advice.platform, "system", lambda: "Linux")
    for devices in ([DEBIAN], [NVIDIA, WHEEL], [on_intel], [DEBIAN, WHEEL]):
        assert driver_advice.faster_driver(devices) is None
    for devices in ([INTEL], [RUSTICL], [INTEL, WHEEL]):
        assert driver_advice.faster_driver(devices)
    monkeypatch.setattr(driver_advice.platform, "system", lambda: "Windows")
    assert driver_advice.faster_driver([WHEEL]) is None


@pytest.mark.parametrize("device", [NVIDIA, NEWEST, WHEEL, INTEL, RUSTICL])
def test_the_default_has_a_reason(device):
    assert driver_advice.default_reason([device]) == "it is the only device"
    assert driver_advice.default_reason([device, device])


def test_only_mesa_has_a_known_fault():
    assert [driver_advice.known_fault(each) is None for each in (RUSTICL, CLOVER, WHEEL, NVIDIA)] == [0, 0, 1, 1]


def test_devices_prints_driver_target_and_reason(capsys):
    assert main(["devices"]) == 0
    out = capsys.readouterr().out
    device = select_device().device
    assert f"driver {device.driver_version.strip()}" in out
    if target := compiler_target(device):
        assert f"compiles for the CPU {target}" in out
    (reason,) = [line for line in out.splitlines() if line.startswith("default: ")]
    assert reason == f"default: device 0, {driver_advice.default_reason(list_devices())}"


@pytest.mark.parametrize(
    ("version", "text"),
    [
        ("OpenCL 3.0 PoCL HSTR: cpu-x86_64-pc-linux-gnu-znver4", "driver 7.1, code for znver4"),
        ("OpenCL 3.0 CUDA", "driver 7.1"),
    ],
)
def test_the_version_and_target_of_a_driver(version, text):
    assert describe_driver(SimpleNamespace(version=version, driver_version="7.1 ")) == text


def test_only_gpus_get_build_options():
    rounding = pyopencl.device_fp_config.CORRECTLY_ROUNDED_DIVIDE_SQRT
    cpu, gpu, rounding_gpu = (
        SimpleNamespace(type=kind, single_fp_config=config)
        for kind, config in ((CPU, rounding), (GPU, 0), (GPU, rounding))
    )
    assert build_options(cpu) == ()
    assert build_options(gpu) == GPU_OPTIONS
    assert build_options(rounding_gpu) == (*GPU_OPTIONS, ROUNDING_OPTION)


@pytest.mark.parametrize("options", [GPU_OPTIONS, (*GPU_OPTIONS, ROUNDING_OPTION)])
def test_build_options_of_gpus_are_accepted(monkeypatch, options):
    """A driver for a CPU accepts them too, and the kernel takes OpenCL's square root instead of the builtin."""
    monkeypatch.setattr(opencl, "build_options", lambda device: options)
    text = flatten("util/vec.h") + "\n#ifndef NO_BUILTINS\n#error\n#endif\n__kernel void root(__global float* x)"
    text += "{ x[0] = SQRT(x[0]) + (float)lowest_set_bit(8u) + (float)leading_zeros(1u); }"
    device = opencl.Device()
    x = device.buffer(np.array([9.0], np.float32), "the number")
    device.launch(device.build(text, ("-cl-std=CL1.2",))["root"], 1, (x,), local_size=1)
    assert device.read(x, np.float32, 1).tolist() == [3.0 + 3.0 + 31.0]


TWO_DRIVERS = """
import json
from isonoise.device.drivers import list_devices
from isonoise.renderer import Renderer
from small_scene import lamp_over_floor
images = {}
for number, device in enumerate(list_devices()):
    renderer = Renderer(lamp_over_floor(), device=number, strategy="uniform")
    renderer.step()
    images[device.driver_version] = renderer.image().tobytes().hex()
print(json.dumps(list(images.items())))
"""


@pytest.mark.long
def test_the_pocl_of_the_system_beside_that_of_pip(tmp_path):
    """Both are found, run in one process and compute the same bits; the newer one is the default."""
    library = ctypes.util.find_library("pocl")
    if library is None or not WHEEL_FOLDER.is_dir():
        pytest.skip("needs PoCL of the system (apt install pocl-opencl-icd) and of pip (pocl-binary-distribution)")
    (tmp_path / "system.icd").write_text(f"{library}\n")
    environment = os.environ | {"OCL_ICD_VENDORS": str(tmp_path), "PYTHONPATH": os.path.dirname(__file__)}
    environment.pop("ISONOISE_DEVICE_FORM", None)
    done = subprocess.run([sys.executable, "-c", TWO_DRIVERS], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    images = json.loads(done.stdout.splitlines()[-1])
    versions = [version for version, _ in images]
    assert len(versions) == 2
    assert "3.0-rc2" in versions
    numbers = [pocl_version(fake_device(POCL, version)) for version in versions]
    assert numbers == sorted(numbers, reverse=True)
    assert images[0][1] == images[1][1]
