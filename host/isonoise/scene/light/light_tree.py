"""Builds the light tree that selects one of many lights for next-event estimation (kernels/light/light_tree.h).

Conty Estevez and Kulla, "Importance Sampling of Many Lights with Adaptive Tree Splitting", HPG 2018, with 8 children
per node instead of splitting. The bounds of a node are described in `light_bounds.py`; its intensity is the sum of the
intensities of its lights.
"""

from dataclasses import dataclass

import numpy as np

from isonoise.scene import structs
from isonoise.scene.accel.bvh import BVH_WIDTH
from isonoise.scene.accel.ploc import BinaryTree, build_binary_tree
from isonoise.scene.compiled_scene import CompiledScene
from isonoise.scene.light.light_bounds import LightBounds, bound_tree_nodes
from isonoise.scene.light.lights import compute_light_bounds

MIN_TREE_LIGHTS = 4
"""From this number of lights on, selection depends on the shading point. Four separate lamps: half the variance at
equal time. One panel of four triangles, and a room with 21 lights near each other: as good as selection by power."""
LIGHT_NODE_ROWS = 12
"""Rows (float8) of a node: x, y, z of the centers and radii of its children's spheres; their shares of the intensity,
which sum to 1; axes x, y, z of the cones; cosine and sine of their half angles; cosine of the largest angle between
normal and emission; references (int32 bits): a node if above 0, else ~light. An unused slot has share 0."""
_UNUSED_RADIUS = 1e18
"""Radius of an unused slot: it is never the nearest."""
MIN_POWER_SHARE = 1e-30
"""Lower bound of a light's share: its selection probability stays above 0 in 32-bit floats."""


@dataclass(frozen=True)
class LightTree:
    nodes: np.ndarray  # (n, LIGHT_NODE_ROWS, BVH_WIDTH) float32; the first is the root
    # (lights + n,) uint32: BVH_WIDTH * parent + slot of every light, then of every node; NONE if it has no parent
    parents: np.ndarray


def use_light_tree(lights: np.ndarray) -> bool:
    """Whether structs.LIGHT records are enough for selection by light bounds instead of power."""
    return np.count_nonzero(lights["power_pmf"]) >= MIN_TREE_LIGHTS


def build_light_tree(scene: CompiledScene) -> LightTree:
    """The tree over all lights that have power; there has to be at least one."""
    with_power = np.flatnonzero(scene.lights["power_pmf"])
    leaves = compute_light_bounds(scene, scene.lights[with_power])
    tree = build_binary_tree(leaves.lower.astype(np.float32), leaves.upper.astype(np.float32))
    bounds = bound_tree_nodes(tree, leaves)
    nodes = _encode_nodes(_collapse(tree, bounds), bounds, with_power)
    return LightTree(nodes, _parents(nodes, len(scene.lights)))


def _collapse(tree: BinaryTree, bounds: LightBounds) -> np.ndarray:
    """Children of the wide nodes as binary nodes, (n, BVH_WIDTH), -1 for unused slots; breadth-first from the root.

    The child that is split next is the one with the largest cost: diagonal squared, times intensity, times the paper's
    orientation measure. A subtree whose lights fit in one node becomes one node. Children are in the order of their
    leaves, which is that of a Morton curve: neighbours among them are neighbours in space.
    """
    light_count = np.ones(len(tree.left), np.int64)
    for begin, end in tree.rounds():
        light_count[begin:end] = light_count[tree.left[begin:end]] + light_count[tree.right[begin:end]]
    first_leaf = np.zeros(len(tree.left), np.int64)  # number of leaves before those of a node
    for begin, end in reversed(list(tree.rounds())):
        left, right = tree.left[begin:end], tree.right[begin:end]
        first_leaf[left], first_leaf[right] = first_leaf[begin:end], first_leaf[begin:end] + light_count[left]
    spread, total_angle = bounds.spread, np.minimum(bounds.spread + bounds.edge, np.pi)
    sine = np.sin(spread)
    orientation = 0.5 * np.pi * (2 * total_angle * sine - np.cos(spread - 2 * total_angle) - 2 * spread * sine)
    orientation += 2 * np.pi * (1 - np.cos(spread)) + 0.5 * np.pi * np.cos(spread)
    cost = bounds.radius**2 * bounds.intensity * orientation
    levels, nodes = [], np.array([len(light_count) - 1])
    while len(nodes):
        slots = np.full((len(nodes), BVH_WIDTH), -1)
        slots[:, 0] = nodes
        is_small = light_count[nodes] <= BVH_WIDTH
        for used in range(1, BVH_WIDTH):
            can_split = (slots >= 0) & (light_count[slots] > np.where(is_small, 1, BVH_WIDTH)[:, None])
            gain = np.where(can_split, cost[slots], -1.0)
            best = gain.argmax(axis=1)
            rows = np.flatnonzero(gain[np.arange(len(slots)), best] >= 0)
            split = slots[rows, best[rows]]
            # a row that splits now has split in every earlier round, so its next free slot is `used`
            slots[rows, best[rows]], slots[rows, used] = tree.left[split], tree.right[split]
        order = np.where(slots >= 0, first_leaf[slots], len(light_count)).argsort(axis=1, kind="stable")
        slots = np.take_along_axis(slots, order, axis=1)
        levels.append(slots)
        nodes = slots[(slots >= 0) & (light_count[slots] > 1)]
    return np.concatenate(levels)


def _encode_nodes(slots: np.ndarray, bounds: LightBounds, lights: np.ndarray) -> np.ndarray:
    """(n, LIGHT_NODE_ROWS, BVH_WIDTH) float32 of wide nodes; `lights` are the light indices of the leaves."""
    is_used = slots >= 0
    children = bounds[slots[is_used]]
    nodes = np.zeros((len(slots), LIGHT_NODE_ROWS, BVH_WIDTH), np.float32)
    nodes[:, 3] = _UNUSED_RADIUS
    intensity = np.zeros(slots.shape)
    intensity[is_used] = children.intensity
    shares = intensity / intensity.sum(axis=1, keepdims=True)
    nodes[:, 4] = np.where(is_used, np.maximum(shares, MIN_POWER_SHARE), 0.0)
    rows = {
        0: children.center[0],
        1: children.center[1],
        2: children.center[2],
        3: children.padded_radius(),
        5: children.axis[0],
        6: children.axis[1],
        7: children.axis[2],
        8: np.cos(children.spread),
        9: np.sin(children.spread),
        10: np.cos(children.edge),
    }
    for row, values in rows.items():
        nodes[:, row][is_used] = values
    references = np.zeros(slots.shape, np.int32)
    is_light = is_used & (slots < len(lights))
    is_inner = is_used & ~is_light
    references[is_inner] = 1 + np.arange(np.count_nonzero(is_inner))  # nodes are in breadth-first order
    references[is_light] = ~lights[slots[is_light]]
    nodes[:, 11] = references.view(np.float32)
    return nodes


def _parents(nodes: np.ndarray, light_count: int) -> np.ndarray:
    """LightTree.parents of encoded nodes."""
    parents = np.full(light_count + len(nodes), structs.NONE, np.uint32)
    node, slot = np.nonzero(nodes[:, 4] > 0)
    child = nodes[:, 11].view(np.int32)[node, slot]
    parents[np.where(child < 0, ~child, light_count + child)] = BVH_WIDTH * node + slot
    return parents
