"""The limits of a render."""

from dataclasses import dataclass

from isonoise.argument_checks import check_number
from isonoise.errors import UserError
from isonoise.limits import MAX_STOP, MIN_STOP

_LIMIT = (lambda value: MIN_STOP <= value <= MAX_STOP, f"a number from {MIN_STOP:g} to {MAX_STOP:g}")
_CHECKS = {
    "spp": _LIMIT,
    "time": _LIMIT,
    "error": _LIMIT,
    "quantile": (lambda value: 0 < value < 1, "between 0 and 1"),
    "confidence": (lambda value: 0.5 <= value < 1, "at least 0.5 and below 1"),
}
"""Name of a parameter -> whether a number is accepted, and what is, in words."""


@dataclass(frozen=True)
class Stops:
    """Limits of a render; the first one reached ends it. At least one of spp, time and error is required.

    Parameters
    ----------
    spp : float or None
        Mean samples per pixel.
    time : float or None
        Seconds of rendering, without set-up.
    error : float or None
        Relative error at `quantile`, such as 0.02. The render ends when the true error is below it with `confidence`.
    quantile : float
        Quantile over the pixels, between 0 and 1.
    confidence : float
        Probability, at least 0.5 and below 1, that the true error is below `error` when the render ends because of it.
        It holds for all waves together, and as far as the limits of the stated error allow.

    Raises
    ------
    UserError
        If a value is out of range or all limits are missing.
    """

    spp: float | None = None
    time: float | None = None
    error: float | None = None
    quantile: float = 0.99
    confidence: float = 0.95

    def __post_init__(self) -> None:
        for name, (is_valid, accepted) in _CHECKS.items():
            value = getattr(self, name)
            if value is not None or name in ("quantile", "confidence"):
                object.__setattr__(self, name, check_number(name, value, is_valid, accepted))
        if self.spp is None and self.time is None and self.error is None:
            raise UserError("a render needs a limit: spp, time or error")
