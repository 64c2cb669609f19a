"""Other renderers' and papers' strategies: formulas against plain loops, what is done stays done, blocks, edges."""

import itertools
import math

import numpy as np
import pytest

from isonoise.errors import UserError
from isonoise.loop import render
from isonoise.statistics import Statistics
from isonoise.strategies import describe, make_strategy
from isonoise.strategies.cycles import Cycles, display_error, with_neighbours
from isonoise.strategies.dammertz import Block, Dammertz
from isonoise.strategies.luxcore import LuxCore, change, importance
from isonoise.strategies.measures import confidence, half_buffer
from isonoise.strategies.purgathofer import Purgathofer
from isonoise.strategies.tungsten import Tungsten, block_error, carried, clamped, dilated

RETIRING = [Purgathofer, Cycles, Dammertz]
RIVALS = [*RETIRING, Tungsten, LuxCore]
SHAPES = [(1, 1), (7, 5), (5, 7), (16, 33)]
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


def of_samples(x: np.ndarray) -> Statistics:
    """Statistics of RGB samples (n, height, width, 3)."""
    y = x @ LUMINANCE
    count = np.full(x.shape[1:3], len(x), np.uint32)
    variance = y.var(axis=0, ddof=1) if len(x) > 1 else np.zeros(y.shape[1:])
    half = x[1::2].mean(axis=0) if len(x) > 1 else np.zeros(x.shape[1:])
    mean = x.mean(axis=0).astype(np.float32)
    return Statistics(count, np.zeros_like(count), mean, y.mean(axis=0), variance, None, None, half.astype(np.float32))


def made(count, rgb, variance=0.0, half=None, rejected=0) -> Statistics:
    """Statistics of the shape of `rgb` without its channels; grey where `rgb` is two-dimensional."""
    rgb = np.asarray(rgb, dtype=np.float32)
    rgb = np.repeat(rgb[..., None], 3, axis=-1) if rgb.ndim == 2 else rgb
    shape = rgb.shape[:2]
    half = rgb if half is None else np.asarray(half, np.float32)
    half = np.repeat(half[..., None], 3, axis=-1) if half.ndim == 2 else half
    count, rejected = (np.broadcast_to(np.asarray(a, np.uint32), shape).copy() for a in (count, rejected))
    variance = np.broadcast_to(np.asarray(variance, np.float64), shape).copy()
    return Statistics(count, rejected, rgb, rgb @ LUMINANCE, variance, None, None, half)


def noisy(shape, n=16, seed=1, scale=1.0) -> Statistics:
    rng = np.random.default_rng(seed)
    brightness = np.exp(rng.normal(-1, 1.5, size=(*shape, 1)))
    return of_samples(scale * brightness * rng.gamma(0.5, 2.0, size=(n, *shape, 3)))


def warmed_up(strategy):
    """The strategy after its first, uniform wave."""
    waves = strategy.waves()
    assert next(waves).kind == "uniform"
    return strategy, next(waves)


def allocate(strategy, statistics) -> np.ndarray:
    wave = warmed_up(strategy)[1] if isinstance(strategy, LuxCore | Tungsten) else None
    if wave is None:
        return strategy.allocate(statistics, None)
    return strategy.allocate(statistics, round(wave.spp * statistics.count.size))


# Formulas.


def test_half_buffer_is_its_formula():
    s = noisy((5, 7))
    for y, x in itertools.product(range(5), range(7)):
        whole, half = ([float(v) for v in image[y, x]] for image in (s.rgb, s.half))
        expected = sum(abs(a - b) for a, b in zip(whole, half, strict=True)) / math.sqrt(sum(whole))
        assert half_buffer(s)[y, x] == pytest.approx(expected, rel=1e-12)


def test_half_buffer_at_the_edges():
    s = made([[0, 1, 2, 2]], [[0.0, 3.0, 3.0, 0.0]], half=[[0.0, 0.0, 3.0, 0.0]])
    assert half_buffer(s).tolist() == [[math.inf, math.inf, 0.0, 0.0]]


def test_confidence_is_half_of_the_interval():
    s = made([[2, 2, 10, 0, 1]], np.ones((1, 5)), [[2.0, 0.0, 10.0, 0.0, 0.0]])
    assert confidence(s, 0.05)[0] == pytest.approx([12.7062047, 0.0, 2.26215716, math.inf, math.inf])
    assert confidence(s, 0.5)[0, 0] == pytest.approx(1.0)  # tan(pi / 4)


