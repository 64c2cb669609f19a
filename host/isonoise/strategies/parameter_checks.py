"""Checks of strategy parameters; what is out of range is the user's to mend."""

import math

from isonoise.errors import UserError


def check_range(name: str, value: float, low: float, high: float = math.inf) -> None:
    """Raises UserError unless low <= value <= high (inf itself is in range only where `high` is inf)."""
    if not low <= value <= high:
        upper = f"to {high:g}" if high < math.inf else "upwards"
        raise UserError(f"strategy parameter {name} = {value!r} is out of range: it goes from {low:g} {upper}")


def check_integer(name: str, value: float) -> None:
    """Raises UserError unless the value is a whole number (inf passes)."""
    if value != math.inf and value != int(value):
        raise UserError(f"strategy parameter {name} = {value!r} must be a whole number")
