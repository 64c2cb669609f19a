"""Checks of the per-pixel statistics: synthetic samples through `reduce` and `summarise`, against float64.

How the statistics round (host/docs/numerics.md): 16 samples are summed in float32 as differences from the mean so
far, each sum to 16 * 2^-24 of the differences; the blocks are added with 48 bits. A variance is the sum of squares of
these differences, which round by 2^-24 each, and of the block's two sums: 2^-19 in all.
"""

from collections.abc import Iterator
from math import gamma

import numpy as np

from isonoise.selftest.cases import Case, Context, array_case, count_case
from isonoise.selftest.synthetic_samples import Reducer, chunk_median_mean, luminance32
from isonoise.statistics import Needs, Statistics

ALL = Needs(median=True, power=1.3, half=True)
MEDIANS = Needs(median=True)
WITH_NETS = Needs(median=True, power=1.3, half=True, nets=True)
STEP = 2.0**-24
VARIANCE_ERROR = 2.0**-19
VARIANCE_BASIS = "2^-19: float32 sums of 16 squares and of 16 differences"
BLOCK_SUM_BASIS = "sums of 16, 2^-24 each"
LUMINANCE_LIMIT = 2.0**62
"""From this luminance on a sample is rejected (kernels/stages/reduce.cl)."""


def reduced(context: Context, samples: list[np.ndarray], needs: Needs = ALL, scale: float = 1.0) -> Statistics:
    """Returns the statistics of the pixels' samples, which are `scale` times the radiance."""
    reducer = Reducer(context.device, len(samples), needs)
    reducer.add(samples)
    return reducer.statistics(scale)


def large_mean(context: Context) -> Iterator[Case]:
    """Small noise on a large mean."""
    x = 1e6 + 1e-2 * np.random.default_rng(1).standard_normal(200_000)
    statistics, x = reduced(context, [x], MEDIANS), luminance32(x)
    name, basis = (
        "mean 10^6, sigma 10^-2",
        "float32 has a step of 1/16 there: of 16 differences, 2^-24 each of 16 steps",
    )
    yield Case(f"{name}: mean", statistics.mean[0, 0], x.mean(), 16 * STEP, basis)
    variance = x.var(ddof=1)
    yield Case(f"{name}: variance", statistics.variance[0, 0], variance, 2 * VARIANCE_ERROR * variance, VARIANCE_BASIS)


def hundred_million(context: Context) -> Iterator[Case]:
    """10^8 samples in a pixel: plain float32 sums go wrong from 10^7 on."""
    part, repeats = 7 * 5 * 16 * 1786, 100  # whole periods of the mix, whole chunks and whole blocks
    n = part * repeats
    mix = np.resize(np.array([0.1, 0.9, 0.3, 2.7, 0.0, 1e-3, 40.0], np.float32), part)
    reducer = Reducer(context.device, 2, MEDIANS)
    reducer.add([np.full(part, 0.5, np.float32), mix], repeats)
    statistics = reducer.statistics()
    half, x = luminance32(np.array([0.5]))[0], luminance32(mix)
    yield count_case("10^8 samples of 0.5: count", int(statistics.count[0, 0]), "exact", n)
    yield Case("10^8 samples of 0.5: mean", statistics.mean[0, 0], half, 0, "exact: no sample differs from the mean")
    yield Case("10^8 samples of 0.5: variance", statistics.variance[0, 0], 0, 0, "exact: equal samples")
    yield Case("10^8 samples of 0.5: M_x", statistics.median[0, 0], half, STEP * half, "one rounding to float32")
    name, sums = "10^8 samples of a mix", n / 16 * 2.0**-48
    basis = "n / 16 additions that round by 2^-48, and one rounding to float32"
    yield Case(f"{name}: mean", statistics.mean[0, 1], x.mean(), (sums + 2.0**-23) * x.mean(), basis)
    variance = x.var() * n / (n - 1)
    yield Case(f"{name}: variance", statistics.variance[0, 1], variance, VARIANCE_ERROR * variance, VARIANCE_BASIS)
    median = chunk_median_mean(x, MEDIANS)
    basis = "one rounding to float32, 2^-48 a chunk"
    yield Case(f"{name}: M_x", statistics.median[0, 1], median, 2 * STEP * median, basis)
    red = np.float64(mix.astype(np.float64).mean())
    basis = f"{BLOCK_SUM_BASIS}, and one rounding"
    yield Case(f"{name}: red", statistics.rgb[0, 1, 0], red, 2 * VARIANCE_ERROR * red, basis)


