"""Checks of the arguments of public functions. All errors have the same wording: name, value, what is accepted."""

import contextlib
import inspect
import math
import operator
import os
from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any, SupportsFloat, SupportsIndex, cast

from isonoise.errors import UserError
from isonoise.limits import MAX_DEPTH, MAX_PIXELS
from isonoise.suggestions import suggestion

if TYPE_CHECKING:
    import numpy as np

MAX_SEED = 2**64 - 1


def check_keywords(names: Iterable[str], *functions: Callable[..., object]) -> None:
    """Raise UserError unless these are keyword arguments of one of the functions or classes."""
    parameters = [each for function in functions for each in inspect.signature(function).parameters.values()]
    known = list(dict.fromkeys(each.name for each in parameters if each.kind is not each.VAR_KEYWORD))
    for name in names:
        if name not in known:
            raise UserError(f"there is no argument '{name}'{suggestion(name, known)}; known are {', '.join(known)}")


def check_arguments(
    arguments: Mapping[str, Any], checks: Mapping[str, Callable[[str, object], object]], never_none: Iterable[str] = ()
) -> dict[str, Any]:
    """The arguments by name, with what their checks return, such as Python's own numbers in place of NumPy's.

    None stays None, but for `never_none`; arguments without a check are left alone. Raises UserError as the checks do.
    """
    checked = dict(arguments)
    for name, check in checks.items():
        if name in checked and (checked[name] is not None or name in never_none):
            checked[name] = check(name, checked[name])
    return checked


def check_integer(name: str, value: object, low: int, high: int, high_text: str | None = None) -> int:
    """The value as an int. Raises UserError unless it is a whole number from `low` to `high`; True is none."""
    try:
        number = None if isinstance(value, bool) else operator.index(cast(SupportsIndex, value))  # also of numpy
    except TypeError:
        number = None
    if number is None:
        raise UserError(f"{name} = {value!r} is not a whole number")
    if not low <= number <= high:
        raise UserError(f"{name} = {value!r} is out of range: it goes from {low} to {high_text or high}")
    return number


def check_number(name: str, value: object, is_valid: Callable[[float], bool], accepted: str) -> float:
    """The value as a float. Raises UserError unless it is a number, and valid; neither text nor True is one."""
    number = None
    if not isinstance(value, (bool, str, bytes)):
        try:
            number = float(cast(SupportsFloat, value))
        except (TypeError, ValueError, OverflowError):
            number = None
    if number is None or math.isnan(number) or not is_valid(number):
        raise UserError(f"{name} has to be {accepted}, not {value!r}")
    return number


def check_path(name: str, value: object) -> str:
    """The path as text. Raises UserError unless it is a path."""
    if not isinstance(value, (str, os.PathLike)):
        raise UserError(f"{name} = {value!r} is not a path")
    return str(os.fspath(value))


def check_rgb(name: str, value: object) -> "np.ndarray":
    """The linear RGB image as an array. Raises UserError unless it is numbers of shape (height, width, 3)."""
    import numpy as np  # not at the top: `isonoise --help` needs other checks only

    try:
        pixels = np.asarray(value)
    except ValueError:  # of ragged lists
        pixels = np.empty(0, object)
    if pixels.ndim != 3 or pixels.shape[2] != 3 or not pixels.size or pixels.dtype.kind not in "fiu":
        raise UserError(
            f"{name}: {type(value).__name__} of shape {pixels.shape} and type {pixels.dtype} is no linear RGB image; "
            "it has to be an array of numbers of shape (height, width, 3)"
        )
    return pixels


def check_flag(name: str, value: object) -> bool:
    """The value. Raises UserError unless it is True or False."""
    if not isinstance(value, bool):
        raise UserError(f"{name} = {value!r} is neither True nor False")
    return value


def check_choice(name: str, value: object, choices: Iterable[str]) -> str:
    """The value. Raises UserError unless it is one of these texts."""
    choices = list(choices)
    if not isinstance(value, str) or value not in choices:
        hint = suggestion(value, choices) if isinstance(value, str) else ""
        raise UserError(f"{name} = {value!r} is not one of {', '.join(choices)}{hint}")
    return value


def check_seed(seed: object) -> int:
    """The seed as an int. Raises UserError unless it is a whole number from 0 to 2^64 - 1."""
    return check_integer("seed", seed, 0, MAX_SEED, "2^64 - 1")


def check_size(size: object) -> tuple[int, int]:
    """An image size (width, height). Raises UserError unless these are two whole numbers from 1, not too large."""
    sides: tuple[object, ...] | None = None
    if not isinstance(size, (str, Mapping)):
        with contextlib.suppress(TypeError):
            sides = tuple(cast(Iterable[object], size))
    if sides is None or len(sides) != 2:
        raise UserError(f"size = {size!r} is not (width, height) in pixels, such as (640, 360)")
    names = "width", "height"
    width, height = (
        check_integer(f"size: {name}", side, 1, MAX_PIXELS) for name, side in zip(names, sides, strict=True)
    )
    if width * height > MAX_PIXELS:
        raise UserError(f"size = {size!r} is out of range: an image has 1 to {MAX_PIXELS:,} pixels")
    return width, height


def check_callable(name: str, value: object) -> Callable[..., object]:
    """The value. Raises UserError unless it can be called."""
    if not callable(value):
        raise UserError(f"{name} = {value!r} is not a function")
    return value


def check_depth(max_depth: object) -> int:
    """The longest path in segments, -1 for no limit, as an int. Raises UserError if it is something else."""
    return check_integer("max_depth", max_depth, -1, MAX_DEPTH)


def check_mapping(name: str, value: object) -> Mapping[str, object]:
    """The value. Raises UserError unless it is a dict."""
    if not isinstance(value, Mapping):
        raise UserError(f"{name} = {value!r} is not a dict")
    return value
