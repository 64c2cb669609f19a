"""Cases of the per-pixel statistics: made samples through `reduce` and `summarise`, against float64 or closed forms.

How the statistics round (host/docs/numerics.md): 16 samples are summed in float32 as differences from the mean so
far, each sum to 16 * 2^-24 of the differences; the blocks are added with 48 bits. A variance is the sum of squares of
these differences, which round by 2^-24 each, and of the block's two sums: 2^-19 in all.
"""

from collections.abc import Iterator
from math import gamma

import numpy as np

from isonoise.selftest.core import Bench, Case, count, worst
from isonoise.selftest.synthetic_samples import Reducer, chunk_medians, luminance32
from isonoise.statistics import Needs, Statistics

ALL = Needs(median=True, power=1.3, half=True)
MEDIANS = Needs(median=True)
SQUARES = 2.0**-19
SQUARES_BASIS = "2^-19: float32 sums of 16 squares and of 16 differences"
STEP = 2.0**-24
LIMIT = 2.0**62
"""Luminance from which on a sample counts as not finite (kernels/stages/reduce.cl)."""


def statistics_cases(bench: Bench) -> Iterator[Case]:
    """All cases of the group."""
    yield from _large_mean(bench)
    yield from _hundred_million(bench)
    yield from _decades(bench)
    yield from _denormals(bench)
    for alpha in (1.1, 1.5, 2.5):
        yield from _pareto(bench, alpha)
    yield from _equal(bench)
    yield from _unfull_chunks(bench)
    yield from _order(bench)
    yield from _rejected(bench)


def reduced(bench: Bench, samples: list[np.ndarray], needs: Needs = ALL, scale: float = 1.0) -> Statistics:
    """Statistics of the pixels' samples."""
    reducer = Reducer(bench.device, len(samples), needs)
    reducer.feed(samples)
    return reducer.statistics(scale)


def _large_mean(bench: Bench) -> Iterator[Case]:
    x = 1e6 + 1e-2 * np.random.default_rng(1).standard_normal(200_000)
    statistics, x = reduced(bench, [x], MEDIANS), luminance32(x)
    basis = "float32 has a step of 1/16 there: of 16 differences, 2^-24 each of 16 steps"
    yield Case("mean 10^6, sigma 10^-2: mean", statistics.mean[0, 0], x.mean(), 16 * STEP, basis)
    variance = x.var(ddof=1)
    yield Case("... variance", statistics.variance[0, 0], variance, 2 * SQUARES * variance, SQUARES_BASIS)


def _hundred_million(bench: Bench) -> Iterator[Case]:
    part, times = 7 * 5 * 16 * 1786, 100  # whole periods of the mix, whole chunks and whole blocks
    n = part * times
    mix = np.resize(np.array([0.1, 0.9, 0.3, 2.7, 0.0, 1e-3, 40.0], np.float32), part)
    reducer = Reducer(bench.device, 2, MEDIANS)
    reducer.feed([np.full(part, 0.5, np.float32), mix], times)
    statistics = reducer.statistics()
    half, x = luminance32(np.array([0.5]))[0], luminance32(mix)
    sums = n / 16 * 2.0**-48
    basis = "n / 16 additions that round by 2^-48"
    yield count("10^8 samples of 0.5: count", int(statistics.count[0, 0]), "exact", n)
    yield Case("... mean", statistics.mean[0, 0], half, sums * half, basis)
    yield Case("... variance", statistics.variance[0, 0], 0, 0, "exact: equal samples do not vary")
    yield Case("... M_x", statistics.median[0, 0], half, STEP * half, "one rounding to float32")
    yield Case("10^8 samples of a mix: mean", statistics.mean[0, 1], x.mean(), (sums + 2.0**-23) * x.mean(), basis)
    variance = x.var() * n / (n - 1)
    yield Case("... variance", statistics.variance[0, 1], variance, SQUARES * variance, SQUARES_BASIS)
    median = chunk_medians(x, MEDIANS)
    yield Case("... M_x", statistics.median[0, 1], median, 2 * STEP * median, "one rounding to float32, 2^-48 a chunk")
    red = np.float64(mix.astype(np.float64).mean())
    yield Case("... red", statistics.rgb[0, 1, 0], red, 2 * SQUARES * red, "sums of 16, 16 * 2^-24, and one rounding")