def sixty_decades(context: Context) -> Iterator[Case]:
    """Samples of very different sizes, in different pixels and in one."""
    values = 10.0 ** np.arange(-30, 31)
    statistics = reduced(context, [np.full(21, v) for v in values])
    x = luminance32(values)
    accepted = x < LUMINANCE_LIMIT
    name, rejected = "10^-30 to 10^30", 21 * int((~accepted).sum())
    yield count_case(f"{name}: samples rejected", int(statistics.rejected.sum()), "all from 2^62 on", rejected)
    ratio, basis = statistics.mean[0, accepted] / x[accepted], "21 additions that round by 2^-48"
    yield array_case(f"{name}: mean over the value", ratio, 1, 21 * 2.0**-48, basis)
    scaled = reduced(context, [np.full(21, np.ldexp(v, -40)) for v in values], scale=2.0**-40)
    x = np.ldexp(luminance32(np.ldexp(values, -40)), 40)
    ratio, basis = scaled.mean[0] / x, "as above; no sample is rejected"
    yield array_case(f"{name}: mean over the value, samples scaled by 2^-40", ratio, 1, 21 * 2.0**-48, basis)

    random = np.random.default_rng(3)
    mixed = [10 ** random.uniform(-30, 17, n) for n in (10, 1000, 100_000)]
    statistics = reduced(context, mixed)
    references = [luminance32(s) for s in mixed]
    medians = [chunk_median_mean(x, ALL) for x in references]
    variances = [x.var(ddof=1) for x in references]
    for name, measured, expected, tolerance, basis in (
        ("mean", statistics.mean[0], [x.mean() for x in references], 16 * STEP, BLOCK_SUM_BASIS),
        ("variance", statistics.variance[0], variances, 2 * VARIANCE_ERROR, VARIANCE_BASIS),
        ("M_x", statistics.median[0], medians, 2 * STEP, "rounding to float32"),
    ):
        yield array_case(f"10^-30 to 10^17 in one pixel: {name}, relative", measured / expected, 1, tolerance, basis)


def largest_samples(context: Context) -> Iterator[Case]:
    """Squares beyond float32 count as its largest number, before the division by n - 1."""
    largest = np.nextafter(np.float32(LUMINANCE_LIMIT), np.float32(0))
    samples = np.where(np.arange(1000) % 2 == 0, largest, np.float32(0))
    statistics = reduced(context, [samples])
    name, expected = "1000 samples of 0 and 2^62 in turn", float(np.finfo(np.float32).max) / 999
    basis = "the sum of squares is limited to the largest float32"
    yield Case(f"{name}: variance", statistics.variance[0, 0], expected, STEP * expected, basis)
    mean = luminance32(samples).mean()
    yield Case(f"{name}: mean", statistics.mean[0, 0], mean, 16 * STEP * mean, BLOCK_SUM_BASIS)


def denormals(context: Context) -> Iterator[Case]:
    """Samples smaller than the smallest normal float32."""
    statistics = reduced(context, [np.full(33, 1e-40), np.full(33, 1e-45)], MEDIANS)
    basis = "2^-126: devices may flush smaller numbers to 0"
    yield array_case("denormal samples: mean", statistics.mean[0], [1e-40, 1.4e-45], 2.0**-126, basis)
    yield array_case("denormal samples: variance", statistics.variance[0], 0, 0, "exact: equal samples")
    mixed = np.tile([1.0, 1e-40], 500)
    statistics, x = reduced(context, [mixed], MEDIANS), luminance32(mixed)
    yield Case("1 and 10^-40 in turn: mean", statistics.mean[0, 0], x.mean(), 16 * STEP * x.mean(), BLOCK_SUM_BASIS)


def pareto(context: Context) -> Iterator[Case]:
    """Samples of density alpha x^-(alpha + 1), x >= 1, times a brightness that differs from pixel to pixel."""
    for alpha in (1.1, 1.5, 2.5):
        yield from _pareto(context, alpha)


