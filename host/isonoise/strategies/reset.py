"""Puts a strategy back to what it was before a render, so that another one can begin. Called by `Renderer`."""

import copy

from isonoise.errors import UserError
from isonoise.strategies.base import Strategy


class StrategyReset:
    """Calling it gives the strategy the attributes that it has now. They are copied."""

    def __init__(self, strategy: Strategy):
        self._attributes: dict[str, object] | None = None
        self._failure: Exception | None = None
        try:
            self._attributes = copy.deepcopy(vars(strategy))
        except Exception as error:  # of the strategy's own objects; a render without a reset does not need the copy
            self._failure = error

    def __call__(self, strategy: Strategy) -> None:
        """Raises UserError if the attributes could not be copied."""
        if self._attributes is None:
            raise UserError(
                f"strategy '{strategy.name}' cannot begin anew, because its attributes cannot be copied "
                f"({self._failure}); make another Renderer"
            ) from self._failure
        vars(strategy).clear()
        vars(strategy).update(copy.deepcopy(self._attributes))
