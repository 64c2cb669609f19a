"""Morph targets with their default weights and skins in rest pose. Called by `shapes.py`."""

from dataclasses import replace

import numpy as np

from isonoise.scene.formats.gltf.accessors import Accessors
from isonoise.scene.formats.gltf.document import Document
from isonoise.scene.formats.gltf.json_objects import JsonObject
from isonoise.scene.formats.gltf.primitives import Geometry, read_vertex_values
from isonoise.scene.mesh.mesh import make_uvs, normalize

_MAX_JOINT_SETS = 8  # of four joints per vertex


def morph_weights(mesh: JsonObject, node: JsonObject) -> tuple[float, ...]:
    """The default weights of a mesh's morph targets: those of the node, or else of the mesh."""
    return node.numbers("weights", None, None) or mesh.numbers("weights", None, ())


def morph(geometry: Geometry, primitive: JsonObject, weights: tuple[float, ...], accessors: Accessors) -> Geometry:
    """The geometry with the weighted displacements of its targets (glTF 2.0 section 3.7.2.2)."""
    targets = primitive.objects("targets")
    if targets and len(weights) not in (0, len(targets)):
        primitive.fail("targets", f"there are {len(targets)} targets, but {len(weights)} weights")
    vertices, normals = geometry.vertices.astype(float), geometry.normals
    uv_sets, colours = [uvs.astype(float) for uvs in geometry.uv_sets], geometry.colours
    for target, weight in zip(targets, weights, strict=False):
        if not weight:
            continue

        def displaced(values, name: str, *types: str, target=target, weight=weight):
            if values is None or name not in target:
                return values
            shift = read_vertex_values(target, name, len(values), accessors, *types)
            return values + weight * shift[:, : values.shape[1]].astype(float)

        vertices = displaced(vertices, "POSITION", "VEC3")
        normals = displaced(normals, "NORMAL", "VEC3")
        uv_sets = [displaced(uvs, f"TEXCOORD_{number}", "VEC2") for number, uvs in enumerate(uv_sets)]
        colours = displaced(colours, "COLOR_0", "VEC3", "VEC4")
    if not np.isfinite(vertices).all():
        primitive.fail("targets", "a displaced position is not a finite number")
    normals = None if normals is None else np.where(np.isfinite(normals).all(axis=1, keepdims=True), normals, 0.0)
    colours = None if colours is None else np.clip(np.nan_to_num(colours), 0.0, 1.0)
    uv_sets = [make_uvs(uvs, flip=False) for uvs in uv_sets]
    return replace(geometry, vertices=vertices, normals=normals, uv_sets=uv_sets, colours=colours)


def joint_matrices(skin: JsonObject, matrices: np.ndarray, document: Document, accessors: Accessors) -> np.ndarray:
    """(joints, 4, 4): from the space of a skinned mesh to the world, for each joint in rest pose.

    `matrices` are the transforms of all nodes.
    """
    joints = skin.integers("joints")
    for joint in joints:
        document.get("nodes", joint, skin, "joints")
    if not joints:
        skin.fail("joints", "it is missing")
    if "inverseBindMatrices" not in skin:
        return matrices[joints]
    columns = accessors.read_floats(skin, "inverseBindMatrices", "MAT4")
    if len(columns) < len(joints):
        skin.fail("inverseBindMatrices", f"there are {len(columns)} matrices for {len(joints)} joints")
    inverse_bind = columns[: len(joints)].reshape(-1, 4, 4).transpose(0, 2, 1).astype(float)
    return matrices[joints] @ inverse_bind


def apply_skin(geometry: Geometry, primitive: JsonObject, matrices: np.ndarray, accessors: Accessors) -> Geometry:
    """The geometry in world space: each vertex by the weighted mean of its joints' matrices (section 3.7.3.3)."""
    attributes = primitive.object("attributes")
    count = len(geometry.vertices)
    blended, total = np.zeros((count, 3, 4)), np.zeros(count)
    for number in range(_MAX_JOINT_SETS):
        weights = read_vertex_values(attributes, f"WEIGHTS_{number}", count, accessors, "VEC4")
        if weights is None:
            break
        joints = accessors.read_integers(attributes, f"JOINTS_{number}", "VEC4")
        if len(joints) != count:
            attributes.fail(f"JOINTS_{number}", f"it has {len(joints)} elements, but there are {count} positions")
        weights = np.nan_to_num(weights.astype(float), posinf=0.0, neginf=0.0)
        if count and joints[weights != 0].max(initial=0) >= len(matrices):
            attributes.fail(f"JOINTS_{number}", f"a joint is out of range; the skin has {len(matrices)}")
        for weight, joint in zip(weights.T, joints.T, strict=True):
            blended += weight[:, None, None] * matrices[np.minimum(joint, len(matrices) - 1), :3]
        total += weights.sum(axis=1)
    blended[total == 0] = matrices[0, :3]
    blended /= np.where(total == 0, 1.0, total)[:, None, None]
    vertices = np.einsum("vij,vj->vi", blended[..., :3], geometry.vertices) + blended[..., 3]
    if not np.isfinite(vertices).all():
        attributes.fail("", "its skin moves a vertex beyond the range of floats")
    normals = geometry.normals
    if normals is not None:
        normals = np.einsum("vij,vj->vi", normal_matrices(blended[..., :3]), normals.astype(float))
        normals = normalize(np.where(np.isfinite(normals).all(axis=1, keepdims=True), normals, 0.0))
    return replace(geometry, vertices=vertices, normals=normals)


def normal_matrices(linear: np.ndarray) -> np.ndarray:
    """(..., 3, 3) matrices that transform normals, but for their length, also where `linear` cannot be inverted.

    They are the cofactors, negative if the transform mirrors, so that front sides stay front sides.
    """
    x, y, z = linear[..., 0], linear[..., 1], linear[..., 2]
    cofactors = np.stack([np.cross(y, z), np.cross(z, x), np.cross(x, y)], axis=-1)
    is_mirror = np.linalg.det(linear) < 0
    return np.where(is_mirror[..., None, None], -cofactors, cofactors)
