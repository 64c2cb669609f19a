"""Strategies of other renderers and papers: valid allocations of extreme statistics, determinism, parameters."""

import math

import numpy as np
import pytest
from synthetic_statistics import make_statistics, noisy_statistics

from isonoise.errors import UserError
from isonoise.render_scene import render
from isonoise.strategies import make_strategy
from isonoise.strategies.cycles import Cycles
from isonoise.strategies.dammertz import Dammertz
from isonoise.strategies.luxcore import LuxCore
from isonoise.strategies.purgathofer import Purgathofer
from isonoise.strategies.tungsten import Tungsten

STOPPING = [Purgathofer, Cycles, Dammertz]
PUBLISHED = [*STOPPING, Tungsten, LuxCore]
SHAPES = [(1, 1), (7, 5), (5, 7), (16, 33)]


def warmed_up(strategy):
    """The strategy after its first, uniform wave."""
    waves = strategy.waves()
    assert next(waves).kind == "uniform"
    return strategy, next(waves)


def pixel_index(shape) -> np.ndarray:
    return np.arange(math.prod(shape)).reshape(shape)


EXTREMES = {
    "noisy": noisy_statistics,
    "black": lambda shape: make_statistics(16, np.zeros(shape)),
    "nothing": lambda shape: make_statistics(0, np.zeros(shape)),
    "one each": lambda shape: make_statistics(1, np.ones(shape), half=np.zeros(shape)),
    "no half": lambda shape: make_statistics(pixel_index(shape) % 4, noisy_statistics(shape).rgb, 1.0),
    "constant": lambda shape: make_statistics(16, np.ones(shape)),
    "all rejected": lambda shape: make_statistics(0, np.zeros(shape), rejected=16),
    "one rejected": lambda shape: make_statistics(
        np.where(pixel_index(shape) == 0, 0, 16),
        np.where(pixel_index(shape) == 0, 0, 1),
        1.0,
        half=np.full(shape, 0.5),
        rejected=np.where(pixel_index(shape) == 0, 16, 0),
    ),
    "one pixel": lambda shape: make_statistics(
        16,
        np.ones(shape),
        np.where(pixel_index(shape) == math.prod(shape) // 2, 1e30, 0),
        half=np.where(pixel_index(shape) == math.prod(shape) // 2, 1e15, 1),
    ),
    "huge": lambda shape: noisy_statistics(shape, scale=1e30),
    "tiny": lambda shape: noisy_statistics(shape, scale=1e-30),
    "negative": lambda shape: make_statistics(16, np.full(shape, -1.0), 1.0, half=np.zeros(shape)),
    "many": lambda shape: make_statistics(2**31, np.ones(shape), 1.0, half=np.full(shape, 1.1)),
}


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("extreme", EXTREMES)
@pytest.mark.parametrize("cls", PUBLISHED)
def test_allocations_of_extreme_statistics_are_valid(cls, extreme, shape):
    s = EXTREMES[extreme](shape)
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
            if extreme in ("black", "nothing", "one each", "constant", "all rejected"):
                assert np.ptp(allocation) == 0
            if extreme == "one pixel" and cls in (Purgathofer, Cycles, Tungsten):
                assert allocation.ravel()[pixels // 2] >= allocation.max() - 1
            if extreme == "one rejected" and cls in STOPPING and pixels > 1:
                assert allocation[0, 0] == 0


@pytest.mark.parametrize("cls", PUBLISHED)
def test_strategies_are_deterministic_and_reusable(cls):
    first, second = cls(), cls()
    maps = []
    for strategy in (first, second, first):
        wave = warmed_up(strategy)[1]
        budget = None if wave.spp is None else round(wave.spp * 16 * 33)
        maps.append([strategy.allocate(noisy_statistics((16, 33), n=n), budget) for n in (16, 48, 80, 200)])
    for other in maps[1:]:
        assert all((a == b).all() for a, b in zip(maps[0], other, strict=True))


@pytest.mark.parametrize("power", [-20, 20])
@pytest.mark.parametrize("cls", PUBLISHED)
def test_which_strategies_depend_on_the_brightness(cls, power):
    """LuxCore's errors are normalised, so nothing. The others compare with numbers in the scene's units, as
    published; Tungsten only where a block's mean is below sqrt(1e-3): none here, but all with 2^-20 of the light."""
    plain, scaled = (
        [noisy_statistics((16, 33), n=n, seed=n, scale=scale) for n in (200, 2000)] for scale in (1.0, 2.0**power)
    )
    maps = []
    for statistics in (plain, scaled):
        strategy, wave = warmed_up(cls(threshold=0.01) if cls is Dammertz else cls())
        budget = None if wave.spp is None else round(wave.spp * 16 * 33)
        maps.append(np.array([strategy.allocate(s, budget) for s in statistics for _ in range(3)]))
    same = (maps[0] == maps[1]).all()
    assert same == (cls is LuxCore or (cls is Tungsten and power > 0))


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


@pytest.mark.parametrize("cls", PUBLISHED)
def test_a_render_ends_with_the_requested_samples(cls):
    # so small an image has no blocks small enough to stop at Dammertz' own threshold within seconds
    strategy = cls(threshold=0.05) if cls is Dammertz else cls()
    outcome = render("cornell", spp=150.5, size=(32, 32), strategy=strategy)
    assert outcome.reason == "spp"
    count = outcome.statistics.count
    assert outcome.statistics.samples == round(150.5 * 32 * 32)
    assert [row.kind for row in outcome.rows][:2] == ["uniform", "adaptive"]
    assert count.max() > 1.2 * count.min()
    assert np.isfinite(outcome.statistics.rgb).all()
