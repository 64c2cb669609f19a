"""Checks of adaptive rendering where the noise is very uneven, or perfectly even."""

from collections.abc import Iterator

import numpy as np

from isonoise.selftest.cases import Case, Context, array_case, count_case
from isonoise.selftest.scenes import area_light, diffuse, look_at, make_scene, rgb, transform
from isonoise.statistics import Statistics
from isonoise.strategies import make_strategy

SHAPE = (32, 32)
PIXELS = SHAPE[0] * SHAPE[1]
STRATEGIES = ("pooled", "relative-median", "relative-mean", "absolute", "tsallis")
BUDGET = 20 * PIXELS


def _statistics(mean: np.ndarray, variance: np.ndarray, count: np.ndarray | int = 16) -> Statistics:
    return Statistics(
        count=np.broadcast_to(np.uint32(count), SHAPE),
        rejected=np.zeros(SHAPE, np.uint32),
        rgb=np.repeat(mean[..., None], 3, axis=-1).astype(np.float32),
        mean=mean,
        variance=variance,
        median=0.9 * mean,
    )


def _allocations(statistics: Statistics, budget: int = BUDGET) -> dict[str, np.ndarray]:
    return {name: make_strategy(name).allocate(statistics, budget) for name in STRATEGIES}


def _render(context: Context, description: dict, strategy: str, waves: int = 8) -> Statistics:
    from isonoise.renderer import Renderer

    renderer = Renderer(description, context.device_choice, strategy, seed=3, pool_size=2**14)
    for _ in range(waves):
        renderer.step()
    return renderer.statistics()


