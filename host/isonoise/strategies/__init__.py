"""Strategies: schedules of waves, measures and allocation rules."""

from isonoise.strategies.base import Strategy, Wave
from isonoise.strategies.registry import DEFAULT_STRATEGY, available_strategies, describe, make_strategy

__all__ = ["DEFAULT_STRATEGY", "Strategy", "Wave", "available_strategies", "describe", "make_strategy"]
