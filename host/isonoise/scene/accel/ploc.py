"""Clusters boxes into a binary tree: PLOC in numpy, without a Python loop over primitives.

Meister and Bittner, "Parallel Locally-Ordered Clustering for Bounding Volume Hierarchy Construction", TVCG 2018: each
cluster finds, among its neighbours along a Morton curve, the one whose union with it has the least surface area. Pairs
that choose each other merge. This repeats until one cluster is left. Called by `bvh.py` and the light tree.
"""

from dataclasses import dataclass

import numpy as np

SEARCH_RADIUS = 8
"""Neighbours considered on each side. In the paper, quality hardly improves beyond 8 to 16."""
CHUNK_CLUSTERS = 16384
"""Clusters per vectorised step of the search: its temporaries stay in the cache."""
_MAX_COST = np.float32(3e38)


@dataclass(frozen=True)
class BinaryTree:
    """Nodes 0..n-1 are the leaves (primitives), n..2n-2 the inner nodes in order of creation; the last is the root.

    `merges` is the number of inner nodes made in each round. The children of a round's nodes are from earlier rounds.
    """

    left: np.ndarray  # (2n-1,) int32, -1 for leaves
    right: np.ndarray  # (2n-1,) int32, -1 for leaves
    lower: np.ndarray  # (3, 2n-1) float32
    upper: np.ndarray  # (3, 2n-1) float32
    merges: list[int]

    @property
    def leaf_count(self) -> int:
        return (len(self.left) + 1) // 2

    def rounds(self):
        """Node ranges [begin, end) of the rounds, first to last."""
        begin = self.leaf_count
        for merged in self.merges:
            yield begin, begin + merged
            begin += merged