def _decades(bench: Bench) -> Iterator[Case]:
    values = 10.0 ** np.arange(-30, 31)
    on_device = reduced(bench, [np.full(21, v) for v in values])
    x = luminance32(values)
    entered = x < LIMIT
    yield count(
        "10^-30 to 10^30: samples rejected",
        int(on_device.rejected.sum()),
        "all from 2^62 on",
        21 * int((~entered).sum()),
    )
    mean, expected = on_device.mean[0, entered], x[entered]
    yield worst("... mean over the value", mean / expected, 1, 21 * 2.0**-48, "21 additions that round by 2^-48")
    scaled = reduced(bench, [np.full(21, np.ldexp(v, -40)) for v in values], scale=2.0**-40)
    x = np.ldexp(luminance32(np.ldexp(values, -40)), 40)
    yield worst("... the same scaled by 2^-40", scaled.mean[0] / x, 1, 21 * 2.0**-48, "as above; nothing is rejected")
    random = np.random.default_rng(3)
    mixed = [10 ** random.uniform(-30, 17, n) for n in (10, 1000, 100_000)]
    statistics = reduced(bench, mixed)
    references = [luminance32(s) for s in mixed]
    for name, measured, expected, tolerance, basis in (
        ("mean", statistics.mean[0], [x.mean() for x in references], 16 * STEP, "sums of 16, 2^-24 each"),
        ("variance", statistics.variance[0], [x.var(ddof=1) for x in references], 2 * SQUARES, SQUARES_BASIS),
        ("M_x", statistics.median[0], [chunk_medians(x, ALL) for x in references], 2 * STEP, "rounding to float32"),
    ):
        yield worst(f"10^-30 to 10^17 in one pixel: {name}, relative", measured / expected, 1, tolerance, basis)

    largest = np.where(np.arange(1000) % 2 == 0, np.nextafter(np.float32(LIMIT), np.float32(0)), np.float32(0))
    statistics = reduced(bench, [largest])
    most = float(np.finfo(np.float32).max)
    basis = "squares that leave float32 count as its largest number, before the division by n - 1"
    yield Case(
        "1000 samples of 0 and 2^62 in turn: variance", statistics.variance[0, 0], most / 999, STEP * most / 999, basis
    )
    mean = luminance32(largest).mean()
    yield Case("... mean", statistics.mean[0, 0], mean, 16 * STEP * mean, "sums of 16, 2^-24 each")


def _denormals(bench: Bench) -> Iterator[Case]:
    statistics = reduced(bench, [np.full(33, 1e-40), np.full(33, 1e-45)], MEDIANS)
    least = 2.0**-126
    basis = "2^-126: devices may take what is smaller for 0"
    yield worst("denormal samples: mean", statistics.mean[0], [1e-40, 1.4e-45], least, basis)
    yield worst("... variance", statistics.variance[0], 0, 0, "exact: equal samples do not vary")
    mixed = np.tile([1.0, 1e-40], 500)
    statistics, x = reduced(bench, [mixed], MEDIANS), luminance32(mixed)
    yield Case("1 and 10^-40 in turn: mean", statistics.mean[0, 0], x.mean(), 16 * STEP * x.mean(), "sums of 16")


def _pareto(bench: Bench, alpha: float) -> Iterator[Case]:
    """Samples of density alpha x^-(alpha + 1), x >= 1, times a brightness that differs from pixel to pixel."""
    random = np.random.default_rng(int(10 * alpha))
    n, brightness = 20_000, 1.25 ** np.arange(16)
    samples = [b * (1 + random.pareto(alpha, n)) for b in brightness]
    statistics, x = reduced(bench, samples), np.stack([luminance32(s) for s in samples])
    name = f"Pareto, alpha {alpha}"
    planes = (
        statistics.mean,
        statistics.variance,
        statistics.median,
        statistics.power,
        statistics.rgb,
        statistics.half,
    )
    yield count(f"{name}: statistics not finite", sum(np.count_nonzero(~np.isfinite(p)) for p in planes), "none may be")
    ratio = statistics.mean[0] / x.mean(axis=1)
    # what a block rounds by is 16 * 2^-24 of its spread: of its largest sample where that is all there is
    spread = 16 * STEP * x.std(axis=1) / x.mean(axis=1) / np.sqrt(n / 16)
    yield worst("... mean, relative", ratio, 1, spread + 2.0**-40, "16 * 2^-24 of the spread of a block, at random")
    yield worst("... variance, relative", statistics.variance[0] / x.var(axis=1, ddof=1), 1, 2 * SQUARES, SQUARES_BASIS)
    # the third of five: E = 5! / 2! G(3 - 1/alpha) / G(6 - 1/alpha) (order statistics of Pareto's distribution)
    median = 60 * gamma(3 - 1 / alpha) / gamma(6 - 1 / alpha)
    square = 60 * gamma(3 - 2 / alpha) / gamma(6 - 2 / alpha)
    se = np.sqrt((square - median**2) * 5 / n)
    yield worst("... M_x over brightness", statistics.median[0] / brightness, median, 5 * se, "5 standard errors")
    bound = 5 / 3 * x.mean(axis=1)  # three of five are no smaller than their median
    yield count("... pixels with M_x above its bound, 5/3 of the mean", statistics.median[0] > bound, "none may be")
    yield count("... pixels out of their order by M_x", np.diff(statistics.median[0]) <= 0, "steps of over 9 sigma")


