"""Figures of a hierarchy, from its arrays alone (their layout: `scene.bvh`)."""

import numpy as np

from isonoise.scene.accel.bvh import NODE_ROWS, Bvh
from isonoise.scene.compiled_scene import CompiledScene
from isonoise.scene.structs import NONE


def tree_facts(bvh: Bvh, scene: CompiledScene) -> dict[str, object]:
    """Counts, bytes and cost of a scene's hierarchy."""
    used = bvh.blocks[:, 9].view(np.uint32) != NONE
    return {
        "nodes": len(bvh.nodes),
        "leaves": len(bvh.blocks) + len(scene.analytics) + len(scene.instances),
        "triangle_blocks": len(bvh.blocks),
        "triangles_per_block": float(used.sum() / len(bvh.blocks)) if len(bvh.blocks) else None,
        "children_per_node": float(np.isfinite(bvh.nodes[:, 0]).sum() / len(bvh.nodes)),
        "depth": bvh.depth,
        "stack_entries": bvh.stack,
        "sah_cost": sah_cost(bvh, scene),
        "size_bytes": bvh.nodes.nbytes + bvh.blocks.nbytes,
    }


def sah_cost(bvh: Bvh, scene: CompiledScene) -> float | None:
    """Nodes and leaves that a random line through the root's box is expected to visit, had it no end.

    Surface area heuristic (Goldsmith and Salmon 1987) with a cost of 1 for the test of a node's children and 1 for that
    of a leaf, which take about as long: the sum of the areas of all boxes, over the root's. A visit to an instance
    costs what its group's tree does. None where the root has no area.
    """
    roots = [0, *range(1, len(scene.group_offsets))] if len(scene.instances) else [0]
    references = bvh.nodes[:, 6].view(np.int32)
    area = _half_areas(bvh.nodes)
    root_area = [_half_area(np.stack([_low(bvh.nodes[root]), _high(bvh.nodes[root])])) for root in roots]
    tree = _tree_of(references, area > 0, len(roots))
    below = np.bincount(tree, weights=area.sum(axis=1), minlength=len(roots))
    cost = np.array([1 + b / a if a > 0 else 0.0 for b, a in zip(below, root_area, strict=True)])
    if len(scene.instances):
        leaf = ~references
        beyond = bvh.first_analytic + len(scene.analytics)
        which = (references < 0) & (leaf >= beyond)
        group_cost = cost[scene.instances["root"][leaf[which] - beyond]]
        cost[0] += float((area[which] * group_cost).sum() / root_area[0]) if root_area[0] > 0 else 0.0
    return float(cost[0]) if root_area[0] > 0 else None


def _tree_of(references: np.ndarray, used: np.ndarray, trees: int) -> np.ndarray:
    """Which tree every node belongs to: node i < `trees` is the root of tree i; a child comes after its parent."""
    tree = np.zeros(len(references), int)
    tree[:trees] = np.arange(trees)
    frontier = np.arange(trees)
    while len(frontier):
        inner = (references[frontier] > 0) & used[frontier]
        children = references[frontier][inner] // NODE_ROWS
        tree[children] = np.repeat(tree[frontier], inner.sum(axis=1))
        frontier = children
    return tree


def _low(node: np.ndarray) -> np.ndarray:
    return node[0:3].min(axis=1).astype(float)


def _high(node: np.ndarray) -> np.ndarray:
    return node[3:6].max(axis=1).astype(float)


def _half_area(corners: np.ndarray) -> float:
    x, y, z = corners[1] - corners[0]
    return float(x * y + y * z + z * x)


def _half_areas(nodes: np.ndarray) -> np.ndarray:
    """(N, 8) float64: half the surface of the box of every child, 0 where there is none."""
    used = np.isfinite(nodes[:, 0])
    extent = np.where(used[:, None], nodes[:, 3:6].astype(float) - np.where(used[:, None], nodes[:, 0:3], 0), 0)
    x, y, z = extent[:, 0], extent[:, 1], extent[:, 2]
    return x * y + y * z + z * x
