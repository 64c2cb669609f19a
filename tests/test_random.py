"""Random numbers of kernels/util/random.h: the published generator, uniform, independent for different counters.

The statistical tests use one fixed set of numbers: as long as the generator passes the first test, they give the same
verdict. Their bounds are at z standard deviations; false alarms of a good generator are 6e-7 for each of the about 150
comparisons at z = 5, 1e-4 for the file.
"""

import numpy as np
import pytest

from isonoise.device.opencl import Device
from isonoise.device.program import flatten

Z = 5.0
MASK = 2**32 - 1

KERNEL = """
__kernel void blocks(__global const uint* counter, __global const uint2* key, __global float* numbers, uint n)
{
    const uint i = get_global_id(0);
    if (i >= n) return;
    const Vec4 number = random_block(key[i], counter[3 * i], counter[3 * i + 1], counter[3 * i + 2]);
    STORE3(xyz(number), 0, numbers + 4 * i);
    numbers[4 * i + 3] = number.w;
}

__kernel void counters(__global uint* counter, uint depths)
{
    const uint depth = get_global_id(0);
    if (depth >= depths) return;
    counter[3 * depth] = BLOCK_CAMERA;
    counter[3 * depth + 1] = BLOCK_BSDF(depth);
    counter[3 * depth + 2] = BLOCK_LIGHT(depth);
}
"""


def philox_4x32(counter, key, rounds: int = 7) -> tuple[int, int, int, int]:
    """Philox in Python integers, from the paper: Salmon, Moraes, Dror, Shaw, SC 2011, section 3.3."""
    (a, b, c, d), (k0, k1) = map(int, counter), map(int, key)
    for _ in range(rounds):
        first, second = 0xD2511F53 * a, 0xCD9E8D57 * c
        a, b, c, d = second >> 32 ^ b ^ k0, second & MASK, first >> 32 ^ d ^ k1, first & MASK
        k0, k1 = k0 + 0x9E3779B9 & MASK, k1 + 0xBB67AE85 & MASK
    return a, b, c, d


@pytest.fixture(scope="module")
def generate():
    """Returns numbers (n, 4) of the device for counters (n, 3), which are pixel, sample and block, and keys (n, 2)."""
    device = Device()
    kernel = device.build(flatten("util/random.h") + KERNEL, ("-cl-std=CL1.2",))["blocks"]

    def run(counters, keys) -> np.ndarray:
        counters, keys = np.ascontiguousarray(counters, np.uint32), np.asarray(keys, np.uint32)
        keys = np.ascontiguousarray(np.broadcast_to(keys, (len(counters), 2)))
        n = len(counters)
        numbers = device.buffer(16 * n, "numbers")
        device.launch(
            kernel, n, (device.buffer(counters, "counters"), device.buffer(keys, "keys"), numbers, np.uint32(n))
        )
        return device.read(numbers, np.float32, 4 * n).reshape(n, 4)

    return run


KNOWN = [  # Random123, tests/kat_vectors: philox4x32 with 7 rounds
    (
        [0, 0, 0, 0],
        [0, 0],
        [0x5F6FB709, 0x0D893F64, 0x4F121F81, 0x4F730A48],
    ),
    (
        [MASK] * 4,
        [MASK] * 2,
        [0x5207DDC2, 0x45165E59, 0x4D8EE751, 0x8C52F662],
    ),
    (
        [0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344],
        [0xA4093822, 0x299F31D0],
        [0x4DFCCABA, 0x190A87F0, 0xC47362BA, 0xB6B5242A],
    ),
]


@pytest.mark.parametrize(("counter", "key", "expected"), KNOWN)
def test_known_answers(counter, key, expected):
    """Of the Python function; on the device the last word of the counter is always 0."""
    assert list(philox_4x32(counter, key)) == expected


def test_the_device_computes_philox(generate):
    """Random counters and keys, and extreme ones whose products overflow: the upper 24 bits of every word."""
    random = np.random.default_rng(1)
    words = random.integers(0, 2**32, (2000, 5), dtype=np.uint64)
    words[:200] = random.choice([0, 1, 2**31, MASK], (200, 5))
    words[0] = 0  # a known answer that a path can have
    blocks = [philox_4x32([*w[:3], 0], w[3:]) for w in words]
    expected = [[(word >> 8) / 2**24 for word in block] for block in blocks]
    assert generate(words[:, :3], words[:, 3:]).tolist() == expected


