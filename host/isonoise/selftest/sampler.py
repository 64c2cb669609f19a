"""Checks of the sampler `sobol` (kernels/util/sobol.h): bits, nets, uniformity, independence."""

from collections.abc import Iterator

import numpy as np

from isonoise.device.opencl import Device
from isonoise.device.program import flatten
from isonoise.selftest.cases import Case, Context, array_case, count_case

_KERNEL = """
__kernel void blocks(__global const uint* counter, uint2 seed, __global float* numbers, uint n)
{
    const uint i = get_global_id(0);
    if (i >= n) return;
    const Vec4 number = random_block(seed, counter[3 * i], counter[3 * i + 1], counter[3 * i + 2]);
    STORE3(xyz(number), 0, numbers + 4 * i);
    numbers[4 * i + 3] = number.w;
}
"""
SECOND_PAIR = (0x1, 0x2, 0x5, 0xB, 0x17, 0x3D, 0x62, 0xA9, 0x147, 0x396, 0x6BA, 0xF2F, 0x1864, 0x352D, 0x66F7, 0xC672)
"""Columns of the matrix that the second pair of a group reads the index through."""
MAX_DEVIATE = 6.0
"""Bound of standard normal deviates: 2e-9 false alarms each."""
_BLOCKS = (0, 1, 2, 3, 14, 15, 0x80000001, 0xC0000003)


class SobolNumbers:
    """The numbers of the device's sampler `sobol`."""

    def __init__(self, device: Device):
        self._device = device
        options = ("-cl-std=CL1.2", "-DFEATURE_SOBOL=1")
        self._kernel = device.build(flatten("util/random.h") + _KERNEL, options)["blocks"]

    def __call__(self, pixel, index, block, seed: tuple[int, int] = (0, 0)) -> np.ndarray:
        """Returns float64 (..., 4): the numbers of dimension blocks; the counters broadcast."""
        counters = np.stack(np.broadcast_arrays(pixel, index, block), axis=-1)
        flat = np.ascontiguousarray(counters.reshape(-1, 3), np.uint32)
        numbers = self._device.buffer(16 * len(flat), "the numbers")
        counter, key = self._device.buffer(flat, "the counters"), np.array(seed, np.uint32)
        self._device.launch(self._kernel, len(flat), (counter, key, numbers, np.uint32(len(flat))))
        return self._device.read(numbers, np.float32, 4 * len(flat)).reshape(*counters.shape[:-1], 4).astype(float)


def _hash(x: np.ndarray) -> np.ndarray:
    x = (x ^ x >> np.uint32(16)) * np.uint32(0x7FEB352D)
    x = (x ^ x >> np.uint32(15)) * np.uint32(0x846CA68B)
    return x ^ x >> np.uint32(16)


def _reversed(x: np.ndarray) -> np.ndarray:
    return sum(((x >> np.uint32(k)) & np.uint32(1)) << np.uint32(31 - k) for k in range(32)).astype(np.uint32)


def _scrambled(x: np.ndarray, seed: np.ndarray) -> np.ndarray:
    x = _reversed(x)
    x ^= x * np.uint32(0x3D20ADEA)
    x = (x + seed) * (seed >> np.uint32(16) | np.uint32(1))
    x ^= x * np.uint32(0x05526C56)
    return _reversed(x ^ x * np.uint32(0x53A22864))


def _combined(index: np.ndarray, columns: list[int]) -> np.ndarray:
    """The exclusive or of the columns whose bits are set in the index."""
    result = np.zeros_like(index)
    for k, column in enumerate(columns):
        result ^= np.where(index >> np.uint32(k) & np.uint32(1), np.uint32(column), np.uint32(0))
    return result


def _sobol(index: np.ndarray) -> np.ndarray:
    """The second dimension of the Sobol' sequence from its direction numbers, those of Pascal's triangle modulo 2."""
    columns = [1 << 31]
    for _ in range(31):
        columns.append(columns[-1] ^ columns[-1] >> 1)
    return _combined(index, columns)