def _equal(bench: Bench) -> Iterator[Case]:
    counts = (1, 2, 5, 16, 17, 10_000)
    zeros = reduced(bench, [np.zeros(n) for n in counts])
    planes = [p for name, p in vars(zeros).items() if name != "count"]
    yield count("all samples 0: statistics other than 0", sum(np.count_nonzero(p) for p in planes), "exact")
    for value in (1.0, 0.1, 1e-30, 1e15):
        statistics, x = reduced(bench, [np.full(n, value) for n in counts]), luminance32(np.array([value]))[0]
        yield worst(f"all samples {value:g}: variance", statistics.variance, 0, 0, "exact")
        yield worst("... mean, relative", statistics.mean / x, 1, 10_000 / 16 * 2.0**-48, "n / 16 additions of 2^-48")
        yield worst("... M_x, relative", statistics.median / x, 1, STEP, "one rounding to float32")


def _unfull_chunks(bench: Bench) -> Iterator[Case]:
    """1 to 40 samples: chunks, batches and blocks that end anywhere."""
    random = np.random.default_rng(4)
    samples = [random.exponential(size=(n, 3)) for n in range(1, 41)]
    references = [luminance32(s) for s in samples]
    one = reduced(bench, [np.array([[0.25, 0.5, 1.0]])])
    x = luminance32(np.array([[0.25, 0.5, 1.0]]))[0]
    yield Case("one sample: mean", one.mean[0, 0], x, 0, "exact")
    yield Case("... variance", one.variance[0, 0], 0, 0, "exact: of one there is none")
    yield Case("... M_x", one.median[0, 0], x, 0, "exact")
    for needs in (ALL, Needs(median=True, chunk=7, batch=3)):
        statistics = reduced(bench, samples, needs)
        name = f"1 to 40 samples, chunks of {needs.chunk} means of {needs.batch}"
        medians = [chunk_medians(x, needs) for x in references]
        yield worst(f"{name}: M_x, relative", statistics.median[0] / medians, 1, 4 * STEP, "roundings to float32")
    mean, variance = [x.mean() for x in references], [x.var(ddof=1) if len(x) > 1 else 0.0 for x in references]
    yield worst("... mean, relative", statistics.mean[0] / mean, 1, 16 * STEP, "sums of 16, 2^-24 each")
    yield worst("... variance", statistics.variance[0], variance, np.multiply(2 * SQUARES, variance), SQUARES_BASIS)


def _order(bench: Bench) -> Iterator[Case]:
    random = np.random.default_rng(6)
    samples = [1 + random.pareto(1.5, size=(n, 3)) for n in (4, 17, 100, 1234, 5000)]
    whole = reduced(bench, samples)
    reducer = Reducer(bench.device, len(samples), ALL)
    for begin, end in ((0, 0.01), (0.01, 0.02), (0.02, 0.3), (0.3, 0.77), (0.77, 1)):
        reducer.feed([s[int(begin * len(s)) : int(end * len(s))] for s in samples])
    cut = reducer.statistics()
    differ = sum(np.count_nonzero(p != getattr(cut, name)) for name, p in vars(whole).items())
    yield count("in five slices or in one: values that differ", differ, "exact: the same bits")
    n = 16 * 5 * 500
    x = random.pareto(1.5, n)
    orders = [x, x[::-1], np.sort(x), np.sort(x)[::-1], random.permutation(x)]
    statistics, expected = reduced(bench, orders), luminance32(x)
    deviation = 16 * STEP * expected.std() / expected.mean()
    yield worst(
        "five orders of the same samples: mean", statistics.mean[0] / expected.mean(), 1, deviation, "sums of 16, 2^-24"
    )
    variance = expected.var(ddof=1)
    yield worst("... variance, relative", statistics.variance[0] / variance, 1, 2 * SQUARES, SQUARES_BASIS)


def _rejected(bench: Bench) -> Iterator[Case]:
    random = np.random.default_rng(5)
    good = random.exponential(size=(997, 3))
    bad = {
        "NaN": [[np.nan, 1, 1], [1, np.nan, 1], [1, 1, np.nan], [np.nan] * 3],
        "+Inf": [[np.inf, 1, 1], [1, np.inf, 1], [1, 1, np.inf], [1e38, 1e38, 1e38]],
        "-Inf": [[-np.inf, 1, 1], [1, -np.inf, 1], [1, 1, -np.inf], [np.inf, -np.inf, 0]],
        "negative": [[-1, -1, -1], [-1e-3, 0, 0], [1, -0.5, 1], [0, 0, -1e9]],
    }
    places = [0, 3, 500, 997]
    mixed = [np.insert(good, places, rows, axis=0) for rows in bad.values()]
    only = np.concatenate([np.array(rows, float) for rows in bad.values()])
    statistics = reduced(bench, [good, *mixed, only])
    for place, name in enumerate(bad, start=1):
        yield count(f"4 samples {name} among 997: counted apart", int(statistics.rejected[0, place]), "exact", 4)
        differ = sum(
            np.count_nonzero(p[0, place] != p[0, 0]) for key, p in vars(statistics).items() if key != "rejected"
        )
        yield count("... statistics of the others that change", differ, "exact: the same bits")
    others = [p[0, -1] for key, p in vars(statistics).items() if key != "rejected"]
    yield count("16 bad samples and no other: counted apart", int(statistics.rejected[0, -1]), "exact", 16)
    yield count("... statistics other than 0", sum(np.count_nonzero(p) for p in others), "exact")
