"""Builds the 8-wide BVH that the kernels traverse, by collapsing a binary tree. Called by `build.py`.

Layout on the device (all float8, see kernels/geometry/bvh.h):
- node: lower x, y, z and upper x, y, z of 8 children, then 8 child references (int32 bits);
- block: x, y, z of the first, second and third corners of 8 triangles, then 8 triangle indices (uint32 bits).

A reference >= 0 is a node: the index of its first row (a float8). A negative reference is a leaf; ~reference is the
index of a block's first row or, beyond the rows of all blocks, an analytic primitive or an instance (see `build.py`).
Unused child slots of a node are boxes that no ray intersects. Unused vector lanes of a triangle block are triangles of
zero area.
"""

from dataclasses import dataclass

import numpy as np

from isonoise.scene.accel.ploc import BinaryTree, build_balanced_tree, build_binary_tree, half_area

BVH_WIDTH = 8
NODE_ROWS, BLOCK_ROWS = 7, 10
NODE_COST = 1.0
"""Cost of intersecting a node, in intersections of a block."""
CHUNK_NODES = 16384
"""Nodes processed at once: the temporaries stay in the cache."""
STACK_SIZE = 256
"""Most stack entries that a traversal may need (isonoise.device.form.MAX_STACK_SIZE has two more)."""


@dataclass(frozen=True)
class Bvh:
    nodes: np.ndarray  # (N, NODE_ROWS, BVH_WIDTH) float32
    blocks: np.ndarray  # (M, BLOCK_ROWS, BVH_WIDTH) float32
    stack: int  # stack entries that a traversal may need
    depth: int  # levels of nodes

    @property
    def first_analytic(self) -> int:
        """Number of the first leaf that is not a block."""
        return BLOCK_ROWS * len(self.blocks)


def build_bvh(
    corners: np.ndarray, analytic_lower: np.ndarray, analytic_upper: np.ndarray, stack_size: int = STACK_SIZE
) -> Bvh:
    """Build over triangles, corners (T, 3, 3) float32, and the boxes of the analytic primitives, (A, 3) float32.

    If the tree needs more than `stack_size` stack entries, a balanced tree is built instead.
    """
    triangle_count, analytic_count = len(corners), len(analytic_lower)
    if triangle_count + analytic_count == 0:
        return Bvh(_empty_nodes(1), np.zeros((0, BLOCK_ROWS, BVH_WIDTH), np.float32), 1, 1)
    by_corner = np.ascontiguousarray(corners.transpose(1, 2, 0))  # (corner, axis, triangle)
    lower = np.concatenate([by_corner.min(axis=0), analytic_lower.T], axis=1).astype(np.float32)
    upper = np.concatenate([by_corner.max(axis=0), analytic_upper.T], axis=1).astype(np.float32)
    weight = np.ones(triangle_count + analytic_count, np.int32)
    weight[triangle_count:] = BVH_WIDTH + 1  # an analytic primitive never shares a leaf
    bvh = _collapse(build_binary_tree(lower, upper), weight, corners)
    if bvh.stack > stack_size:
        bvh = _collapse(build_balanced_tree(lower, upper), weight, corners)
    return bvh


def _empty_nodes(n: int) -> np.ndarray:
    nodes = np.zeros((n, NODE_ROWS, BVH_WIDTH), np.float32)
    nodes[:, 0:3] = np.inf
    nodes[:, 3:6] = -np.inf
    return nodes


@dataclass(frozen=True)
class _Subtrees:
    """Of every binary node, the primitives below it."""

    count: np.ndarray  # (2n-1,) int32
    first: np.ndarray  # (2n-1,) int32: position in `order` of the first one
    order: np.ndarray  # (n,) int32: primitives in depth-first order


def _collapse(tree: BinaryTree, weight: np.ndarray, corners: np.ndarray) -> Bvh:
    """Make the wide nodes of least cost, level by level from the root."""
    subtrees = _count_primitives(tree)
    plan = _plan_wide_nodes(tree, weight)
    levels, max_stack = [], 1
    nodes = np.array([len(tree.left) - 1], np.int32)  # the root
    stack = np.ones(1, np.int64)
    while len(nodes):
        slots = _wide_children(tree, nodes, plan)
        is_used = slots >= 0
        stack = stack + is_used.sum(axis=1) - 1
        max_stack = max(max_stack, int(stack.max()))
        levels.append(slots)
        is_inner = is_used & ~plan.is_leaf[slots]
        nodes = slots[is_inner]
        stack = np.repeat(stack, is_inner.sum(axis=1))
    slots = np.concatenate(levels)
    return Bvh(*_encode(tree, slots, plan.is_leaf, subtrees, corners), max_stack, len(levels))


