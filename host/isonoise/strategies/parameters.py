"""Parameters of strategies: dataclass fields with a range, and further checks. All errors have the same wording."""

import math
from dataclasses import field, fields
from numbers import Real
from typing import Any

from isonoise.errors import UserError


def ranged(default: float, low: float, high: float = math.inf) -> Any:
    """A dataclass field with a default, accepted from `low` to `high`; inf is accepted only if `high` is inf."""
    return field(default=default, metadata={"range": (low, high)})


def check_ranges(strategy: Any) -> None:
    """Raise UserError unless every `ranged` field of the dataclass is in its range."""
    for parameter in fields(strategy):
        if "range" in parameter.metadata:
            name, value = parameter.name, getattr(strategy, parameter.name)
            low, high = parameter.metadata["range"]
            if isinstance(value, bool) or not isinstance(value, Real):
                raise UserError(f"strategy parameter {name} = {value!r} is not a number")
            if not low <= value <= high:
                upper = f"to {high:g}" if high < math.inf else "upwards"
                raise UserError(f"strategy parameter {name} = {value!r} is out of range: it goes from {low:g} {upper}")


def check_integer(name: str, value: float) -> None:
    """Raise UserError unless the value is a whole number or inf."""
    if value != math.inf and value != int(value):
        raise UserError(f"strategy parameter {name} = {value!r} must be a whole number")


def check_odd(name: str, value: int) -> None:
    """Raise UserError unless the value is odd."""
    if value % 2 == 0:
        raise UserError(f"strategy parameter {name} = {value!r} must be odd")