class BinaryTreeBuilder:
    """Grows a BinaryTree over n boxes, corners (3, n) float32, by rounds of merges."""

    def __init__(self, lower: np.ndarray, upper: np.ndarray):
        n = lower.shape[1]
        self.left, self.right = np.full(2 * n - 1, -1, np.int32), np.full(2 * n - 1, -1, np.int32)
        self.lower, self.upper = np.empty((3, 2 * n - 1), np.float32), np.empty((3, 2 * n - 1), np.float32)
        self.lower[:, :n], self.upper[:, :n] = lower, upper
        self.node_count = n
        self.merges: list[int] = []

    def merge(self, left: np.ndarray, right: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        """Add the parents of pairs of nodes, with the corners of their boxes (3, m); return their indices (m,)."""
        begin, end = self.node_count, self.node_count + len(left)
        self.left[begin:end], self.right[begin:end] = left, right
        self.lower[:, begin:end], self.upper[:, begin:end] = lower, upper
        self.merges.append(len(left))
        self.node_count = end
        return np.arange(begin, end, dtype=np.int32)

    def tree(self) -> BinaryTree:
        return BinaryTree(self.left, self.right, self.lower, self.upper, self.merges)


def half_area(lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Half the surface area of boxes given as (3, n) corners."""
    x, y, z = upper - lower
    return x * y + y * z + z * x


def morton_order(lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Order (n,) int32 of the centers of boxes, corners (3, n), along a Morton curve of 21 bits per axis."""
    centers = (lower.astype("f8") + upper) * 0.5  # float64: the sum of two large corners overflows float32
    low = centers.min(axis=1, keepdims=True)
    extent = float((centers.max(axis=1, keepdims=True) - low).max())
    cells = np.zeros(centers.shape, np.uint64) if extent == 0 else ((centers - low) * (2097151.0 / extent)).astype("u8")
    code = np.zeros(centers.shape[1], np.uint64)
    for axis in range(3):
        code |= _spread_bits(cells[axis]) << np.uint64(axis)
    return np.argsort(code, kind="stable").astype(np.int32)


def _spread_bits(x: np.ndarray) -> np.ndarray:
    """Insert two zero bits between neighbouring bits of 21-bit numbers."""
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
    """Cluster n >= 1 boxes, corners (3, n) float32 and finite."""
    return _cluster(lower, upper, morton_order(lower, upper), SEARCH_RADIUS)


def build_ordered_tree(lower: np.ndarray, upper: np.ndarray) -> BinaryTree:
    """The same for boxes along a Morton curve: keeps their order, because only neighbours merge."""
    return _cluster(lower, upper, np.arange(lower.shape[1], dtype=np.int32), 1)


def _cluster(lower: np.ndarray, upper: np.ndarray, nodes: np.ndarray, search_radius: int) -> BinaryTree:
    """Merge the boxes, in the order `nodes`, until one cluster is left."""
    builder = BinaryTreeBuilder(lower, upper)
    nodes = nodes.copy()  # the current clusters, in order, and their boxes
    lower, upper = lower.take(nodes, axis=1), upper.take(nodes, axis=1)
    while len(nodes) > 1:
        neighbour = _best_neighbours(lower, upper, search_radius)
        index = np.arange(len(nodes), dtype=np.int32)
        first = np.flatnonzero((neighbour[neighbour] == index) & (index < neighbour))
        second = neighbour[first]
        union_lower = np.minimum(lower.take(first, axis=1), lower.take(second, axis=1))
        union_upper = np.maximum(upper.take(first, axis=1), upper.take(second, axis=1))
        nodes[first] = builder.merge(nodes[first], nodes[second], union_lower, union_upper)
        lower[:, first], upper[:, first] = union_lower, union_upper
        remains = np.ones(len(nodes), bool)
        remains[second] = False
        remaining = np.flatnonzero(remains)
        nodes, lower, upper = nodes[remaining], lower.take(remaining, axis=1), upper.take(remaining, axis=1)
    return builder.tree()


def build_balanced_tree(lower: np.ndarray, upper: np.ndarray) -> BinaryTree:
    """A tree of depth log2 n: neighbours along the Morton curve merge in pairs, round after round."""
    builder = BinaryTreeBuilder(lower, upper)
    nodes = morton_order(lower, upper)
    while len(nodes) > 1:
        even_count = len(nodes) // 2 * 2
        left, right = nodes[:even_count:2], nodes[1::2]
        union_lower = np.minimum(builder.lower[:, left], builder.lower[:, right])
        union_upper = np.maximum(builder.upper[:, left], builder.upper[:, right])
        nodes = np.concatenate([builder.merge(left, right, union_lower, union_upper), nodes[even_count:]])
    return builder.tree()


def _best_neighbours(lower: np.ndarray, upper: np.ndarray, search_radius: int) -> np.ndarray:
    """For each cluster the index of the neighbour with the least surface area of their union.

    Of equal costs the first one tried wins, and the pairs (0, 1), (2, 3), ... are tried first. So identical boxes halve
    in number each round instead of merging one by one. The first pair tried of those with the least cost overall
    chooses each other, so every round merges at least one pair.
    """
    n = lower.shape[1]
    best_cost = np.full(n, np.inf, np.float32)
    best_index = np.zeros(n, np.int32)
    index = np.arange(n, dtype=np.int32)
    for begin in range(0, n, CHUNK_CLUSTERS):
        end = min(begin + CHUNK_CLUSTERS, n)
        for distance in range(1, min(search_radius, n - 1) + 1):
            stop = min(end, n - distance)
            if stop <= begin:
                continue
            a, b = slice(begin, stop), slice(begin + distance, stop + distance)
            cost = half_area(np.minimum(lower[:, a], lower[:, b]), np.maximum(upper[:, a], upper[:, b]))
            np.minimum(cost, _MAX_COST, out=cost)  # pairs whose cost overflows still have to merge
            for offset, stride in ((begin & 1, 2), (~begin & 1, 2)) if distance == 1 else ((0, 1),):
                pair_cost = cost[offset::stride]
                first = slice(begin + offset, stop, stride)
                second = slice(begin + offset + distance, stop + distance, stride)
                for this, other in ((first, second), (second, first)):
                    is_better = pair_cost < best_cost[this]
                    np.copyto(best_cost[this], pair_cost, where=is_better)
                    np.copyto(best_index[this], index[other], where=is_better)
    return best_index
