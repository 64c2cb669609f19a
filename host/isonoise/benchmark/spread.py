"""Spread of a figure over the repeats of a measurement, as in the JSON files."""

import statistics
from collections.abc import Iterable


def spread(values: Iterable[float]) -> dict[str, float]:
    """`median`, `min` and `max` of the values."""
    values = list(values)
    return {"median": statistics.median(values), "min": min(values), "max": max(values)}
