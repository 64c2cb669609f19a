"""Checks of the arguments that `load`, `Scene.compile` and `Renderer` have in common."""

from collections.abc import Callable
from typing import Any

from isonoise.argument_checks import check_arguments, check_choice, check_depth, check_flag, check_mapping, check_size
from isonoise.errors import UserError
from isonoise.samplers import SAMPLERS
from isonoise.scene.view import View


def _check_view(name: str, value: object) -> object:
    if not isinstance(value, View):
        raise UserError(f"{name} = {value!r} is not an isonoise.View")
    return value


SCENE_CHECKS: dict[str, Callable[[str, object], object]] = {
    "size": lambda name, value: check_size(value),
    "max_depth": lambda name, value: check_depth(value),
    "parameters": check_mapping,
    "sampler": lambda name, value: check_choice(name, value, SAMPLERS),
    "allow_outside": check_flag,
    "view": _check_view,
}
"""Name of an argument -> its check."""


def check_scene_arguments(**arguments: Any) -> None:
    """Raise UserError if one of these arguments of `load` or `Scene.compile` has another type or is out of range."""
    check_arguments(arguments, SCENE_CHECKS, never_none=("allow_outside",))
