"""What `isonoise devices` says about the drivers of this machine: why one is the default, and what would be faster."""

import platform
from pathlib import Path

from isonoise.device.drivers import Rank, compiler_target, is_cpu, is_mesa, rank_of

OS_RELEASE = Path("/etc/os-release")
CPU_INFO = Path("/proc/cpuinfo")

_POCL_PACKAGES = {
    "debian": "apt install pocl-opencl-icd",
    "ubuntu": "apt install pocl-opencl-icd",
    "fedora": "dnf install pocl",
    "arch": "pacman -S pocl",
    "opensuse": "zypper install pocl",
    "suse": "zypper install pocl",
    "alpine": "apk add pocl",
}
"""ID or ID_LIKE of a Linux distribution -> command that installs its PoCL."""

_REASONS = {
    Rank.GPU: "GPUs come first",
    Rank.NEW_POCL: "the newest PoCL, which is the fastest driver for CPUs where several were measured",
    Rank.OLD_POCL_ON_INTEL: "PoCL comes before other drivers on Intel's CPUs",
    Rank.OTHER: "other drivers come before PoCL older than 3.1 on this CPU",
    Rank.OLD_POCL: "no other device was found",
    Rank.MESA: "no other device was found",
}

_SPEED_OF_POCL = {
    Rank.OLD_POCL: ", 1.2 to 1.9 times as fast as PoCL 3.0 on an AMD Zen 4; or Intel's driver "
    "(pip install intel-opencl-rt), 1.05 to 1.24 times as fast there",
    Rank.OTHER: ", 1.1 to 1.6 times as fast as Intel's driver on an AMD Zen 4 and an Intel Xeon",
}

# Targets of LLVM that lack an instruction set; where a CPU has it, the compiler takes it for an older one.
_WITHOUT_AVX2 = {"generic", "x86-64", "x86-64-v2", "nehalem", "westmere", "sandybridge", "ivybridge", "btver2"}
_WITHOUT_AVX512 = _WITHOUT_AVX2 | {
    *("x86-64-v3", "haswell", "broadwell", "skylake", "alderlake", "raptorlake", "meteorlake", "bdver4"),
    *("znver1", "znver2", "znver3"),
}
_MISSING = {"avx512f": ("AVX-512", _WITHOUT_AVX512), "avx2": ("AVX2", _WITHOUT_AVX2)}
"""Flag of the CPU -> its name, and the targets without it."""


def default_reason(devices: list) -> str:
    """Why the first of the devices is the default."""
    if len(devices) == 1:
        return "it is the only device"
    return _REASONS[rank_of(devices[0])]


def unused_instructions(device) -> str | None:
    """The largest instruction set that this CPU has and the target of PoCL's compiler lacks; None if there is none.

    Only for the CPU of this machine, on Linux. Targets that are not listed count as complete.
    """
    target = compiler_target(device) if is_cpu(device) else None
    if target is None:
        return None
    try:
        lines = CPU_INFO.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return None
    flags = next((line.split(":", 1)[1].split() for line in lines if line.startswith("flags")), [])
    return next((name for flag, (name, without) in _MISSING.items() if flag in flags and target in without), None)


def faster_driver(devices: list) -> str | None:
    """A driver that is likely faster than that of the first device, and how to get it; None if none is known.

    PoCL 3.1 is compared with PoCL 3.0 and with Intel's driver: host/docs/devices.md#choice-of-a-device.
    """
    if platform.system() != "Linux" or any(rank_of(device) <= Rank.NEW_POCL for device in devices):
        return None
    rank = rank_of(devices[0])
    if rank == Rank.OLD_POCL_ON_INTEL:
        return None
    command = _install_command()
    advice = f"PoCL 3.1 or newer of your distribution{f' ({command})' if command else ''}"
    return f"{advice}{_SPEED_OF_POCL.get(rank, '')}"


def _install_command() -> str | None:
    """The command that installs PoCL on this Linux distribution; None if it is not known."""
    try:
        lines = OS_RELEASE.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return None
    fields = {name: value.strip("\"'") for name, _, value in (line.partition("=") for line in lines)}
    names = [fields.get("ID", ""), *fields.get("ID_LIKE", "").split()]
    return next((_POCL_PACKAGES[name] for name in names if name in _POCL_PACKAGES), None)


def known_fault(device) -> str | None:
    """What is known to be wrong with the device's driver; None if nothing is."""
    if not is_mesa(device):
        return None
    return "rusticl 22.3 computes wrong numbers; a render checks the driver and is refused if it does"
