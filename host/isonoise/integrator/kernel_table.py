"""The kernels that trace paths: their files, their arguments, and the buffers that hold paths."""

from collections.abc import Mapping

from isonoise.scene import structs
from isonoise.scene.light import envmap
from isonoise.scene.material import textures

STRUCTS = {
    "Camera": structs.CAMERA,
    "Shape": structs.SHAPE,
    "Analytic": structs.ANALYTIC,
    "Instance": structs.INSTANCE,
    "Bsdf": structs.BSDF,
    "Texture": textures.TEXTURE,
    "Environment": envmap.ENVIRONMENT,
    "Light": structs.LIGHT,
    "Alias": structs.ALIAS,
    "LightBound": structs.LIGHT_BOUND,
    "Medium": structs.MEDIUM,
}

# Kernel -> file and arguments, by the names in `Stages.arguments` or given at the launch.
KERNELS = {
    "list_samples": ("stages/pixel_stages.cl", "first_pixel pixels slice_samples pixel_offset sample_pixel"),
    "generate": (
        "stages/generate.cl",
        "count_new plane_stride first_slot first_sample seed camera inverse_cdf inverse_cdf_cells sample_pixel "
        "pixel_offset count rejected ray_origin ray_direction throughput path samples INSTANCES:instance "
        "VOLPATH:crossing MEDIA:medium MEDIA:sensor_medium LIGHT_TREE:mis_normal LIGHT_LIST:mis_normal",
    ),
    "intersect": (
        "stages/intersect.cl",
        "path_count plane_stride rays_per_item nodes blocks first_analytic analytics ray_origin ray_direction path hit "
        "INSTANCES:instances INSTANCES:first_instance INSTANCES:instance COUNT_TESTS:tests",
    ),
    "shade": (
        "stages/shade.cl",
        "path_count plane_stride sample_pixel seed max_depth rr_depth triangles faces corner_normals UVS:uvs "
        "TEXTURES:textures TEXTURES:texel_bytes TEXTURES:texel_floats TEXTURES:srgb TEXTURES:attributes "
        "TEXTURES:textured_slots analytics shapes bsdfs ROUGH_PLASTIC:rough_transmittances "
        "lights light_alias light_count ENVIRONMENT_MAP:environment ENVIRONMENT_MAP:environment_texels "
        "ENVIRONMENT_MAP:environment_rows ENVIRONMENT_MAP:environment_aliases environment_light "
        "hit ray_origin ray_direction throughput path shadow_origin "
        "shadow_direction shadow_radiance samples alive INSTANCES:instances INSTANCES:world_triangles "
        "INSTANCES:instance "
        "VOLPATH:crossing MEDIA:media MEDIA:medium "
        "LIGHT_TREE:light_nodes LIGHT_TREE:light_parents LIGHT_LIST:light_bounds LIGHT_TREE:mis_normal "
        "LIGHT_LIST:mis_normal",
    ),
    "shadow": (
        "stages/shadow.cl",
        "path_count plane_stride rays_per_item nodes blocks first_analytic analytics shadow_origin shadow_direction "
        "shadow_radiance hit path samples INSTANCES:instances INSTANCES:first_instance INSTANCES:instance",
    ),
    "shadow_transmittance": (
        "stages/shadow_transmittance.cl",
        "path_count plane_stride nodes blocks first_analytic triangles faces corner_normals UVS:uvs "
        "TEXTURES:textures TEXTURES:texel_bytes TEXTURES:texel_floats TEXTURES:srgb TEXTURES:attributes analytics "
        "shapes bsdfs shadow_origin shadow_direction shadow_radiance hit path samples MEDIA:media MEDIA:scene_sphere "
        "INSTANCES:instances INSTANCES:first_instance INSTANCES:instance",
    ),
    "count_alive": ("stages/compact.cl", "alive path_count block_alive"),
    "scan_blocks": ("stages/compact.cl", "block_alive blocks_in_use total_alive"),
    "move_paths": (
        "stages/compact.cl",
        "alive path_count plane_stride block_alive ray_origin ray_direction throughput path "
        "next_ray_origin next_ray_direction next_throughput next_path INSTANCES:instance INSTANCES:next_instance "
        "VOLPATH:crossing VOLPATH:next_crossing MEDIA:medium MEDIA:next_medium "
        "LIGHT_TREE:mis_normal LIGHT_LIST:mis_normal LIGHT_TREE:next_mis_normal LIGHT_LIST:next_mis_normal",
    ),
    "reduce": (
        "stages/pixel_stages.cl",
        "samples first_pixel pixels slice_samples pixel_offset total_pixels count rejected sums block_sums "
        "CHUNK_MEDIANS:medians POWER_MEAN:powers POWER_MEAN:power HALF_BUFFER:halves",
    ),
    "summarise": (
        "stages/pixel_stages.cl",
        "first_pixel pixels stride total_pixels count sums block_sums summary "
        "CHUNK_MEDIANS:medians POWER_MEAN:powers HALF_BUFFER:halves",
    ),
}