def test_the_interval_holds_the_mean_as_often_as_it_says():
    """Of 4 normal samples in 100,000 pixels; 4.4 standard deviations of a binomial share (false alarms: 1e-5)."""
    rng = np.random.default_rng(2)
    s = of_samples(np.repeat(5 + rng.normal(size=(4, 250, 400, 1)), 3, axis=-1))
    for significance in (0.01, 0.05, 0.3):
        missed = np.mean(np.abs(s.mean - 5) > confidence(s, significance))
        assert missed == pytest.approx(significance, abs=4.4 * math.sqrt(significance / 1e5))


def test_cycles_error_is_its_formula():
    s = noisy((5, 7))
    assert s.rgb.sum(axis=-1).min() < 1 < s.rgb.sum(axis=-1).max()
    for y, x in itertools.product(range(5), range(7)):
        whole, half = ([float(v) for v in image[y, x]] for image in (s.rgb, s.half))
        light = sum(whole)
        norm = math.sqrt(light) if light < 1 else light
        expected = sum(abs(a - b) for a, b in zip(whole, half, strict=True)) / (1e-4 + norm)
        assert display_error(s)[y, x] == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("shape", SHAPES)
def test_neighbours_are_the_eight_around(shape):
    active = np.random.default_rng(3).random(shape) < 0.1
    wide = with_neighbours(active)
    for y, x in np.ndindex(shape):
        around = active[max(y - 1, 0) : y + 2, max(x - 1, 0) : x + 2]
        assert wide[y, x] == around.any()


