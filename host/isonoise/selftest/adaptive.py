"""Cases of adaptive rendering where the noise is as uneven, or as even, as it can be."""

from collections.abc import Iterator

import numpy as np

from isonoise.selftest.core import Bench, Case, count, worst
from isonoise.selftest.scenes import area, lamp_over_floor, looking, rgb, scene
from isonoise.statistics import Statistics
from isonoise.strategies import make_strategy

SHAPE = (32, 32)
PIXELS = SHAPE[0] * SHAPE[1]
STRATEGIES = ("pooled", "relative-median", "relative-mean", "absolute", "tsallis")
BUDGET = 20 * PIXELS


def adaptive_cases(bench: Bench) -> Iterator[Case]:
    """All cases of the group."""
    yield from _one_noisy_pixel()
    yield from _black_but_for_one_pixel(bench)
    yield from _constant(bench)
    yield from _scaled_emitters(bench)


def _statistics(mean: np.ndarray, variance: np.ndarray, n: int = 16) -> Statistics:
    return Statistics(
        count=np.full(SHAPE, n, np.uint32),
        rejected=np.zeros(SHAPE, np.uint32),
        rgb=np.repeat(mean[..., None], 3, axis=-1).astype(np.float32),
        mean=mean,
        variance=variance,
        median=0.9 * mean,
    )


def _allocations(statistics: Statistics, budget: int = BUDGET) -> dict[str, np.ndarray]:
    return {name: make_strategy(name).allocate(statistics, budget) for name in STRATEGIES}


def _one_noisy_pixel() -> Iterator[Case]:
    """Wave after wave, the true variances being those given: what all others get must not vanish."""
    variance = np.ones(SHAPE)
    variance[16, 16] = 1e6
    for name in STRATEGIES:
        strategy, n = make_strategy(name), np.full(SHAPE, 16, np.int64)
        total, samples = 0, n.sum()
        for wave in strategy.waves():
            if samples > 400 * PIXELS:
                break
            budget = round((wave.spp or 1) * PIXELS)
            given = np.full(SHAPE, budget // PIXELS)
            if wave.kind == "adaptive":
                statistics = _statistics(np.ones(SHAPE), variance)
                statistics = Statistics(**vars(statistics) | {"count": n.astype(np.uint32)})
                given = strategy.allocate(statistics, budget)
                total += int(given.sum(dtype=np.int64)) != budget
            n = n + given
            samples = n.sum()
        yield count(f"a pixel of 10^6 times the variance, {name}: waves off their budget", total, "exact")
        rest = np.delete(n.ravel(), 16 * SHAPE[1] + 16)
        # uniform waves bring at least 1 / (1 + ratio) of all samples; ratio 1 at most
        least = 0.45 * 400
        yield count(
            "... other pixels that starve", rest < least, f"each has {least:g} of 400 samples from uniform waves"
        )


def _black_but_for_one_pixel(bench: Bench) -> Iterator[Case]:
    mean, variance = np.zeros(SHAPE), np.zeros(SHAPE)
    mean[5, 7], variance[5, 7] = 1e-3, 1e-4
    for name, allocation in _allocations(_statistics(mean, variance)).items():
        total = int(allocation.sum(dtype=np.int64))
        yield count(f"black but for one pixel, {name}: samples of the wave", total, "exact", BUDGET)
        yield count("... pixels with more than the one that is lit", allocation > allocation[5, 7], "none may have")
    # a lamp over a fifth of a pixel
    lamp = {"type": "sphere", "center": [0.03, 0.0, 0.03], "radius": 0.012} | area(1.0)
    dark = scene(looking((0.0, -1.0, 0.0), (0.0, 0.0, 0.0)), 16, 1, lamp=lamp)
    for name in STRATEGIES:
        statistics = _rendered(bench, dark, name)
        most = np.array(np.unravel_index(statistics.count.argmax(), statistics.shape))
        found = np.argwhere(statistics.mean > 0)
        yield count(f"render of a small lamp in the dark, {name}: pixels lit", len(found), "it lies within one", 1)
        far = np.abs(found - most).max() if len(found) else np.inf
        yield Case("... pixels from there to the one with most samples", far, 0, 1, "`pooled` reckons with neighbours")


def _constant(bench: Bench) -> Iterator[Case]:
    for value in (0.0, 0.5):
        statistics = _statistics(np.full(SHAPE, value), np.zeros(SHAPE))
        for name, allocation in _allocations(statistics, BUDGET + 100).items():
            uneven = int(allocation.max()) - int(allocation.min())
            yield Case(
                f"constant image of {value:g}, {name}: most less least", uneven, 1, 0, "even, up to the remainder"
            )

    view = looking((0.0, -3.0, 0.0), (0.0, 0.0, 0.0))
    sky = scene(view, 16, 1, sky={"type": "constant", "radiance": rgb((0.2, 0.3, 0.4))})
    for name in STRATEGIES:
        statistics = _rendered(bench, sky, name)
        uneven = int(statistics.count.max()) - int(statistics.count.min())
        yield Case(
            f"render of a constant sky, {name}: most less least samples", uneven, 0, 8, "a remainder a wave of 8"
        )
        yield count("... variances other than 0", statistics.variance, "exact")


def _rendered(bench: Bench, of: dict, strategy: str, waves: int = 8) -> Statistics:
    from isonoise.renderer import Renderer

    renderer = Renderer(of, bench.choice, strategy, seed=3, pool_size=2**14)
    for _ in range(waves):
        renderer.step()
    return renderer.statistics()


def _scaled_emitters(bench: Bench) -> Iterator[Case]:
    """A render with lights so much brighter or dimmer: the same samples, so the same maps."""

    def counts(factor: float, strategy: str) -> tuple[np.ndarray, np.ndarray]:
        statistics = _rendered(bench, lamp_over_floor(factor), strategy, 6)
        return statistics.count.astype(np.float64), statistics.mean / factor

    for strategy in ("pooled:warmup=8", "relative-median:warmup=8,growth=0.5"):
        name = strategy.partition(":")[0]
        plain, image = counts(1.0, strategy)
        differ = sum(np.count_nonzero(counts(f, strategy)[0] != plain) for f in (2.0**20, 2.0**-20))
        yield count(f"emitters times 2^20 and 2^-20, {name}: counts that differ", differ, "exact")
        for factor in (1e6, 1e-6):
            scaled, scaled_image = counts(factor, strategy)
            off = abs(scaled - plain).sum() / plain.sum()
            basis = "radiance rounds by 2^-24; a share of the pixels is so near to a half that it rounds the other way"
            yield Case(f"emitters times {factor:g}, {name}: share of the samples elsewhere", off, 0, 1e-3, basis)
            same = (plain == scaled) & (image > 0)
            yield worst("... image over the plain one", scaled_image[same] / image[same], 1, 1e-5, "float32 radiance")
