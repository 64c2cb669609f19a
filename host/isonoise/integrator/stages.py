"""Kernels that are built and launched by name, with arguments by name."""

import copy
from collections.abc import Collection, Mapping, Sequence
from pathlib import PurePosixPath
from types import MappingProxyType

import numpy as np

from isonoise.device.opencl import LOCAL_SIZE, Device, global_size
from isonoise.device.precompile import FirstLaunch, Job, OnCompile, precompile
from isonoise.device.program import stage_source
from isonoise.integrator.generated_headers import generated_headers
from isonoise.integrator.kernel_table import NO_WORK, VALUE_TYPES, Kernel, programs

_C_VALUES = {
    "uint": np.ones(1, np.uint32),
    "uint2": np.ones(2, np.uint32),
    "float": np.ones(1, np.float32),
    "float4": np.ones(4, np.float32),
}
_NOTHING: Mapping[str, int] = MappingProxyType({})


class Stages:
    """The kernels of a table, built for a set of features.

    `arguments` holds the arguments that stay the same from launch to launch; the owner of a buffer enters it there.
    `texts` are the source and the build options of every program.

    Parameters
    ----------
    constants : macros of all programs
    file_constants : macros of one file alone
    local_sizes : work-items per work-group of kernels that do not run with `LOCAL_SIZE`
    items_per_work_item : of kernels whose work-items process more than one
    compiled_items : compile the kernels now, on all cores, for launches over that many items, which `warm_up` makes.
        None: the driver compiles them when it likes.
    on_compile : called before each program is compiled. It is not kept: it may hold the object that holds the stages.
    """

    def __init__(
        self,
        device: Device,
        table: Mapping[str, Kernel],
        features: Mapping[str, bool],
        constants: Mapping[str, int | str],
        structs: Mapping[str, np.dtype],
        local_sizes: Mapping[str, int] = _NOTHING,
        items_per_work_item: Mapping[str, int] = _NOTHING,
        file_constants: Mapping[str, Mapping[str, int]] = MappingProxyType({}),
        compiled_items: int | None = None,
        on_compile: OnCompile = lambda name, done, total: None,
    ):
        self.device = device
        self.arguments: dict[str, object] = {}
        self._kernels: dict[str, object] = {}
        self._local_sizes, self._items_per_work_item = dict(local_sizes), dict(items_per_work_item)
        self._names = {name: kernel.arguments_for(features) for name, kernel in table.items()}
        texts = {}
        for files in programs(row.file for row in table.values()):
            own = {**constants, **file_constants.get(files[0], {})}
            texts[tuple(files)] = stage_source(files, structs, own, features, generated_headers())
        self._compiled_items = compiled_items
        if compiled_items is not None:
            precompile(device, [self._job(table, *item, compiled_items) for item in texts.items()], on_compile)
        self.texts: tuple[tuple[str, tuple[str, ...]], ...] = tuple(texts.values())
        for number, (files, text) in enumerate(texts.items()):
            on_compile(_program_name(files), number, len(texts))
            self._kernels.update(device.build(*text))

    def __iter__(self):
        return iter(self._kernels)

    def __getitem__(self, name: str):
        """The compiled kernel, for measurements."""
        return self._kernels[name]

    def with_own_arguments(self) -> "Stages":
        """The same kernels, with no arguments yet."""
        other = copy.copy(self)
        other.arguments = {}
        return other

    def launch(self, kernel: str, items: int, per_work_item: int | None = None, **given) -> None:
        """Enqueue a kernel over at least `items`.

        `given` are the arguments of this launch alone; `per_work_item` replaces the kernel's items per work-item.
        """
        arguments = tuple(given[name] if name in given else self.arguments[name] for name in self._names[kernel])
        per_work_item = per_work_item or self._items_per_work_item.get(kernel, 1)
        self.device.launch(self._kernels[kernel], items, arguments, per_work_item, self._local_size(kernel))

    def warm_up(self, on_compile: OnCompile = lambda name, done, total: None, left_out: Collection[str] = ()) -> None:
        """Launch every kernel on nothing, because some drivers compile only now, for a local and a global size.

        Kernels that are `left_out` have no arguments and will not be launched.

        PoCL compiles a kernel separately for global sizes below 2^16. What it compiles for larger ones also runs small
        ones, so the launches over `compiled_items` come first.
        """
        names = [name for name in self if name not in left_out]
        for items in (self._compiled_items, 1):
            for number, name in enumerate(names):
                on_compile(name, number, len(names))
                self.launch(name, items, **NO_WORK)
        self.device.finish()
        self.device.reset_profile()

    def _local_size(self, kernel: str) -> int:
        return self._local_sizes.get(kernel, LOCAL_SIZE)

    def _job(self, table: Mapping[str, Kernel], files: Sequence[str], text: tuple, items: int) -> Job:
        """The compilation of a program for launches over `items`; `text` is its source and options."""
        launches = []
        for name, row in table.items():
            if row.file in files:
                local_size = self._local_size(name)
                size = global_size(items, self._items_per_work_item.get(name, 1), local_size)
                arguments = (
                    None if argument not in row.values else _any_value(argument) for argument in self._names[name]
                )
                launches.append(FirstLaunch(name, size, local_size, tuple(arguments)))
        return Job(*text, tuple(launches), _program_name(files))


def _program_name(files: Sequence[str]) -> str:
    """The name of a program for people: that of its first file, without folder and suffix."""
    return PurePosixPath(files[0]).stem


def _any_value(argument: str) -> str:
    """A value with which a kernel finds no work, in hexadecimal digits."""
    value = NO_WORK[argument] if argument in NO_WORK else _C_VALUES[VALUE_TYPES.get(argument, "uint")]
    return value.tobytes().hex()
