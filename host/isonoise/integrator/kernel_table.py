"""The kernels and the path state, each declared once.

From these tables come the kernels' parameter lists and the code that unpacks them (`generated_headers`), the buffers
(`wavefront`) and what a feature costs (`feature_costs`).
"""

from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np

from isonoise.scene import structs
from isonoise.scene.light import envmap, light_tree
from isonoise.scene.light.light_kinds import light_macros, select
from isonoise.scene.material import bsdf_kinds, textures

STRUCTS = {
    "Camera": structs.CAMERA,
    "Triangle": structs.TRIANGLE,
    "Shape": structs.SHAPE,
    "Analytic": structs.ANALYTIC,
    "Instance": structs.INSTANCE,
    "Bsdf": structs.BSDF,
    "Texture": textures.TEXTURE,
    "Environment": envmap.ENVIRONMENT,
    "Light": structs.LIGHT,
    "Projection": structs.PROJECTION,
    "LightBound": structs.LIGHT_BOUND,
    "Medium": structs.MEDIUM,
    "HeterogeneousMedium": structs.HETEROGENEOUS_MEDIUM,
    "Grid": structs.GRID,
}

CONSTANTS: dict[str, int | str] = {
    **structs.CONSTANTS,
    **textures.CONSTANTS,
    **bsdf_kinds.bsdf_macros(),
    **light_macros(),
    **light_tree.CONSTANTS,
}
"""Macros of the kernels that no scene changes."""


class PathField(NamedTuple):
    """A buffer of path state: it is kept between bounces and moved when the paths are compacted.

    The buffer exists if any of `features` is on, or always if there are none. `planes` is the number of 4-byte members,
    each stored as a plane of its own.
    """

    element: str  # C type of a member: 'float' or 'uint'
    planes: int
    features: tuple[str, ...] = ()
    initial: str = ""  # C expression that `generate` stores; empty if it computes the field itself
    default: str = ""  # value of the `Path` member where the feature is off; empty if `Path` has no such member


PATH_STATE = {
    "ray_origin": PathField("float", 4),  # x, y, z, t_max
    "ray_direction": PathField("float", 4),  # x, y, z, pdf of the direction
    "throughput": PathField("float", 4),  # red, green, blue, eta
    "path_ids": PathField("uint", 4),  # PATH_SAMPLE, PATH_START_PRIMITIVE, PATH_SAMPLE_INDEX, PATH_DEPTH
    "instance": PathField("uint", 1, ("INSTANCES",), initial="NONE"),
    "null_bounces": PathField("uint", 1, ("VOLPATH",), initial="0u", default="0u"),
    "mis_distance": PathField("float", 1, ("VOLPATH",), initial="0.0f", default="0.0f"),
    "medium": PathField("uint", 1, ("MEDIA",), initial="sensor_medium", default="0u"),
    "mis_normal": PathField(
        "float",
        4,
        ("LIGHT_TREE", "LIGHT_LIST"),
        initial="vec4(0.0f, 0.0f, 0.0f, 0.0f)",
        default="vec4(0.0f, 0.0f, 0.0f, 0.0f)",
    ),
}
"""State of a path between bounces."""

BOUNCE_BUFFERS = {
    "hit": {"": 16},
    "alive": {"": 4},
    "holes": {"": 4},
    "tests": {"COUNT_TESTS": 8},
    "shadow_origin": {"NEXT_EVENT": 16},
    "shadow_direction": {"NEXT_EVENT": 16},
    "shadow_radiance": {"NEXT_EVENT": 12, "NEXT_EVENT MEDIA": 4},
    "shadow_stream": {"NEXT_EVENT HETEROGENEOUS": 8},
}
"""Buffers of the paths within a bounce: bytes a path, by the features that all have to be on for them."""

NO_WORK = dict.fromkeys(
    (
        *("pixels", "total_pixels", "tile_count", "error_groups", "first_pixel"),
        *("path_count", "count_new", "path_block_count", "rays_per_item", "first_slot"),
        *("slice_samples", "first_sample", "first_layer_pixel", "layer_pixels"),
    ),
    np.uint32(0),
)
"""Values with which every kernel returns without work."""

VALUE_TYPES = {
    "seed": "uint2",
    "scene_sphere": "float4",
    **dict.fromkeys(("power", "error_floor", "inverse_unit"), "float"),
}
"""C types of the arguments that are passed by value, where that is not `uint`."""

