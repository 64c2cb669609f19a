"""A tree over the lights of a scene, by which next-event estimation picks one of many (kernels/light/light_tree.h).

Conty Estevez and Kulla, "Importance Sampling of Many Lights with Adaptive Tree Splitting", HPG 2018, with 8 children a
node in place of the splitting. What the lights below a node emit is bounded by a sphere that they stand in, a cone of
their normals, and the angle to a normal up to which light leaves; how much it is at most, by the sum of the intensities
along the normals.
"""

from dataclasses import dataclass

import numpy as np

from isonoise.scene import structs
from isonoise.scene.accel.bvh import BVH_WIDTH
from isonoise.scene.accel.ploc import BinaryTree, build_binary_tree
from isonoise.scene.compiled_scene import CompiledScene
from isonoise.scene.light.light_bounds import LightBounds, compute_light_bounds, joined

MIN_TREE_LIGHTS = 4
"""Lights from which on they are picked by what they could send. Four lamps that stand apart: half the variance at equal
time. One panel of four triangles, and a room with 21 lights near each other: as good as the alias table."""
LIGHT_NODE_ROWS = 12
"""float8 of a node: center x, y, z and radius of the spheres around its children; their shares of the intensity, which
sum to 1; axes x, y, z of the cones; cosine and sine of their half angles; cosine of the angle up to which light leaves;
the children (int32 bits): above 0 a node, else ~light. Where there is no child, the share is 0."""
_NOWHERE = 1e18
"""Radius where there is no child: that is never the nearest."""
MIN_POWER_SHARE = 1e-30
"""So that whatever has power is picked with a probability that 32-bit floats can tell from none."""


@dataclass(frozen=True)
class LightTree:
    nodes: np.ndarray  # (n, LIGHT_NODE_ROWS, BVH_WIDTH) float32; the first is the root
    parents: (
        np.ndarray
    )  # (lights + n,) uint32: BVH_WIDTH * parent + slot of every light, then of every node; NONE has none


def use_light_tree(lights: np.ndarray) -> bool:
    """Whether a scene with these LIGHT records is better off with a tree than with the alias table."""
    return np.count_nonzero(lights["selection_pmf"]) >= MIN_TREE_LIGHTS


def build_light_tree(scene: CompiledScene) -> LightTree:
    """The tree over all lights that have power; there is at least one."""
    bright = np.flatnonzero(scene.lights["selection_pmf"])
    leaves = compute_light_bounds(scene, scene.lights[bright])
    tree = build_binary_tree(leaves.lower.astype(np.float32), leaves.upper.astype(np.float32))
    bounds = joined(tree, leaves)
    nodes = _records(_collapse(tree, bounds), bounds, bright)
    return LightTree(nodes, _places(nodes, len(scene.lights)))


def _collapse(tree: BinaryTree, bounds: LightBounds) -> np.ndarray:
    """Binary nodes that are the children of wide ones, (n, BVH_WIDTH), -1 where there is none; root first, level by
    level.

    Opened is the child whose lights could differ most: by diagonal squared, intensity, and the paper's measure of its
    directions. Few lights, that fit in a node, stay together in one of their own.
    """
    size = np.ones(len(tree.left), np.int64)
    for begin, end in tree.rounds():
        size[begin:end] = size[tree.left[begin:end]] + size[tree.right[begin:end]]
    spread, reach = bounds.spread, np.minimum(bounds.spread + bounds.edge, np.pi)
    around = 0.5 * np.pi * (2 * reach * np.sin(spread) - np.cos(spread - 2 * reach) - 2 * spread * np.sin(spread))
    around += 2 * np.pi * (1 - np.cos(spread)) + 0.5 * np.pi * np.cos(spread)
    variety = bounds.radius**2 * bounds.intensity * around
    levels, frontier = [], np.array([len(size) - 1])
    while len(frontier):
        slots = np.full((len(frontier), BVH_WIDTH), -1)
        slots[:, 0] = frontier
        small = size[frontier] <= BVH_WIDTH
        for used in range(1, BVH_WIDTH):
            openable = (slots >= 0) & (size[slots] > np.where(small, 1, BVH_WIDTH)[:, None])
            gain = np.where(openable, variety[slots], -1.0)
            pick = gain.argmax(axis=1)
            rows = np.flatnonzero(gain[np.arange(len(slots)), pick] >= 0)
            opened = slots[rows, pick[rows]]
            # every row that opens has opened in all rounds before, so that its next free slot is `used`
            slots[rows, pick[rows]], slots[rows, used] = tree.left[opened], tree.right[opened]
        levels.append(slots)
        frontier = slots[(slots >= 0) & (size[slots] > 1)]
    return np.concatenate(levels)


def _records(slots: np.ndarray, bounds: LightBounds, lights: np.ndarray) -> np.ndarray:
    """(n, LIGHT_NODE_ROWS, BVH_WIDTH) float32 of wide nodes; `lights` are the numbers of the leaves."""
    used = slots >= 0
    of = bounds[slots[used]]
    center = 0.5 * (of.lower + of.upper)
    nodes = np.zeros((len(slots), LIGHT_NODE_ROWS, BVH_WIDTH), np.float32)
    nodes[:, 3] = _NOWHERE

    def enter(row: int, values: np.ndarray) -> None:
        nodes[:, row][used] = values

    for axis in range(3):
        enter(axis, center[axis])
        enter(5 + axis, of.axis[axis])
    enter(3, of.radius + 2.0**-22 * np.abs(center).max(axis=0))  # the middle is rounded
    enter(8, np.cos(of.spread))
    enter(9, np.sin(of.spread))
    enter(10, np.cos(of.edge))
    references = np.zeros(slots.shape, np.int32)
    is_leaf = slots < len(lights)
    inner = used & ~is_leaf
    references[inner] = 1 + np.arange(np.count_nonzero(inner))  # nodes stand in breadth-first order
    references[used & is_leaf] = ~lights[slots[used & is_leaf]]
    nodes[:, 11] = references.view(np.float32)
    intensity = np.zeros(slots.shape)
    intensity[used] = of.intensity
    shares = intensity / intensity.sum(axis=1, keepdims=True)
    nodes[:, 4] = np.where(used, np.maximum(shares, MIN_POWER_SHARE), 0.0)
    return nodes


def _places(nodes: np.ndarray, lights: int) -> np.ndarray:
    """Where lights and nodes stand: LightTree.parents."""
    places = np.full(lights + len(nodes), structs.NONE, np.uint32)
    references = nodes[:, 11].view(np.int32)
    node, slot = np.nonzero(nodes[:, 4] > 0)
    child = references[node, slot]
    places[np.where(child < 0, ~child, lights + child)] = BVH_WIDTH * node + slot
    return places
