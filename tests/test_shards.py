"""The shards of an image: every pixel once, spread over the image, the same on any machine."""

import numpy as np
import pytest

from isonoise.distributed.shards import BLOCK_SIZE, MAX_SHARDS, MIN_SHARDS, SHARD_PIXELS, Shards

SHAPES = [(1, 1), (1, 4000), (4000, 1), (7, 9), (8, 8), (37, 1001), (64, 64), (250, 333)]
NUMBERS = [None, 3, 61]


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("number", NUMBERS)
def test_every_pixel_is_in_one_shard(shape, number):
    shards = Shards(shape, number)
    pixels = shards.pixels(range(shards.number))
    assert pixels.dtype == np.uint32
    assert np.array_equal(np.sort(pixels), np.arange(shape[0] * shape[1]))
    assert [len(shards.pixels([shard])) for shard in range(shards.number)] == shards.sizes.tolist()


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("number", NUMBERS)
def test_sums_are_those_of_the_pixels(shape, number):
    """Also where 32 bits overflow."""
    shards = Shards(shape, number)
    allocation = np.random.default_rng(1).integers(0, 2**32, shape, dtype=np.uint32)
    expected = [int(allocation.ravel()[shards.pixels([k])].sum(dtype=np.int64)) for k in range(shards.number)]
    assert shards.sums(allocation).tolist() == expected


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("number", NUMBERS)
def test_shards_have_as_many_blocks_but_for_one(shape, number):
    shards = Shards(shape, number)
    blocks = []
    for shard in range(shards.number):
        rows, columns = np.divmod(shards.pixels([shard]), shape[1])
        blocks.append(len({*zip(rows // BLOCK_SIZE, columns // BLOCK_SIZE, strict=True)}))
    assert max(blocks) - min(blocks) <= 1
    assert min(blocks) >= 1


def test_shards_are_spread_over_the_image():
    """Each shard has one block of every run of the Morton curve. So a square cell that consists of whole runs has
    the same number of blocks of each shard, and a quadrant of any image about the same."""
    shards = Shards((512, 512), 64)
    rows, columns = np.divmod(shards.pixels([5]), 512)
    cells = np.bincount(rows // 64 * 8 + columns // 64)
    assert cells.tolist() == [BLOCK_SIZE**2] * 64
    shards = Shards((500, 333))
    for shard in range(shards.number):
        rows, columns = np.divmod(shards.pixels([shard]), 333)
        quadrants = np.bincount((rows >= 250) * 2 + (columns >= 167), minlength=4)
        # a run that two quadrants share, or that the edge of the image cuts, moves a block or two
        assert abs(quadrants - len(rows) / 4).max() <= 3 * BLOCK_SIZE**2


def test_the_order_is_hashed():
    """Shards are no lattice, whose distance could agree with a pattern in the image: in 64 runs of 64 blocks, the place
    of a shard takes about 64 (1 - 1/e) values."""
    shards = Shards((512, 512), 64)
    for shard in range(0, 64, 9):
        rows, columns = np.divmod(shards.pixels([shard])[:: BLOCK_SIZE**2], 512)
        places = {*zip(rows // 8 % 8, columns // 8 % 8, strict=True)}
        assert 30 <= len(places) <= 52


def splitmix64(state: int) -> int:
    """One output of SplitMix64, from its definition. The first one of state 0 is printed in many places."""
    mask = 2**64 - 1
    state = state + 0x9E3779B97F4A7C15 & mask
    state = (state ^ state >> 30) * 0xBF58476D1CE4E5B9 & mask
    state = (state ^ state >> 27) * 0x94D049BB133111EB & mask
    return state ^ state >> 31


def test_the_order_is_that_of_splitmix64():
    """So it is the same on any machine."""
    assert splitmix64(0) == 0xE220A8397B1DCDAF
    # the first ones along the Morton curve, (row, column)
    blocks = [(0, 0), (0, 1), (1, 0), (1, 1), (0, 2), (1, 2)]
    runs = [sorted(range(3), key=lambda k, run=run: splitmix64(3 * run + k)) for run in range(2)]
    firsts = [[8 * 24 * row + 8 * column for row, column in blocks[begin : begin + 3]] for begin in (0, 3)]
    shards = Shards((24, 24), 3)
    for run in range(2):
        for first, shard in zip(firsts[run], runs[run], strict=True):
            assert shards.pixels([shard])[run * BLOCK_SIZE**2] == first


@pytest.mark.parametrize(
    ("shape", "number"),
    [
        ((1, 1), 1),
        ((64, 64), MIN_SHARDS),
        ((512, 512), 512 * 512 // SHARD_PIXELS),
        ((1080, 1920), 2025),
        ((2200, 2000), MAX_SHARDS),
    ],
)
def test_number_of_shards(shape, number):
    assert Shards(shape).number == number


def test_pixels_follow_the_order_of_the_shards():
    shards = Shards((50, 70), 5)
    expected = np.concatenate([shards.pixels([3]), shards.pixels([1])])
    assert np.array_equal(shards.pixels([3, 1]), expected)
    assert shards.pixels([]).shape == (0,)
