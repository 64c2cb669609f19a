"""OpenCL drivers: what their version strings say."""

from types import SimpleNamespace

import pytest

from isonoise.device.drivers import compiler_target


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
