"""The arguments that describe a scene to the kernels: buffers and counts, by the names in `kernel_table`."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from isonoise.device.opencl import Device
from isonoise.errors import SceneError
from isonoise.integrator.brute_force import distinct_corners
from isonoise.integrator.pixel_filter import CELLS, inverse_cdf
from isonoise.scene.accel.bvh import Bvh
from isonoise.scene.compiled_scene import CompiledScene
from isonoise.scene.light import light_list
from isonoise.scene.light.light_tree import build_light_tree
from isonoise.scene.material import bsdfs, textures
from isonoise.scene.mesh.triangle_records import corner_normals, triangle_records

MAX_TABLE_BYTES = 2**33
"""Size of a table of the scene: kernels index its 4-byte words with signed 32-bit numbers (`record_reader`)."""

BVH_ARGUMENTS = ("nodes", "triangle_blocks")
"""Arguments that hold the BVH."""

_NO_LIMIT = 0xFFFFFFFF
_EMPTY = np.zeros(0, np.float32)


def scene_arguments(
    device: Device, scene: CompiledScene, bvh: Bvh, features: Mapping[str, bool], brute_force: bool
) -> dict[str, object]:
    """Upload a scene.

    Parameters
    ----------
    features : what the kernels are built for; buffers that it does not need are None
    brute_force : whether rays are tested against all primitives, without the BVH

    Returns
    -------
    Argument name -> buffer, number, or None
    """
    return {
        **_camera(device, scene, features),
        **_geometry(device, scene, bvh, features),
        **(_triangle_corners(device, scene) if brute_force else {}),
        **_materials(device, scene, features),
        **_heterogeneous(device, scene),
        **_lights(device, scene),
        **_light_selection(device, scene, features),
        "max_depth": np.uint32(scene.max_depth if scene.max_depth >= 0 else _NO_LIMIT),
        "rr_depth": np.uint32(scene.rr_depth),
    }


class _SizedBuffer(NamedTuple):
    size: int


class _BufferSizes:
    """Stands for a device: its buffers have a size and no memory."""

    def buffer(self, content: np.ndarray, label: str) -> _SizedBuffer:
        return _SizedBuffer(content.nbytes)


def measure_scene(scene: CompiledScene, bvh: Bvh, features: Mapping[str, bool], brute_force: bool) -> tuple[int, int]:
    """Bytes of the buffers that `scene_arguments` would make: those of the scene, and those of the BVH."""
    return scene_bytes(scene_arguments(_BufferSizes(), scene, bvh, features, brute_force))


def scene_bytes(arguments: Mapping[str, object]) -> tuple[int, int]:
    """Bytes of the buffers of a scene, and of its BVH."""
    bvh = sum(buffer_size(arguments[name]) for name in BVH_ARGUMENTS)
    return sum(buffer_size(argument) for argument in arguments.values()) - bvh, bvh


def buffer_size(argument: object) -> int:
    """Bytes of the argument if it is a buffer, else 0."""
    return 0 if argument is None or isinstance(argument, np.generic | np.ndarray) else argument.size


def _table(device: Device, array: np.ndarray, label: str):
    """A buffer with the array, None if that is empty. `label` names it in errors and reports.

    Raises SceneError above `MAX_TABLE_BYTES`.
    """
    if array.nbytes > MAX_TABLE_BYTES:
        raise SceneError(
            f"{label} need {array.nbytes / 2**30:.1f} GiB, the limit is {MAX_TABLE_BYTES >> 30} GiB; "
            "use fewer triangles, or smaller images and volumes"
        )
    return device.buffer(array, label) if array.size else None


def _camera(device: Device, scene: CompiledScene, features: Mapping[str, bool]) -> dict[str, object]:
    camera, table = scene.camera[0], _EMPTY
    if features["FILTER_TABLE"]:
        table = inverse_cdf(scene.filter, float(camera["filter_radius"]), float(camera["filter_stddev"]))
    return {
        "camera": device.buffer(scene.camera, "the camera"),
        "sensor_medium": np.uint32(scene.sensor_medium),
        "inverse_cdf": _table(device, table, "the pixel filter"),
        "inverse_cdf_cells": np.uint32(CELLS),
    }


def _geometry(device: Device, scene: CompiledScene, bvh: Bvh, features: Mapping[str, bool]) -> dict[str, object]:
    normals = corner_normals(scene) if features["VERTEX_NORMALS"] else _EMPTY
    return {
        "nodes": _table(device, bvh.nodes, "the BVH nodes"),
        "triangle_blocks": _table(device, bvh.blocks, "the triangles of the BVH"),
        "first_analytic": np.uint32(bvh.first_analytic),
        "first_instance": np.uint32(bvh.first_analytic + len(scene.analytics)),
        "world_triangle_count": np.uint32(scene.group_offsets[0, 0]),
        "triangle_count": np.uint32(len(scene.faces)),
        "analytic_count": np.uint32(len(scene.analytics)),
        **dict.fromkeys(("corners", "corner_indices")),
        "corner_count": np.uint32(0),
        "triangles": _table(device, triangle_records(scene), "the triangles"),
        "faces": _table(device, scene.faces if features["UVS"] else _EMPTY, "the faces"),
        "corner_normals": _table(device, normals, "the vertex normals"),
        "uvs": _table(device, scene.uvs, "the texture coordinates"),
        "analytics": _table(device, scene.analytics, "the analytic shapes"),
        "shapes": _table(device, scene.shapes if features["ANALYTICS"] else _EMPTY, "the shapes"),
        "instances": _table(device, scene.instances, "the instances"),
        "triangle_shape": _table(device, scene.triangle_shape if features["LAYERS"] else _EMPTY, "the shapes"),
        "scene_sphere": _bounding_sphere(scene.bounds),
    }


def _triangle_corners(device: Device, scene: CompiledScene) -> dict[str, object]:
    if not len(scene.faces):
        return {}
    corners, indices = distinct_corners(scene)
    return {
        "corners": device.buffer(corners, "the triangles"),
        "corner_indices": device.buffer(indices, "the triangles"),
        "corner_count": np.uint32(len(corners)),
    }


def _materials(device: Device, scene: CompiledScene, features: Mapping[str, bool]) -> dict[str, object]:
    return {
        "bsdfs": _table(device, scene.bsdfs, "the materials"),
        "rough_transmittances": _table(device, scene.rough_transmittances, "the tables of rough plastics"),
        "textures": _table(device, scene.textures, "the textures"),
        "texel_bytes": _table(device, scene.texel_bytes, "the texels"),
        "texel_floats": _table(device, scene.texel_floats, "the texels"),
        "srgb": _table(device, textures.SRGB if features["BITMAPS"] else _EMPTY, "the table of sRGB"),
        "attributes": _table(device, scene.attributes, "the mesh attributes"),
        "textured_slots": np.uint32(bsdfs.textured_slots(scene.bsdfs)),
        "media": _table(device, scene.media, "the media"),
    }


def _heterogeneous(device: Device, scene: CompiledScene) -> dict[str, object]:
    if scene.heterogeneous is None:
        return {}
    return {name: _table(device, array, "the volumes") for name, array in scene.heterogeneous.arrays().items()}


def _lights(device: Device, scene: CompiledScene) -> dict[str, object]:
    arguments = {
        "lights": _table(device, scene.lights, "the lights"),
        "projections": _table(device, scene.projections, "the lights"),
        "light_cdf": _table(device, scene.light_cdf, "the light table"),
        "light_count": np.uint32(len(scene.lights)),
        "environment_light": np.uint32(scene.environment_light & 0xFFFFFFFF),
    }
    environment = scene.environment
    if environment is not None:
        arrays = {"": environment.record, "_texels": environment.texels}
        arrays |= {"_rows": environment.rows, "_guide": environment.guide}
        label = "the environment map"
        arguments |= {f"environment{suffix}": device.buffer(array, label) for suffix, array in arrays.items()}
    return arguments


def _light_selection(device: Device, scene: CompiledScene, features: Mapping[str, bool]) -> dict[str, object]:
    """The light list or the light tree, if the scene has enough lights for one."""
    if features["LIGHT_LIST"]:
        return {"light_bounds": device.buffer(light_list.build_light_list(scene), "the light list")}
    if not features["LIGHT_TREE"]:
        return {}
    tree = build_light_tree(scene)
    return {
        "light_nodes": device.buffer(tree.nodes, "the light tree"),
        "light_parents": device.buffer(tree.parents, "the light tree"),
    }


def _bounding_sphere(bounds: np.ndarray) -> np.ndarray:
    """Center and radius (4,) float32 of the sphere around a box (2, 3)."""
    radius = 0.5 * np.linalg.norm(np.ptp(bounds.astype(float), axis=0))
    return np.append(bounds.mean(axis=0), radius).astype(np.float32)