ELEMENT_TYPES = {
    **dict.fromkeys(("nodes", "triangle_blocks", "light_nodes"), "float8"),
    **dict.fromkeys(("faces", "corner_indices", "light_parents", "environment_guide"), "uint"),
    **dict.fromkeys(("sample_pixel", "sample_index", "pixel_list", "pixel_offset"), "uint"),
    **dict.fromkeys(("triangle_shape", "layer_indices"), "uint"),
    **dict.fromkeys(("count", "rejected", "error_bins"), "uint"),
    **dict.fromkeys(("alive", "path_block_alive", "total_alive", "holes"), "uint"),
    "tests": "uint2",
    "texel_bytes": "uchar",
    "camera": "Camera",
    "triangles": "Triangle",
    "analytics": "Analytic",
    "shapes": "Shape",
    "instances": "Instance",
    "bsdfs": "Bsdf",
    "textures": "Texture",
    "lights": "Light",
    "projections": "Projection",
    "light_bounds": "LightBound",
    "environment": "Environment",
    "media": "Medium",
    "heterogeneous_media": "HeterogeneousMedium",
    "grids": "Grid",
    "shadow_stream": "uint",
}
"""C types of the elements of a buffer, where that is not `float`; those of the path state are in `PATH_STATE`."""

_TEXTURES = "textures texel_bytes texel_floats srgb attributes"
_ENVMAP = "environment environment_texels environment_rows environment_guide"
_MEDIA = "media heterogeneous_media grids grid_values extinction_bounds"
_LIGHT_TABLES = "light_nodes light_parents light_bounds projections"
ARGUMENT_FEATURES = {
    "uvs": ("UVS",),
    **dict.fromkeys((*_TEXTURES.split(), "textured_slots"), ("TEXTURES",)),
    "rough_transmittances": tuple(
        bsdf_kinds.feature_of(kind) for kind in bsdf_kinds.select(lambda kind: "ROUGH_TRANSMITTANCE" in kind.helpers)
    ),
    **dict.fromkeys(_ENVMAP.split(), ("ENVIRONMENT_MAP",)),
    "projections": tuple(kind.feature for kind in select(lambda kind: kind.project is not None)),
    **dict.fromkeys(("instances", "first_instance", "world_triangle_count"), ("INSTANCES",)),
    **dict.fromkeys(("media", "sensor_medium", "scene_sphere"), ("MEDIA",)),
    **dict.fromkeys((*_MEDIA.split()[1:], "shadow_stream"), ("HETEROGENEOUS",)),
    **dict.fromkeys(("light_nodes", "light_parents"), ("LIGHT_TREE",)),
    "light_bounds": ("LIGHT_LIST",),
    "tests": ("COUNT_TESTS",),
    "medians": ("CHUNK_MEDIANS",),
    **dict.fromkeys(("powers", "power"), ("POWER_MEAN",)),
    "halves": ("HALF_BUFFER",),
    **dict.fromkeys(("net_means", "net_ratios"), ("NET_MEANS",)),
    **dict.fromkeys(("neighbours", "neighbour_radius"), ("NEIGHBOURS",)),
    **{name: field.features for name, field in PATH_STATE.items()},
}
"""Features of which one has to be on for an argument to be there. All other arguments are always there."""


def _names(arguments: str) -> tuple[str, ...]:
    """Argument names; PATH_STATE stands for all buffers of the path state."""
    return tuple(name for word in arguments.split() for name in (PATH_STATE if word == "PATH_STATE" else [word]))


class Kernel(NamedTuple):
    """A kernel: its file, the values that are passed to it, the buffers it reads and those it writes.

    It is launched if all features of `needs` are on and those of `excludes` are off.
    """

    file: str
    values: tuple[str, ...]
    reads: tuple[str, ...]
    writes: tuple[str, ...]
    needs: tuple[str, ...] = ()
    excludes: tuple[str, ...] = ()

    @property
    def arguments(self) -> tuple[str, ...]:
        """All arguments in the order of the C parameters, whatever the features."""
        return (*self.values, *self.reads, *self.writes)

    def arguments_for(self, features: Mapping[str, bool]) -> tuple[str, ...]:
        """The arguments that are there with these features."""
        return tuple(name for name in self.arguments if is_present(name, features))

    def is_launched(self, features: Mapping[str, bool]) -> bool:
        """Whether a scene with these features needs the kernel."""
        return all(features[name] for name in self.needs) and not any(features[name] for name in self.excludes)


