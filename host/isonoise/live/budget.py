"""How much of the time of a render its pictures may take. Used by `LivePage`."""

import time
from collections.abc import Callable

SHARE = 0.005
"""Share of the time that pictures may take."""
RESERVE_S = 0.2
"""Seconds that pictures may take at once after a while without them, as at the beginning."""
OVERDRAFT_S = 1.0
"""Seconds by which urgent pictures may exceed that; later ones then come less often."""


class Budget:
    """Seconds that pictures have taken, and may take.

    Parameters
    ----------
    clock : callable
        Returns seconds.
    """

    def __init__(self, clock: Callable[[], float] = time.perf_counter):
        self._clock, self._last = clock, clock()
        self._left_s = RESERVE_S

    def spend(self, seconds: float) -> None:
        """Pictures have taken so long."""
        self._left_s -= seconds

    def allows(self, seconds: float, is_urgent: bool = False) -> bool:
        """Whether a picture may be made that takes about so long. One that takes longer than the reserve waits for it.

        An urgent one may be made at once unless too many of them were.
        """
        now = self._clock()
        self._left_s = min(self._left_s + SHARE * (now - self._last), RESERVE_S)
        self._last = now
        return self._left_s >= (seconds - OVERDRAFT_S if is_urgent else min(seconds, RESERVE_S))
