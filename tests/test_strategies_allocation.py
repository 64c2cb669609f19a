"""Allocation rules: exact sums, water-filling against rational arithmetic, caps, scaling, hashed order."""

import tracemalloc
from fractions import Fraction

import numpy as np
import pytest

from isonoise.strategies.allocation import deficit, distribute_in_proportion, proportional_to_error
from isonoise.strategies.uniform_allocation import uniform_allocation


def exact_shares(count, variance, budget, cap):
    """Shares min(max(0, V t - n), (g - 1) n) of sum `budget` in rational numbers, by trying every linear piece."""
    n, v = [int(c) for c in count], [Fraction(float(x)) for x in variance]
    entries = [a / b for a, b in zip(n, v, strict=True)]
    breaks = sorted({*entries, *(cap * t for t in entries)})

    def shares(t):
        return [min(max(Fraction(0), b * t - a), Fraction((cap - 1) * a)) for a, b in zip(n, v, strict=True)]

    low = max(t for t in breaks if sum(shares(t)) <= budget)
    high = min((t for t in breaks if sum(shares(t)) > budget), default=None)
    if high is None:
        return shares(low)
    at_low, at_high = sum(shares(low)), sum(shares(high))
    return shares(low + (high - low) * (budget - at_low) / (at_high - at_low))


def largest_remainders(shares, budget):
    floors = [int(s) for s in shares]
    order = sorted(range(len(shares)), key=lambda i: floors[i] - shares[i])
    for i in order[: budget - sum(floors)]:
        floors[i] += 1
    return floors


@pytest.mark.parametrize("seed", range(20))
def test_deficit_equals_rational_arithmetic(seed):
    rng = np.random.default_rng(seed)
    count = rng.integers(1, 50, size=(4, 5), dtype=np.uint32)
    variance = rng.lognormal(0, 3, size=(4, 5))
    for budget in (1, 7, 100, int(2.9 * count.sum())):
        expected = largest_remainders(exact_shares(count.ravel(), variance.ravel(), budget, 4), budget)
        assert deficit(count, variance, budget, 0).ravel().tolist() == expected


@pytest.mark.parametrize("cap", [2, 4, np.inf])
@pytest.mark.parametrize("clip", [0.9, 1.0])
@pytest.mark.parametrize("budget", [0, 1, 62, 63, 64, 1000, 10**6, 2**33])
@pytest.mark.parametrize("rule", [deficit, proportional_to_error])
def test_counts_sum_to_the_budget(rule, budget, clip, cap):
    rng = np.random.default_rng(budget)
    count = rng.integers(0, 100, size=(7, 9), dtype=np.uint32)
    variances = {
        "random": rng.lognormal(0, 2, size=count.shape),
        "zero": np.zeros(count.shape),
        "equal": np.ones(count.shape),
        "decades": 10.0 ** rng.uniform(-6, 6, size=count.shape),
        "one pixel": np.where(np.arange(63).reshape(7, 9) == 30, 1.0, 0.0),
        "unknown": np.full(count.shape, np.inf),
        "nan": np.full(count.shape, np.nan),
        "tiny": np.full(count.shape, 5e-324),
        "huge": np.full(count.shape, 1e308),
    }
    for name, variance in variances.items():
        allocation = rule(count, variance, budget, 1, clip=clip, cap=cap)
        assert allocation.dtype == np.uint32, name
        assert allocation.shape == count.shape, name
        assert int(allocation.sum(dtype=np.int64)) == budget, name


def test_a_single_pixel_gets_all_samples():
    count = np.array([[16]], dtype=np.uint32)
    for variance in (0.0, 1.0, np.inf, np.nan):
        assert deficit(count, np.array([[variance]]), 12345, 0).item() == 12345