BRUTE_FORCE_KERNELS = {
    "intersect": (
        "stages/intersect_brute_force.cl",
        "path_count plane_stride corners corner_count corner_indices triangle_count analytics analytic_count "
        "ray_origin ray_direction path hit",
    ),
    "shadow": (
        "stages/shadow_brute_force.cl",
        "path_count plane_stride corners corner_count corner_indices triangle_count analytics analytic_count "
        "shadow_origin shadow_direction shadow_radiance hit path samples",
    ),
}
"""What takes the place of their rows of `KERNELS` where there are so few primitives that no hierarchy is needed."""

ONE_PROGRAM = (
    "stages/generate.cl",
    "stages/compact.cl",
    "stages/intersect.cl",
    "stages/intersect_brute_force.cl",
    "stages/shadow.cl",
    "stages/shadow_brute_force.cl",
)
"""Files that are built together, as far as they are needed: what a scene's shapes change, and its materials don't.

Compilers start slowly: PoCL takes 0.2 s more for each program, and 0.04 s where it has compiled it before.
"""

TAKE_LANES = {"generate", "shade"}
"""Kernels of which a work-item takes several paths: kernels/path/path_state.h."""

TAKE_MANY = {"intersect", "shadow", "count_alive", "move_paths"}
"""Kernels of which a work-item of a CPU takes several rays, one after the other, or a block of paths."""

PATH_STATE = {
    **{"ray_origin": 16, "ray_direction": 16, "throughput": 16, "path": 16},
    **{"INSTANCES:instance": 4, "VOLPATH:crossing": 8, "MEDIA:medium": 4},
    **{"LIGHT_TREE:mis_normal": 16, "LIGHT_LIST:mis_normal": 16},
}
"""Buffers that hold a path between bounces, with their bytes; each has a second one, `next_...`, to move to."""

PATH_BUFFERS = {
    "hit": {"": 16},
    "alive": {"": 4},
    "tests": {"COUNT_TESTS": 8},
    "shadow_origin": {"NEXT_EVENT": 16},
    "shadow_direction": {"NEXT_EVENT": 16},
    "shadow_radiance": {"NEXT_EVENT": 12, "NEXT_EVENT MEDIA": 4},
}
"""Buffers of the paths within a bounce: bytes, by the features that all have to be on for them."""


def kernel_table(features: Mapping[str, bool], few: bool) -> dict[str, tuple[str, str]]:
    """The kernels that a scene needs; `few`: whether it has so few primitives that there is no hierarchy."""
    shadow = ("shadow_transmittance" if features["VOLPATH"] else "shadow") if features["NEXT_EVENT"] else None
    table = KERNELS | (BRUTE_FORCE_KERNELS if few else {})
    return {
        name: row for name, row in table.items() if name == shadow or name not in ("shadow", "shadow_transmittance")
    }


def path_bytes(features: Mapping[str, bool]) -> dict[str, int]:
    """Bytes a path of every buffer that holds paths."""
    sizes = {name: size for state, size in present(PATH_STATE, features).items() for name in (state, f"next_{state}")}
    for name, parts in PATH_BUFFERS.items():
        size = sum(part for needed, part in parts.items() if all(features[feature] for feature in needed.split()))
        sizes |= {name: size} if size else {}
    return sizes


def present(named: Mapping[str, object], features: Mapping[str, bool]) -> dict[str, object]:
    """What goes by `name`, or by `NAME:name` with the feature NAME on; the names without their features."""
    parted = [(key.rpartition(":"), value) for key, value in named.items()]
    return {name: value for (feature, _, name), value in parted if not feature or features[feature]}
