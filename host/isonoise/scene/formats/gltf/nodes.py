"""The node hierarchy of a glTF file: transforms to world space, and which nodes the scene shows.

Called by `read.py`. glTF 2.0 sections 3.5.2 and 3.5.3.
"""

from dataclasses import dataclass

import numpy as np

from isonoise.scene.formats.gltf.accessors import Accessors
from isonoise.scene.formats.gltf.document import Document
from isonoise.scene.formats.gltf.json_objects import JsonObject
from isonoise.scene.formats.report import ImportReport

_MAX_ELEMENT = 1e30  # of a transform to world space: products stay within 64-bit floats
_MAX_ROUNDING = 1e-5  # of the last row of a matrix
_INSTANCING = "EXT_mesh_gpu_instancing"


@dataclass(frozen=True)
class PlacedNode:
    """A node of the scene that is shown."""

    node: JsonObject
    to_world: np.ndarray  # (4, 4)
    is_visible: bool  # with KHR_node_visibility; concerns meshes and lights

    @property
    def name(self) -> str:
        """The name that the file gives it, or else its place."""
        return self.node.string("name", "") or self.node.place


def world_transforms(document: Document) -> np.ndarray:
    """(nodes, 4, 4) of all nodes. Raises SceneError if they do not form trees or a transform is too large."""
    nodes = document.all("nodes")
    children = [node.integers("children") for node in nodes]
    has_parent = np.zeros(len(nodes), bool)
    for node, indices in zip(nodes, children, strict=True):
        for index in indices:
            document.get("nodes", index, node, "children")
            if has_parent[index]:
                node.fail("children", f"nodes[{index}] is a child twice; nodes have to form trees")
            has_parent[index] = True
    matrices = _local_transforms(nodes)
    queue = np.flatnonzero(~has_parent).tolist()
    is_reached = ~has_parent
    for index in queue:
        for child in children[index]:
            matrices[child] = matrices[index] @ matrices[child]
            is_reached[child] = True
        queue += children[index]
    if not is_reached.all():
        nodes[int(np.argmin(is_reached))].fail("children", "a node is its own ancestor; nodes have to form trees")
    is_valid = (np.abs(matrices) < _MAX_ELEMENT).all(axis=(1, 2))
    if not is_valid.all():
        nodes[int(np.argmin(is_valid))].fail("", f"its transform exceeds {_MAX_ELEMENT:g}")
    return matrices


def _local_transforms(nodes: list[JsonObject]) -> np.ndarray:
    """(nodes, 4, 4): from each node to its parent."""
    rotations = np.array([node.numbers("rotation", 4, (0.0, 0.0, 0.0, 1.0)) for node in nodes]).reshape(-1, 4)
    for index in np.flatnonzero(~_is_quaternion(rotations)):
        nodes[index].fail("rotation", "it is no unit quaternion")
    matrices = compose_transforms(
        np.array([node.numbers("translation", 3, (0.0, 0.0, 0.0)) for node in nodes]).reshape(-1, 3),
        rotations,
        np.array([node.numbers("scale", 3, (1.0, 1.0, 1.0)) for node in nodes]).reshape(-1, 3),
    )
    for index, node in enumerate(nodes):
        if "matrix" in node:
            matrices[index] = np.array(node.numbers("matrix", 16)).reshape(4, 4).T
            if not np.allclose(matrices[index, 3], (0, 0, 0, 1), rtol=0, atol=_MAX_ROUNDING):
                node.fail("matrix", "its last row has to be 0 0 0 1")
            matrices[index, 3] = 0, 0, 0, 1
    return matrices


def _is_quaternion(rotations: np.ndarray) -> np.ndarray:
    """(n,) bool: whether quaternions can be normalised."""
    largest = np.abs(rotations).max(axis=1)
    return (largest > 1e-30) & (largest < 1e30)


def compose_transforms(translations: np.ndarray, rotations: np.ndarray, factors: np.ndarray) -> np.ndarray:
    """(n, 4, 4) matrices T R S of translations (n, 3), quaternions (n, 4) in the order x, y, z, w, and scales (n, 3).

    Quaternions are normalised.
    """
    x, y, z, w = (rotations / np.linalg.norm(rotations, axis=1, keepdims=True)).T
    matrices = np.zeros((len(rotations), 4, 4))
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
        (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
        (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
    )
    matrices[:, :3, :3] = np.stack([np.stack(row, axis=-1) for row in rows], axis=1) * factors[:, None]
    matrices[:, :3, 3], matrices[:, 3, 3] = translations, 1.0
    return matrices


def placed_nodes(document: Document, matrices: np.ndarray, report: ImportReport) -> list[PlacedNode]:
    """The nodes of the default scene, parents first."""
    nodes = document.all("nodes")
    queue = [(index, True) for index in _root_nodes(document, report)]
    placed, is_placed = [], np.zeros(len(nodes), bool)
    for index, parent_is_visible in queue:
        if is_placed[index]:
            continue
        is_placed[index] = True
        visibility = nodes[index].extension("KHR_node_visibility")
        is_visible = parent_is_visible and (visibility is None or visibility.boolean("visible", True))
        placed.append(PlacedNode(nodes[index], matrices[index], is_visible))
        queue += [(child, is_visible) for child in nodes[index].integers("children")]
    if placed:
        report.use("scene_graph")
    return placed


def _root_nodes(document: Document, report: ImportReport) -> list[int]:
    """Indices of the root nodes of the default scene; without scenes, of all nodes that are no child."""
    scenes = document.all("scenes")
    if not scenes:
        children = {child for node in document.all("nodes") for child in node.integers("children")}
        return [index for index in range(len(document.all("nodes"))) if index not in children]
    scene = document.referenced(document.root, "scene", "scenes") or scenes[0]
    if len(scenes) > 1:
        name = scene.string("name", "") or scene.place
        report.limit("scene_graph", f"the file has {len(scenes)} scenes; only the default one, '{name}', is read")
    roots = scene.integers("nodes")
    for index in roots:
        document.get("nodes", index, scene, "nodes")
    return roots


def instance_transforms(placed: PlacedNode, accessors: Accessors, report: ImportReport) -> np.ndarray:
    """(n, 4, 4) to world space: one for a usual node, one per instance with EXT_mesh_gpu_instancing."""
    extension = placed.node.extension(_INSTANCING)
    if extension is None:
        return placed.to_world[None]
    report.use("instances", placed.node.place)
    attributes = extension.object("attributes")
    if attributes is None:
        extension.fail("attributes", "it is missing")
    kinds = {"TRANSLATION": ("VEC3", (0, 0, 0)), "ROTATION": ("VEC4", (0, 0, 0, 1)), "SCALE": ("VEC3", (1, 1, 1))}
    given = {name: accessors.read_floats(attributes, name, kinds[name][0]) for name in kinds if name in attributes}
    if not given:
        return placed.to_world[None]
    count = len(next(iter(given.values())))
    columns = []
    for name, (_, default) in kinds.items():
        values = given[name].astype(float) if name in given else np.tile(np.array(default, float), (count, 1))
        if len(values) != count:
            attributes.fail(name, f"it has {len(values)} elements, others have {count}")
        if not (np.abs(values) < _MAX_ELEMENT).all():
            attributes.fail(name, f"a value is not finite or exceeds {_MAX_ELEMENT:g}")
        columns.append(values)
    if not _is_quaternion(columns[1]).all():
        attributes.fail("ROTATION", "an element is no unit quaternion")
    return placed.to_world @ compose_transforms(*columns)