def test_every_use_has_its_own_block():
    device = Device()
    kernel = device.build(flatten("util/random.h") + KERNEL, ("-cl-std=CL1.2",))["counters"]
    buffer = device.buffer(12 * 100, "counters")
    device.launch(kernel, 100, (buffer, np.uint32(100)))
    camera, bsdf, light = device.read(buffer, np.uint32, 300).reshape(100, 3).T.tolist()
    assert len(set(camera)) == 1
    assert len({camera[0], *bsdf, *light}) == 201


@pytest.fixture(scope="module")
def lattice(generate) -> np.ndarray:
    """Returns numbers of 64x64 pixels, 16 samples and 4 dimension blocks each: (4096, 16, 4, 4) float64."""
    pixel, index, block = np.meshgrid(np.arange(4096), np.arange(16), np.arange(4), indexing="ij")
    counters = np.stack([pixel, index, block], axis=-1).reshape(-1, 3)
    return generate(counters, [12, 0]).astype(np.float64).reshape(4096, 16, 4, 4)


def chi_square_z(counts: np.ndarray, expected: float) -> float:
    """Returns the standard normal deviate of a chi-square statistic (Wilson and Hilferty 1931)."""
    freedom = counts.size - 1
    chi = ((counts - expected) ** 2).sum() / expected
    return ((chi / freedom) ** (1 / 3) - 1 + 2 / (9 * freedom)) / np.sqrt(2 / (9 * freedom))


def test_numbers_are_uniform_in_the_unit_interval(lattice):
    assert lattice.min() >= 0
    assert lattice.max() < 1
    assert lattice.min() < 1e-5  # of a million numbers; fails with a probability of e^-10
    assert lattice.max() > 1 - 1e-5
    for block in range(4):
        for dimension in range(4):
            u = lattice[:, :, block, dimension].ravel()
            counts = np.bincount((u * 256).astype(int), minlength=256)
            assert abs(chi_square_z(counts, u.size / 256)) < Z
            low_bits = np.bincount((u * 2**24).astype(int) % 256, minlength=256)
            assert abs(chi_square_z(low_bits, u.size / 256)) < Z


def pairs(lattice: np.ndarray):
    """Yields numbers of neighbouring counters: by pixel, row, sample, block and dimension."""
    u = lattice
    for component in range(4):
        yield "pixel", u[:-1, :, :, component], u[1:, :, :, component]
        yield "row", u[:-64, :, :, component], u[64:, :, :, component]
        yield "sample", u[:, :-1, :, component], u[:, 1:, :, component]
        yield "block", u[:, :, :-1, component], u[:, :, 1:, component]
    for one in range(4):
        for other in range(one):
            yield "dimension", u[..., one], u[..., other]


def test_neighbours_are_independent(lattice):
    """By correlation, and the chi-square of 16x16 cells of the unit square."""
    for name, a, b in pairs(lattice):
        a, b = a.ravel(), b.ravel()
        correlation = 12 * np.mean((a - 0.5) * (b - 0.5))
        assert abs(correlation) * np.sqrt(a.size) < Z, name
        cells = np.bincount((a * 16).astype(int) * 16 + (b * 16).astype(int), minlength=256)
        assert abs(chi_square_z(cells, a.size / 256)) < Z, name


def test_seeds_are_independent(generate, lattice):
    counters = np.zeros((4096, 3), np.uint32)
    counters[:, 0] = np.arange(4096)
    base = lattice[:, 0, 0]
    for seed in ([13, 0], [12, 1], [13, 2**31]):
        other = generate(counters, seed).astype(np.float64)
        assert (other != base).mean() > 0.999
        correlation = 12 * np.mean((base - 0.5) * (other - 0.5), axis=0)
        assert (np.abs(correlation) * np.sqrt(4096) < Z).all()
