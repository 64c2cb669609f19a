"""Cases of the allocation rules on the host: whole numbers whose sum is the budget, whatever the errors are.

Expected shares of water-filling come from an independent solution: bisection for the level in Python's own floats.
"""

from collections.abc import Callable, Iterator

import numpy as np

from isonoise.selftest.core import Bench, Case, count, worst
from isonoise.strategies.allocation import deficit, proportional, proportional_to_error
from isonoise.strategies.uniform_allocation import uniform_allocation

SHAPE = (64, 96)
PIXELS = SHAPE[0] * SHAPE[1]
LARGEST = 2**33
BUDGETS = {"0": 0, "1": 1, "pixels - 1": PIXELS - 1, "2^33": LARGEST}
COUNT = np.full(SHAPE, 16, np.uint32)

Rule = Callable[[np.ndarray, int], np.ndarray]
RULES: dict[str, Rule] = {
    "deficit": lambda v, budget: deficit(COUNT, v, budget, 7),
    "deficit, clip and no cap": lambda v, budget: deficit(COUNT, v, budget, 7, clip=0.99, cap=np.inf),
    "proportional": lambda v, budget: proportional_to_error(COUNT, v, budget, 7),
    "proportional, no cap": lambda v, budget: proportional_to_error(COUNT, v, budget, 7, cap=np.inf),
}


def allocation_cases(bench: Bench) -> Iterator[Case]:
    """All cases of the group; they need no device."""
    for what, variance in _maps().items():
        for budget_name, budget in BUDGETS.items():
            totals = [int(rule(variance, budget).sum(dtype=np.int64)) for rule in RULES.values()]
            wrong = sum(total != budget for total in totals)
            yield count(f"{what}, budget {budget_name}: rules of {len(RULES)} off the budget", wrong, "exact")
    yield from _beyond_32_bits()
    yield from _shares()


def _maps() -> dict[str, np.ndarray]:
    """Variances per pixel."""
    random = np.random.default_rng(1)
    decades = 10 ** random.uniform(-6, 6, SHAPE)
    one = np.zeros(SHAPE)
    one[40, 50] = 1e-3
    holes = decades.copy()
    holes[random.uniform(size=SHAPE) < 0.1] = np.nan
    holes[0, :3] = np.inf, -np.inf, -1
    return {
        "errors over 12 decades": decades,
        "all errors 0": np.zeros(SHAPE),
        "one pixel has all the error": one,
        "NaN, Inf and negative ones in the map": holes,
    }


def _beyond_32_bits() -> Iterator[Case]:
    """Waves and counts of more than 2^32 samples."""
    variance = _maps()["errors over 12 decades"]
    full = np.full(SHAPE, 2**31, np.uint32)  # 2^31 a pixel: 1.3 * 10^13 in all
    for budget in (2**32 - 1, 2**32, 2**32 + 1, 2**40 + 12345):
        maps = [
            uniform_allocation(SHAPE, budget, 3),
            proportional(np.sqrt(variance), budget // 4, 3),
            deficit(full, variance, budget, 3),
            proportional_to_error(full, variance, budget, 3),
        ]
        totals = np.array([int(m.sum(dtype=np.int64)) for m in maps])
        wrong = totals != [budget, budget // 4, budget, budget]
        yield count(f"a wave of {budget:,} samples: rules of 4 off the budget", wrong, "exact")
    largest = deficit(full, variance, 2**40, 3)
    over = full.astype(np.int64) + largest > 2**32 - 1
    yield count("... pixels whose count leaves 32 bits", over, "none may")


def _shares() -> Iterator[Case]:
    maps = _maps()
    budget = 40 * PIXELS
    v = maps["errors over 12 decades"]
    level = _level(v.ravel().tolist(), 16.0, budget)
    expected = np.maximum(v * level - 16, 0)
    measured = deficit(COUNT, v, budget, 7, cap=np.inf)
    basis = "whole numbers: less than 1 from the share, and the level's rounding"
    yield worst("errors over 12 decades: samples of a pixel", measured, expected, 1 + 1e-9 * expected, basis)
    even = deficit(COUNT, maps["all errors 0"], PIXELS + 5, 7)
    yield count("all errors 0: pixels that get neither 1 nor 2", (even != 1) & (even != 2), "even, up to a remainder")
    one = deficit(COUNT, maps["one pixel has all the error"], 1000, 7)
    yield count("one pixel has all the error: its samples, cap 4", int(one[40, 50]), "(4 - 1) * 16, exact", 48)
    one = deficit(COUNT, maps["one pixel has all the error"], 1000, 7, cap=np.inf)
    yield count("... without a cap", int(one[40, 50]), "all of the budget", 1000)
    holes = deficit(COUNT, maps["NaN, Inf and negative ones in the map"], PIXELS, 7, cap=np.inf)
    nan = np.isnan(maps["NaN, Inf and negative ones in the map"])
    yield count("NaN in the map: samples of these pixels", int(holes[nan].sum()), "NaN is no evidence: none", 0)
    scaled = [deficit(COUNT, np.ldexp(v, k), budget, 7) for k in (0, -40, 40)]
    differ = [np.count_nonzero(m != scaled[0]) for m in scaled]
    yield count("errors times 2^-20 and 2^20: pixels that differ", sum(differ), "exact")


def _level(variance: list[float], offset: float, budget: int) -> float:
    """The t with sum max(0, v t - offset) = budget, by bisection."""
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