def expected_numbers(pixel, index, block, seed: tuple[int, int] = (0, 0)) -> np.ndarray:
    """Returns float64 (..., 4): what the device must compute, from the sequence's definition, in integers."""
    pixel, index, block = (np.asarray(a).astype(np.uint32) for a in np.broadcast_arrays(pixel, index, block))
    first, second = np.array([seed[0]], np.uint32), np.array([seed[1]], np.uint32)
    with np.errstate(over="ignore"):
        pixel_key = _hash(pixel) ^ _hash(first ^ np.uint32(0xBB67AE85))
        group_key = _hash(second ^ _hash(first + np.uint32(0x3C6EF372))) + np.uint32(0x9E3779B9) * (
            block >> np.uint32(1)
        )
        is_odd = block & np.uint32(1) == 1
        own_key = group_key + np.where(is_odd, np.uint32(0x85EBCA6B), np.uint32(0xC2B2AE35))
        words = []
        for key, is_second in ((group_key, ~is_odd), (own_key, np.zeros_like(is_odd))):
            key = _hash(pixel_key + key)
            key_x = _hash(key ^ np.where(is_second, np.uint32(0x3C6EF372), np.uint32(0x9E3779B9)))
            key_y = key_x >> np.uint32(16) ^ key_x * np.uint32(0x85EBCA6B)
            shuffled = _scrambled(index, key)
            matrix = shuffled & np.uint32(0xFFFF0000) ^ _combined(shuffled & np.uint32(0xFFFF), list(SECOND_PAIR))
            source = np.where(is_second, matrix, shuffled)
            for value, scramble in ((_reversed(source), key_x), (_sobol(source), key_y)):
                words.append(np.where(is_second, value ^ scramble, _scrambled(value, scramble)))
    return np.stack([word >> np.uint32(8) for word in words], axis=-1) / 2**24


def bits(context: Context) -> Iterator[Case]:
    """All 2^32 sample indices and all blocks: the bits of the definition."""
    numbers, random = SobolNumbers(context.device), np.random.default_rng(1)
    words = random.integers(0, 2**32, (3, 4000), dtype=np.uint64)
    words[:, :400] = random.choice([0, 1, 2**31, 2**32 - 1], (3, 400))
    for seed in ((0, 0), (2**32 - 1, 1), (12, 2**31)):
        differing = numbers(*words, seed) != expected_numbers(*words, seed)
        yield count_case(
            f"4 numbers of 4,000 blocks, seed {seed}: numbers that differ", differing, "exact: the same bits"
        )


def nets(context: Context) -> Iterator[Case]:
    """Every pair is a (0,2)-sequence: each aligned run of 2^m samples has a point in each of 2^m rectangles."""
    numbers = SobolNumbers(context.device)
    for first in (0, 2**20, 2**32 - 2**10):
        wrong = 0
        for block in _BLOCKS:
            u = numbers(np.arange(3)[:, None], first + np.arange(2**10), block)
            for m in range(11):
                runs = u.reshape(3, -1, 2**m, 2, 2)  # of pairs
                for a in range(m + 1):
                    cell = (runs[..., 0] * 2**a).astype(int) * 2 ** (m - a) + (runs[..., 1] * 2 ** (m - a)).astype(int)
                    wrong += int((np.sort(cell, axis=2) != np.arange(2**m)[:, None]).any())
        yield count_case(
            f"runs of 1 to 1,024 samples from sample {first:,} on: shapes that are no nets", wrong, "exact"
        )


def _chi_square_deviate(counts: np.ndarray) -> float:
    """Standard normal deviate of the chi-square of equally probable cells (Wilson and Hilferty 1931)."""
    expected, dof = counts.mean(), counts.size - 1
    chi_square = ((counts - expected) ** 2).sum() / expected
    return ((chi_square / dof) ** (1 / 3) - 1 + 2 / (9 * dof)) / np.sqrt(2 / (9 * dof))


def independence(context: Context) -> Iterator[Case]:
    """Over the pixels, numbers are uniform, and independent of the other numbers of a path."""
    numbers, pixels = SobolNumbers(context.device), np.arange(2**14)[:, None]
    u = np.concatenate(
        [numbers(pixels, np.array([index]), np.arange(4))[:, :, :].reshape(2**14, 16) for index in (0, 5)], 1
    )
    single = [_chi_square_deviate(np.bincount((u[:, k] * 256).astype(int), minlength=256)) for k in range(u.shape[1])]
    basis = f"{MAX_DEVIATE:g} standard deviations"
    yield array_case("2 samples, 16 dimensions: chi-square of 256 cells", single, 0, MAX_DEVIATE, basis)
    cell = (u * 8).astype(int)
    pairs = [(a, b) for a in range(u.shape[1]) for b in range(a) if a - b != 16]  # not the same dimension twice
    joint = [_chi_square_deviate(np.bincount(cell[:, a] * 8 + cell[:, b], minlength=64)) for a, b in pairs]
    yield array_case("pairs of these: chi-square of 8x8 cells", joint, 0, MAX_DEVIATE, basis)
    other = numbers(pixels, np.array([0]), np.arange(4), seed=(1, 0)).reshape(2**14, 16)
    joint = [
        _chi_square_deviate(np.bincount(cell[:, a] * 8 + (other[:, a] * 8).astype(int), minlength=64))
        for a in range(16)
    ]
    yield array_case("the same dimension with another seed: chi-square of 8x8 cells", joint, 0, MAX_DEVIATE, basis)


CHECKS = (bits, nets, independence)
