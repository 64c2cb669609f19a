"""Statistics of a BVH from its arrays, whose layout `scene.accel.bvh` documents; called by `measure`."""

import numpy as np

from isonoise.scene.accel.bvh import NODE_ROWS, Bvh
from isonoise.scene.compiled_scene import CompiledScene
from isonoise.scene.structs import NONE


def bvh_statistics(bvh: Bvh, scene: CompiledScene) -> dict[str, object]:
    """The JSON field `bvh`: counts, bytes and SAH cost."""
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
    """Expected number of nodes and leaves that an infinite random line through the root's box visits.

    Surface area heuristic (Goldsmith and Salmon 1987): the sum of the areas of all boxes over the root's. The test of a
    node's children and that of a leaf both cost 1, because they take about the same time. An instance costs as much as
    the tree of its group. None if the root has no area.
    """
    roots = [0, *range(1, len(scene.group_offsets))] if len(scene.instances) else [0]
    references = bvh.nodes[:, 6].view(np.int32)
    area = _half_areas(bvh.nodes)
    root_area = [_root_half_area(bvh.nodes[root]) for root in roots]
    tree = _tree_of(references, area > 0, len(roots))
    child_area = np.bincount(tree, weights=area.sum(axis=1), minlength=len(roots))
    cost = np.array([1 + b / a if a > 0 else 0.0 for b, a in zip(child_area, root_area, strict=True)])
    if len(scene.instances):
        leaf = ~references
        first_instance = bvh.first_analytic + len(scene.analytics)
        is_instance = (references < 0) & (leaf >= first_instance)
        group_cost = cost[scene.instances["root"][leaf[is_instance] - first_instance]]
        cost[0] += float((area[is_instance] * group_cost).sum() / root_area[0]) if root_area[0] > 0 else 0.0
    return float(cost[0]) if root_area[0] > 0 else None


def _tree_of(references: np.ndarray, used: np.ndarray, trees: int) -> np.ndarray:
    """Index of the tree of every node. Node i < `trees` is the root of tree i; children come after their parents."""
    tree = np.zeros(len(references), int)
    tree[:trees] = np.arange(trees)
    frontier = np.arange(trees)
    while len(frontier):
        is_inner = (references[frontier] > 0) & used[frontier]
        children = references[frontier][is_inner] // NODE_ROWS
        tree[children] = np.repeat(tree[frontier], is_inner.sum(axis=1))
        frontier = children
    return tree


def _root_half_area(root: np.ndarray) -> float:
    extent = root[3:6].max(axis=1).astype(float) - root[0:3].min(axis=1).astype(float)
    x, y, z = extent
    return float(x * y + y * z + z * x)


def _half_areas(nodes: np.ndarray) -> np.ndarray:
    """(N, 8) float64: half of the surface area of every child's box, 0 for unused children."""
    used = np.isfinite(nodes[:, 0])
    extent = np.where(used[:, None], nodes[:, 3:6].astype(float) - np.where(used[:, None], nodes[:, 0:3], 0), 0)
    x, y, z = extent[:, 0], extent[:, 1], extent[:, 2]
    return x * y + y * z + z * x
