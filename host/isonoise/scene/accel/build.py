"""Builds the BVH of a scene: a tree over the world and a tree over each shape group, in common arrays.

Nodes: the root of the world, the roots of the groups, then the other nodes, tree by tree. Leaves: the blocks of all
trees, then all analytic primitives, then the instances, which only the world's tree has (see
kernels/stages/intersect.cl). Called before rendering; reads a CompiledScene.
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
    """Build the BVH over all primitives and instances of a scene.

    Raises SceneError if the traversal stack of the kernels would overflow.
    """
    lower, upper = analytic_bounds(scene.analytics)
    if not len(scene.instances):
        return build_bvh(scene.vertices[scene.faces], lower, upper)

    def build_tree(begin: list[int], end: list[int], instance_boxes=()) -> Bvh:
        """Tree over the triangles and analytic primitives in [begin, end), and the instances."""
        triangles, analytics = map(slice, begin, end)
        low, high = lower[analytics], upper[analytics]
        if instance_boxes:
            low, high = np.concatenate([low, instance_boxes[0]]), np.concatenate([high, instance_boxes[1]])
        return build_bvh(scene.vertices[scene.faces[triangles]], low, high, STACK_SIZE // 2)

    offsets = scene.group_offsets.tolist()
    groups = [build_tree(begin, end) for begin, end in pairwise(offsets)]
    group_boxes = np.stack([_bounding_box(group) for group in groups])[scene.instances["root"] - 1]
    world = build_tree([0, 0], offsets[0], instance_bounds(scene.instances, group_boxes))
    if (stack := world.stack + max(group.stack for group in groups)) > STACK_SIZE:
        raise SceneError(
            f"the BVH is too deep: a ray would need a stack of {stack} nodes, the limit is {STACK_SIZE}; "
            "use fewer overlapping primitives"
        )
    depth = world.depth + max(group.depth for group in groups)
    return replace(_concatenate_trees([world, *groups], scene), stack=stack, depth=depth)


def _bounding_box(tree: Bvh) -> np.ndarray:
    """(2, 3) float64 corners of the box around a tree."""
    root = tree.nodes[0].astype(np.float64)
    return np.stack([root[0:3].min(axis=1), root[3:6].max(axis=1)])


def _concatenate_trees(trees: list[Bvh], scene: CompiledScene) -> Bvh:
    """The trees of the world and of the groups in common arrays; stack and depth are those of the world."""
    offsets = np.concatenate([np.zeros((1, 2), int), scene.group_offsets.astype(int)])
    first_analytic_leaf, total_analytics = sum(tree.first_analytic for tree in trees), len(scene.analytics)
    roots, other_nodes, blocks = [], [], []
    first_node, first_block = len(trees), 0
    for tree, (first_triangle, first_analytic), (_, end_analytic) in zip(trees, offsets[:-1], offsets[1:], strict=True):
        nodes = tree.nodes.copy()
        references = nodes[:, 6].view(np.int32)
        leaf = ~references
        box_number = leaf - tree.first_analytic  # among the tree's analytic primitives, then among the instances
        analytic_count = end_analytic - first_analytic
        box_leaf = np.where(
            box_number < analytic_count, first_analytic + box_number, total_analytics + box_number - analytic_count
        )
        leaf = np.where(box_number < 0, BLOCK_ROWS * first_block + leaf, first_analytic_leaf + box_leaf)
        # node 0, the root, is no node's child: reference 0 marks an unused slot
        inner = np.where(references > 0, NODE_ROWS * (first_node - 1) + references, 0)
        references[:] = np.where(references < 0, ~leaf, inner)
        roots.append(nodes[:1])
        other_nodes.append(nodes[1:])
        blocks.append(tree.blocks.copy())
        triangle_ids = blocks[-1][:, 9].view(np.uint32)
        triangle_ids[triangle_ids != NONE] += np.uint32(first_triangle)
        first_node += len(nodes) - 1
        first_block += len(tree.blocks)
    return replace(trees[0], nodes=np.concatenate(roots + other_nodes), blocks=np.concatenate(blocks))