def test_errors_are_equal_where_samples_went():
    rng = np.random.default_rng(3)
    count = rng.integers(16, 200, size=(40, 50), dtype=np.uint32)
    variance = 10.0 ** rng.uniform(-6, 6, size=count.shape)
    allocation = deficit(count, variance, 10**9, 0, cap=np.inf)
    level = variance / (count + allocation)
    got = allocation > 1000  # where a rounding by one sample is at most a thousandth
    assert got.any()
    assert level[got].max() / level[got].min() < 1.002
    # A pixel of 16 samples whose share rounds to 0 may exceed the others by less than one sample.
    assert level[allocation == 0].max() < level[got].max() * (1 + 1 / 16)


def test_exact_water_filling_keeps_the_mean_error_of_uniform_sampling_and_sqrt_lowers_it():
    rng = np.random.default_rng(4)
    variance = rng.lognormal(0, 1, size=(64, 64))
    count = np.ones(variance.shape, dtype=np.uint32)  # so few that no pixel is above the water level
    total = 10_000_000
    filled = count + deficit(count, variance, total - count.size, 0, cap=np.inf)
    uniform = np.mean(variance / (total / count.size))
    assert np.mean(variance / filled) == pytest.approx(uniform, rel=1e-3)  # rounding: one sample in about 2000
    root = np.sqrt(variance) * total / np.sqrt(variance).sum()
    assert np.mean(variance / root) < 0.9 * uniform  # exp(-sigma^2 / 4) = 0.78 for this distribution
    assert np.max(variance / filled) < 0.3 * np.max(variance / root)


