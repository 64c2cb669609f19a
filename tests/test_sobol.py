"""Numbers of the sampler `sobol` (kernels/util/sobol.h): nets, uniform, independent between pixels and dimensions.

Statistical tests use one fixed set of numbers. Their bounds are at z standard deviations; false alarms of a good
sampler are 6e-7 for each of the about 200 comparisons at z = 5, 1e-4 for the file.
"""

from functools import reduce
from operator import xor

import numpy as np
import pytest
from test_random import KERNEL, Z, chi_square_z

from isonoise.device.opencl import Device
from isonoise.device.program import flatten

MASK = 2**32 - 1
PAIRS = ((0, 1), (2, 3))  # components of a dimension block


@pytest.fixture(scope="module")
def generate():
    """Returns numbers (n, 4) float64 for counters (n, 3), which are pixel, sample and block, and a seed (2,)."""
    device = Device()
    options = ("-cl-std=CL1.2", "-DFEATURE_SOBOL=1")
    kernel = device.build(flatten("util/random.h") + KERNEL, options)["blocks"]

    def run(counters, seed=(0, 0)) -> np.ndarray:
        counters = np.ascontiguousarray(counters, np.uint32).reshape(-1, 3)
        n = len(counters)
        keys = np.ascontiguousarray(np.broadcast_to(np.array(seed, np.uint32), (n, 2)))
        numbers = device.buffer(16 * n, "numbers")
        arguments = (device.buffer(counters, "counters"), device.buffer(keys, "keys"), numbers, np.uint32(n))
        device.launch(kernel, n, arguments)
        return device.read(numbers, np.float32, 4 * n).reshape(n, 4).astype(np.float64)

    return run


def counters(pixel, index, block) -> np.ndarray:
    return np.stack(np.broadcast_arrays(pixel, index, block), axis=-1).reshape(-1, 3)


def hash_uint(x: int) -> int:
    x = (x ^ x >> 16) * 0x7FEB352D & MASK
    x = (x ^ x >> 15) * 0x846CA68B & MASK
    return x ^ x >> 16


def reverse_bits(x: int) -> int:
    return int(f"{x:032b}"[::-1], 2)


def scramble(x: int, seed: int) -> int:
    """Owen scrambling of 32 bits: whether a bit flips depends on the higher ones alone."""
    x = reverse_bits(x)
    x ^= x * 0x3D20ADEA & MASK
    x = x + seed & MASK
    x = x * (seed >> 16 | 1) & MASK
    x ^= x * 0x05526C56 & MASK
    x ^= x * 0x53A22864 & MASK
    return reverse_bits(x)


def sobol(index: int) -> int:
    """The second dimension of the Sobol' sequence, from its direction numbers: columns of Pascal's triangle mod 2."""
    direction, result = 1 << 31, 0
    for k in range(32):
        result ^= direction if index >> k & 1 else 0
        direction ^= direction >> 1
    return result


def second_pair_index(index: int) -> int:
    """The product with the matrix of kernels/util/sobol.h; its columns as published there."""
    columns = (0x1, 0x2, 0x5, 0xB, 0x17, 0x3D, 0x62, 0xA9, 0x147, 0x396, 0x6BA, 0xF2F, 0x1864, 0x352D, 0x66F7, 0xC672)
    return index & 0xFFFF0000 ^ reduce(xor, (column for k, column in enumerate(columns) if index >> k & 1), 0)


def reference_block(seed, pixel: int, index: int, block: int) -> list[float]:
    pixel_key = hash_uint(pixel) ^ hash_uint(seed[0] ^ 0xBB67AE85)
    group_key = hash_uint(seed[1] ^ hash_uint(seed[0] + 0x3C6EF372 & MASK)) + 0x9E3779B9 * (block >> 1)
    numbers = []
    for offset, is_second in ((0, not block & 1), (0x85EBCA6B if block & 1 else 0xC2B2AE35, False)):
        key = hash_uint(pixel_key + group_key + offset & MASK)
        key_x = hash_uint(key ^ (0x3C6EF372 if is_second else 0x9E3779B9))
        key_y = key_x >> 16 ^ key_x * 0x85EBCA6B & MASK
        shuffled = scramble(index, key)
        if is_second:
            shuffled = second_pair_index(shuffled)
            numbers += [reverse_bits(shuffled) ^ key_x, sobol(shuffled) ^ key_y]
        else:
            numbers += [scramble(reverse_bits(shuffled), key_x), scramble(sobol(shuffled), key_y)]
    return [(number >> 8) / 2**24 for number in numbers]


def test_the_device_computes_the_reference(generate):
    """Random counters, and extreme ones: all 2^32 indices are valid."""
    random = np.random.default_rng(1)
    words = random.integers(0, 2**32, (2000, 3), dtype=np.uint64)
    words[:200] = random.choice([0, 1, 2**31, MASK], (200, 3))
    for seed in ((0, 0), (12, 2**31), (MASK, MASK)):
        expected = [reference_block(seed, *map(int, word)) for word in words]
        assert generate(words, seed).tolist() == expected


