"""Sweeps of an experiment: from `set`, `grid` and `list` to one set of values per variant; for `experiment_file`."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product

from isonoise.errors import UserError

MAX_VARIANTS = 10_000
"""Of a scene or strategy."""


@dataclass(frozen=True)
class Variant:
    """Values by their keys: all of them, and those that are not the same in every variant."""

    values: Mapping[str, object]
    swept: Mapping[str, object]


def variants(fixed: Mapping[str, object], grid: Mapping[str, Sequence], lists: Mapping[str, Sequence]) -> list[Variant]:
    """All variants, the last key of the grid changes fastest.

    Parameters
    ----------
    fixed : mapping
        Values of all variants.
    grid : mapping
        Key -> values: every combination is a variant.
    lists : mapping
        Key -> values, as many for each key: the first ones belong together, then the second ones. They are combined
        with those of the grid.

    Raises
    ------
    UserError
        If a key is in two of them, a list is empty or longer than another one, or there are too many variants.
    """
    keys = [*fixed, *grid, *lists]
    for key in keys:
        if keys.count(key) > 1:
            raise UserError(f"'{key}' has values in two of 'set', 'grid' and 'list': leave one")
    for key, values in {**grid, **lists}.items():
        if not values:
            raise UserError(f"'{key}' has no values")
        if key in grid and (twice := [value for value in values if list(values).count(value) > 1]):
            raise UserError(f"'{key}' has the value {twice[0]} twice")
    if len({len(values) for values in lists.values()}) > 1:
        lengths = ", ".join(f"'{key}' has {len(values)}" for key, values in lists.items())
        raise UserError(f"the values of 'list' belong together one by one, but {lengths}")
    count = 1
    for values in [*grid.values(), *list(lists.values())[:1]]:
        count *= len(values)
    if count > MAX_VARIANTS:
        raise UserError(f"{count:,} variants are too many: at most {MAX_VARIANTS:,}")
    rows = [dict(zip(lists, row, strict=True)) for row in zip(*lists.values(), strict=True)] if lists else [{}]
    cells = [dict(zip(grid, cell, strict=True)) for cell in product(*grid.values())]
    return [Variant({**fixed, **cell, **row}, {**cell, **row}) for row in rows for cell in cells]
