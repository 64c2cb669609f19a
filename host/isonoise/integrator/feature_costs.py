"""What a feature costs where it is on. It is computed from the tables that programs and buffers are made from."""

import functools
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from isonoise.device.program import stage_source
from isonoise.integrator.features import FEATURES
from isonoise.integrator.generated_headers import generated_headers
from isonoise.integrator.kernel_table import (
    BRUTE_FORCE_KERNELS,
    CONSTANTS,
    KERNELS,
    STRUCTS,
    kernel_table,
    path_bytes,
)


@dataclass(frozen=True)
class Cost:
    """The cost of a feature. `str` gives it as one line."""

    path_bytes: int  # path state, bytes for every path in flight
    buffers: Mapping[str, str]  # further buffers: Feature.buffers
    stages: tuple[str, ...]  # stages that are launched for this feature alone
    code: tuple[str, ...]  # stages with code for it

    def __str__(self) -> str:
        parts = [f"{self.path_bytes} bytes a path"] if self.path_bytes else []
        parts += [f"{name} ({size})" for name, size in self.buffers.items()]
        parts += [f"stage {name}" for name in self.stages]
        return ", ".join([*parts, f"code in {', '.join(self.code)}"])


def cost(name: str, features: Mapping[str, bool]) -> Cost:
    """The cost of feature `name` beside those of `features` that are on."""
    on, off = ({**features, name: value} for value in (True, False))
    extra_bytes = sum(path_bytes(on).values()) - sum(path_bytes(off).values())
    stages = tuple(kernel for kernel in kernel_table(on, False) if kernel not in kernel_table(off, False))
    return Cost(extra_bytes, FEATURES[name].buffers, stages, stages_with(name))


def stages_with(name: str) -> tuple[str, ...]:
    """Stages that have code for a feature."""
    return tuple(stage for stage, features in _features_by_stage().items() if name in features)


def features_in(file: str) -> set[str]:
    """Features that the text of a stage, or a macro in it, tests."""
    _, options = stage_source(file, STRUCTS, CONSTANTS, dict.fromkeys(FEATURES, True), generated_headers())
    return set(re.findall(r"-DFEATURE_(\w+)", " ".join(options)))


@functools.cache
def _features_by_stage() -> dict[str, set[str]]:
    files = sorted({row.file for table in (KERNELS, BRUTE_FORCE_KERNELS) for row in table.values()})
    return {Path(file).stem: features_in(file) for file in files}
