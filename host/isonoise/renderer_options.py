"""The keyword arguments of `Renderer`: their types, for functions that pass them on, and their checks."""

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypedDict

from isonoise.argument_checks import check_arguments, check_callable, check_flag, check_integer, check_seed
from isonoise.device.pool_size import MAX_POOL_SIZE
from isonoise.device.selection import SelectedDevice
from isonoise.errors import UserError
from isonoise.layers import check_layers
from isonoise.scene.arguments import SCENE_CHECKS
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
    """The options as `check_arguments` returns them. Raises UserError if one has another type or is out of range."""
    return check_arguments(options, _CHECKS, never_none=("strategy", "seed", "profile", "allow_outside"))


def _check_device(name: str, value: object) -> str | int | SelectedDevice:
    return value if isinstance(value, (str, SelectedDevice)) else check_integer(name, value, 0, 2**31 - 1)


def _check_strategy(name: str, value: object) -> object:
    if isinstance(value, (str, Strategy)):
        return value
    hint = f"; make an object of it: {value.__name__}(...)" if isinstance(value, type) else ""
    raise UserError(f"{name} = {value!r} is neither a strategy's name nor an object of a subclass of Strategy{hint}")


def _check_cluster(name: str, value: object) -> object:
    if not hasattr(value, "pool"):
        raise UserError(f"{name} = {value!r} is not an isonoise.Cluster")
    return value


_CHECKS: dict[str, Callable[[str, object], object]] = SCENE_CHECKS | {
    "device": _check_device,
    "strategy": _check_strategy,
    "seed": lambda name, value: check_seed(value),
    "pool_size": lambda name, value: check_integer(name, value, 1, MAX_POOL_SIZE),
    "profile": check_flag,
    "memory": lambda name, value: check_integer(f"{name} (in bytes)", value, 1, MAX_MEMORY_BYTES),
    "cluster": _check_cluster,
    "layers": lambda name, value: check_layers(value),
    "on_compile": check_callable,
}
