"""Builds the light tree that selects one of many lights for next-event estimation (kernels/light/light_tree.h).

Conty Estevez and Kulla, "Importance Sampling of Many Lights with Adaptive Tree Splitting", HPG 2018, with 8 children
per node instead of splitting. The bounds of a node are described in `light_bounds.py`; its intensity is the sum of the
intensities of its lights. The leaves are in the order of the light records, so that the lights below every node follow
each other and can be selected by power with the table of sums of all lights.
"""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from isonoise.scene import structs
from isonoise.scene.accel.bvh import BVH_WIDTH
from isonoise.scene.accel.ploc import BinaryTree, build_ordered_tree
from isonoise.scene.compiled_scene import CompiledScene
from isonoise.scene.light.light_bounds import LightBounds, bound_tree_nodes
from isonoise.scene.light.lights import compute_light_bounds

MIN_TREE_LIGHTS = 4
"""From this number of lights on, selection depends on the shading point. Four separate lamps: half the variance at
equal time. One panel of four triangles, and a room with 21 lights near each other: as good as selection by power."""
MIN_POWER_SHARE = 1e-30
"""Lower bound of a light's share of the intensity: its selection probability stays above 0 in 32-bit floats."""
MAX_VARIATION = 1 / 16
"""Lights below a child are selected by power where this exceeds the sine of the angle that its sphere subtends, over
the smaller of the two cosines, plus the sine of its cone's half angle. 10,082 triangles, against importance down to the
lights: over a floor 0.88 of the time and 1.18 of the variance; in a Cornell box 0.9 of the time, the same variance.
With 1/4, twice the variance over the floor."""
_MIN_SQUARED_DISTANCE = 1e-30
"""Smallest squared distance that is distinguished, relative to the squared size of the scene: keeps weights finite."""


class NodeRow(IntEnum):
    """First row (float8) of every quantity of a node's children; in kernels NODE_<name>."""

    CHILD = 0  # int32 bits: a node if above 0, else ~light
    FIRST_LIGHT = 1  # int32 bits, as LAST_LIGHT: all lights below the child; 0 and -1 in an unused slot
    LAST_LIGHT = 2
    CENTER = 3  # three rows: of the bounding sphere
    RADIUS = 6
    AXIS = 7  # three rows: of the cone of normals
    COS_SPREAD = 10  # of the half angle of that cone
    SIN_SPREAD = 11
    COS_EDGE = 12  # of the largest angle between a normal and emitted light
    INTENSITY = 13  # share of the node's intensity, times the squared size of the scene
    MAX_IRRADIANCE = 14  # upper bound of the intensity over the squared distance
    EMISSION_RADIUS = 15  # how far points of the lights reach along a normal: LightBounds.padded_emission_radius
    MIN_UNIFORM = 16  # the smaller cosine times the distance above which the lights below differ little


LIGHT_NODE_ROWS = max(NodeRow) + 1
CONSTANTS = {
    "LIGHT_NODE_ROWS": str(LIGHT_NODE_ROWS),
    **{f"NODE_{row.name}": str(int(row)) for row in NodeRow},
}
"""Macros of the kernels; as text they are signed, so that compilers gather with signed indices."""


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
    tree = build_ordered_tree(leaves.lower.astype(np.float32), leaves.upper.astype(np.float32))
    bounds = bound_tree_nodes(tree, leaves)
    squared_size = float((np.ptp(scene.bounds.astype(np.float64), axis=0) ** 2).sum()) or 1.0
    light_count, first_leaf = _leaf_ranges(tree)
    slots = _collapse(tree, bounds, light_count, first_leaf)
    ranges = with_power[first_leaf], with_power[first_leaf + light_count - 1]
    nodes = _encode_nodes(slots, bounds, _min_uniform(tree, bounds), ranges, squared_size)
    return LightTree(nodes, _parents(nodes, len(scene.lights)))


def _leaf_ranges(tree: BinaryTree) -> tuple[np.ndarray, np.ndarray]:
    """Number of leaves below each node, and of those before them."""
    light_count = np.ones(len(tree.left), np.int64)
    for begin, end in tree.rounds():
        light_count[begin:end] = light_count[tree.left[begin:end]] + light_count[tree.right[begin:end]]
    first_leaf = np.zeros(len(tree.left), np.int64)
    for begin, end in reversed(list(tree.rounds())):
        left, right = tree.left[begin:end], tree.right[begin:end]
        first_leaf[left], first_leaf[right] = first_leaf[begin:end], first_leaf[begin:end] + light_count[left]
    return light_count, first_leaf


