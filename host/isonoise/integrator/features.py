"""The features: what a scene or a strategy may need of the programs, the buffers and the stages.

Kernels test `FEATURE_<name>` with #if; the host sets every one to 0 or 1. What a scene does not use is left out.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from isonoise.integrator.pixel_filter import CELLS
from isonoise.scene import structs
from isonoise.scene.accel.bvh import BLOCK_ROWS, BVH_WIDTH
from isonoise.scene.compiled_scene import CompiledScene
from isonoise.scene.light import light_kinds, light_list
from isonoise.scene.light.light_kinds import KINDS as LIGHT_KINDS
from isonoise.scene.light.light_kinds import LightKind, light_bits
from isonoise.scene.light.light_tree import LIGHT_NODE_ROWS, use_light_tree
from isonoise.scene.material import bsdf_kinds, textures
from isonoise.scene.material.bsdf_kinds import bsdf_bits, feature_of
from isonoise.scene.material.bsdfs import reads_uvs
from isonoise.statistics import BASIC_NEEDS, Needs


@dataclass(frozen=True)
class _Use:
    """A scene with a strategy's needs, and facts about them that several features ask for."""

    scene: CompiledScene | None
    needs: Needs

    @cached_property
    def bsdf_bits(self) -> int:
        return int(np.bitwise_or.reduce(self.scene.bsdfs["kind"]))

    @cached_property
    def light_bits(self) -> int:
        return int(np.bitwise_or.reduce(self.scene.lights["kind"]))

    @cached_property
    def samples_lights(self) -> bool:
        """Whether next-event estimation can find light."""
        non_delta = bsdf_kinds.bits_where(lambda kind: kind.scatters and not kind.is_delta)
        can_scatter = self.bsdf_bits & non_delta != 0
        return self.light_bits != 0 and can_scatter and (self.is_unlimited or self.scene.max_depth > 1)

    @cached_property
    def selects_lights_by_importance(self) -> bool:
        """Whether lights are selected by their importance for a point."""
        return self.samples_lights and use_light_tree(self.scene.lights)

    @cached_property
    def uses_light_list(self) -> bool:
        # with VOLPATH paths are shaded one by one, where the list takes 2 to 5 times as long as the tree
        return light_list.use_light_list(self.scene.lights) and not self.is_volpath

    @cached_property
    def is_volpath(self) -> bool:
        return len(self.scene.media) > 0 or self.has_bsdf_flag(structs.BSDF_PASS_THROUGH)

    @property
    def is_unlimited(self) -> bool:
        return self.scene.max_depth < 0

    @property
    def has_textured_lights(self) -> bool:
        return bool((self.scene.lights["texture"] != structs.NONE).any())

    @property
    def has_textured_area_lights(self) -> bool:
        is_area = self.scene.lights["kind"] & _AREA_LIGHTS != 0
        return bool((self.scene.lights["texture"][is_area] != structs.NONE).any())

    def has_bsdf_flag(self, flag: int) -> bool:
        return bool((self.scene.bsdfs["flags"] & flag).any())

    def has_analytic(self, kind: int) -> bool:
        return kind in self.scene.analytics["kind"]

    def has_texture(self, kind: int) -> bool:
        return kind in self.scene.textures["kind"]


@dataclass(frozen=True)
class Feature:
    """A feature. What it costs beside its buffers is computed from the kernels: `feature_costs`."""

    description: str
    is_used: Callable[[_Use], bool]
    buffers: Mapping[str, str] = field(default_factory=dict)
    """Buffers that exist for the feature, by the names of the kernel arguments, with a description of their sizes.
    Several features may share a buffer."""


def _records(dtype: np.dtype, item: str) -> str:
    return f"{dtype.itemsize} bytes {item}"


_LIGHTS = {"lights": _records(structs.LIGHT, "a light"), "light_cdf": "8 bytes a light"}


def _bsdf_features(condition: Callable[[bsdf_kinds.BsdfKind], bool]) -> dict[str, Feature]:
    def feature(kind: bsdf_kinds.BsdfKind) -> Feature:
        bit = bsdf_bits(kind.name)
        return Feature(kind.description, lambda use: use.bsdf_bits & bit != 0, kind.buffers)

    return {feature_of(kind): feature(kind) for kind in bsdf_kinds.select(condition)}


def _light_features() -> dict[str, Feature]:
    def feature(name: str, kind: LightKind) -> Feature:
        bit = light_bits(name)
        return Feature(kind.description, lambda use: use.light_bits & bit != 0, {**_LIGHTS, **kind.buffers})

    return {kind.feature: feature(name, kind) for name, kind in LIGHT_KINDS.items()}


