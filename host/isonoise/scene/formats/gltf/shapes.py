"""Makes the shapes of a glTF file from the nodes that have meshes. Called by `read.py`."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from isonoise.errors import SceneError
from isonoise.scene.formats.gltf.accessors import Accessors
from isonoise.scene.formats.gltf.bake import bake_copies
from isonoise.scene.formats.gltf.deform import apply_skin, joint_matrices, morph, morph_weights
from isonoise.scene.formats.gltf.document import Document
from isonoise.scene.formats.gltf.json_objects import JsonObject
from isonoise.scene.formats.gltf.materials import Materials
from isonoise.scene.formats.gltf.nodes import PlacedNode, instance_transforms
from isonoise.scene.formats.gltf.opacity import VERTEX_ALPHA
from isonoise.scene.formats.gltf.primitives import Geometry, has_mirrored_uvs, is_closed, read_geometry
from isonoise.scene.formats.gltf.surface import PrimitiveInfo, Surface, describe_vertex_colours
from isonoise.scene.formats.mesh_shape import mesh_shape
from isonoise.scene.formats.report import ImportReport
from isonoise.scene.mesh.mesh import Mesh

_MIN_SAVED_TRIANGLES = 100_000
"""Copies of a mesh become instances if that saves as many triangles. Rays find copies faster than instances."""
_MAX_TRIANGLES = 1 << 26
_MIN_RELATIVE_DETERMINANT = 1e-9  # of an instance's transform; flatter copies become triangles


@dataclass
class _Copies:
    """A mesh with certain weights of its morph targets, and where it is placed."""

    index: int
    mesh: JsonObject
    weights: tuple[float, ...]
    name: str
    matrices: list[np.ndarray]  # (n, 4, 4) each
    joints: np.ndarray | None = None  # (joints, 4, 4) of a skin


class Shapes:
    """The shapes of a scene dict, by name."""

    def __init__(self, document: Document, accessors: Accessors, materials: Materials, report: ImportReport):
        self.document, self.accessors, self.materials, self.report = document, accessors, materials, report
        self.shapes: dict[str, dict] = {}
        self._triangles = 0
        self._name_counts: dict[str, int] = {}

    def add_nodes(self, placed: list[PlacedNode], matrices: np.ndarray) -> None:
        """Add the meshes of nodes. `matrices` are the transforms of all nodes, for skins."""
        copies: dict[tuple, _Copies] = {}
        for one in placed:
            mesh = self.document.referenced(one.node, "mesh", "meshes")
            if mesh is None or not one.is_visible:
                continue
            index, weights, joints = one.node.integer("mesh"), morph_weights(mesh, one.node), None
            if any(weights):
                self.report.use("animation", one.name)
            skin = self.document.referenced(one.node, "skin", "skins")
            if skin is not None:  # the node's own transform does not matter
                self.report.use("animation", one.name)
                joints, transforms = joint_matrices(skin, matrices, self.document, self.accessors), np.eye(4)[None]
            else:
                transforms = instance_transforms(one, self.accessors, self.report)
            key = (index, weights, one.node.place if joints is not None else "")
            if key not in copies:
                name = mesh.string("name", "") or one.node.string("name", "") or str(index)
                copies[key] = _Copies(index, mesh, weights, name, [], joints)
            copies[key].matrices.append(transforms)
        self.report.count("meshes", len({index for index, _, _ in copies}))
        for one in copies.values():
            self._add_copies(one)

    def _add_copies(self, copies: _Copies) -> None:
        matrices = np.concatenate(copies.matrices)
        primitives = list(self._primitives(copies))
        triangles = sum(len(geometry.faces) for geometry, *_ in primitives)
        self.report.count("triangles", triangles * len(matrices))
        if len(matrices) > 1:
            self.report.count("copies of meshes", len(matrices) - 1)
        determinants = np.linalg.det(matrices[:, :3, :3])
        sizes = np.abs(matrices[:, :3, :3]).max(axis=(1, 2))
        can_be_instance = np.abs(determinants) > _MIN_RELATIVE_DETERMINANT * sizes**3
        if (can_be_instance.sum() - 1) * triangles < _MIN_SAVED_TRIANGLES:
            can_be_instance[:] = False
        # a mirrored copy of a surface with a normal map needs a bsdf of its own
        has_sides = any(self.materials.surface(material, info).uses_tangents for _, material, info in primitives)
        sides = [determinants >= 0, determinants < 0] if has_sides else [np.ones(len(matrices), bool)]
        for is_on_side, is_mirrored in zip(sides, (False, True), strict=False):
            is_instance = is_on_side & can_be_instance
            in_group = {}
            for part, surface in self._parts(primitives, is_mirrored):
                is_shared = surface.emission is None and is_instance.any()
                if is_shared and (shape := self._shape(part, surface, np.eye(4)[None])):
                    in_group[f"shape_{len(in_group)}"] = shape
                is_single = is_on_side & ~can_be_instance if is_shared else is_on_side
                if is_single.any() and (shape := self._shape(part, surface, matrices[is_single])):
                    self.shapes[self._unique_name(f"mesh_{copies.name}")] = shape
            if in_group:
                self._add_instances(copies.name, in_group, matrices[is_instance])

    def _add_instances(self, name: str, group: dict[str, dict], matrices: np.ndarray) -> None:
        self.report.use("instances", name)
        identifier = self._unique_name(f"group_{name}")
        self.shapes[identifier] = {"type": "shapegroup", **group}
        for matrix in matrices:
            instance = {"type": "instance", "to_world": matrix, "shape": {"type": "ref", "id": identifier}}
            self.shapes[self._unique_name(f"instance_{name}")] = instance

    def _primitives(self, copies: _Copies) -> Iterator[tuple[Geometry, int | None, PrimitiveInfo]]:
        """Geometry, material and description of each primitive with triangles."""
        for primitive in copies.mesh.objects("primitives"):
            geometry = read_geometry(primitive, self.accessors, self.report)
            if geometry is None:
                continue
            if copies.weights:
                geometry = morph(geometry, primitive, copies.weights, self.accessors)
            if copies.joints is not None:
                geometry = apply_skin(geometry, primitive, copies.joints, self.accessors)
            material = primitive.integer("material", None)
            if material is not None:
                self.document.get("materials", material, primitive, "material")
            yield geometry, material, describe(geometry, "TANGENT" in primitive.object("attributes"))

    def _parts(self, primitives: list, is_mirrored: bool) -> Iterator[tuple[Geometry, Surface]]:
        """The primitives with their surfaces, divided where the image of a normal map is mirrored on some triangles."""
        for geometry, material, info in primitives:
            surface = self.materials.surface(material, info)
            if not surface.uses_tangents or surface.uv_set >= len(geometry.uv_sets):
                yield geometry, surface
                continue
            has_mirrored = has_mirrored_uvs(geometry, geometry.uv_sets[surface.uv_set]) != is_mirrored
            if not has_mirrored.all():
                yield replace(geometry, faces=geometry.faces[~has_mirrored]), surface
            if has_mirrored.any():
                mirrored = self.materials.surface(material, replace(info, has_mirrored_uvs=True))
                yield replace(geometry, faces=geometry.faces[has_mirrored]), mirrored

    def _shape(self, geometry: Geometry, surface: Surface, matrices: np.ndarray) -> dict | None:
        """A mesh of all copies of a geometry, in world space; None if it has no extent."""
        self._triangles += len(geometry.faces) * len(matrices)
        if self._triangles > _MAX_TRIANGLES:
            raise SceneError(f"{self.document.path}: it has more than {_MAX_TRIANGLES:,} triangles")
        uv_sets = geometry.uv_sets[surface.uv_set : surface.uv_set + 1]
        baked = bake_copies(replace(geometry, uv_sets=uv_sets), matrices)
        if baked is None:
            return None
        no_normals = np.zeros((0, 3))
        mesh = Mesh(baked.vertices, baked.faces, no_normals if baked.normals is None else baked.normals)
        if baked.uv_sets:
            mesh.uvs = baked.uv_sets[0].astype(np.float32)
        if surface.needs_vertex_colours:
            if baked.colours is not None:
                colours = np.float32(surface.vertex_colour_factor) * baked.colours.astype(np.float32)
                mesh.attributes["vertex_color"] = colours
            if baked.alphas is not None:
                mesh.attributes[VERTEX_ALPHA] = baked.alphas.astype(np.float32)
        shape = mesh_shape(mesh, surface.bsdf, face_normals=geometry.normals is None)
        if surface.emission is not None:
            shape["emitter"] = surface.emission
            if surface.emits_from_both_sides and not is_closed(geometry):
                self.report.limit("emission", "only the front of a surface emits, also where it is double-sided")
        if surface.interior_medium is not None:
            shape["interior"] = surface.interior_medium
        return shape

    def _unique_name(self, name: str) -> str:
        """The name with characters that any scene file may have, and a number if it is taken."""
        return unique_name(name, self._name_counts)


def describe(geometry: Geometry, has_tangents: bool) -> PrimitiveInfo:
    """What a surface depends on besides its material; whether images are mirrored on it is found later."""
    bounds = [tuple(zip(uvs.min(axis=0).tolist(), uvs.max(axis=0).tolist(), strict=True)) for uvs in geometry.uv_sets]
    return PrimitiveInfo(
        len(geometry.uv_sets),
        None if geometry.colours is None else describe_vertex_colours(geometry.colours[geometry.faces.ravel()]),
        geometry.alphas is not None and bool((geometry.alphas[geometry.faces.ravel()] != 1).any()),
        has_tangents=has_tangents,
        uv_bounds=tuple(bounds),
    )


def unique_name(name: str, counts: dict[str, int]) -> str:
    """The name in plain characters, with a number if it is taken. `counts` is how often each name was asked for."""
    plain = "".join(c if c.isascii() and (c.isalnum() or c in "_-") else "_" for c in name[:60])
    unique = plain
    while unique in counts:
        counts[plain] += 1
        unique = f"{plain}__{counts[plain]}"
    counts[unique] = 1
    return unique