def _pareto(context: Context, alpha: float) -> Iterator[Case]:
    random = np.random.default_rng(int(10 * alpha))
    n, brightness = 20_000, 1.25 ** np.arange(16)
    samples = [b * (1 + random.pareto(alpha, n)) for b in brightness]
    statistics, x = reduced(context, samples), np.stack([luminance32(s) for s in samples])
    name = f"Pareto, alpha {alpha}"
    infinite = sum(np.count_nonzero(~np.isfinite(plane)) for plane in statistics.planes().values())
    yield count_case(f"{name}: statistics not finite", infinite, "none allowed")
    ratio = statistics.mean[0] / x.mean(axis=1)
    # a block rounds by 16 * 2^-24 of its spread, which may be that of its largest sample alone
    spread = 16 * STEP * x.std(axis=1) / x.mean(axis=1) / np.sqrt(n / 16)
    basis = "16 * 2^-24 of the spread of a block, at random"
    yield array_case(f"{name}: mean, relative", ratio, 1, spread + 2.0**-40, basis)
    ratio = statistics.variance[0] / x.var(axis=1, ddof=1)
    yield array_case(f"{name}: variance, relative", ratio, 1, 2 * VARIANCE_ERROR, VARIANCE_BASIS)
    # the third of five: E = 5! / 2! G(3 - 1/alpha) / G(6 - 1/alpha) (order statistics of Pareto's distribution)
    median = 60 * gamma(3 - 1 / alpha) / gamma(6 - 1 / alpha)
    square = 60 * gamma(3 - 2 / alpha) / gamma(6 - 2 / alpha)
    tolerance = 5 * np.sqrt((square - median**2) * 5 / n)
    ratio = statistics.median[0] / brightness
    yield array_case(f"{name}: M_x over brightness", ratio, median, tolerance, "5 standard errors")
    above = statistics.median[0] > 5 / 3 * x.mean(axis=1)  # three of five samples are no smaller than their median
    yield count_case(f"{name}: pixels with M_x above its bound, 5/3 of the mean", above, "none allowed")
    unordered = np.diff(statistics.median[0]) <= 0
    yield count_case(f"{name}: pixels out of their order by M_x", unordered, "steps of over 9 sigma")


def equal_samples(context: Context) -> Iterator[Case]:
    """Equal samples have no variance."""
    counts = (1, 2, 5, 16, 17, 10_000)
    zeros = reduced(context, [np.zeros(n) for n in counts])
    nonzero = sum(np.count_nonzero(plane) for name, plane in zeros.planes().items() if name != "count")
    yield count_case("all samples 0: statistics other than 0", nonzero, "exact")
    for value in (1.0, 0.1, 1e-30, 1e15):
        statistics, x = reduced(context, [np.full(n, value) for n in counts]), luminance32(np.array([value]))[0]
        name, basis = f"all samples {value:g}", "n / 16 additions that round by 2^-48"
        yield array_case(f"{name}: variance", statistics.variance, 0, 0, "exact")
        yield array_case(f"{name}: mean, relative", statistics.mean / x, 1, 10_000 / 16 * 2.0**-48, basis)
        yield array_case(f"{name}: M_x, relative", statistics.median / x, 1, STEP, "one rounding to float32")


def partial_chunks(context: Context) -> Iterator[Case]:
    """1 to 40 samples: chunks, batches and blocks that are not full."""
    name, colour = "one sample", np.array([[0.25, 0.5, 1.0]])
    one, x = reduced(context, [colour]), luminance32(colour)[0]
    yield Case(f"{name}: mean", one.mean[0, 0], x, 0, "exact")
    yield Case(f"{name}: variance", one.variance[0, 0], 0, 0, "exact: 0 for a single sample")
    yield Case(f"{name}: M_x", one.median[0, 0], x, 0, "exact")
    random = np.random.default_rng(4)
    samples = [random.exponential(size=(n, 3)) for n in range(1, 41)]
    references = [luminance32(s) for s in samples]
    mean, variance = [x.mean() for x in references], [x.var(ddof=1) if len(x) > 1 else 0.0 for x in references]
    for needs in (ALL, Needs(median=True, chunk=7, batch=3)):
        statistics = reduced(context, samples, needs)
        name = f"1 to 40 samples, chunks of {needs.chunk} means of {needs.batch}"
        ratio = statistics.median[0] / [chunk_median_mean(x, needs) for x in references]
        yield array_case(f"{name}: M_x, relative", ratio, 1, 4 * STEP, "roundings to float32")
        yield array_case(f"{name}: mean, relative", statistics.mean[0] / mean, 1, 16 * STEP, BLOCK_SUM_BASIS)
        tolerance = np.multiply(2 * VARIANCE_ERROR, variance)
        yield array_case(f"{name}: variance", statistics.variance[0], variance, tolerance, VARIANCE_BASIS)


