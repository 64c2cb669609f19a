"""Checks of the allocation rules on the host: whole numbers whose sum is the budget, for any map of errors.

Expected shares of water-filling come from an independent solution: bisection in Python floats.
"""

from collections.abc import Callable, Iterator

import numpy as np

from isonoise.selftest.cases import Case, Context, array_case, count_case
from isonoise.strategies.allocation import deficit, distribute_in_proportion, proportional_to_error
from isonoise.strategies.uniform_allocation import uniform_allocation

SHAPE = (64, 96)
PIXELS = SHAPE[0] * SHAPE[1]
BUDGETS = {"0": 0, "1": 1, "pixels - 1": PIXELS - 1, "2^33": 2**33}
COUNT = np.full(SHAPE, 16, np.uint32)
DECADES, ZERO, ONE_PIXEL, INVALID = (
    "errors over 12 decades",
    "all errors 0",
    "one pixel has all the error",
    "NaN, Inf and negative errors",
)

Rule = Callable[[np.ndarray, int], np.ndarray]
RULES: dict[str, Rule] = {
    "deficit": lambda v, budget: deficit(COUNT, v, budget, 7),
    "deficit, clip and no cap": lambda v, budget: deficit(COUNT, v, budget, 7, clip=0.99, cap=np.inf),
    "proportional": lambda v, budget: proportional_to_error(COUNT, v, budget, 7),
    "proportional, no cap": lambda v, budget: proportional_to_error(COUNT, v, budget, 7, cap=np.inf),
}


def _variance_maps() -> dict[str, np.ndarray]:
    random = np.random.default_rng(1)
    decades = 10 ** random.uniform(-6, 6, SHAPE)
    one = np.zeros(SHAPE)
    one[40, 50] = 1e-3
    invalid = decades.copy()
    invalid[random.uniform(size=SHAPE) < 0.1] = np.nan
    invalid[0, :3] = np.inf, -np.inf, -1
    return {DECADES: decades, ZERO: np.zeros(SHAPE), ONE_PIXEL: one, INVALID: invalid}


def _total(allocation: np.ndarray) -> int:
    return int(allocation.sum(dtype=np.int64))


def budgets(context: Context) -> Iterator[Case]:
    """Every rule meets every budget exactly."""
    for map_name, variance in _variance_maps().items():
        for budget_name, budget in BUDGETS.items():
            wrong = sum(_total(rule(variance, budget)) != budget for rule in RULES.values())
            yield count_case(f"{map_name}, budget {budget_name}: rules of {len(RULES)} off the budget", wrong, "exact")


def beyond_32_bits(context: Context) -> Iterator[Case]:
    """Waves and counts of more than 2^32 samples."""
    variance = _variance_maps()[DECADES]
    count = np.full(SHAPE, 2**31, np.uint32)  # 2^31 a pixel: 1.3 * 10^13 in all
    for budget in (2**32 - 1, 2**32, 2**32 + 1, 2**40 + 12345):
        allocations = [
            uniform_allocation(SHAPE, budget, 3),
            distribute_in_proportion(np.sqrt(variance), budget // 4, 3),
            deficit(count, variance, budget, 3),
            proportional_to_error(count, variance, budget, 3),
        ]
        wrong = np.array([_total(a) for a in allocations]) != [budget, budget // 4, budget, budget]
        yield count_case(f"a wave of {budget:,} samples: rules of 4 off the budget", wrong, "exact")
    overflowing = count.astype(np.int64) + deficit(count, variance, 2**40, 3) > 2**32 - 1
    yield count_case("a wave of 2^40 samples: pixels whose count exceeds 32 bits", overflowing, "none allowed")


def shares(context: Context) -> Iterator[Case]:
    """The samples of single pixels."""
    maps = _variance_maps()
    decades, one_pixel, invalid = maps[DECADES], maps[ONE_PIXEL], maps[INVALID]
    budget = 40 * PIXELS
    level = _water_level(decades.ravel().tolist(), 16.0, budget)
    expected = np.maximum(decades * level - 16, 0)
    allocation = deficit(COUNT, decades, budget, 7, cap=np.inf)
    basis = "whole numbers: less than 1 from the share, and the level's rounding"
    yield array_case(f"{DECADES}: samples of a pixel", allocation, expected, 1 + 1e-9 * expected, basis)
    allocation = deficit(COUNT, maps[ZERO], PIXELS + 5, 7)
    uneven = (allocation != 1) & (allocation != 2)
    yield count_case(f"{ZERO}: pixels that get neither 1 nor 2", uneven, "even, up to a remainder")
    capped = deficit(COUNT, one_pixel, 1000, 7)
    yield count_case(f"{ONE_PIXEL}: its samples, cap 4", int(capped[40, 50]), "(4 - 1) * 16, exact", 48)
    uncapped = deficit(COUNT, one_pixel, 1000, 7, cap=np.inf)
    yield count_case(f"{ONE_PIXEL}: its samples, no cap", int(uncapped[40, 50]), "all of the budget", 1000)
    allocation = deficit(COUNT, invalid, PIXELS, 7, cap=np.inf)
    yield count_case(f"{INVALID}: samples of pixels with NaN", int(allocation[np.isnan(invalid)].sum()), "none allowed")
    scaled = [deficit(COUNT, np.ldexp(decades, k), budget, 7) for k in (0, -40, 40)]
    differing = sum(np.count_nonzero(a != scaled[0]) for a in scaled)
    yield count_case("errors times 2^-20 and 2^20: pixels that differ", differing, "exact")


def _water_level(variance: list[float], offset: float, budget: int) -> float:
    """Returns t with sum max(0, v t - offset) = budget, by bisection."""
    low, high = 0.0, 1.0
    while sum(max(v * high - offset, 0.0) for v in variance) < budget:
        high *= 2
    for _ in range(100):
        middle = 0.5 * (low + high)
        if sum(max(v * middle - offset, 0.0) for v in variance) < budget:
            low = middle
        else:
            high = middle
    return high


CHECKS = (budgets, beyond_32_bits, shares)
