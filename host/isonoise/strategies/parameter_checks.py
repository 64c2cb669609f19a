"""Range checks of strategy parameters, with one wording for all strategies."""

import math

from isonoise.errors import UserError


def check_range(name: str, value: float, low: float, high: float = math.inf) -> None:
    """Raise UserError unless low <= value <= high. inf is in range only if `high` is inf."""
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