def slices_and_order(context: Context) -> Iterator[Case]:
    """Slices change no bit; the order of samples changes only the rounding."""
    random = np.random.default_rng(6)
    samples = [1 + random.pareto(1.5, size=(n, 3)) for n in (4, 17, 100, 1234, 5000)]
    whole = reduced(context, samples, WITH_NETS)
    reducer = Reducer(context.device, len(samples), WITH_NETS)
    for begin, end in ((0, 0.01), (0.01, 0.02), (0.02, 0.3), (0.3, 0.77), (0.77, 1)):
        reducer.add([s[int(begin * len(s)) : int(end * len(s))] for s in samples])
    sliced = reducer.statistics()
    differing = sum(np.count_nonzero(plane != getattr(sliced, name)) for name, plane in whole.planes().items())
    yield count_case("in five slices or in one: values that differ", differing, "exact: the same bits")
    x = random.pareto(1.5, 16 * 5 * 500)
    orders = [x, x[::-1], np.sort(x), np.sort(x)[::-1], random.permutation(x)]
    statistics, expected = reduced(context, orders), luminance32(x)
    name, tolerance = "five orders of the same samples", 16 * STEP * expected.std() / expected.mean()
    yield array_case(f"{name}: mean", statistics.mean[0] / expected.mean(), 1, tolerance, BLOCK_SUM_BASIS)
    ratio = statistics.variance[0] / expected.var(ddof=1)
    yield array_case(f"{name}: variance, relative", ratio, 1, 2 * VARIANCE_ERROR, VARIANCE_BASIS)


def rejected_samples(context: Context) -> Iterator[Case]:
    """Samples that are not finite or negative are counted and change nothing else."""
    good = np.random.default_rng(5).exponential(size=(997, 3))
    bad = {
        "NaN": [[np.nan, 1, 1], [1, np.nan, 1], [1, 1, np.nan], [np.nan] * 3],
        "+Inf": [[np.inf, 1, 1], [1, np.inf, 1], [1, 1, np.inf], [1e38, 1e38, 1e38]],
        "-Inf": [[-np.inf, 1, 1], [1, -np.inf, 1], [1, 1, -np.inf], [np.inf, -np.inf, 0]],
        "negative": [[-1, -1, -1], [-1e-3, 0, 0], [1, -0.5, 1], [0, 0, -1e9]],
    }
    mixed = [np.insert(good, [0, 3, 500, 997], rows, axis=0) for rows in bad.values()]
    only_bad = np.concatenate([np.array(rows, float) for rows in bad.values()])
    statistics = reduced(context, [good, *mixed, only_bad])
    planes = [plane[0] for name, plane in statistics.planes().items() if name != "rejected"]
    for pixel, kind in enumerate(bad, start=1):
        name = f"4 samples {kind} among 997"
        yield count_case(f"{name}: rejected", int(statistics.rejected[0, pixel]), "exact", 4)
        differing = sum(np.count_nonzero(plane[pixel] != plane[0]) for plane in planes)
        yield count_case(f"{name}: statistics of the others that change", differing, "exact: the same bits")
    yield count_case("16 bad samples and no other: rejected", int(statistics.rejected[0, -1]), "exact", 16)
    nonzero = sum(np.count_nonzero(plane[-1]) for plane in planes)
    yield count_case("16 bad samples and no other: statistics other than 0", nonzero, "exact")


CHECKS = (
    large_mean,
    hundred_million,
    sixty_decades,
    largest_samples,
    denormals,
    pareto,
    equal_samples,
    partial_chunks,
    slices_and_order,
    rejected_samples,
)
