"""The limits of a render."""

from dataclasses import dataclass

from isonoise.errors import UserError
from isonoise.limits import MAX_STOP, MIN_STOP


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

    def __post_init__(self):
        for name in ("spp", "time", "error"):
            value = getattr(self, name)
            if value is not None and not MIN_STOP <= value <= MAX_STOP:
                raise UserError(f"{name} has to be a number from {MIN_STOP:g} to {MAX_STOP:g}, not {value}")
        if not 0 < self.quantile < 1:
            raise UserError(f"quantile has to lie between 0 and 1, not {self.quantile}")
        if not 0.5 <= self.confidence < 1:
            raise UserError(f"confidence has to be at least 0.5 and below 1, not {self.confidence}")
        if self.spp is None and self.time is None and self.error is None:
            raise UserError("a render needs a limit: spp, time or error")
