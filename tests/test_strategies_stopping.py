"""Strategies that stop sampling converged pixels (purgathofer, cycles, dammertz): errors, convergence, blocks."""

import itertools
import math

import numpy as np
import pytest
from synthetic_statistics import make_statistics, noisy_statistics

from isonoise.strategies.cycles import Cycles, dilate, display_error
from isonoise.strategies.dammertz import Block, Dammertz
from isonoise.strategies.measures import confidence
from isonoise.strategies.purgathofer import Purgathofer

SHAPES = [(1, 1), (7, 5), (5, 7), (16, 33)]


def test_cycles_error_is_its_formula():
    s = noisy_statistics((5, 7))
    assert s.rgb.sum(axis=-1).min() < 1 < s.rgb.sum(axis=-1).max()
    for y, x in itertools.product(range(5), range(7)):
        whole, half = ([float(v) for v in image[y, x]] for image in (s.rgb, s.half))
        light = sum(whole)
        norm = math.sqrt(light) if light < 1 else light
        expected = sum(abs(a - b) for a, b in zip(whole, half, strict=True)) / (1e-4 + norm)
        assert display_error(s)[y, x] == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("shape", SHAPES)
def test_cycles_dilates_by_the_eight_neighbours(shape):
    active = np.random.default_rng(3).random(shape) < 0.1
    wide = dilate(active)
    for y, x in np.ndindex(shape):
        around = active[max(y - 1, 0) : y + 2, max(x - 1, 0) : x + 2]
        assert wide[y, x] == around.any()


def test_dammertz_block_error_and_split():
    error = np.random.default_rng(9).lognormal(0, 1, size=(40, 24))
    block = Block(8, 40, 4, 20)
    inside = error[8:40, 4:20]
    assert block.error(error) == pytest.approx(math.sqrt(inside.size / error.size) * inside.mean())
    cuts = [
        (Block(8, y, 4, 20), Block(y, 40, 4, 20))  # across the longer side, 8 pixels or more on either
        for y in range(16, 33)
    ]
    assert block.split(error, 8) == min(cuts, key=lambda cut: abs(cut[0].error(error) - cut[1].error(error)))
    assert block.split(error, 17) is None
    (first, second) = Block(0, 10, 0, 20).split(error, 10)
    assert (first, second) == (Block(0, 10, 0, 10), Block(0, 10, 10, 20))


@pytest.mark.parametrize("cls", [Purgathofer, Cycles, Dammertz])
def test_adaptive_waves_have_no_spp(cls):
    first, *later = itertools.islice(cls().waves(), 5)
    assert (first.kind, first.spp) == ("uniform", cls().first_test_spp)
    assert all((wave.kind, wave.spp) == ("adaptive", None) for wave in later)


def test_cycles_first_test():
    assert Cycles().first_test_spp == 80  # 64 samples; the first test at or after the one beyond that
    assert Cycles(threshold=0.1).first_test_spp == 48
    assert Cycles(threshold=1.0).first_test_spp == 32
    assert [Cycles(min_samples=n).first_test_spp for n in (1, 4, 14, 15, 30, 31)] == [16, 16, 16, 32, 32, 48]


def test_purgathofer_converges_below_the_tolerance():
    s = make_statistics(100, np.ones((1, 3)), [[0.9, 1.1, 0.0]])
    strategy = Purgathofer(tolerance=float(confidence(make_statistics(100, np.ones((1, 1)), 1.0), 0.05)[0, 0]))
    assert (strategy.allocate(s, None) > 0).tolist() == [[False, True, False]]


@pytest.mark.parametrize(("significance", "tolerance"), [(0.05, 0.05), (0.1, 0.025), (1e-3, 0.3)])
def test_purgathofer_needs_enough_equal_samples(significance, tolerance):
    least = math.log(significance) / math.log(1 - tolerance)
    n = np.arange(2, 200)[None]
    strategy = Purgathofer(significance=significance, tolerance=tolerance)
    active = strategy.allocate(make_statistics(n, np.full(n.shape, 0.7)), None) > 0
    assert (active == (n < least)).all()


@pytest.mark.parametrize(("cls", "reach"), [(Purgathofer, 0), (Cycles, 1)])
def test_converged_pixels_stay_converged_until_all_are(cls, reach):
    """Columns from 8 on are noisy. Then all are: those done stay done, but for neighbours where these are taken up."""
    column = np.arange(16)[None] * np.ones((16, 1))

    def state(noisy):
        return make_statistics(1000, np.ones((16, 16)), np.where(noisy, 1e3, 0.1), half=np.where(noisy, 1.5, 1.0))

    strategy = cls()
    assert ((strategy.allocate(state(column >= 8), None) > 0) == (column >= 8 - reach)).all()
    assert ((strategy.allocate(state(column >= 0), None) > 0) == (column >= 8 - 2 * reach)).all()
    strategy.allocate(state(column < 0), None)  # all are done
    assert (strategy.allocate(state(column >= 0), None) > 0).all()


def test_the_threshold_is_halved_when_all_pixels_have_converged():
    error = np.array([[1.0, 2.0, 3.0, 3.9]])
    strategy = Purgathofer(tolerance=0.4)
    t_se = confidence(make_statistics(100, np.ones((1, 4)), 1.0), 0.05)
    s = make_statistics(100, np.ones((1, 4)), (0.1 * error / t_se) ** 2)  # half intervals of 0.1, 0.2, 0.3, 0.39
    assert (strategy.allocate(s, None) > 0).tolist() == [[False, False, True, True]]  # at 0.2, not far from equality
    s = make_statistics(1600, np.ones((1, 4)), s.variance)  # a quarter of it: done at 0.2, and again at 0.1
    assert (strategy.allocate(s, None) > 0).tolist() == [[False, False, True, True]]  # at 0.05


