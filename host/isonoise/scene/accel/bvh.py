"""The 8-wide bounding volume hierarchy that the kernels traverse, collapsed from a binary tree.

Layout on the device (all float8, see kernels/geometry/bvh.h):
- node: lower x, y, z and upper x, y, z of 8 children, then 8 child references (int32 bits);
- block: x, y, z of the first, second and third corners of 8 triangles, then 8 triangle indices (uint32 bits).

A reference >= 0 is a node: the number of its first row, a float8. ~reference of a negative one is a leaf: the number of
a block's first row, or past the blocks' rows an analytic primitive or anything else that is a box (`hierarchy`).
Unused slots of a node are boxes that no ray meets; unused lanes of a block are triangles of zero area.
"""

from dataclasses import dataclass

import numpy as np

from isonoise.scene.accel.ploc import BinaryTree, build_binary_tree, half_area, morton_order

BVH_WIDTH = 8
NODE_ROWS, BLOCK_ROWS = 7, 10
NODE_COST = 1.0
"""Cost of a node in tests of a block."""
CHUNK = 16384
"""Nodes at a time, so that what is in use stays in the cache."""
STACK_SIZE = 256
"""Entries of a ray's traversal stack (kernels/geometry/traverse.h); deeper trees are built again by halving."""


@dataclass(frozen=True)
class Bvh:
    nodes: np.ndarray  # (N, 7, 8) float32
    blocks: np.ndarray  # (M, 10, 8) float32
    stack: int  # stack entries that a traversal may need
    depth: int  # levels of nodes

    @property
    def first_analytic(self) -> int:
        """Number of the first leaf that is no block."""
        return BLOCK_ROWS * len(self.blocks)


def build_bvh(
    corners: np.ndarray, analytic_lower: np.ndarray, analytic_upper: np.ndarray, stack_size: int = STACK_SIZE
) -> Bvh:
    """Builds over triangles, corners (T, 3, 3) float32, and the boxes of the analytic primitives, (A, 3) float32.

    A tree that needs more than `stack_size` entries is built again by halving.
    """
    triangles, analytics = len(corners), len(analytic_lower)
    if triangles + analytics == 0:
        return Bvh(_empty_nodes(1), np.zeros((0, 10, 8), np.float32), 1, 1)
    by_corner = np.ascontiguousarray(corners.transpose(1, 2, 0))  # (corner, axis, triangle)
    lower = np.concatenate([by_corner.min(axis=0), analytic_lower.T], axis=1).astype(np.float32)
    upper = np.concatenate([by_corner.max(axis=0), analytic_upper.T], axis=1).astype(np.float32)
    weight = np.ones(triangles + analytics, np.int32)
    weight[triangles:] = BVH_WIDTH + 1  # an analytic primitive never shares a leaf
    bvh = _collapse(build_binary_tree(lower, upper), weight, corners)
    if bvh.stack > stack_size:
        bvh = _collapse(_halve(lower, upper), weight, corners)
    return bvh


