"""Measures and allocation rules as parameters of strategies; those of users are checked here. Called by `adaptive`."""

import inspect
from collections.abc import Callable, Mapping

import numpy as np

from isonoise.errors import UserError
from isonoise.statistics import Statistics
from isonoise.strategies.lookup import MEASURES, RULES, Kind

Measure = Callable[..., np.ndarray]
"""`measure(statistics)` or `measure(statistics, floor)`: the error of every pixel, (height, width)."""
AllocationRule = Callable[..., np.ndarray]
"""`rule(count, variance, budget)`: samples per pixel, (height, width) uint32, that sum to `budget`.

`wave_index`, `clip`, `cap` and `exponent` are passed to rules that have parameters of these names.
"""


def find_measure(measure: str | Measure) -> Measure:
    """The function of a name or `module:function`. Raises UserError if there is none with the right parameters."""
    return _find(MEASURES, measure, ("statistics",), ("floor",))


def find_rule(rule: str | AllocationRule) -> AllocationRule:
    """The function of a name or `module:function`. Raises UserError if there is none with the right parameters."""
    return _find(RULES, rule, ("count", "variance", "budget"), ("wave_index", "clip", "cap", "exponent"))


def compute_measure(measure: Measure, statistics: Statistics, floor: float) -> np.ndarray:
    """The measure of every pixel, a new float64 array.

    Raises
    ------
    UserError
        If it is no array of real numbers of the image's shape, or if any of them is negative or not a number.
    """
    values = np.asarray(measure(statistics, **_accepted(measure, {"floor": floor})))
    name = f"measure '{MEASURES.name_of(measure)}' returned"
    if values.shape != statistics.shape or values.dtype.kind not in "fiu":
        raise UserError(
            f"{name} {_describe(values)}; it has to return one real number per pixel, an array of shape "
            f"{statistics.shape} (height, width)"
        )
    values = values.astype(np.float64)  # a copy: what the function returned may be part of the statistics
    wrong = ~(values >= 0)
    if wrong.any():
        raise UserError(
            f"{name} {_describe_wrong(values, wrong)}; an error is 0 or more: 0 where the pixel is exact, inf where "
            "nothing is known of it"
        )
    return values


def allocate_by_rule(
    rule: AllocationRule, statistics: Statistics, variance: np.ndarray, budget: int, limits: Mapping[str, float]
) -> np.ndarray:
    """The allocation map of a rule.

    Raises
    ------
    UserError
        If it is not uint32 of the image's shape, or does not sum to the budget.
    """
    # The sample count serves as wave index: it grows with every wave and needs no state.
    options = _accepted(rule, {"wave_index": statistics.samples, **limits})
    allocation = rule(statistics.count, variance, budget, **options)
    name = RULES.name_of(rule)
    if name in RULES.built_in:
        return allocation
    allocation = np.asarray(allocation)
    is_map = allocation.shape == statistics.shape and allocation.dtype == np.uint32
    if not is_map or int(allocation.sum(dtype=np.int64)) != budget:
        raise UserError(
            f"allocation rule '{name}' returned {_describe(allocation)}; it has to return the samples "
            f"of every pixel: uint32, shape {statistics.shape} (height, width), sum {budget}; "
            "isonoise.allocation.distribute_in_proportion makes such an array of any weights"
        )
    return allocation


def _find(
    kind: Kind, piece: str | Measure | AllocationRule, arguments: tuple[str, ...], options: tuple[str, ...]
) -> Callable[..., np.ndarray]:
    function = kind.find(piece) if isinstance(piece, str) else piece
    name = piece if isinstance(piece, str) else kind.name_of(piece)
    if not callable(function) or inspect.isclass(function):
        raise UserError(f"{kind.noun} '{name}' is not a function")
    try:
        parameters = _parameters(function)
        inspect.signature(function).bind(*arguments, **{option: None for option in options if option in parameters})
    except (TypeError, ValueError) as error:
        raise UserError(
            f"{kind.noun} '{name}' has to be a function of ({', '.join(arguments)}), and of none, some or all of "
            f"{', '.join(options)} by name: {error}"
        ) from error
    return function


def _accepted(function: Callable[..., np.ndarray], options: Mapping[str, object]) -> dict[str, object]:
    """The options that the function has parameters for."""
    return {name: value for name, value in options.items() if name in _parameters(function)}


def _parameters(function: Callable[..., np.ndarray]) -> Mapping[str, inspect.Parameter]:
    return inspect.signature(function).parameters


def _describe(values: np.ndarray) -> str:
    """Type, shape and sum of an array that a user's function has returned."""
    text = f"{values.dtype} of shape {values.shape}"
    if values.dtype.kind not in "fiub":
        return text
    if np.isnan(values).any():
        return f"{text} with nan in it"
    return f"{text}, sum {values.sum()}"


def _describe_wrong(values: np.ndarray, wrong: np.ndarray) -> str:
    y, x = (int(index) for index in np.argwhere(wrong)[0])
    pixels = int(wrong.sum())
    return f"{values[y, x]:g} in {pixels} pixel{'s' * (pixels > 1)}, first at x = {x}, y = {y}"