def test_cycles_activates_neighbours():
    rgb = np.ones((9, 9))
    half = rgb.copy()
    half[4, 4] = 1.3  # 0.9 / 3.0001, above 5 * 0.01
    strategy = Cycles()
    active = strategy.allocate(make_statistics(80, rgb, half=half), None) > 0
    expected = np.zeros((9, 9), bool)
    expected[3:6, 3:6] = True
    assert (active == expected).all()
    # the neighbours are tested again, and take up theirs when they fail; others stay done
    half[3, 3], half[8, 8] = 1.3, 1.3
    active = strategy.allocate(make_statistics(96, rgb, half=half), None) > 0
    expected[2:5, 2:5] = True
    assert (active == expected).all()


def test_few_active_pixels_get_several_steps():
    half = np.ones((100, 100))
    half[50, 50] = 1.3
    strategy = Cycles()
    allocation = strategy.allocate(make_statistics(80, np.ones((100, 100)), half=half), None)
    assert set(allocation[allocation > 0].tolist()) == {80}  # 800,000 / 64 samples for 9 pixels, but none doubles
    strategy = Cycles()
    allocation = strategy.allocate(make_statistics(8000, np.ones((100, 100)), half=half), None)
    assert (set(allocation[allocation > 0].tolist()), np.count_nonzero(allocation)) == ({8000}, 9)
    strategy = Cycles()
    allocation = strategy.allocate(make_statistics(80, np.ones((100, 100)), half=np.full((100, 100), 1.3)), None)
    assert (allocation == 16).all()


def test_cycles_is_relative_above_one():
    s = noisy_statistics((16, 33), n=80)
    bright = make_statistics(80, s.rgb + 1, half=s.half + 1)
    scaled = make_statistics(80, bright.rgb * 2.0**20, half=bright.half * 2.0**20)
    # but for the 1e-4: a ten-thousandth of N
    assert display_error(scaled) == pytest.approx(display_error(bright), rel=1e-4)


def test_dammertz_blocks_split_and_stop():
    """Noise falls by 4 a test, evenly but for a corner of the image: it is sampled when all else has stopped."""
    strategy = Dammertz(threshold=0.01, smallest=8)
    noise = np.full((32, 64), 20.0)
    noise[:8, :8] = 100.0
    rng = np.random.default_rng(10)
    sampled, areas = [], []
    before = np.ones(noise.shape, bool)
    for test in range(6):
        half = 1 + noise * 4.0**-test * rng.uniform(0.5, 1.5, size=noise.shape) / 3 * math.sqrt(3)
        active = strategy.allocate(make_statistics(16 * (test + 1), np.ones(noise.shape), half=half), None) > 0
        assert (active <= before).all()  # stopped blocks stay stopped
        cover = np.zeros(noise.shape, int)
        for block in strategy._active_blocks:
            cover[block.pixels] += 1
        assert (cover == active).all()  # blocks do not overlap, and nothing else is sampled
        sampled.append(active.mean())
        areas.append([(b.bottom - b.top) * (b.right - b.left) for b in strategy._active_blocks])
        before = active
    assert areas[0] == [32 * 64]  # above 256 thresholds: as it is
    assert [len(a) for a in areas[2:5]] == [2, 4, 8]  # one split a test
    assert min(min(a) for a in areas) >= 64
    assert sampled[0] == 1
    assert 0 < sampled[-1] < 0.25
    assert active[:8, :8].all()


def test_dammertz_first_round_splits_once_per_test():
    strategy = Dammertz(threshold=0.004)
    half = 1 + np.random.default_rng(14).uniform(0.01, 0.02, size=(64, 64))
    for blocks in (2, 4, 8, 16):
        assert (strategy.allocate(make_statistics(16, np.ones((64, 64)), half=half), None) > 0).all()
        assert len(strategy._active_blocks) == blocks


def test_dammertz_new_round_tests_blocks_of_all_levels():
    """All have stopped but for the threshold; the half with more noise is found at once, on all levels."""
    half = np.where(np.arange(64) < 32, 1.0001, 1.01)[None] * np.ones((64, 1))
    strategy = Dammertz(threshold=0.5)
    active = strategy.allocate(make_statistics(16, np.ones((64, 64)), half=half), None) > 0
    assert active[:, 40:].any()
    assert not active[:, :24].any()
    assert min(b.right - b.left for b in strategy._active_blocks) == 8


def test_dammertz_smallest_block():
    for shape, smallest in (((7, 5), 8), ((16, 33), 8), ((40, 40), 3), ((1, 64), 1)):
        strategy = Dammertz(threshold=1e-9, smallest=smallest)
        half = 1 + np.random.default_rng(11).uniform(1e-8, 2e-8, size=shape).astype(np.float32) * 10
        for _ in range(14):
            strategy.allocate(make_statistics(16, np.ones(shape), half=half), None)
        for block in strategy._active_blocks:
            for side, whole in ((block.bottom - block.top, shape[0]), (block.right - block.left, shape[1])):
                assert side >= smallest or side == whole