def one_noisy_pixel(context: Context) -> Iterator[Case]:
    """One pixel has 10^6 times the variance of the others: they still get samples, wave after wave."""
    variance = np.ones(SHAPE)
    variance[16, 16] = 1e6
    for name in STRATEGIES:
        strategy, n = make_strategy(name), np.full(SHAPE, 16, np.int64)
        off_budget, samples = 0, n.sum()
        for wave in strategy.waves():
            if samples > 400 * PIXELS:
                break
            budget = round((wave.spp or 1) * PIXELS)
            allocation = np.full(SHAPE, budget // PIXELS)
            if wave.kind == "adaptive":
                allocation = strategy.allocate(_statistics(np.ones(SHAPE), variance, n), budget)
                off_budget += int(allocation.sum(dtype=np.int64)) != budget
            n = n + allocation
            samples = n.sum()
        case_name = f"a pixel of 10^6 times the variance, {name}"
        yield count_case(f"{case_name}: waves off their budget", off_budget, "exact")
        # uniform waves bring at least 1 / (1 + ratio) of all samples; ratio 1 at most
        minimum = 0.45 * 400
        starved = np.delete(n.ravel(), 16 * SHAPE[1] + 16) < minimum
        basis = f"each has {minimum:g} of 400 samples from uniform waves"
        yield count_case(f"{case_name}: other pixels with too few samples", starved, basis)


def one_lit_pixel(context: Context) -> Iterator[Case]:
    """An image that is black except for one pixel."""
    mean, variance = np.zeros(SHAPE), np.zeros(SHAPE)
    mean[5, 7], variance[5, 7] = 1e-3, 1e-4
    for strategy, allocation in _allocations(_statistics(mean, variance)).items():
        name, total = f"black except for one pixel, {strategy}", int(allocation.sum(dtype=np.int64))
        yield count_case(f"{name}: samples of the wave", total, "exact", BUDGET)
        more, basis = allocation > allocation[5, 7], "none allowed"
        if strategy == "pooled":
            more, basis = allocation > allocation[5, 7] + 1, "none but its neighbours, up to the remainder"
            more[3:8, 5:10] = False
        yield count_case(f"{name}: pixels with more samples than the lit one", more, basis)
    # a lamp over a fifth of a pixel
    lamp = {"type": "sphere", "center": [0.03, 0.0, 0.03], "radius": 0.012} | area_light(1.0)
    dark = make_scene(look_at((0.0, -1.0, 0.0), (0.0, 0.0, 0.0)), 16, 1, lamp=lamp)
    for strategy in STRATEGIES:
        statistics = _render(context, dark, strategy)
        busiest = np.array(np.unravel_index(statistics.count.argmax(), statistics.shape))
        lit = np.argwhere(statistics.mean > 0)
        name = f"render of a small lamp in the dark, {strategy}"
        yield count_case(f"{name}: lit pixels", len(lit), "the lamp lies within one pixel", 1)
        distance = np.abs(lit - busiest).max() if len(lit) else np.inf
        basis = "`pooled` uses statistics of neighbours, at most two pixels away"
        yield Case(f"{name}: pixels from the lit one to the one with most samples", distance, 0, 2, basis)


def constant_image(context: Context) -> Iterator[Case]:
    """Images without noise get even allocations."""
    for value in (0.0, 0.5):
        statistics = _statistics(np.full(SHAPE, value), np.zeros(SHAPE))
        for strategy, allocation in _allocations(statistics, BUDGET + 100).items():
            name, difference = f"constant image of {value:g}, {strategy}: most - least", np.ptp(allocation.astype(int))
            yield Case(name, difference, 1, 0, "even, up to the remainder")
    sky = {"type": "constant", "radiance": rgb((0.2, 0.3, 0.4))}
    description = make_scene(look_at((0.0, -3.0, 0.0), (0.0, 0.0, 0.0)), 16, 1, sky=sky)
    for strategy in STRATEGIES:
        statistics = _render(context, description, strategy)
        name, difference = f"render of a constant sky, {strategy}", np.ptp(statistics.count.astype(int))
        yield Case(f"{name}: most - least samples", difference, 0, 8, "a remainder in each of 8 waves")
        yield count_case(f"{name}: variances other than 0", statistics.variance, "exact")


def _lamp_over_floor(factor: float) -> dict:
    """Soft light, noise and a black background; the lamp's radiance is `factor` times (5, 4, 3)."""
    radiance = factor * np.array([5.0, 4.0, 3.0])
    lamp = {"type": "rectangle", "to_world": transform((0.3, 0.3, 1.0), (0.4, 0.2, 1.0), 180)} | area_light(radiance)
    floor = {"type": "rectangle", "bsdf": diffuse(0.6)}
    return make_scene(look_at((0.0, -3.0, 2.4), (0.0, 0.0, 0.0)), 24, 4, floor=floor, lamp=lamp)


def scaled_emitters(context: Context) -> Iterator[Case]:
    """Brighter or dimmer lights give the same samples, so the same allocations."""

    def render_scaled(factor: float, strategy: str) -> tuple[np.ndarray, np.ndarray]:
        statistics = _render(context, _lamp_over_floor(factor), strategy, 6)
        return statistics.count.astype(np.float64), statistics.mean / factor

    for strategy in ("pooled:warmup=8", "relative-median:warmup=8,growth=0.5"):
        strategy_name = strategy.partition(":")[0]
        count, image = render_scaled(1.0, strategy)
        differing = sum(np.count_nonzero(render_scaled(f, strategy)[0] != count) for f in (2.0**20, 2.0**-20))
        yield count_case(f"emitters times 2^20 and 2^-20, {strategy_name}: counts that differ", differing, "exact")
        for factor in (1e6, 1e-6):
            scaled_count, scaled_image = render_scaled(factor, strategy)
            moved = abs(scaled_count - count).sum() / count.sum()
            name = f"emitters times {factor:g}, {strategy_name}"
            basis = "radiance rounds by 2^-24; a share of the pixels is so near to a half that it rounds the other way"
            yield Case(f"{name}: share of the samples in other pixels", moved, 0, 1e-3, basis)
            same = (count == scaled_count) & (image > 0)
            ratio = scaled_image[same] / image[same]
            yield array_case(f"{name}: image over the one with factor 1", ratio, 1, 1e-5, "float32 radiance")


CHECKS = (one_noisy_pixel, one_lit_pixel, constant_image, scaled_emitters)