@pytest.mark.parametrize("shape", SHAPES)
def test_tungsten_blocks_are_those_of_all_their_samples(shape):
    rng = np.random.default_rng(4)
    x = np.repeat(rng.gamma(0.5, 0.3, size=(6, *shape, 1)), 3, axis=-1)
    error = block_error(of_samples(x))
    assert error.shape == (-(-shape[0] // 4), -(-shape[1] // 4))
    for by, bx in np.ndindex(error.shape):
        samples = x[:, 4 * by : 4 * by + 4, 4 * bx : 4 * bx + 4, 0].ravel()
        expected = samples.var(ddof=1) / (samples.size * max(samples.mean() ** 2, 1e-3))
        assert error[by, bx] == pytest.approx(expected, rel=1e-9)


def test_tungsten_clamps_at_the_95th_percentile_of_errors_above_zero():
    error = np.concatenate([np.arange(1.0, 101), np.zeros(50), [np.inf]]).reshape(1, -1)
    assert clamped(error).max() == 96  # the element 100 * 95 / 100, from 0
    assert clamped(error)[0, -1] == 96
    assert (clamped(error)[0, 100:150] == 0).all()
    assert clamped(np.array([[0.0, np.inf]])).tolist() == [[0.0, 1.0]]


@pytest.mark.parametrize("shape", SHAPES)
def test_tungsten_dilates_in_two_sweeps(shape):
    error = np.random.default_rng(5).random(shape)
    offsets = [(0, 0), (0, 1), (0, -1), (1, 0), (-1, 0), (1, -1), (-1, 1)]
    for y, x in np.ndindex(shape):
        near = [(y + a, x + b) for a, b in offsets if 0 <= y + a < shape[0] and 0 <= x + b < shape[1]]
        assert dilated(error)[y, x] == max(error[at] for at in near)


@pytest.mark.parametrize("start", [0.0, 0.3, 0.999])
def test_fractions_are_carried(start):
    rng = np.random.default_rng(6)
    share = rng.lognormal(0, 2, size=(13, 17))
    for budget in (1, 100, 10**6):
        counts = carried(share * (budget / share.sum()), budget, start).astype(np.int64)
        assert counts.sum() == budget
        exact = np.cumsum(share) * (budget / share.sum())
        assert (np.abs(np.cumsum(counts) - exact) < 1 + 1e-6).all()


def test_luxcore_error_is_its_formula():
    a, b = noisy((9, 11), seed=7).rgb, noisy((9, 11), seed=8).rgb
    a[2, 3] = 0
    b[2, 3] = 1
    error = np.zeros((9, 11))
    for y, x in np.ndindex(9, 11):
        light = sum(map(float, a[y, x]))
        difference = sum(abs(float(p) - float(q)) for p, q in zip(a[y, x], b[y, x], strict=True))
        error[y, x] = difference / math.sqrt(light) if light else 0
    assert change(a, b) == pytest.approx(error, rel=1e-12)

    mean = np.zeros((9, 11))
    for y, x in np.ndindex(9, 11):
        mean[y, x] = error[max(y - 4, 0) : min(y + 4, 9), max(x - 4, 0) : min(x + 4, 11)].mean()
    score = np.clip((mean - mean.mean()) / mean.std(), -6, 6)
    expected = (score - score.min()) / (score.max() - score.min())
    assert importance(error, 4) == pytest.approx(expected, abs=1e-9)


def test_luxcore_cuts_at_six_sigma():
    """One pixel in 10,000: it is 100 standard deviations from the mean, the others a hundredth of one."""
    error = np.full((100, 100), 1.0)
    error[::2] = 2.0
    error[50, 50] = 1e6
    noise = importance(error, 1)
    assert noise.max() == 1
    window = error[49:51, 49:51].mean()
    assert noise[10, 10] < 0.01
    assert (noise == 1).sum() == 4
    mean, deviation = 4 * window / 1e4, 2 * window / 1e2  # of four windows that hold the pixel
    assert (window - mean) / deviation > 6


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


# What is done, and what is not.


@pytest.mark.parametrize("cls", RETIRING)
def test_the_schedule_leaves_the_number_to_the_map(cls):
    first, *later = itertools.islice(cls().waves(), 5)
    assert (first.kind, first.spp) == ("uniform", cls().first)
    assert all((wave.kind, wave.spp) == ("adaptive", None) for wave in later)


def test_tests_of_cycles_begin_where_cycles_begins():
    assert Cycles().first == 80  # 64 samples; the first test at or after the one beyond that
    assert Cycles(threshold=0.1).first == 48
    assert Cycles(threshold=1.0).first == 32
    assert [Cycles(min_samples=n).first for n in (1, 4, 14, 15, 30, 31)] == [16, 16, 16, 32, 32, 48]


def test_purgathofer_is_done_below_the_tolerance():
    s = made(100, np.ones((1, 3)), [[0.9, 1.1, 0.0]])
    strategy = Purgathofer(tolerance=float(confidence(made(100, np.ones((1, 1)), 1.0), 0.05)[0, 0]))
    assert (strategy.allocate(s, None) > 0).tolist() == [[False, True, False]]


@pytest.mark.parametrize(("significance", "tolerance"), [(0.05, 0.05), (0.1, 0.025), (1e-3, 0.3)])
def test_equal_samples_are_trusted_when_there_are_enough(significance, tolerance):
    least = math.log(significance) / math.log(1 - tolerance)
    n = np.arange(2, 200)[None]
    strategy = Purgathofer(significance=significance, tolerance=tolerance)
    active = strategy.allocate(made(n, np.full(n.shape, 0.7)), None) > 0
    assert (active == (n < least)).all()


@pytest.mark.parametrize(("cls", "reach"), [(Purgathofer, 0), (Cycles, 1)])
def test_done_pixels_stay_done_until_all_are(cls, reach):
    """Columns from 8 on are noisy. Then all are: those done stay done, but for neighbours where these are taken up."""
    column = np.arange(16)[None] * np.ones((16, 1))

    def state(noisy):
        return made(1000, np.ones((16, 16)), np.where(noisy, 1e3, 0.1), half=np.where(noisy, 1.5, 1.0))

    strategy = cls()
    assert ((strategy.allocate(state(column >= 8), None) > 0) == (column >= 8 - reach)).all()
    assert ((strategy.allocate(state(column >= 0), None) > 0) == (column >= 8 - 2 * reach)).all()
    strategy.allocate(state(column < 0), None)  # all are done
    assert (strategy.allocate(state(column >= 0), None) > 0).all()


def test_the_threshold_is_halved_when_all_are_done():
    error = np.array([[1.0, 2.0, 3.0, 3.9]])
    strategy = Purgathofer(tolerance=0.4)
    t_se = confidence(made(100, np.ones((1, 4)), 1.0), 0.05)
    s = made(100, np.ones((1, 4)), (0.1 * error / t_se) ** 2)  # half intervals of 0.1, 0.2, 0.3, 0.39
    assert (strategy.allocate(s, None) > 0).tolist() == [[False, False, True, True]]  # at 0.2, not far from equality
    s = made(1600, np.ones((1, 4)), s.variance)  # a quarter of it: done at 0.2, and again at 0.1
    assert (strategy.allocate(s, None) > 0).tolist() == [[False, False, True, True]]  # at 0.05


def test_cycles_takes_up_the_neighbours():
    rgb = np.ones((9, 9))
    half = rgb.copy()
    half[4, 4] = 1.3  # 0.9 / 3.0001, above 5 * 0.01
    strategy = Cycles()
    active = strategy.allocate(made(80, rgb, half=half), None) > 0
    expected = np.zeros((9, 9), bool)
    expected[3:6, 3:6] = True
    assert (active == expected).all()
    # the neighbours are tested again, and take up theirs when they fail; others stay done
    half[3, 3], half[8, 8] = 1.3, 1.3
    active = strategy.allocate(made(96, rgb, half=half), None) > 0
    expected[2:5, 2:5] = True
    assert (active == expected).all()


def test_active_pixels_get_a_step_or_several_where_they_are_few():
    half = np.ones((100, 100))
    half[50, 50] = 1.3
    strategy = Cycles()
    allocation = strategy.allocate(made(80, np.ones((100, 100)), half=half), None)
    assert set(allocation[allocation > 0].tolist()) == {80}  # 800,000 / 64 samples for 9 pixels, but none doubles
    strategy = Cycles()
    allocation = strategy.allocate(made(8000, np.ones((100, 100)), half=half), None)
    assert (set(allocation[allocation > 0].tolist()), np.count_nonzero(allocation)) == ({8000}, 9)
    strategy = Cycles()
    allocation = strategy.allocate(made(80, np.ones((100, 100)), half=np.full((100, 100), 1.3)), None)
    assert (allocation == 16).all()


# Dammertz' blocks.


def test_blocks_split_and_stop():
    """Noise falls by 4 a test, evenly but for a corner of the image: it is sampled when all else has stopped."""
    strategy = Dammertz(threshold=0.01, smallest=8)
    noise = np.full((32, 64), 20.0)
    noise[:8, :8] = 100.0
    rng = np.random.default_rng(10)
    sampled, areas = [], []
    before = np.ones(noise.shape, bool)
    for test in range(6):
        half = 1 + noise * 4.0**-test * rng.uniform(0.5, 1.5, size=noise.shape) / 3 * math.sqrt(3)
        active = strategy.allocate(made(16 * (test + 1), np.ones(noise.shape), half=half), None) > 0
        assert (active <= before).all()  # stopped blocks stay stopped
        cover = np.zeros(noise.shape, int)
        for block in strategy._blocks:
            cover[block.pixels] += 1
        assert (cover == active).all()  # blocks do not overlap, and nothing else is sampled
        sampled.append(active.mean())
        areas.append([(b.bottom - b.top) * (b.right - b.left) for b in strategy._blocks])
        before = active
    assert areas[0] == [32 * 64]  # above 256 thresholds: as it is
    assert [len(a) for a in areas[2:5]] == [2, 4, 8]  # one split a test
    assert min(min(a) for a in areas) >= 64
    assert sampled[0] == 1
    assert 0 < sampled[-1] < 0.25
    assert active[:8, :8].all()


def test_the_first_round_splits_once_a_test():
    strategy = Dammertz(threshold=0.004)
    half = 1 + np.random.default_rng(14).uniform(0.01, 0.02, size=(64, 64))
    for blocks in (2, 4, 8, 16):
        assert (strategy.allocate(made(16, np.ones((64, 64)), half=half), None) > 0).all()
        assert len(strategy._blocks) == blocks


def test_a_new_round_of_blocks_begins_with_the_image_and_uses_what_is_known():
    """All have stopped but for the threshold; the half with more noise is found at once, on all levels."""
    half = np.where(np.arange(64) < 32, 1.0001, 1.01)[None] * np.ones((64, 1))
    strategy = Dammertz(threshold=0.5)
    active = strategy.allocate(made(16, np.ones((64, 64)), half=half), None) > 0
    assert active[:, 40:].any()
    assert not active[:, :24].any()
    assert min(b.right - b.left for b in strategy._blocks) == 8


def test_no_block_becomes_narrower_than_the_least():
    for shape, smallest in (((7, 5), 8), ((16, 33), 8), ((40, 40), 3), ((1, 64), 1)):
        strategy = Dammertz(threshold=1e-9, smallest=smallest)
        half = 1 + np.random.default_rng(11).uniform(1e-8, 2e-8, size=shape).astype(np.float32) * 10
        for _ in range(14):
            strategy.allocate(made(16, np.ones(shape), half=half), None)
        for block in strategy._blocks:
            for side, whole in ((block.bottom - block.top, shape[0]), (block.right - block.left, shape[1])):
                assert side >= smallest or side == whole


# Shares.


@pytest.mark.parametrize("budget", [0, 1, 34, 35, 36, 560, 10**6])
def test_tungsten_gives_every_pixel_one_and_the_rest_by_error(budget):
    s = noisy((7, 5))
    allocation = Tungsten().allocate(s, budget)
    assert allocation.sum() == budget
    if budget >= 35:
        assert allocation.min() >= 1
        weights = dilated(clamped(block_error(s)))[np.arange(7)[:, None] // 4, np.arange(5) // 4]
        share = 1 + (budget - 35) * weights / weights.sum()
        assert np.abs(allocation - share).max() < 2


def test_tungsten_carries_elsewhere_in_every_wave():
    """Half a sample each on average: over many waves all pixels get as many."""
    times = np.zeros((8, 8))
    for wave in range(400):
        times += Tungsten().allocate(made(16 + wave, np.ones((8, 8)), 1.0), 64 + 32) - 1
    assert times.sum() == 400 * 32
    assert np.ptp(times) <= 12


def test_luxcore_tests_against_the_image_of_the_test_before():
    strategy, wave = warmed_up(LuxCore(scale=1))
    assert (wave.kind, wave.spp) == ("adaptive", 32)
    image = np.ones((10, 10))
    budget = 32 * 100
    assert (strategy.allocate(made(32, image), budget) == 32).all()  # nothing to compare with yet
    changed = image.copy()
    changed[3, 3] = 2.0
    first = strategy.allocate(made(64, changed), budget)
    assert first[3, 3] == first[4, 4] == first.max() > 10 * first.min()
    # until there are 32 samples per pixel more, the weights stay
    again = strategy.allocate(made(95, image), budget).astype(int)
    assert np.abs(again - first).max() <= 1
    changed[7, 7] = 2.0
    second = strategy.allocate(made(96, changed), budget)  # compared with the image of 64, not of 95
    assert second[7, 7] > 10 * second[3, 3]
    # a new render begins without an image
    next(strategy.waves())
    assert (strategy.allocate(made(64, image), budget) == 32).all()


@pytest.mark.parametrize("strength", [0.0, 0.5, 0.95])
def test_luxcore_keeps_its_floor(strength):
    strategy, _ = warmed_up(LuxCore(strength=strength))
    strategy.allocate(noisy((30, 40), seed=12), 32 * 1200)
    allocation = strategy.allocate(noisy((30, 40), n=64, seed=13), 10**6)
    assert allocation.sum() == 10**6
    assert allocation.min() >= (1 - strength) * allocation.max() - 1
    assert allocation.min() <= (1 - strength) * allocation.max() + 1


# The edges.

EDGES = {
    "noisy": noisy,
    "black": lambda shape: made(16, np.zeros(shape)),
    "nothing": lambda shape: made(0, np.zeros(shape)),
    "one each": lambda shape: made(1, np.ones(shape), half=np.zeros(shape)),
    "no half": lambda shape: made(np.arange(math.prod(shape)).reshape(shape) % 4, noisy(shape).rgb, 1.0),
    "constant": lambda shape: made(16, np.ones(shape)),
    "all rejected": lambda shape: made(0, np.zeros(shape), rejected=16),
    "one rejected": lambda shape: made(
        np.where(np.arange(math.prod(shape)).reshape(shape) == 0, 0, 16),
        np.where(np.arange(math.prod(shape)).reshape(shape) == 0, 0, 1),
        1.0,
        half=np.full(shape, 0.5),
        rejected=np.where(np.arange(math.prod(shape)).reshape(shape) == 0, 16, 0),
    ),
    "one pixel": lambda shape: made(
        16,
        np.ones(shape),
        np.where(np.arange(math.prod(shape)).reshape(shape) == math.prod(shape) // 2, 1e30, 0),
        half=np.where(np.arange(math.prod(shape)).reshape(shape) == math.prod(shape) // 2, 1e15, 1),
    ),
    "huge": lambda shape: noisy(shape, scale=1e30),
    "tiny": lambda shape: noisy(shape, scale=1e-30),
    "negative": lambda shape: made(16, np.full(shape, -1.0), 1.0, half=np.zeros(shape)),
    "many": lambda shape: made(2**31, np.ones(shape), 1.0, half=np.full(shape, 1.1)),
}


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("edge", EDGES)
@pytest.mark.parametrize("cls", RIVALS)
def test_maps_are_sound_at_the_edges(cls, edge, shape):
    s = EDGES[edge](shape)
    pixels = s.count.size
    strategy, wave = warmed_up(cls())
    with np.errstate(all="raise", under="ignore"):
        for _ in range(3):
            budget = None if wave.spp is None else round(wave.spp * pixels)
            allocation = strategy.allocate(s, budget)
            assert allocation.dtype == np.uint32
            assert allocation.shape == shape
            total = int(allocation.sum(dtype=np.int64))
            assert total >= 1 if budget is None else total == budget
            if edge in ("black", "nothing", "one each", "constant", "all rejected"):
                assert np.ptp(allocation) == 0
            if edge == "one pixel" and cls in (Purgathofer, Cycles, Tungsten):
                assert allocation.ravel()[pixels // 2] >= allocation.max() - 1
            if edge == "one rejected" and cls in RETIRING and pixels > 1:
                assert allocation[0, 0] == 0


@pytest.mark.parametrize("cls", RIVALS)
def test_two_objects_do_the_same_and_one_serves_several_renders(cls):
    first, second = cls(), cls()
    maps = []
    for strategy in (first, second, first):
        wave = warmed_up(strategy)[1]
        budget = None if wave.spp is None else round(wave.spp * 16 * 33)
        maps.append([strategy.allocate(noisy((16, 33), n=n), budget) for n in (16, 48, 80, 200)])
    for other in maps[1:]:
        assert all((a == b).all() for a, b in zip(maps[0], other, strict=True))


# The scene's brightness.


@pytest.mark.parametrize("power", [-20, 20])
@pytest.mark.parametrize("cls", RIVALS)
def test_what_scaling_the_light_changes(cls, power):
    """LuxCore's errors are normalised, so nothing. The others compare with numbers in the scene's units, as
    published; Tungsten only where a block's mean is below sqrt(1e-3): none here, but all with 2^-20 of the light."""
    plain, scaled = ([noisy((16, 33), n=n, seed=n, scale=scale) for n in (200, 2000)] for scale in (1.0, 2.0**power))
    maps = []
    for statistics in (plain, scaled):
        strategy, wave = warmed_up(cls(threshold=0.01) if cls is Dammertz else cls())
        budget = None if wave.spp is None else round(wave.spp * 16 * 33)
        maps.append(np.array([strategy.allocate(s, budget) for s in statistics for _ in range(3)]))
    same = (maps[0] == maps[1]).all()
    assert same == (cls is LuxCore or (cls is Tungsten and power > 0))


def test_cycles_is_relative_above_one():
    s = noisy((16, 33), n=80)
    bright = made(80, s.rgb + 1, half=s.half + 1)
    scaled = made(80, bright.rgb * 2.0**20, half=bright.half * 2.0**20)
    # but for the 1e-4: a ten-thousandth of N
    assert display_error(scaled) == pytest.approx(display_error(bright), rel=1e-4)


# As strategies.


@pytest.mark.parametrize("cls", RIVALS)
def test_they_go_by_name_and_describe_themselves(cls):
    strategy = make_strategy(cls.name)
    assert type(strategy) is cls
    again = make_strategy(describe(strategy))
    assert vars(again) == vars(strategy)
    assert all(
        f"- `{key}`" in cls.__doc__ for key in describe(strategy).partition(":")[2].replace("=", ",").split(",")[::2]
    )


@pytest.mark.parametrize(
    "spec",
    [
        "purgathofer:significance=0.6",
        "purgathofer:tolerance=1",
        "purgathofer:warmup=1",
        "cycles:threshold=0",
        "cycles:min_samples=-1",
        "dammertz:threshold=2",
        "dammertz:step=1",
        "dammertz:smallest=0",
        "tungsten:warmup=1",
        "tungsten:step=0",
        "luxcore:strength=0.96",
        "luxcore:scale=0",
        "luxcore:step=0",
    ],
)
def test_parameters_out_of_range(spec):
    with pytest.raises(UserError, match="out of range"):
        make_strategy(spec)


@pytest.mark.parametrize("cls", RIVALS)
def test_a_render_ends_with_the_samples_asked_for(cls):
    # so small an image has no blocks small enough to stop at Dammertz' own threshold within seconds
    strategy = cls(threshold=0.05) if cls is Dammertz else cls()
    outcome = render("cornell", spp=150.5, size=(32, 32), strategy=strategy)
    assert outcome.reason == "spp"
    count = outcome.statistics.count
    assert outcome.statistics.samples == round(150.5 * 32 * 32)
    assert [row.kind for row in outcome.rows][:2] == ["uniform", "adaptive"]
    assert count.max() > 1.2 * count.min()
    assert np.isfinite(outcome.statistics.rgb).all()