def _count_primitives(tree: BinaryTree) -> _Subtrees:
    count = np.ones(len(tree.left), np.int32)
    for begin, end in tree.rounds():
        count[begin:end] = count[tree.left[begin:end]] + count[tree.right[begin:end]]
    first = np.zeros(len(tree.left), np.int32)
    for begin, end in reversed(list(tree.rounds())):
        left, right = tree.left[begin:end], tree.right[begin:end]
        first[left] = first[begin:end]
        first[right] = first[begin:end] + count[left]
    order = np.empty(tree.leaf_count, np.int32)
    order[first[: tree.leaf_count]] = np.arange(tree.leaf_count, dtype=np.int32)
    return _Subtrees(count, first, order)


@dataclass(frozen=True)
class _Plan:
    """How the binary nodes collapse to wide nodes of least cost.

    The budget of an inner node is the number of slots of a wide node that it may occupy.
    """

    is_leaf: np.ndarray  # (2n-1,) bool: with a budget of 1, the node becomes a leaf
    slots: np.ndarray  # (n-1, BVH_WIDTH + 1) uint8, by inner node and budget: slots that it occupies
    left_slots: np.ndarray  # the same shape: slots that its left child may occupy


def _plan_wide_nodes(tree: BinaryTree, weight: np.ndarray) -> _Plan:
    """Choose the wide nodes of least cost by the surface area heuristic (Goldsmith and Salmon 1987).

    Ylitie, Karras, Laine, "Efficient Incoherent Ray Traversal on GPUs Through Compressed Wide BVHs", HPG 2017, 3.1:
    from the leaves up, the least cost of a binary node for each budget of 1 to 7 slots. With a budget of 1 it becomes a
    leaf, or a wide node whose up to 8 slots are shared by its two children. `weight` is that of each primitive; at most
    BVH_WIDTH in total fit in a leaf.
    """
    leaf_count = tree.leaf_count
    area = half_area(tree.lower, tree.upper)
    total_weight = np.empty(len(area), np.int64)
    total_weight[:leaf_count] = weight
    cost = np.empty((len(area), BVH_WIDTH - 1), np.float32)  # by node and budget - 1
    cost[:leaf_count] = area[:leaf_count, None]
    is_leaf = np.ones(len(area), bool)
    slots = np.ones((leaf_count - 1, BVH_WIDTH + 1), np.uint8)
    left_slots = np.zeros((leaf_count - 1, BVH_WIDTH + 1), np.uint8)
    for round_begin, round_end in tree.rounds():
        for begin in range(round_begin, round_end, CHUNK_NODES):
            chunk = slice(begin, min(begin + CHUNK_NODES, round_end))
            inner = slice(chunk.start - leaf_count, chunk.stop - leaf_count)
            left, right = tree.left[chunk], tree.right[chunk]
            total_weight[chunk] = total_weight[left] + total_weight[right]
            children_cost, left_slots[inner] = _share_slots(cost[left], cost[right])
            node_cost = NODE_COST * area[chunk] + children_cost[BVH_WIDTH]
            leaf_cost = np.where(total_weight[chunk] <= BVH_WIDTH, area[chunk], np.float32(np.inf))
            is_leaf[chunk] = leaf_cost <= node_cost
            cost[chunk, 0] = np.minimum(leaf_cost, node_cost)
            for budget in range(2, BVH_WIDTH):
                keeps_fewer = cost[chunk, budget - 2] <= children_cost[budget]
                cost[chunk, budget - 1] = np.minimum(cost[chunk, budget - 2], children_cost[budget])
                slots[inner, budget] = np.where(keeps_fewer, slots[inner, budget - 1], budget)
                left_slots[inner, budget] = np.where(
                    keeps_fewer, left_slots[inner, budget - 1], left_slots[inner, budget]
                )
    return _Plan(is_leaf, slots, left_slots)