def _halve(lower: np.ndarray, upper: np.ndarray) -> BinaryTree:
    """A tree of depth log2 n: neighbours along the Morton curve pair up, round after round."""
    n = lower.shape[1]
    left, right = np.full(2 * n - 1, -1, np.int32), np.full(2 * n - 1, -1, np.int32)
    lowers, uppers = np.empty((3, 2 * n - 1), np.float32), np.empty((3, 2 * n - 1), np.float32)
    lowers[:, :n], uppers[:, :n] = lower, upper
    nodes = morton_order((lower.astype("f8") + upper) * 0.5).astype(np.int32)
    merges, created = [], n
    while len(nodes) > 1:
        a, b = nodes[: len(nodes) // 2 * 2 : 2], nodes[1::2]
        new = np.arange(created, created + len(a), dtype=np.int32)
        left[new], right[new] = a, b
        lowers[:, new] = np.minimum(lowers[:, a], lowers[:, b])
        uppers[:, new] = np.maximum(uppers[:, a], uppers[:, b])
        nodes = np.concatenate([new, nodes[len(nodes) // 2 * 2 :]])
        merges.append(len(new))
        created += len(new)
    return BinaryTree(left, right, lowers, uppers, merges)


def _empty_nodes(n: int) -> np.ndarray:
    nodes = np.zeros((n, 7, BVH_WIDTH), np.float32)
    nodes[:, 0:3] = np.inf
    nodes[:, 3:6] = -np.inf
    return nodes


def _collapse(tree: BinaryTree, weight: np.ndarray, corners: np.ndarray) -> Bvh:
    """Makes the wide nodes that cost least, level by level from the root."""
    primitives = tree.leaves
    size = np.ones(len(tree.left), np.int32)  # primitives below
    load = np.empty(len(tree.left), np.int64)  # weight below: at most BVH_WIDTH makes a leaf
    load[:primitives] = weight
    for begin, end in tree.rounds():
        left, right = tree.left[begin:end], tree.right[begin:end]
        size[begin:end] = size[left] + size[right]
        load[begin:end] = load[left] + load[right]
    first = np.zeros(len(tree.left), np.int32)  # place of the first primitive below, in depth-first order
    for begin, end in reversed(list(tree.rounds())):
        left, right = tree.left[begin:end], tree.right[begin:end]
        first[left] = first[begin:end]
        first[right] = first[begin:end] + size[left]
    order = np.empty(primitives, np.int32)
    order[first[:primitives]] = np.arange(primitives, dtype=np.int32)

    plan = _plan(tree, load)
    root = np.array([len(tree.left) - 1], np.int32)
    levels, stack_need, frontier, need = [], 1, root, np.ones(1, np.int64)
    while len(frontier):
        slots = _children(tree, frontier, plan)
        used = slots >= 0
        need = need + used.sum(axis=1) - 1
        stack_need = max(stack_need, int(need.max()))
        levels.append(slots)
        inner = used & ~plan.is_leaf[slots]
        frontier = slots[inner]
        need = np.repeat(need, inner.sum(axis=1))
    slots = np.concatenate(levels)
    return Bvh(*_lay_out(tree, slots, plan.is_leaf, first, size, order, corners), stack_need, len(levels))


@dataclass(frozen=True)
class _Plan:
    """What becomes of the binary nodes in the wide hierarchy of least cost."""

    is_leaf: np.ndarray  # (2n-1,) bool: as one tree it is a leaf
    # (n-1, BVH_WIDTH+1) uint8, by inner node and the number of trees that it may become: how many it becomes, and how
    # many
    # of these are made of its left child
    trees: np.ndarray
    left_trees: np.ndarray


def _plan(tree: BinaryTree, load: np.ndarray) -> _Plan:
    """The hierarchy of least cost by the surface area heuristic (Goldsmith and Salmon 1987).

    Ylitie, Karras, Laine, "Efficient Incoherent Ray Traversal on GPUs Through Compressed Wide BVHs", HPG 2017, 3.1:
    from the leaves up, the least cost of a binary node that becomes at most i trees, i = 1 to 7. As one tree it is a
    leaf or a wide node, whose up to 8 children are the trees that its two sides become.
    """
    leaves = tree.leaves
    area = half_area(tree.lower, tree.upper)
    cost = np.empty((len(area), BVH_WIDTH - 1), np.float32)  # [node, i - 1]
    cost[:leaves] = area[:leaves, None]
    is_leaf = np.ones(len(area), bool)
    trees = np.ones((leaves - 1, BVH_WIDTH + 1), np.uint8)
    left_trees = np.zeros((leaves - 1, BVH_WIDTH + 1), np.uint8)
    for first, last in tree.rounds():
        for begin in range(first, last, CHUNK):
            part = slice(begin, min(begin + CHUNK, last))
            inner = slice(part.start - leaves, part.stop - leaves)
            left, right = cost[tree.left[part]].T.copy(), cost[tree.right[part]].T.copy()
            as_children = [None, None]  # cost of both sides as at most j trees in all
            for j in range(2, BVH_WIDTH + 1):
                best, picked = left[0] + right[j - 2], np.ones(left.shape[1], np.uint8)
                for k in range(2, j):
                    other = left[k - 1] + right[j - k - 1]
                    np.copyto(picked, np.uint8(k), where=other < best)
                    np.minimum(best, other, out=best)
                as_children.append(best)
                left_trees[inner, j] = picked
            wide = NODE_COST * area[part] + as_children[BVH_WIDTH]
            leaf = np.where(load[part] <= BVH_WIDTH, area[part], np.float32(np.inf))
            is_leaf[part] = leaf <= wide
            cost[part, 0] = np.minimum(leaf, wide)
            for j in range(2, BVH_WIDTH):
                fewer = cost[part, j - 2] <= as_children[j]
                cost[part, j - 1] = np.minimum(cost[part, j - 2], as_children[j])
                trees[inner, j] = np.where(fewer, trees[inner, j - 1], j)
                left_trees[inner, j] = np.where(fewer, left_trees[inner, j - 1], left_trees[inner, j])
    return _Plan(is_leaf, trees, left_trees)


def _children(tree: BinaryTree, frontier: np.ndarray, plan: _Plan) -> np.ndarray:
    """Children of the wide nodes that become of the binary nodes `frontier`: (len(frontier), BVH_WIDTH), or -1."""
    slots = np.full((len(frontier), BVH_WIDTH), -1, np.int32)
    if plan.is_leaf[frontier[0]]:  # only a root can be: one leaf holds the whole scene
        slots[:, 0] = frontier
        return slots
    leaves, parents, nodes = tree.leaves, [], []
    parent, node, trees = np.arange(len(frontier)), frontier, np.full(len(frontier), BVH_WIDTH)
    of_left = plan.left_trees[frontier - leaves, BVH_WIDTH]
    while len(node):
        parent, budget = np.concatenate([parent, parent]), np.concatenate([of_left, trees - of_left])
        node = np.concatenate([tree.left[node], tree.right[node]])
        inner = np.maximum(node - leaves, 0)
        trees = np.where(node < leaves, 1, plan.trees[inner, budget])
        whole = trees == 1
        parents.append(parent[whole])
        nodes.append(node[whole])
        of_left = plan.left_trees[inner, budget][~whole]
        parent, node, trees = parent[~whole], node[~whole], trees[~whole]
    parent, node = np.concatenate(parents), np.concatenate(nodes)
    order = np.argsort(parent, kind="stable")
    parent, node = parent[order], node[order]
    slots[parent, np.arange(len(parent)) - np.searchsorted(parent, parent)] = node
    return slots


def _lay_out(tree, slots, is_leaf, first, size, order, corners) -> tuple[np.ndarray, np.ndarray]:
    used = slots >= 0
    nodes = _empty_nodes(len(slots))
    for axis in range(3):
        lower, upper = tree.lower[axis][slots[used]], tree.upper[axis][slots[used]]
        # one unit in the last place wider: a ray that runs in the plane of a box's side has to meet the edges that lie
        # there
        margin = np.float32(2.0**-23) * np.maximum(np.abs(lower), np.abs(upper))
        nodes[:, axis][used] = lower - margin
        nodes[:, 3 + axis][used] = upper + margin
    inner = used & ~is_leaf[slots]
    leaf = used & is_leaf[slots]
    members = slots[leaf]
    is_block = order[first[members]] < len(corners)
    block_nodes = members[is_block]
    leaf_reference = np.empty(len(members), np.int32)
    leaf_reference[is_block] = BLOCK_ROWS * np.arange(len(block_nodes))
    leaf_reference[~is_block] = BLOCK_ROWS * len(block_nodes) + order[first[members[~is_block]]] - len(corners)
    references = np.zeros(slots.shape, np.int32)
    references[inner] = NODE_ROWS * (1 + np.arange(np.count_nonzero(inner)))  # nodes stand in breadth-first order
    references[leaf] = ~leaf_reference
    nodes[:, 6] = references.view(np.float32)

    blocks = np.zeros((len(block_nodes), 10, BVH_WIDTH), np.float32)
    lane = np.arange(BVH_WIDTH)
    filled = lane < size[block_nodes][:, None]
    ids = order[first[block_nodes][:, None] + np.where(filled, lane, 0)]
    rows = corners.reshape(-1, 9).take(ids, axis=0)  # (block, lane, coordinate)
    rows[~filled] = 0
    blocks[:, :9] = rows.transpose(0, 2, 1)
    blocks[:, 9] = np.where(filled, ids, -1).astype(np.int32).view(np.float32)
    return nodes, blocks
