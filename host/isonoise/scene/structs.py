"""Records shared by host and kernels, declared once as numpy dtypes; the C declarations are generated from them.

Every member is 4 bytes wide (uint32, int32, float32 or an array of these), so that no compiler has anything to pad.
Constants that both sides name stand in `CONSTANTS` and are passed to the kernels as macros.
"""

import numpy as np

from isonoise.scene.material.bsdf_kinds import CONSTANT_COUNT, SLOT_COUNT

NONE = 0xFFFFFFFF
"""Marks 'no such index' (a shape without a light, a light without a primitive)."""

# Kinds are bits, each its own: kernels test them with `&`, which no compiler makes a jump table of. Loops with one are
# not vectorised.
ANALYTIC_SPHERE, ANALYTIC_DISK, ANALYTIC_CYLINDER = (1 << bit for bit in range(3))
CAMERA_PINHOLE, CAMERA_THIN_LENS, CAMERA_ORTHOGRAPHIC = range(3)
SHAPE_FLIP_NORMALS, SHAPE_VERTEX_NORMALS, SHAPE_UVS, SHAPE_PASS_THROUGH = 1, 2, 4, 8
TRIANGLE_REVERSED_WINDING = 16  # beside its shape's flags
(
    BSDF_TWOSIDED,
    BSDF_BECKMANN,  # microfacet distribution; else GGX
    BSDF_NONLINEAR,  # plastic: colours shift with scattering below the coat
    BSDF_SAMPLE_ALL_NORMALS,  # microfacets: not only the visible ones
    BSDF_KEEP_INVALID_NORMALS,  # bump and normal maps
    BSDF_NO_BUMP_SHADOWING,
    BSDF_NO_LIGHT_SAMPLING,  # phase function from which no lights are sampled
    BSDF_PASS_THROUGH,  # part of the light goes straight on
    BSDF_TRANSMITS,  # light from both sides counts
    BSDF_EVALUATE_BOTH,  # blend: next-event estimation evaluates both parts
) = (1 << bit for bit in range(10))
BSDF_SLOTS, BSDF_CONSTANTS = SLOT_COUNT, max(CONSTANT_COUNT, 1)

CAMERA = np.dtype(
    [
        ("to_world", "f4", 12),  # rows of the 3x4 camera-to-world matrix; +z looks ahead, +x points left
        # tangent of half the field of view of the full film, along x and y; orthographic: half its size
        ("tan_half_fov", "f4", 2),
        ("principal_point", "f4", 2),  # offset of the principal point, in fractions of the film
        ("near_clip", "f4"),  # distances along the optical axis
        ("far_clip", "f4"),
        ("film_size", "u4", 2),  # full film in pixels (width, height)
        ("crop_offset", "u4", 2),  # pixel of the full film where the image begins
        ("crop_size", "u4", 2),  # the image in pixels (width, height)
        ("filter_radius", "f4"),  # tent: radius; gaussian: truncation radius; box: half width (pixels)
        ("filter_stddev", "f4"),  # gaussian only
        ("kind", "u4"),  # CAMERA_PINHOLE, CAMERA_THIN_LENS or CAMERA_ORTHOGRAPHIC
        ("aperture_radius", "f4"),  # thin lens only
        ("focus_distance", "f4"),  # of the plane in focus, along the optical axis; thin lens only
    ]
)

SHAPE = np.dtype(
    [
        ("bsdf", "u4"),
        ("light", "u4"),  # of an analytic shape, NONE if it does not shine
        ("first_primitive", "u4"),  # triangle index, or index of the analytic primitive
        ("flags", "u4"),  # SHAPE_FLIP_NORMALS | SHAPE_VERTEX_NORMALS | SHAPE_UVS | SHAPE_PASS_THROUGH
        ("media", "u4"),  # within | without << 16, each MEDIUM_NONE if there is none; NONE if the shape separates none
    ]
)

MEDIUM_NONE = 0xFFFF
"""Marks 'no medium' in the 16 bits that an index has."""

TRIANGLE = np.dtype(
    [
        ("corner", "f4", 3),  # the first one
        ("bsdf", "u4"),  # index
        ("edge1", "f4", 3),  # from the first corner to the second
        ("light", "u4"),  # NONE if it does not shine
        ("edge2", "f4", 3),  # to the third
        ("flags", "u4"),  # of the shape, TRIANGLE_REVERSED_WINDING
        ("normal", "f4", 3),  # unit geometric normal; zero if the triangle has no area
        ("media", "u4"),  # of the shape
    ]
)
"""What shading reads of a triangle, in one cache line."""

ANALYTIC = np.dtype(
    [
        ("kind", "u4"),
        ("shape", "u4"),
        ("center", "f4", 3),  # sphere
        ("radius", "f4"),  # sphere
        ("to_world", "f4", 12),  # disk (unit disk in z = 0), cylinder (x^2 + y^2 = 1, 0 <= z <= 1): rows of 3x4
        ("to_object", "f4", 12),  # its inverse
    ]
)

