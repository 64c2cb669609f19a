"""The feature set: what of the program, the buffers and the stages a scene and a strategy need; all else is left out.

Kernels test `FEATURE_<name>` with #if; the host sets every one to 0 or 1.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from isonoise.integrator.pixel_filter import CELLS
from isonoise.scene import structs
from isonoise.scene.accel.bvh import BLOCK_ROWS, BVH_WIDTH
from isonoise.scene.compiled_scene import CompiledScene
from isonoise.scene.light import light_list
from isonoise.scene.light.light_kinds import KINDS as LIGHT_KINDS
from isonoise.scene.light.light_kinds import light_bits
from isonoise.scene.light.light_tree import LIGHT_NODE_ROWS, use_light_tree
from isonoise.scene.material import bsdf_kinds, textures
from isonoise.scene.material.bsdf_kinds import bsdf_bits, feature_of
from isonoise.scene.material.bsdfs import reads_uvs
from isonoise.statistics import BASIC_NEEDS, Needs


@dataclass(frozen=True)
class Feature:
    """What a feature is. `buffers` are there for it, by the names of the kernels' arguments, with the size of what they
    hold; some serve several features. What else it costs is computed from the kernels: `integrator.costs`."""

    meaning: str
    buffers: Mapping[str, str] = field(default_factory=dict)


def _records(dtype: np.dtype, of: str) -> str:
    return f"{dtype.itemsize} bytes {of}"


_LIGHTS = {"lights": _records(structs.LIGHT, "a light"), "light_alias": _records(structs.ALIAS, "a light")}

_SCATTERING = bsdf_kinds.select(lambda kind: kind.scatters and not kind.feature)
_OTHER_BSDFS = bsdf_kinds.select(lambda kind: not kind.scatters)


def _bsdf_feature(kind: bsdf_kinds.BsdfKind) -> Feature:
    return Feature(kind.description, kind.buffers)


FEATURES = {
    "TRIANGLES": Feature(
        "triangle meshes",
        {
            "triangles": _records(structs.TRIANGLE, "a triangle"),
            "blocks": f"{4 * BLOCK_ROWS * BVH_WIDTH} bytes for up to {BVH_WIDTH} triangles",
            "corners": "12 bytes a corner, where there is no hierarchy",
            "corner_indices": "12 bytes a triangle, where there is no hierarchy",
        },
    ),
    "VERTEX_NORMALS": Feature("smooth shading by vertex normals", {"corner_normals": "36 bytes a triangle"}),
    "UVS": Feature("texture coordinates", {"uvs": "8 bytes a vertex", "faces": "12 bytes a triangle"}),
    "TEXTURES": Feature("parameters that vary over a surface", {"textures": _records(textures.TEXTURE, "a texture")}),
    "BITMAPS": Feature(
        "images as textures",
        {
            "texel_bytes": "4 bytes a texel of 8-bit images",
            "texel_floats": "16 bytes a texel of others",
            "srgb": "1,024 bytes",
        },
    ),
    "CHECKERBOARDS": Feature("checkerboards"),
    "MESH_ATTRIBUTES": Feature("colours of vertices and faces", {"attributes": "12 bytes a colour"}),
    "ANALYTICS": Feature(
        "shapes that are not triangles",
        {"analytics": _records(structs.ANALYTIC, "a shape"), "shapes": _records(structs.SHAPE, "a shape or mesh")},
    ),
    "SPHERES": Feature("spheres"),
    "DISKS": Feature("disks"),
    "CYLINDERS": Feature("cylinders"),
    "INSTANCES": Feature(
        "groups of shapes that stand in several places", {"instances": _records(structs.INSTANCE, "an instance")}
    ),
    **{feature_of(kind): _bsdf_feature(kind) for kind in _SCATTERING},
    "BECKMANN": Feature("rough surfaces by Beckmann's distribution"),
    "SAMPLE_ALL_NORMALS": Feature("rough surfaces sampled by all their normals"),
    **{feature_of(kind): _bsdf_feature(kind) for kind in _OTHER_BSDFS},
    "TWOSIDED": Feature("two-sided materials"),
    "VOLPATH": Feature("surfaces that let paths and light through unturned"),
    "MEDIA": Feature("media", {"media": _records(structs.MEDIUM, "a medium")}),
    "AREA_LIGHTS": Feature("surfaces that shine", _LIGHTS),
    "TEXTURED_LIGHTS": Feature("lights whose radiance varies over them"),
    **{kind.feature: Feature(kind.description, {**_LIGHTS, **kind.buffers}) for kind in LIGHT_KINDS.values()},
    "MANY_LIGHTS": Feature("more than one light"),
    "LIGHT_TREE": Feature(
        "many lights, picked by what they could send to a point",
        {
            "light_nodes": f"{4 * LIGHT_NODE_ROWS * BVH_WIDTH} bytes for up to {BVH_WIDTH} lights or nodes",
            "light_parents": "4 bytes a light and node",
        },
    ),
    "LIGHT_LIST": Feature(
        "some lights, each weighed by what it could send to a point",
        {"light_bounds": _records(structs.LIGHT_BOUND, "a light")},
    ),
    "NEXT_EVENT": Feature("next-event estimation"),
    "RUSSIAN_ROULETTE": Feature("russian roulette"),
    "HIDE_EMITTERS": Feature("lights hidden from the camera"),
    "THIN_LENS": Feature("a lens with depth of field"),
    "ORTHOGRAPHIC": Feature("a camera of parallel rays"),
    "FILTER_TABLE": Feature("pixel filter other than a box", {"inverse_cdf": f"{4 * (CELLS + 1):,} bytes"}),
    "CHUNK_MEDIANS": Feature("chunk medians M_x", {"medians": "4 bytes a pixel and entry of a chunk, and 4 a pixel"}),
    "BATCH_MEANS": Feature("chunks of means of several samples", {"medians": "8 bytes more a pixel"}),
    "POWER_MEAN": Feature("mean of a power of the samples", {"powers": "8 bytes a pixel"}),
    "HALF_BUFFER": Feature("mean of every second sample", {"halves": "24 bytes a pixel"}),
    "COUNT_TESTS": Feature("nodes and blocks of triangles tested, counted"),
}
"""What a scene, or a strategy, may use. What is in all programs, such as `nodes` and `bsdfs`, is in no feature."""


def features(scene: CompiledScene, needs: Needs = BASIC_NEEDS) -> dict[str, bool]:
    """Which features the scene uses, and the statistics of `needs` ask for. Keys and order as in `FEATURES`."""
    analytic = set(scene.analytics["kind"])
    bsdf, light = (int(np.bitwise_or.reduce(table["kind"])) for table in (scene.bsdfs, scene.lights))
    non_delta = bsdf_bits(*(kind.name for kind in bsdf_kinds.select(lambda kind: kind.scatters and not kind.is_delta)))
    area = light_bits(*(name for name, kind in LIGHT_KINDS.items() if kind.is_area))
    endless = scene.max_depth < 0
    next_event = light != 0 and bsdf & non_delta != 0 and (endless or scene.max_depth > 1)
    weighs_lights = next_event and use_light_tree(scene.lights)
    volpath = len(scene.media) > 0 or bool((scene.bsdfs["flags"] & structs.BSDF_PASS_THROUGH).any())
    lists_lights = light_list.use_light_list(scene.lights) and not volpath  # one by one they take 2 to 5 times as long
    return {
        "TRIANGLES": len(scene.faces) > 0,
        "VERTEX_NORMALS": bool((scene.shapes["flags"] & structs.SHAPE_VERTEX_NORMALS).any()),
        "UVS": reads_uvs(scene.bsdfs) or bool((scene.lights["texture"] != structs.NONE).any()),
        "TEXTURES": len(scene.textures) > 0,
        "BITMAPS": textures.TEXTURE_BITMAP in scene.textures["kind"],
        "CHECKERBOARDS": textures.TEXTURE_CHECKERBOARD in scene.textures["kind"],
        "MESH_ATTRIBUTES": textures.TEXTURE_MESH_ATTRIBUTE in scene.textures["kind"],
        "ANALYTICS": len(scene.analytics) > 0,
        "SPHERES": structs.ANALYTIC_SPHERE in analytic,
        "DISKS": structs.ANALYTIC_DISK in analytic,
        "CYLINDERS": structs.ANALYTIC_CYLINDER in analytic,
        "INSTANCES": len(scene.instances) > 0,
        **{feature_of(kind): bsdf & bsdf_bits(kind.name) != 0 for kind in _SCATTERING},
        "BECKMANN": bool((scene.bsdfs["flags"] & structs.BSDF_BECKMANN).any()),
        "SAMPLE_ALL_NORMALS": bool((scene.bsdfs["flags"] & structs.BSDF_SAMPLE_ALL_NORMALS).any()),
        **{feature_of(kind): bsdf & bsdf_bits(kind.name) != 0 for kind in _OTHER_BSDFS},
        "TWOSIDED": bool((scene.bsdfs["flags"] & structs.BSDF_TWOSIDED).any()),
        "VOLPATH": volpath,
        "MEDIA": len(scene.media) > 0,
        "AREA_LIGHTS": light & area != 0,
        "TEXTURED_LIGHTS": bool((scene.lights["texture"] != structs.NONE).any()),
        **{kind.feature: light & light_bits(name) != 0 for name, kind in LIGHT_KINDS.items()},
        "MANY_LIGHTS": len(scene.lights) > 1,
        "LIGHT_TREE": weighs_lights and not lists_lights,
        "LIGHT_LIST": weighs_lights and lists_lights,
        "NEXT_EVENT": next_event,
        "RUSSIAN_ROULETTE": endless or scene.rr_depth < scene.max_depth,
        "HIDE_EMITTERS": scene.hide_emitters,
        "THIN_LENS": bool(scene.camera["kind"][0] == structs.CAMERA_THIN_LENS),
        "ORTHOGRAPHIC": bool(scene.camera["kind"][0] == structs.CAMERA_ORTHOGRAPHIC),
        "FILTER_TABLE": scene.filter != "box",
        **statistics_features(needs),
        "COUNT_TESTS": False,  # a picture never needs it: it is switched on to measure
    }


def statistics_features(needs: Needs) -> dict[str, bool]:
    """Which features the statistics of `needs` ask for: all that the stages `reduce` and `summarise` know."""
    return {
        "CHUNK_MEDIANS": needs.median,
        "BATCH_MEANS": needs.median and needs.batch > 1,
        "POWER_MEAN": needs.power is not None,
        "HALF_BUFFER": needs.half,
    }