@pytest.mark.parametrize("first", [0, 2**20, 2**32 - 2**10])
@pytest.mark.parametrize("block", [0, 1, 2, 9, 0x80000000, 0xC0000003])
def test_aligned_runs_are_nets(generate, first, block):
    """One point in each elementary rectangle, for every aligned run of 2^m samples, every pixel and pair."""
    numbers = generate(counters(np.arange(3)[:, None], first + np.arange(2**10), block)).reshape(3, -1, 4)
    for m in range(11):
        runs = numbers.reshape(3, -1, 2**m, 4)
        for x, y in PAIRS:
            for a in range(m + 1):
                cell = (runs[..., x] * 2**a).astype(int) * 2 ** (m - a) + (runs[..., y] * 2 ** (m - a)).astype(int)
                assert (np.sort(cell, axis=-1) == np.arange(2**m)).all(), (m, a)


@pytest.fixture(scope="module")
def lattice(generate) -> np.ndarray:
    """Returns numbers of 64x64 pixels, 16 samples and 4 dimension blocks each: (4096, 16, 4, 4)."""
    grid = np.meshgrid(np.arange(4096), np.arange(16), np.arange(4), indexing="ij")
    return generate(counters(*grid), (12, 0)).reshape(4096, 16, 4, 4)


def test_every_sample_is_uniform_over_the_pixels(lattice):
    for index in range(16):
        for block in range(4):
            for component in range(4):
                u = lattice[:, index, block, component]
                assert abs(chi_square_z(np.bincount((u * 64).astype(int), minlength=64), 64.0)) < Z
    low_bits = np.bincount((lattice[:, 0] * 2**24).astype(int).ravel() % 256, minlength=256)
    assert abs(chi_square_z(low_bits, low_bits.sum() / 256)) < Z


def assert_independent(a: np.ndarray, b: np.ndarray, name) -> None:
    """Over pixels: no correlation, and a uniform distribution over 8x8 cells of the unit square."""
    assert abs(12 * np.mean((a - 0.5) * (b - 0.5))) * np.sqrt(a.size) < Z, name
    cells = np.bincount((a * 8).astype(int) * 8 + (b * 8).astype(int), minlength=64)
    assert abs(chi_square_z(cells, a.size / 64)) < Z, name


def test_pixels_and_dimensions_are_independent(lattice):
    """Of the same sample and of different ones; within a pair, of the same sample alone."""
    for component in range(4):
        u = lattice[..., component]
        for index in (0, 5):
            assert_independent(u[:-1, index, 1], u[1:, index, 1], "pixel")
            assert_independent(u[:-64, index, 1], u[64:, index, 1], "row")
            assert_independent(u[:-1, index, 1], u[1:, index + 1, 1], "pixel and sample")
            for block in range(3):
                assert_independent(u[:, index, block], u[:, index, block + 1], "block")
                assert_independent(u[:, index, block], u[:, index + 1, block + 1], "block and sample")
        for other in range(component):
            assert_independent(lattice[:, 3, 1, component], lattice[:, 3, 1, other], "dimension")


def test_differences_of_halves_are_uncorrelated(lattice):
    """For nets of a pixel: the difference between the halves of one says nothing of that of another, which the
    estimate of the design effect assumes."""
    function = np.floor(lattice[..., 0] * 3) * lattice[..., 1]
    halves = [
        function[:, first : first + n].mean(axis=1) for first, n in ((0, 8), (8, 8), (0, 4), (4, 4), (8, 4), (12, 4))
    ]
    differences = [halves[0] - halves[1], halves[2] - halves[3], halves[4] - halves[5]]
    for block in range(4):
        for one, other in ((0, 1), (0, 2), (1, 2)):
            product = differences[one][:, block] * differences[other][:, block]
            assert abs(product.mean()) < Z * product.std() / np.sqrt(len(product))


@pytest.mark.parametrize("groups", [(1, 0), (3, 2), (5, 4)])  # an odd block, and the even one before it
def test_both_pairs_of_a_group_are_spread_together(generate, groups):
    """Any two of their four dimensions: at most 2^3 times as many points of a net in a rectangle as on average."""
    numbers = [generate(counters(np.arange(3)[:, None], np.arange(2**10), block)).reshape(3, -1, 4) for block in groups]
    for first in (0, 1):
        for second in (0, 1):
            for a in range(4, 7):
                cell = (numbers[0][..., first] * 2**a).astype(int) * 2 ** (10 - a)
                cell += (numbers[1][..., second] * 2 ** (10 - a)).astype(int)
                assert max(np.bincount(row).max() for row in cell) <= 8


def test_the_variance_falls_faster_than_one_over_n(generate):
    """Of the mean of x y over the pixels: that of a net of n points is below 2 / n^2 of the variance of one point."""
    numbers = generate(counters(np.arange(1000)[:, None], np.arange(256), 1)).reshape(1000, 256, 4)
    for x, y in PAIRS:
        product = numbers[..., x] * numbers[..., y]
        variance = 7 / 144
        for n in (4, 16, 64, 256):
            assert product[:, :n].mean(axis=1).var() < 2 * variance / n**2


def test_seeds_are_independent(generate):
    """Also for the same numbers at other pixels: a seed must not only permute the pixels."""
    pixels = counters(np.arange(4096), 0, 1)
    base = generate(pixels, (12, 0))
    for seed in ((13, 0), (12, 1), (13, 2**31), (0, 12)):
        other = generate(pixels, seed)
        assert not set(map(tuple, other.tolist())) & set(map(tuple, base.tolist()))
        for component in range(4):
            assert_independent(base[:, component], other[:, component], seed)