def _share_slots(left_cost: np.ndarray, right_cost: np.ndarray) -> tuple[list, np.ndarray]:
    """(by budget, the least cost (n,) of two children that share it; (n, BVH_WIDTH + 1) uint8 slots of the left one).

    The costs of the children are (n, BVH_WIDTH - 1), by budget - 1. Budgets start at 2.
    """
    left, right = left_cost.T.copy(), right_cost.T.copy()
    costs: list = [None, None]
    left_slots = np.zeros((left.shape[1], BVH_WIDTH + 1), np.uint8)
    for budget in range(2, BVH_WIDTH + 1):
        min_cost, left_budget = left[0] + right[budget - 2], np.ones(left.shape[1], np.uint8)
        for k in range(2, budget):
            other = left[k - 1] + right[budget - k - 1]
            np.copyto(left_budget, np.uint8(k), where=other < min_cost)
            np.minimum(min_cost, other, out=min_cost)
        costs.append(min_cost)
        left_slots[:, budget] = left_budget
    return costs, left_slots


def _wide_children(tree: BinaryTree, nodes: np.ndarray, plan: _Plan) -> np.ndarray:
    """Children of the wide nodes that the binary `nodes` become: (len(nodes), BVH_WIDTH), -1 for unused slots."""
    slots = np.full((len(nodes), BVH_WIDTH), -1, np.int32)
    if plan.is_leaf[nodes[0]]:  # only at the root: one leaf holds the whole scene
        slots[:, 0] = nodes
        return slots
    leaf_count, parents, children = tree.leaf_count, [], []
    parent, node, budget = np.arange(len(nodes)), nodes, np.full(len(nodes), BVH_WIDTH)
    left_budget = plan.left_slots[nodes - leaf_count, BVH_WIDTH]
    while len(node):
        parent, child_budget = np.concatenate([parent, parent]), np.concatenate([left_budget, budget - left_budget])
        node = np.concatenate([tree.left[node], tree.right[node]])
        inner = np.maximum(node - leaf_count, 0)
        budget = np.where(node < leaf_count, 1, plan.slots[inner, child_budget])
        is_child = budget == 1
        parents.append(parent[is_child])
        children.append(node[is_child])
        left_budget = plan.left_slots[inner, child_budget][~is_child]
        parent, node, budget = parent[~is_child], node[~is_child], budget[~is_child]
    parent, node = np.concatenate(parents), np.concatenate(children)
    order = np.argsort(parent, kind="stable")
    parent, node = parent[order], node[order]
    slots[parent, np.arange(len(parent)) - np.searchsorted(parent, parent)] = node
    return slots


def _encode(
    tree: BinaryTree, slots: np.ndarray, is_leaf: np.ndarray, subtrees: _Subtrees, corners: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(nodes, blocks) as the device reads them; `slots` are the children of the wide nodes, in breadth-first order."""
    is_used = slots >= 0
    nodes = _empty_nodes(len(slots))
    for axis in range(3):
        lower, upper = tree.lower[axis][slots[is_used]], tree.upper[axis][slots[is_used]]
        # padded by one unit in the last place: a ray in the plane of a box's side has to hit edges in that plane
        padding = np.float32(2.0**-23) * np.maximum(np.abs(lower), np.abs(upper))
        nodes[:, axis][is_used] = lower - padding
        nodes[:, 3 + axis][is_used] = upper + padding
    inner = is_used & ~is_leaf[slots]
    leaf = is_used & is_leaf[slots]
    leaves = slots[leaf]
    first_primitive = subtrees.order[subtrees.first[leaves]]
    is_block = first_primitive < len(corners)
    block_nodes = leaves[is_block]
    leaf_reference = np.empty(len(leaves), np.int32)
    leaf_reference[is_block] = BLOCK_ROWS * np.arange(len(block_nodes))
    leaf_reference[~is_block] = BLOCK_ROWS * len(block_nodes) + first_primitive[~is_block] - len(corners)
    references = np.zeros(slots.shape, np.int32)
    references[inner] = NODE_ROWS * (1 + np.arange(np.count_nonzero(inner)))
    references[leaf] = ~leaf_reference
    nodes[:, 6] = references.view(np.float32)

    blocks = np.zeros((len(block_nodes), BLOCK_ROWS, BVH_WIDTH), np.float32)
    lane = np.arange(BVH_WIDTH)
    is_filled = lane < subtrees.count[block_nodes][:, None]
    ids = subtrees.order[subtrees.first[block_nodes][:, None] + np.where(is_filled, lane, 0)]
    triangles = corners.reshape(-1, 9).take(ids, axis=0)  # (block, lane, coordinate)
    triangles[~is_filled] = 0
    blocks[:, :9] = triangles.transpose(0, 2, 1)
    blocks[:, 9] = np.where(is_filled, ids, -1).astype(np.int32).view(np.float32)
    return nodes, blocks