def _collapse(tree: BinaryTree, bounds: LightBounds, light_count: np.ndarray, first_leaf: np.ndarray) -> np.ndarray:
    """Children of the wide nodes as binary nodes, (n, BVH_WIDTH), -1 for unused slots; breadth-first from the root.

    The child that is split next is the one with the largest cost: diagonal squared, times intensity, times the paper's
    orientation measure. A subtree whose lights fit in one node becomes one node. Children are in the order of their
    leaves, which is that of a Morton curve: neighbours among them are neighbours in space.
    """
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


def _min_uniform(tree: BinaryTree, bounds: LightBounds) -> np.ndarray:
    """NodeRow.MIN_UNIFORM of binary nodes: infinite with spots, whose light ends within their cone."""
    emits_everywhere, has_spots = bounds.spread >= np.pi, bounds.edge < np.pi / 2
    for begin, end in tree.rounds():
        left, right = tree.left[begin:end], tree.right[begin:end]
        emits_everywhere[begin:end] = emits_everywhere[left] & emits_everywhere[right]
        has_spots[begin:end] = has_spots[left] | has_spots[right]
    variation = np.where(emits_everywhere, 0.0, np.sin(np.minimum(bounds.spread, np.pi / 2)))
    allowed = MAX_VARIATION - np.where(has_spots, np.inf, variation)
    return np.divide(bounds.radius, allowed, out=np.full(len(allowed), np.inf), where=allowed > 0)


def _encode_nodes(
    slots: np.ndarray,
    bounds: LightBounds,
    min_uniform: np.ndarray,
    ranges: tuple[np.ndarray, np.ndarray],
    squared_size: float,
) -> np.ndarray:
    """(n, LIGHT_NODE_ROWS, BVH_WIDTH) float32 of wide nodes; `ranges` are the first and last light of binary nodes."""
    is_used = slots >= 0
    children = bounds[slots[is_used]]
    nodes = np.zeros((len(slots), LIGHT_NODE_ROWS, BVH_WIDTH), np.float32)
    intensity = np.zeros(slots.shape)
    intensity[is_used] = children.intensity
    shares = np.maximum(intensity / intensity.sum(axis=1, keepdims=True), MIN_POWER_SHARE)[is_used] * squared_size
    rows = {
        NodeRow.CENTER: children.center[0],
        NodeRow.CENTER + 1: children.center[1],
        NodeRow.CENTER + 2: children.center[2],
        NodeRow.RADIUS: children.padded_radius(),
        NodeRow.AXIS: children.axis[0],
        NodeRow.AXIS + 1: children.axis[1],
        NodeRow.AXIS + 2: children.axis[2],
        NodeRow.COS_SPREAD: np.cos(children.spread),
        NodeRow.SIN_SPREAD: np.where(children.spread > 0, np.sin(children.spread), 0.0),
        NodeRow.COS_EDGE: np.cos(children.edge),
        NodeRow.INTENSITY: shares,
        NodeRow.MAX_IRRADIANCE: shares / np.maximum(0.25 * children.radius**2, _MIN_SQUARED_DISTANCE * squared_size),
        NodeRow.EMISSION_RADIUS: children.padded_emission_radius(),
        NodeRow.MIN_UNIFORM: min_uniform[slots[is_used]],
    }
    for row, values in rows.items():
        nodes[:, row][is_used] = values
    first, last = (light[slots] for light in ranges)
    is_inner = is_used & (first < last)
    references = np.where(is_used, ~first, 0)
    references[is_inner] = 1 + np.arange(np.count_nonzero(is_inner))  # nodes are in breadth-first order
    for row, values in (
        (NodeRow.CHILD, references),
        (NodeRow.FIRST_LIGHT, np.where(is_used, first, 0)),
        (NodeRow.LAST_LIGHT, np.where(is_used, last, -1)),
    ):
        nodes[:, row] = values.astype(np.int32).view(np.float32)
    return nodes


def _parents(nodes: np.ndarray, light_count: int) -> np.ndarray:
    """LightTree.parents of encoded nodes."""
    parents = np.full(light_count + len(nodes), structs.NONE, np.uint32)
    node, slot = np.nonzero(nodes[:, NodeRow.LAST_LIGHT].view(np.int32) >= 0)
    child = nodes[:, NodeRow.CHILD].view(np.int32)[node, slot]
    parents[np.where(child < 0, ~child, light_count + child)] = BVH_WIDTH * node + slot
    return parents
