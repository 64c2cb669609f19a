"""What a feature costs where it is on, read from the tables by which programs and buffers are made."""

import functools
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from isonoise.device.program import flatten
from isonoise.integrator.features import FEATURES
from isonoise.integrator.generated_headers import generated_headers
from isonoise.integrator.kernel_table import BRUTE_FORCE_KERNELS, KERNELS, kernel_table, path_bytes


@dataclass(frozen=True)
class Cost:
    path_bytes: int  # of state, for every path in flight
    buffers: Mapping[str, str]  # what more there is on the device: Feature.buffers
    stages: tuple[str, ...]  # that are launched for it alone
    code: tuple[str, ...]  # stages, by their files, that have code for it

    def __str__(self) -> str:
        parts = [f"{self.path_bytes} bytes a path"] if self.path_bytes else []
        parts += [f"{name} ({size})" for name, size in self.buffers.items()]
        parts += [f"stage {name}" for name in self.stages]
        return ", ".join([*parts, f"code in {', '.join(self.code)}"])


def cost(name: str, features: Mapping[str, bool]) -> Cost:
    """What the feature costs in a program that has it beside those of `features`, or would save in one without it."""
    on, off = ({**features, name: value} for value in (True, False))
    bytes_on, bytes_off = (sum(path_bytes(each).values()) for each in (on, off))
    stages = tuple(kernel for kernel in kernel_table(on, False) if kernel not in kernel_table(off, False))
    return Cost(bytes_on - bytes_off, FEATURES[name].buffers, stages, stages_with(name))


def stages_with(name: str) -> tuple[str, ...]:
    """Stages whose text has code for the feature, by the names of their files."""
    return tuple(stage for stage, mentioned in _mentioned().items() if name in mentioned)


@functools.cache
def _mentioned() -> dict[str, set[str]]:
    """Stage -> features that it tests."""
    files = dict.fromkeys(row.file for table in (KERNELS, BRUTE_FORCE_KERNELS) for row in table.values())
    return {
        Path(file).stem: set(re.findall(r"\bFEATURE_(\w+)", flatten(file, generated_headers())))
        for file in sorted(files)
    }
