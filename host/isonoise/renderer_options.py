"""The keyword arguments of `Renderer`: their types, for functions that pass them on, and their checks."""

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypedDict

from isonoise.argument_checks import (
    check_callable,
    check_choice,
    check_depth,
    check_flag,
    check_integer,
    check_mapping,
    check_seed,
    check_size,
)
from isonoise.device.pool_size import MAX_POOL_SIZE
from isonoise.device.selection import SelectedDevice
from isonoise.errors import UserError
from isonoise.layers import check_layers
from isonoise.samplers import SAMPLERS
from isonoise.scene.view import View
from isonoise.strategies import Strategy

if TYPE_CHECKING:
    from isonoise.distributed.cluster import Cluster

MAX_MEMORY_BYTES = 2**63 - 1


class RendererOptions(TypedDict, total=False):
    """Keyword arguments of `Renderer`, which has their meanings."""

    device: str | int | None
    strategy: str | Strategy
    seed: int
    size: tuple[int, int] | None
    max_depth: int | None
    parameters: Mapping[str, object] | None
    sampler: str | None
    pool_size: int | None
    profile: bool
    allow_outside: bool
    memory: int | None
    view: View | None
    cluster: "Cluster | None"
    layers: Sequence[str]
    on_compile: Callable[..., None] | None


def check_options(options: Mapping[str, Any]) -> dict[str, Any]:
    """The options with numbers of Python's own types. Raises UserError if one has another type or is out of range.

    None stays None where it is accepted, and what is no option is left alone.
    """
    checked = dict(options)
    for name, check in _CHECKS.items():
        if name in checked and (checked[name] is not None or name in _NEVER_NONE):
            checked[name] = check(name, checked[name])
    return checked


def _check_device(name: str, value: object) -> str | int | SelectedDevice:
    return value if isinstance(value, (str, SelectedDevice)) else check_integer(name, value, 0, 2**31 - 1)


def _check_strategy(name: str, value: object) -> object:
    if isinstance(value, (str, Strategy)):
        return value
    hint = f"; make an object of it: {value.__name__}(...)" if isinstance(value, type) else ""
    raise UserError(f"{name} = {value!r} is neither a strategy's name nor an object of a subclass of Strategy{hint}")


def _check_view(name: str, value: object) -> object:
    if not isinstance(value, View):
        raise UserError(f"{name} = {value!r} is not an isonoise.View")
    return value


_NEVER_NONE = ("strategy", "seed", "profile", "allow_outside")
_CHECKS: dict[str, Callable[[str, object], object]] = {
    "device": _check_device,
    "strategy": _check_strategy,
    "seed": lambda name, value: check_seed(value),
    "size": lambda name, value: check_size(value),
    "max_depth": lambda name, value: check_depth(value),
    "parameters": check_mapping,
    "sampler": lambda name, value: check_choice(name, value, SAMPLERS),
    "pool_size": lambda name, value: check_integer(name, value, 1, MAX_POOL_SIZE),
    "profile": check_flag,
    "allow_outside": check_flag,
    "memory": lambda name, value: check_integer(f"{name} (in bytes)", value, 1, MAX_MEMORY_BYTES),
    "view": _check_view,
    "layers": lambda name, value: check_layers(value),
    "on_compile": check_callable,
}
