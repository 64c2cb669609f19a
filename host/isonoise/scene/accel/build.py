"""The hierarchy of a scene: a tree over what stands in the world, and one over each group of shapes, in common arrays.

Nodes: the root of the world, the roots of the groups, then the other nodes, tree by tree. Leaves: the blocks of all
trees, then all analytic primitives, then the instances, which stand in the world's tree alone
(kernels/stages/intersect.cl).
"""

from dataclasses import replace
from itertools import pairwise

import numpy as np

from isonoise.errors import SceneError
from isonoise.scene.accel.bounds import analytic_bounds, instance_bounds
from isonoise.scene.accel.bvh import BLOCK_ROWS, NODE_ROWS, STACK_SIZE, Bvh, build_bvh
from isonoise.scene.compiled_scene import CompiledScene
from isonoise.scene.structs import NONE


def build_scene_bvh(scene: CompiledScene) -> Bvh:
    """Builds over all primitives and instances of a scene."""
    lower, upper = analytic_bounds(scene.analytics)
    if not len(scene.instances):
        return build_bvh(scene.vertices[scene.faces], lower, upper)

    def tree(begin: list[int], end: list[int], more: tuple[np.ndarray, np.ndarray] | None = None) -> Bvh:
        triangles, analytics = map(slice, begin, end)
        low, high = lower[analytics], upper[analytics]
        if more:
            low, high = np.concatenate([low, more[0]]), np.concatenate([high, more[1]])
        return build_bvh(scene.vertices[scene.faces[triangles]], low, high, STACK_SIZE // 2)

    begins = scene.group_offsets.tolist()
    groups = [tree(begin, end) for begin, end in pairwise(begins)]
    boxes = np.stack([_box(group) for group in groups])[scene.instances["root"] - 1]
    world = tree([0, 0], begins[0], instance_bounds(scene.instances, boxes))
    if (stack := world.stack + max(group.stack for group in groups)) > STACK_SIZE:
        raise SceneError(f"the hierarchy is too deep: a ray would have to keep {stack} nodes, {STACK_SIZE} at most")
    depth = world.depth + max(group.depth for group in groups)
    return replace(_joined([world, *groups], scene), stack=stack, depth=depth)


def _box(tree: Bvh) -> np.ndarray:
    """(2, 3) float64 corners of the box around a tree."""
    root = tree.nodes[0].astype(np.float64)
    return np.stack([root[0:3].min(axis=1), root[3:6].max(axis=1)])


def _joined(trees: list[Bvh], scene: CompiledScene) -> Bvh:
    """The trees of the world and of the groups in common arrays; stack and depth are the world's."""
    begins = np.concatenate([np.zeros((1, 2), int), scene.group_offsets.astype(int)])
    first_analytic_leaf, total_analytics = sum(tree.first_analytic for tree in trees), len(scene.analytics)
    roots, others, blocks = [], [], []
    first_node, first_block = len(trees), 0
    for tree, (first_triangle, first_analytic), (_, end_analytic) in zip(trees, begins[:-1], begins[1:], strict=True):
        nodes = tree.nodes.copy()
        references = nodes[:, 6].view(np.int32)
        leaf = ~references
        beyond = leaf - tree.first_analytic  # number among the tree's analytic primitives, then among the instances
        own = end_analytic - first_analytic
        leaf = np.where(
            beyond < 0,
            BLOCK_ROWS * first_block + leaf,
            first_analytic_leaf + np.where(beyond < own, first_analytic + beyond, total_analytics + beyond - own),
        )
        # node 0, the root, is nobody's child: there it marks what is unused
        inner = np.where(references > 0, NODE_ROWS * (first_node - 1) + references, 0)
        references[:] = np.where(references < 0, ~leaf, inner)
        roots.append(nodes[:1])
        others.append(nodes[1:])
        blocks.append(tree.blocks.copy())
        ids = blocks[-1][:, 9].view(np.uint32)
        ids[ids != NONE] += np.uint32(first_triangle)
        first_node += len(nodes) - 1
        first_block += len(tree.blocks)
    return replace(trees[0], nodes=np.concatenate(roots + others), blocks=np.concatenate(blocks))