INSTANCE = np.dtype(
    [
        ("to_world", "f4", 12),  # from the group's space: rows of 3x4
        ("to_object", "f4", 12),  # its inverse
        ("root", "u4"),  # the BVH node where the group begins: 1 + its number
    ]
)
"""A group of shapes, compiled once in a space of its own, at one of its places."""

BSDF = np.dtype(
    [
        ("kind", "u4"),
        ("flags", "u4"),  # BSDF_TWOSIDED ... BSDF_TRANSMITS
        ("nested", "u4", 2),  # BSDFs of a wrapper: front, back; of weight 0, 1; else the first
        ("values", "f4", 3 * BSDF_SLOTS),  # a colour a slot; a number in all three channels
        ("constants", "f4", BSDF_CONSTANTS),  # computed by the host
        ("textures", "u4", BSDF_SLOTS),  # that replace the values; NONE
        ("number_slots", "u4"),  # bits of the slots whose texture is read as a number
    ]
)

MEDIUM = np.dtype(
    [
        ("sigma_t", "f4", 3),  # extinction coefficient, per unit of length
        ("albedo", "f4", 3),  # share of it that is scattered
        ("phase", "u4"),  # index of the phase function among the materials
    ]
)

HETEROGENEOUS_MEDIUM = np.dtype(
    [
        ("sigma_t", "u4"),  # index of a grid, which the extinction coefficient of the medium multiplies; NONE: uniform
        ("albedo", "u4"),  # index of a grid, which the albedo of the medium multiplies; NONE
        ("lower", "f4", 3),  # world box outside of which there is no medium
        ("upper", "f4", 3),
        ("to_cells", "f4", 12),  # from the world to cells of extinction bounds: rows of 3x4
        ("cells", "u4", 3),  # along x, y, z
        ("first_cell", "u4"),  # index of its bounds
    ]
)
"""What a heterogeneous medium has beside its MEDIUM; there is one for each medium, homogeneous ones too."""

GRID = np.dtype(
    [
        ("to_local", "f4", 12),  # from the world to the unit cube: rows of 3x4
        ("size", "u4", 3),  # values along x, y, z
        ("channels", "u4"),  # 1 or 3
        ("first", "u4"),  # index of its first value
        ("flags", "u4"),  # TEXTURE_NEAREST | TEXTURE_MIRROR | TEXTURE_CLAMP (neither of the last two: repeat)
    ]
)

PROJECTION = np.dtype([("to_uv", "f4", 9)])
"""Rows of the 3x3 matrix from a vector that starts at a light to (w u, w v, w), where u, v are texture coordinates."""

LIGHT = np.dtype(
    [
        ("kind", "u4"),
        # triangle or analytic index, the first of two triangles; of a projected texture its PROJECTION; else NONE
        ("primitive", "u4"),
        ("power_pmf", "f4"),  # probability of this light where lights are selected by power
        ("area", "f4"),  # world area, 0 for lights without surface
        # radiance; point, spot: radiant intensity; directional: irradiance. All times radiance_scale
        ("radiance", "f4", 3),
        ("texture", "u4"),  # that the radiance is to be multiplied by, NONE
        ("position", "f4", 3),  # point, spot, projector: position; directional: direction of travel (unit)
        ("axis", "f4", 3),  # spot, projector: unit direction of the brightest light
        ("cutoff", "f4"),  # spot, projector: angle from which on it is dark
        ("inverse_transition", "f4"),  # spot: 1 / (cutoff - angle up to which it is brightest)
        # parallelogram: corner of the first triangle that is not on the diagonal, plus 4 times that of the second
        ("apexes", "u4"),
    ]
)

LIGHT_BOUND = np.dtype(
    [
        ("center", "f4", 3),  # of the sphere that it stands in
        ("radius", "f4"),
        ("axis", "f4", 3),  # of the cone of its normals
        ("cos_spread", "f4"),  # of half the cone's angle
        ("sin_spread", "f4"),
        ("cos_edge", "f4"),  # of the angle to a normal up to which light leaves
        ("power_fraction", "f4"),  # of the power of all lights; 0 for a light without power
        ("intensity", "f4"),  # power_fraction times the square of a length, the same for all
        ("max_irradiance", "f4"),  # the intensity over the square of the minimum distance
    ]
)
"""What is known of where a light is, where it shines and how much."""

CONSTANTS = {
    name: value
    for name, value in list(globals().items())
    if isinstance(value, int)
    and name.split("_")[0] in ("NONE", "LANE", "CAMERA", "ANALYTIC", "BSDF", "LIGHT", "SHAPE", "TRIANGLE", "MEDIUM")
}