_AREA_LIGHTS = light_kinds.bits_where(lambda kind: kind.is_area)

FEATURES = {
    "TRIANGLES": Feature(
        "triangle meshes",
        lambda use: len(use.scene.faces) > 0,
        {
            "triangles": _records(structs.TRIANGLE, "a triangle"),
            "triangle_blocks": f"{4 * BLOCK_ROWS * BVH_WIDTH} bytes for up to {BVH_WIDTH} triangles",
            "corners": "12 bytes a corner, if all primitives are tested",
            "corner_indices": "12 bytes a triangle, if all primitives are tested",
        },
    ),
    "VERTEX_NORMALS": Feature(
        "smooth shading by vertex normals",
        lambda use: bool((use.scene.shapes["flags"] & structs.SHAPE_VERTEX_NORMALS).any()),
        {"corner_normals": "36 bytes a triangle"},
    ),
    "UVS": Feature(
        "texture coordinates",
        lambda use: reads_uvs(use.scene.bsdfs) or use.has_textured_lights or "uv" in use.needs.layers,
        {"uvs": "8 bytes a vertex", "faces": "12 bytes a triangle"},
    ),
    "TEXTURES": Feature(
        "textures", lambda use: len(use.scene.textures) > 0, {"textures": _records(textures.TEXTURE, "a texture")}
    ),
    "BITMAPS": Feature(
        "image textures",
        lambda use: use.has_texture(textures.TEXTURE_BITMAP),
        {
            "texel_bytes": "4 bytes a texel of 8-bit images",
            "texel_floats": "16 bytes a texel of other images",
            "srgb": "1,024 bytes",
        },
    ),
    "CHECKERBOARDS": Feature("checkerboards", lambda use: use.has_texture(textures.TEXTURE_CHECKERBOARD)),
    "MESH_ATTRIBUTES": Feature(
        "colours of vertices and faces",
        lambda use: use.has_texture(textures.TEXTURE_MESH_ATTRIBUTE),
        {"attributes": "12 bytes a colour"},
    ),
    "ANALYTICS": Feature(
        "analytic shapes",
        lambda use: len(use.scene.analytics) > 0,
        {"analytics": _records(structs.ANALYTIC, "a shape"), "shapes": _records(structs.SHAPE, "a shape or mesh")},
    ),
    "SPHERES": Feature("spheres", lambda use: use.has_analytic(structs.ANALYTIC_SPHERE)),
    "DISKS": Feature("disks", lambda use: use.has_analytic(structs.ANALYTIC_DISK)),
    "CYLINDERS": Feature("cylinders", lambda use: use.has_analytic(structs.ANALYTIC_CYLINDER)),
    "INSTANCES": Feature(
        "instances",
        lambda use: len(use.scene.instances) > 0,
        {"instances": _records(structs.INSTANCE, "an instance")},
    ),
    **_bsdf_features(lambda kind: kind.scatters and not kind.feature),
    "BECKMANN": Feature("Beckmann microfacet distribution", lambda use: use.has_bsdf_flag(structs.BSDF_BECKMANN)),
    "SAMPLE_ALL_NORMALS": Feature(
        "microfacets sampled without regard to their visibility",
        lambda use: use.has_bsdf_flag(structs.BSDF_SAMPLE_ALL_NORMALS),
    ),
    **_bsdf_features(lambda kind: not kind.scatters),
    "TWOSIDED": Feature("two-sided materials", lambda use: use.has_bsdf_flag(structs.BSDF_TWOSIDED)),
    "VOLPATH": Feature("media or pass-through surfaces, with the integrator volpath", lambda use: use.is_volpath),
    "MEDIA": Feature("media", lambda use: len(use.scene.media) > 0, {"media": _records(structs.MEDIUM, "a medium")}),
    "HETEROGENEOUS": Feature(
        "media that vary in space",
        lambda use: use.scene.heterogeneous is not None,
        {
            "heterogeneous_media": _records(structs.HETEROGENEOUS_MEDIUM, "a medium"),
            "grids": _records(structs.GRID, "a grid"),
            "grid_values": "4 bytes a value of a grid",
            "extinction_bounds": "8 bytes a cell of 64 values of a grid or more",
        },
    ),
    "AREA_LIGHTS": Feature("area emitters", lambda use: use.light_bits & _AREA_LIGHTS != 0, _LIGHTS),
    "TEXTURED_LIGHTS": Feature("textured area emitters", lambda use: use.has_textured_area_lights),
    **_light_features(),
    "MANY_LIGHTS": Feature("more than one light", lambda use: len(use.scene.lights) > 1),
    "LIGHT_TREE": Feature(
        "light tree: one of many lights is selected by its importance for a point",
        lambda use: use.selects_lights_by_importance and not use.uses_light_list,
        {
            "light_nodes": f"{4 * LIGHT_NODE_ROWS * BVH_WIDTH} bytes for up to {BVH_WIDTH} lights or nodes",
            "light_parents": "4 bytes a light and node",
        },
    ),
    "LIGHT_LIST": Feature(
        "light list: one of a few lights is selected by its importance for a point",
        lambda use: use.selects_lights_by_importance and use.uses_light_list,
        {"light_bounds": _records(structs.LIGHT_BOUND, "a light")},
    ),
    "NEXT_EVENT": Feature("next-event estimation", lambda use: use.samples_lights),
    "RUSSIAN_ROULETTE": Feature(
        "Russian roulette", lambda use: use.is_unlimited or use.scene.rr_depth < use.scene.max_depth
    ),
    "HIDE_EMITTERS": Feature("emitters that the camera does not see", lambda use: use.scene.hide_emitters),
    "SOBOL": Feature("well-distributed samples: the sampler sobol", lambda use: use.scene.sampler == "sobol"),
    "THIN_LENS": Feature("depth of field", lambda use: bool(use.scene.camera["kind"][0] == structs.CAMERA_THIN_LENS)),
    "ORTHOGRAPHIC": Feature(
        "orthographic camera", lambda use: bool(use.scene.camera["kind"][0] == structs.CAMERA_ORTHOGRAPHIC)
    ),
    "FILTER_TABLE": Feature(
        "pixel filter other than a box",
        lambda use: use.scene.filter != "box",
        {"inverse_cdf": f"{4 * (CELLS + 1):,} bytes"},
    ),
    "CHUNK_MEDIANS": Feature(
        "chunk medians M_x",
        lambda use: use.needs.median,
        {"medians": "4 bytes a pixel and entry of a chunk, and 4 a pixel"},
    ),
    "BATCH_MEANS": Feature(
        "chunk entries that are means of several samples",
        lambda use: use.needs.median and use.needs.batch > 1,
        {"medians": "8 bytes more a pixel"},
    ),
    "POWER_MEAN": Feature(
        "mean of a power of the samples", lambda use: use.needs.power is not None, {"powers": "8 bytes a pixel"}
    ),
    "HALF_BUFFER": Feature("mean of every second sample", lambda use: use.needs.half, {"halves": "24 bytes a pixel"}),
    "NET_MEANS": Feature(
        "means over nets, for the error of well-distributed samples",
        lambda use: use.needs.nets,
        {"net_means": "28 bytes a pixel"},
    ),
    "NEIGHBOURS": Feature(
        "mean and variance of every pixel's neighbours",
        lambda use: use.needs.neighbours is not None,
        {"neighbours": "8 bytes a pixel"},
    ),
    "LAYERS": Feature(
        "layers of what camera rays hit first",
        lambda use: bool(use.needs.layers),
        {
            "layer_sums": "8 bytes a pixel and channel",
            "layer_indices": "4 bytes a pixel and index",
            "triangle_shape": "4 bytes a triangle",
        },
    ),
    "ALBEDO_LAYER": Feature("the layer albedo", lambda use: "albedo" in use.needs.layers),
    "COUNT_TESTS": Feature("node and triangle tests, counted for measurements", lambda use: False),
}
"""All features, in the order in which they are printed. Buffers of every program belong to no feature."""


def features(scene: CompiledScene, needs: Needs = BASIC_NEEDS) -> dict[str, bool]:
    """Which features a scene uses, and a strategy that reads the statistics of `needs`."""
    use = _Use(scene, needs)
    return {name: bool(feature.is_used(use)) for name, feature in FEATURES.items()}


def statistics_features(needs: Needs) -> dict[str, bool]:
    """Which features of the stages `reduce`, `summarise` and those after it the statistics of `needs` use."""
    names = ("CHUNK_MEDIANS", "BATCH_MEANS", "POWER_MEAN", "HALF_BUFFER", "NET_MEANS", "NEIGHBOURS")
    return {name: FEATURES[name].is_used(_Use(None, needs)) for name in names}