def _kernel(file: str, values: str, reads: str, writes: str, needs: str = "", excludes: str = "") -> Kernel:
    groups = [_names(names) for names in (values, reads, writes)]
    return Kernel(f"stages/{file}", *groups, tuple(needs.split()), tuple(excludes.split()))


def is_present(argument: str, features: Mapping[str, bool]) -> bool:
    """Whether an argument, or a buffer of the path state, is there with these features."""
    needed = ARGUMENT_FEATURES.get(argument, ())
    return not needed or any(features[name] for name in needed)


_SURFACES = f"triangles faces corner_normals uvs {_TEXTURES} analytics shapes bsdfs instances"
_SHADOW_RAY = "shadow_origin shadow_direction shadow_radiance hit path_ids"
_BRUTE_FORCE = "corners corner_indices analytics"
_GRID = "image_width tile_count total_pixels"
_COUNTS = "corner_count triangle_count analytic_count"

KERNELS = {
    "list_samples": _kernel(
        "list_samples.cl",
        "first_pixel pixels slice_samples crop_width film_width film_offset",
        "pixel_offset pixel_list count rejected",
        "sample_pixel sample_index",
    ),
    "generate": _kernel(
        "generate.cl",
        "count_new plane_stride first_slot first_sample inverse_cdf_cells seed sensor_medium",
        "camera inverse_cdf sample_pixel sample_index",
        "PATH_STATE samples",
    ),
    "intersect": _kernel(
        "intersect.cl",
        "path_count plane_stride rays_per_item first_analytic first_instance",
        "nodes triangle_blocks analytics instances ray_origin ray_direction path_ids",
        "hit instance tests",
    ),
    "shade": _kernel(
        "shade.cl",
        "path_count plane_stride max_depth rr_depth light_count environment_light seed textured_slots "
        "world_triangle_count",
        f"sample_pixel {_SURFACES} rough_transmittances lights light_cdf {_ENVMAP} {_LIGHT_TABLES} {_MEDIA}",
        "PATH_STATE hit shadow_origin shadow_direction shadow_radiance shadow_stream samples alive",
    ),
    "shadow": _kernel(
        "shadow.cl",
        "path_count plane_stride rays_per_item first_analytic first_instance",
        f"nodes triangle_blocks analytics instances instance {_SHADOW_RAY}",
        "samples",
        needs="NEXT_EVENT",
        excludes="VOLPATH",
    ),
    "shadow_transmittance": _kernel(
        "shadow_transmittance.cl",
        "path_count plane_stride first_analytic first_instance scene_sphere",
        f"nodes triangle_blocks {_SURFACES} {_MEDIA} instance {_SHADOW_RAY} shadow_stream",
        "samples",
        needs="NEXT_EVENT VOLPATH",
    ),
    "count_alive": _kernel("compact.cl", "path_count", "alive", "path_block_alive"),
    "scan_blocks": _kernel("compact.cl", "path_block_count", "alive", "path_block_alive total_alive"),
    "list_holes": _kernel("compact.cl", "path_count", "alive path_block_alive total_alive", "holes"),
    "accumulate_layers": _kernel(
        "accumulate_layers.cl",
        "plane_stride first_slot first_sample count_new first_pixel pixels first_layer_pixel layer_pixels total_pixels "
        "seed textured_slots world_triangle_count",
        f"sample_pixel pixel_offset camera {_SURFACES} rough_transmittances media triangle_shape",
        "PATH_STATE hit layer_sums layer_indices",  # the first two are only read: `PathBuffers` has no const pointers
        needs="LAYERS",
    ),
    "fill_holes": _kernel(
        "compact.cl", "path_count plane_stride", "alive path_block_alive total_alive holes", "PATH_STATE"
    ),
    "reduce": _kernel(
        "reduce.cl",
        "first_pixel pixels slice_samples total_pixels power",
        "samples pixel_offset",
        "count rejected sums sample_block_sums medians powers halves net_means",
    ),
    "summarise": _kernel(
        "summarise.cl",
        "first_pixel pixels stride total_pixels",
        "count sums sample_block_sums medians powers halves net_means",
        "summary luminance net_ratios",
    ),
    "summarise_rgb": _kernel("summarise.cl", "first_pixel pixels stride total_pixels", "count sums", "summary"),
    "sum_tiles": _kernel("design_effect.cl", _GRID, "count luminance net_ratios", "grid", needs="NET_MEANS"),
    "fit_steps": _kernel("design_effect.cl", _GRID, "grid", "steps", needs="NET_MEANS"),
    "compute_design_effect": _kernel(
        "design_effect.cl", _GRID, "count steps", "design_effect luminance", needs="NET_MEANS"
    ),
    "average_neighbours": _kernel(
        "neighbours.cl",
        "image_width total_pixels neighbour_radius",
        "count luminance",
        "neighbours",
        needs="NEIGHBOURS",
    ),
    "relative_errors": _kernel(
        "relative_errors.cl",
        "image_width total_pixels error_groups error_floor inverse_unit",
        "count luminance",
        "error_scratch error_bins",
    ),
}

