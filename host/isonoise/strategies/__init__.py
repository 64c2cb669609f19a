"""Strategies decide how the samples are distributed: a schedule of waves and an allocation map for each.

A built-in strategy is one file (or class) and one row of `lookup.py`.
"""

from isonoise.strategies.base import Strategy, Wave
from isonoise.strategies.registry import DEFAULT_STRATEGY, available_strategies, describe, make_strategy

__all__ = ["DEFAULT_STRATEGY", "Strategy", "Wave", "available_strategies", "describe", "make_strategy"]
