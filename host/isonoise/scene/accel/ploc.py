"""Bottom-up clustering of boxes into a binary tree: PLOC, in numpy without a Python loop per primitive.

Meister and Bittner, "Parallel Locally-Ordered Clustering for Bounding Volume Hierarchy Construction", TVCG 2018: along
a Morton curve every cluster looks for the neighbour within a small radius whose union with it has the least surface
area; pairs that choose each other merge; repeat until one is left.
"""

from dataclasses import dataclass

import numpy as np

SEARCH_RADIUS = 8
"""Neighbours looked at on each side; the paper's quality hardly grows beyond 8 to 16."""
CHUNK = 16384
"""Clusters per vectorised step of the search, so that its temporaries stay in the cache."""


@dataclass(frozen=True)
class BinaryTree:
    """Nodes 0..n-1 are the leaves (primitives), n..2n-2 the inner ones in order of creation; the last is the root.

    `merges` holds the number of inner nodes made in each round: a round's children are all of earlier rounds.
    """

    left: np.ndarray  # (2n-1,) int32, -1 for leaves
    right: np.ndarray  # (2n-1,) int32, -1 for leaves
    lower: np.ndarray  # (3, 2n-1) float32
    upper: np.ndarray  # (3, 2n-1) float32
    merges: list[int]

    @property
    def leaves(self) -> int:
        return (len(self.left) + 1) // 2

    def rounds(self):
        """Node ranges [begin, end) of the rounds, first to last."""
        begin = self.leaves
        for merged in self.merges:
            yield begin, begin + merged
            begin += merged


def half_area(lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Half the surface area of boxes given as (3, n) corners."""
    x, y, z = upper - lower
    return x * y + y * z + z * x


def morton_order(centers: np.ndarray) -> np.ndarray:
    """Order of points (3, n) along a Morton curve of 21 bits an axis."""
    low = centers.min(axis=1, keepdims=True)
    extent = float((centers.max(axis=1, keepdims=True) - low).max())
    cells = np.zeros(centers.shape, np.uint64) if extent == 0 else ((centers - low) * (2097151.0 / extent)).astype("u8")
    code = np.zeros(centers.shape[1], np.uint64)
    for axis in range(3):
        code |= _spread_bits(cells[axis]) << np.uint64(axis)
    return np.argsort(code, kind="stable")


def _spread_bits(x: np.ndarray) -> np.ndarray:
    """Puts two zero bits between neighbouring bits of 21-bit numbers."""
    for shift, mask in (
        (32, 0x1F00000000FFFF),
        (16, 0x1F0000FF0000FF),
        (8, 0x100F00F00F00F00F),
        (4, 0x10C30C30C30C30C3),
        (2, 0x1249249249249249),
    ):
        x = (x | (x << np.uint64(shift))) & np.uint64(mask)
    return x


def build_binary_tree(lower: np.ndarray, upper: np.ndarray) -> BinaryTree:
    """Clusters n >= 1 boxes, corners of shape (3, n) float32 and finite."""
    n = lower.shape[1]
    left = np.full(2 * n - 1, -1, np.int32)
    right = np.full(2 * n - 1, -1, np.int32)
    lowers = np.empty((3, 2 * n - 1), np.float32)
    uppers = np.empty((3, 2 * n - 1), np.float32)
    lowers[:, :n], uppers[:, :n] = lower, upper
    # float64: the sum of two large corners overflows float32
    nodes = morton_order((lower.astype("f8") + upper) * 0.5).astype(np.int32)
    lo, hi = lower.take(nodes, axis=1), upper.take(nodes, axis=1)
    merges, created = [], n
    while len(nodes) > 1:
        partner = _partners(lo, hi)
        index = np.arange(len(nodes), dtype=np.int32)
        first = np.flatnonzero((partner[partner] == index) & (index < partner))
        second = partner[first]
        new = slice(created, created + len(first))
        left[new], right[new] = nodes[first], nodes[second]
        lowers[:, new] = np.minimum(lo.take(first, axis=1), lo.take(second, axis=1))
        uppers[:, new] = np.maximum(hi.take(first, axis=1), hi.take(second, axis=1))
        nodes[first] = np.arange(new.start, new.stop, dtype=np.int32)
        lo[:, first], hi[:, first] = lowers[:, new], uppers[:, new]
        keep = np.ones(len(nodes), bool)
        keep[second] = False
        kept = np.flatnonzero(keep)
        nodes, lo, hi = nodes[kept], lo.take(kept, axis=1), hi.take(kept, axis=1)
        merges.append(len(first))
        created = new.stop
    return BinaryTree(left, right, lowers, uppers, merges)


def _partners(lo: np.ndarray, hi: np.ndarray) -> np.ndarray:
    """For every cluster the index of its best neighbour.

    Of equal costs the first one tried wins, and pairs (even, odd) are tried first: identical boxes halve in number
    each round instead of merging one by one. The cheapest pair overall that was tried first always chooses each other,
    so that every round merges something.
    """
    n = lo.shape[1]
    best = np.full(n, np.inf, np.float32)
    partner = np.zeros(n, np.int32)
    index = np.arange(n, dtype=np.int32)
    for begin in range(0, n, CHUNK):
        end = min(begin + CHUNK, n)
        for distance in range(1, min(SEARCH_RADIUS, n - 1) + 1):
            stop = min(end, n - distance)
            if stop <= begin:
                continue
            a, b = slice(begin, stop), slice(begin + distance, stop + distance)
            cost = half_area(np.minimum(lo[:, a], lo[:, b]), np.maximum(hi[:, a], hi[:, b]))
            # costs that overflow still have to merge in the end
            np.minimum(cost, np.float32(3e38), out=cost)
            for offset, stride in ((begin & 1, 2), (~begin & 1, 2)) if distance == 1 else ((0, 1),):
                pair_cost = cost[offset::stride]
                here = slice(begin + offset, stop, stride)
                there = slice(begin + offset + distance, stop + distance, stride)
                for one, other in ((here, there), (there, here)):
                    better = pair_cost < best[one]
                    np.copyto(best[one], pair_cost, where=better)
                    np.copyto(partner[one], index[other], where=better)
    return partner
