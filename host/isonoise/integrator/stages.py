"""Kernels that are built and launched by name, with arguments by name."""

from collections.abc import Collection, Mapping

import numpy as np

from isonoise.device.opencl import LOCAL_SIZE, SMALL_LOCAL_SIZE, Device
from isonoise.device.program import stage_source
from isonoise.integrator.kernel_table import ONE_PROGRAM, present


class Stages:
    """The kernels of a table: kernel -> its file and its arguments, by their names and in its order.

    An argument `NAME:argument` is there only with the feature NAME. `arguments` holds those that stay the same from
    launch to launch; whoever owns a buffer enters it. Kernels named `in_small_groups` run in groups of few work-items.
    """

    def __init__(
        self,
        device: Device,
        table: Mapping[str, tuple[str, str]],
        features: Mapping[str, bool],
        constants: Mapping[str, int],
        structs: Mapping[str, np.dtype],
        in_small_groups: Collection[str] = (),
    ):
        self.device = device
        self.arguments: dict[str, object] = {}
        self._kernels: dict[str, object] = {}
        files = dict.fromkeys(file for file, _ in table.values())
        together = [file for file in ONE_PROGRAM if file in files]
        for program in ([together] if together else []) + [[file] for file in files if file not in together]:
            self._kernels.update(device.build(*stage_source(program, structs, constants, features)))
        self._in_small_groups = frozenset(in_small_groups)
        self._names = {
            kernel: tuple(present(dict.fromkeys(arguments.split()), features))
            for kernel, (_, arguments) in table.items()
        }

    def __iter__(self):
        return iter(self._kernels)

    def launch(self, kernel: str, items: int, per_work_item: int = 1, **given) -> None:
        """Runs a kernel over at least `items`; `given` are the arguments of this launch alone."""
        arguments = tuple(given[name] if name in given else self.arguments[name] for name in self._names[kernel])
        local_size = SMALL_LOCAL_SIZE if kernel in self._in_small_groups else LOCAL_SIZE
        self.device.launch(self._kernels[kernel], items, arguments, per_work_item, local_size)