@pytest.mark.parametrize("exponent", [0.5, 1.0, 3.0])
def test_proportional_to_the_error_converges_to_a_power_of_the_variance(exponent):
    """Fixed point of n ~ (V / n)^p: n ~ V^(p / (p + 1)), so V / n is not the same everywhere."""
    variance = np.array([[1.0, 4.0, 16.0, 64.0]])
    count = np.full(variance.shape, 100, dtype=np.uint32)
    for wave in range(400):
        count += proportional_to_error(count, variance, int(0.1 * count.sum()), wave, exponent=exponent)
        count = np.maximum(count // 2, 1) if count.sum() > 10**8 else count  # so that the start does not matter
    slope = np.polyfit(np.log(variance[0]), np.log(count[0]), 1)[0]
    assert slope == pytest.approx(exponent / (exponent + 1), rel=0.01)


def test_proportional_to_the_error_is_its_formula():
    count = np.array([[10, 20, 40]], dtype=np.uint32)
    variance = np.array([[1.0, 4.0, 2.0]])
    weight = (variance / count) ** 2
    expected = 10**6 * weight / weight.sum()
    got = proportional_to_error(count, variance, 10**6, 0, exponent=2.0, cap=np.inf)
    assert np.abs(got - expected).max() < 1


def test_no_pixel_exceeds_the_cap_while_others_are_below_it():
    rng = np.random.default_rng(5)
    count = rng.integers(1, 100, size=(30, 30), dtype=np.uint32)
    variance = np.where(rng.random(count.shape) < 0.1, 10.0 ** rng.uniform(0, 9, size=count.shape), 0.0)
    capacity = int(3 * count.sum())
    for budget in (10, 5000, capacity // 2, capacity - 1, capacity):
        allocation = deficit(count, variance, budget, 0)
        assert (allocation <= 3 * count).all()
    assert (deficit(count, variance, capacity, 0) == 3 * count).all()
    beyond = deficit(count, variance, capacity + count.size, 0)
    assert (beyond == 3 * count + 1).all()


def test_samples_beyond_the_caps_are_spread_evenly():
    count = np.full((10, 10), 16, dtype=np.uint32)
    variance = np.zeros((10, 10))
    variance[4, 7] = 1.0
    allocation = deficit(count, variance, 48 + 99 * 5 + 20, 0)
    assert allocation[4, 7] == 48
    others = np.delete(allocation.ravel(), 47)
    assert sorted(np.unique(others)) == [5, 6]
    assert np.count_nonzero(others == 6) == 20


def test_without_variance_the_allocation_is_uniform():
    count = np.full((9, 11), 16, dtype=np.uint32)
    allocation = deficit(count, np.zeros(count.shape), 99 * 3 + 5, 7)
    assert (allocation == uniform_allocation(count.shape, 99 * 3 + 5, 7)).all()


def test_a_pixel_without_samples_gets_none_by_its_variance():
    count = np.full((4, 4), 10, dtype=np.uint32)
    count[0, 0] = 0
    variance = np.ones((4, 4))
    variance[0, 0] = np.inf
    assert deficit(count, variance, 150, 0)[0, 0] == 0
    # With every other pixel at its cap (15 * 30) the rest goes evenly over the image.
    assert deficit(count, variance, 450 + 16, 0)[0, 0] == 1


def test_inf_counts_as_the_largest_variance_and_nan_as_zero():
    count = np.full((4, 4), 8, dtype=np.uint32)
    variance = np.arange(1.0, 17).reshape(4, 4)
    with_unknown, as_worst = variance.copy(), variance.copy()
    with_unknown[1, 1], as_worst[1, 1] = np.inf, 16.0
    assert (deficit(count, with_unknown, 100, 0) == deficit(count, as_worst, 100, 0)).all()
    for bad in (np.nan, -np.inf, -5.0):
        with_bad, as_zero = variance.copy(), variance.copy()
        with_bad[2, 2], as_zero[2, 2] = bad, 0.0
        assert (deficit(count, with_bad, 100, 0) == deficit(count, as_zero, 100, 0)).all()


def test_clip_cuts_at_the_quantile_of_pixels_with_variance():
    count = np.full((20, 50), 16, dtype=np.uint32)
    variance = np.zeros(1000)
    variance[:100] = np.arange(1, 101)  # the other 900 must not count
    variance[99] = 1e9
    variance = variance.reshape(20, 50)
    allocation = deficit(count, variance, 2000, 0, clip=0.95, cap=np.inf).ravel()
    assert np.ptp(allocation[95:100].astype(int)) <= 1
    assert allocation[100:].sum() == 0
    assert deficit(count, variance, 2000, 0, clip=1.0, cap=np.inf).ravel()[99] == 2000


def test_scaling_the_variance_changes_nothing():
    rng = np.random.default_rng(8)
    count = rng.integers(16, 500, size=(60, 70), dtype=np.uint32)
    variance = 10.0 ** rng.uniform(-6, 6, size=count.shape)
    for clip in (0.99, 1.0):
        allocation = deficit(count, variance, 100_000, 3, clip=clip)
        for power in (-40, -1, 1, 20, 40):
            assert (deficit(count, np.ldexp(variance, power), 100_000, 3, clip=clip) == allocation).all()
        for factor in (3.7, 1e-7):
            change = deficit(count, variance * factor, 100_000, 3, clip=clip).astype(int) - allocation
            assert np.abs(change).max() <= 1
            assert np.count_nonzero(change) <= 4  # pixels whose remainders tie but for the last bit


def test_a_larger_budget_takes_no_samples_away():
    rng = np.random.default_rng(9)
    count = rng.integers(1, 100, size=(20, 20), dtype=np.uint32)
    variance = rng.lognormal(0, 2, size=count.shape)
    before = np.zeros(count.shape, dtype=int)
    for budget in (10, 100, 1000, 10_000, 30_000, 100_000):
        allocation = deficit(count, variance, budget, 0).astype(int)
        assert (allocation >= before - 1).all()  # one sample of rounding
        before = allocation


def test_counts_stay_within_uint32():
    count = np.array([[2**32 - 10, 16, 16]], dtype=np.uint32)
    allocation = deficit(count, np.array([[1.0, 0.0, 0.0]]), 2**31, 0)
    assert allocation[0, 0] <= 9
    assert int(allocation.sum(dtype=np.int64)) == 2**31
    with pytest.raises(ValueError, match="can count"):
        deficit(count, np.ones((1, 3)), 2**33, 0)
    with pytest.raises(ValueError, match="can count"):
        uniform_allocation((1, 1), 2**33, 0)


@pytest.mark.parametrize("arguments", [{"budget": -1}, {"clip": 0}, {"clip": 1.1}, {"cap": 1}, {"cap": 2.5}])
def test_arguments_out_of_range(arguments):
    with pytest.raises(ValueError, match=r"not|out of range"):
        deficit(np.ones((2, 2), np.uint32), np.ones((2, 2)), **{"budget": 4, "wave_index": 0, **arguments})


def test_proportional_equals_rational_arithmetic():
    rng = np.random.default_rng(1)
    for weights in (rng.lognormal(0, 3, size=(5, 6)), rng.permutation(30).reshape(5, 6).astype(np.uint32)):
        total = sum(Fraction(float(w)) for w in weights.ravel())
        for budget in (0, 1, 29, 1000, 10**6 + 1):
            shares = [Fraction(float(w)) * budget / total for w in weights.ravel()]
            counts = distribute_in_proportion(weights, budget, 0)
            assert counts.ravel().tolist() == largest_remainders(shares, budget)
            assert counts.dtype == np.uint32


def test_proportional_with_extreme_weights():
    alone = np.zeros((7, 5))
    alone[3, 2] = 1e-310
    assert distribute_in_proportion(alone, 2**32 - 1, 0)[3, 2] == 2**32 - 1
    for budget in (2**32, -1):
        with pytest.raises(ValueError, match="out of range"):
            distribute_in_proportion(alone, budget, 0)
    assert int(distribute_in_proportion(np.full((7, 5), 1e308), 2**33 + 3, 0).sum(dtype=np.int64)) == 2**33 + 3
    assert (distribute_in_proportion(np.zeros((7, 5)), 70, 0) == 2).all()
    ties = [distribute_in_proportion(np.ones((7, 5), np.uint32), 10, wave) for wave in range(50)]
    assert len({tie.tobytes() for tie in ties}) > 45
    assert all(tie.sum() == 10 and tie.max() == 1 for tie in ties)


@pytest.mark.parametrize("budget", [0, 1, 34, 35, 36, 1000, 2**33])
def test_uniform_allocation_is_even(budget):
    allocation = uniform_allocation((5, 7), budget, 2)
    assert allocation.dtype == np.uint32
    assert int(allocation.sum(dtype=np.int64)) == budget
    assert np.ptp(allocation.astype(np.int64)) <= 1


def test_the_remainder_changes_with_the_wave():
    """Over 4000 waves each of 64 pixels is about 1000 times among the 16 that get one sample more."""
    waves, pixels, rest = 4000, 64, 16
    times = sum(uniform_allocation((8, 8), rest, wave).astype(int) for wave in range(waves)).ravel()
    p = rest / pixels
    # Chi-square with 63 degrees of freedom; 114.1 is its 0.9999 quantile (false alarms: 1e-4).
    assert np.sum((times - waves * p) ** 2) / (waves * p * (1 - p)) * (1 - 1 / pixels) < 114.1
    # Consecutive waves are independent: shared pixels are hypergeometric, mean 4, variance 2.29; five sigma (6e-7).
    shared = [
        np.sum(uniform_allocation((8, 8), rest, wave) * uniform_allocation((8, 8), rest, wave + 1))
        for wave in range(waves)
    ]
    assert abs(np.mean(shared) - 4) < 5 * np.sqrt(2.29 / waves)


def test_memory_of_large_allocations():
    """With a million pixels: besides the input at most five float64 arrays at a time, and masks."""
    rng = np.random.default_rng(10)
    count = rng.integers(16, 1000, size=(1000, 1000), dtype=np.uint32)
    variance = 10.0 ** rng.uniform(-6, 6, size=count.shape)
    tracemalloc.start()
    deficit(count, variance, 8_000_000, 0, clip=0.999)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 6 * 8 * count.size