BRUTE_FORCE_KERNELS = {
    "intersect": _kernel(
        "intersect_brute_force.cl",
        f"path_count plane_stride {_COUNTS}",
        f"{_BRUTE_FORCE} ray_origin ray_direction path_ids",
        "hit",
    ),
    "shadow": _kernel(
        "shadow_brute_force.cl",
        f"path_count plane_stride {_COUNTS}",
        f"{_BRUTE_FORCE} {_SHADOW_RAY}",
        "samples",
        needs="NEXT_EVENT",
        excludes="VOLPATH",
    ),
}
"""Kernels that replace those of the same name if rays are tested against all primitives, without the BVH."""

PROGRAMS = (
    ("list_samples.cl", "reduce.cl", "summarise.cl", "design_effect.cl", "neighbours.cl", "relative_errors.cl"),
    ("generate.cl", "compact.cl", "intersect.cl", "intersect_brute_force.cl", "shadow.cl", "shadow_brute_force.cl"),
)
"""Files that are built as one program. Every other file is a program of its own.

A compiler takes time to start: PoCL takes 0.2 s more for each program, and 0.04 s if it has compiled it before. Files
stand together if the same changes of a scene rebuild them: the statistics; the shapes.
"""

LANE_KERNELS = {"generate", "shade"}
"""Kernels of which a work-item processes LANES paths: kernels/path/path_state.h."""

COMPACTION_KERNELS = {"count_alive", "scan_blocks", "list_holes", "fill_holes"}
"""Kernels of which a work-group shares a path block, on GPUs: kernels/stages/compact.cl."""

SEQUENTIAL_KERNELS = {"intersect", "shadow", "count_alive", "list_holes", "fill_holes"}
"""Kernels of which a work-item of a CPU processes several rays, or a run of paths, one after the other."""

IMAGE_KERNELS = {
    *("summarise", "summarise_rgb", "sum_tiles", "fit_steps", "compute_design_effect", "average_neighbours"),
    "relative_errors",
}
"""Kernels that need the statistics of a whole image."""


def kernel_table(features: Mapping[str, bool], brute_force: bool) -> dict[str, Kernel]:
    """The kernels that a scene needs; `brute_force`: whether rays are tested against all primitives."""
    table = KERNELS | (BRUTE_FORCE_KERNELS if brute_force else {})
    return {name: kernel for name, kernel in table.items() if kernel.is_launched(features)}


def programs(files: Iterable[str]) -> list[list[str]]:
    """The files, grouped into the programs that they are built as."""
    files = list(dict.fromkeys(files))
    groups = [[f"stages/{name}" for name in group if f"stages/{name}" in files] for group in PROGRAMS]
    grouped = {file for group in groups for file in group}
    return [group for group in groups if group] + [[file] for file in files if file not in grouped]


def path_bytes(features: Mapping[str, bool]) -> dict[str, int]:
    """Bytes a path of every buffer that holds paths."""
    sizes = {name: 4 * field.planes for name, field in PATH_STATE.items() if is_present(name, features)}
    for name, parts in BOUNCE_BUFFERS.items():
        size = sum(part for needed, part in parts.items() if all(features[feature] for feature in needed.split()))
        sizes |= {name: size} if size else {}
    return sizes
