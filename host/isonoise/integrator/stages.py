"""Kernels that are built and launched by name, with arguments by name."""

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from isonoise.device.opencl import LOCAL_SIZE, Device
from isonoise.device.program import stage_source
from isonoise.integrator.generated_headers import generated_headers
from isonoise.integrator.kernel_table import Kernel, programs


class Stages:
    """The kernels of a table, built for a set of features.

    `arguments` holds the arguments that stay the same from launch to launch; the owner of a buffer enters it there.
    `local_sizes` are the work-items per work-group of kernels that do not run with `LOCAL_SIZE`. `constants` are macros
    of all programs, `file_constants` those of one file alone.
    """

    def __init__(
        self,
        device: Device,
        table: Mapping[str, Kernel],
        features: Mapping[str, bool],
        constants: Mapping[str, int | str],
        structs: Mapping[str, np.dtype],
        local_sizes: Mapping[str, int] = MappingProxyType({}),
        file_constants: Mapping[str, Mapping[str, int]] = MappingProxyType({}),
    ):
        self.device = device
        self.arguments: dict[str, object] = {}
        self._kernels: dict[str, object] = {}
        for files in programs(row.file for row in table.values()):
            own = {**constants, **file_constants.get(files[0], {})}
            self._kernels.update(device.build(*stage_source(files, structs, own, features, generated_headers())))
        self._local_sizes = dict(local_sizes)
        self._names = {name: kernel.arguments_for(features) for name, kernel in table.items()}

    def __iter__(self):
        return iter(self._kernels)

    def launch(self, kernel: str, items: int, per_work_item: int = 1, **given) -> None:
        """Enqueue a kernel over at least `items`; `given` are the arguments of this launch alone."""
        arguments = tuple(given[name] if name in given else self.arguments[name] for name in self._names[kernel])
        local_size = self._local_sizes.get(kernel, LOCAL_SIZE)
        self.device.launch(self._kernels[kernel], items, arguments, per_work_item, local_size)
