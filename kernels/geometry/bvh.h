// Ray intersection of a node and of a block of 8 triangles of the 8-wide BVH. Called by geometry/traverse.h and the
// stages that trace rays. host/isonoise/scene/accel/bvh.py documents the layout of nodes and blocks.
#pragma once
#include "geometry/instance.h"
#include "util/math.h"

#define NODE_ROWS 7u  // float8: lower x, y, z and upper x, y, z of the 8 children, then their references

// Children of a node, or triangles of a block, are tested BVH_LANES at a time: 8, or 4 on a GPU, where a vector takes a
// register for each of its numbers. The 8 numbers of a row are BVH_PARTS such vectors.
#define BVH_PARTS (8u / BVH_LANES)
#if BVH_LANES == 8
typedef float8 FloatLanes;
#define AS_UINT_LANES as_uint8
#define MAD_LANES MAD8
#define LANE_BITS mask_bits
#else
typedef float4 FloatLanes;
#define AS_UINT_LANES as_uint4
#define MAD_LANES MAD4
#define LANE_BITS mask_bits4
#endif

typedef union {
    FloatLanes part[BVH_PARTS];
    float lane[8];
} ChildDistances;

// Traversal is not vectorised across rays, so it uses OpenCL vectors. They have 4 components, all initialised.
INLINE float4 to_float4(Vec3 v)
{
    return (float4)(v.x, v.y, v.z, 0.0f);
}

#if FEATURE_ANALYTICS || FEATURE_INSTANCES
INLINE Vec3 from_float4(float4 v)
{
    return vec3(v.x, v.y, v.z);
}
#endif

INLINE float4 abs_float4(float4 v)
{
    return as_float4(as_uint4(v) & 0x7FFFFFFFu);
}

INLINE float4 copy_sign_float4(float4 magnitude, float4 sign)
{
    return as_float4(as_uint4(magnitude) | (as_uint4(sign) & 0x80000000u));
}

typedef struct {
    float4 origin, direction;
    // Distance along the ray to a plane of a box: plane * scale + shift. The constants move near planes closer and far
    // planes farther by more than the sum of all rounding errors, so no child is ever missed.
    float4 near_scale, near_shift, far_scale, far_shift;
    int4 near_row;           // rows from a node's lower planes to its near planes: 3 for negative directions, else 0
    int4 axis;               // x, y, z permuted so that |direction| is largest along the last
    float4 shear;            // Woop's shear constants for the permuted axes
    float4 permuted_origin;  // origin along the permuted axes
} Ray;

INLINE Ray make_ray(float4 origin, float4 direction)
{
    Ray ray;
    ray.origin = origin;
    ray.direction = direction;
    const float4 magnitude = abs_float4(direction);
    // A zero component is replaced by one so small that it does not move the ray; this keeps the shifts finite.
    const float4 min_magnitude = 1e-37f * (1.0f + abs_float4(origin));
    const float4 inverse = 1.0f / (magnitude < min_magnitude ? copy_sign_float4(min_magnitude, direction) : direction);
    // Every operation rounds by up to 2^-24 of its result. The rounding errors of a shift, at most 5, do not shrink
    // when the shift cancels against a plane: they are subtracted from near and added to far. The other errors scale
    // the far side: Ize, "Robust BVH Ray Traversal", JCGT 2013.
    const float4 shift = -origin * inverse, rounding = 0x1.8p-22f * abs_float4(shift);
    ray.near_scale = inverse;
    ray.near_shift = shift - rounding;
    ray.far_scale = inverse * 1.0000008f;
    ray.far_shift = shift * 1.0000008f + rounding;
    ray.near_row = inverse < 0.0f ? (int4)(3) : (int4)(0);
    const int kz =
        magnitude.x > magnitude.y ? (magnitude.x > magnitude.z ? 0 : 2) : (magnitude.y > magnitude.z ? 1 : 2);
    const int kx = kz == 2 ? 0 : kz + 1, ky = 3 - kz - kx;
    Float4Lanes d, o;  // indexed in memory: selecting one of three components takes five instructions
    d.vector = direction;
    o.vector = origin;
    // swapping the first two axes keeps the orientation of triangles for negative directions
    const bool is_swapped = d.lane[kz] < 0.0f;
    ray.axis = (int4)(is_swapped ? ky : kx, is_swapped ? kx : ky, kz, 0);
    const float scale = 1.0f / d.lane[kz];
    ray.shear = (float4)(d.lane[ray.axis.x] * scale, d.lane[ray.axis.y] * scale, scale, 0.0f);
    ray.permuted_origin = (float4)(o.lane[ray.axis.x], o.lane[ray.axis.y], o.lane[kz], 0.0f);
    return ray;
}

#if FEATURE_INSTANCES
// The same, in an instance's object space, for a ray given in world space.
INLINE Ray make_object_ray(__global const Instance* instance, float4 origin, float4 direction)
{
    Vec3 o = from_float4(origin), d = from_float4(direction);
    ray_to_object(instance, &o, &d);
    return make_ray(to_float4(o), to_float4(d));
}
#endif

// Bit mask of the children in part `part` of a node whose boxes the ray enters before t_max; `entry` receives the entry
// distances.
INLINE uint intersect_children(__global const float8* node, uint part, const Ray* ray, float t_max, FloatLanes* entry)
{
    __global const FloatLanes* rows = (__global const FloatLanes*)node + part;
    const int stride = (int)BVH_PARTS;
    const int4 row = ray->near_row * stride;
    const float4 near = ray->near_scale, near_shift = ray->near_shift, far = ray->far_scale, far_shift = ray->far_shift;
    __global const FloatLanes *near_row_x = rows + row.x, *near_row_y = rows + row.y + stride;
    __global const FloatLanes *near_row_z = rows + row.z + 2 * stride, *far_row_x = rows - row.x + 3 * stride;
    __global const FloatLanes *far_row_y = rows - row.y + 4 * stride, *far_row_z = rows - row.z + 5 * stride;
    const FloatLanes near_x = MAD_LANES(*near_row_x, near.x, near_shift.x);
    const FloatLanes far_x = MAD_LANES(*far_row_x, far.x, far_shift.x);
    const FloatLanes near_y = MAD_LANES(*near_row_y, near.y, near_shift.y);
    const FloatLanes far_y = MAD_LANES(*far_row_y, far.y, far_shift.y);
    const FloatLanes near_z = MAD_LANES(*near_row_z, near.z, near_shift.z);
    const FloatLanes far_z = MAD_LANES(*far_row_z, far.z, far_shift.z);
    const FloatLanes near_yz = MAX(near_y, near_z), near_x0 = MAX(near_x, (FloatLanes)(0.0f));
    const FloatLanes far_yz = MIN(far_y, far_z), far_xt = MIN(far_x, (FloatLanes)(t_max));
    *entry = MAX(near_yz, near_x0);
    return LANE_BITS(*entry <= MIN(far_yz, far_xt));
}

// The same for all children.
INLINE uint intersect_node(__global const float8* node, const Ray* ray, float t_max, ChildDistances* entry)
{
    uint hits = 0u;
    NO_UNROLL
    for (uint part = 0u; part < BVH_PARTS; ++part)
        hits |= intersect_children(node, part, ray, t_max, entry->part + part) << part * BVH_LANES;
    return hits;
}

#if FEATURE_TRIANGLES
#if BVH_LANES == 8
typedef int8 IntLanes;
typedef uint8 UintLanes;
#else
typedef int4 IntLanes;
typedef uint4 UintLanes;
#endif

typedef union {
    FloatLanes vector;
    float lane[BVH_LANES];
} LaneNumbers;

// Parts of a triangle block that hold triangles; they fill its vector lanes in order. Half of the blocks of a mesh of
// 82,000 triangles hold up to 4.
#if BVH_LANES == 8
#define USED_PARTS(block) BVH_PARTS
#else
#define USED_PARTS(block) (((__global const uint*)((block) + 9))[BVH_LANES] == NONE ? 1u : BVH_PARTS)
#endif

// Intersects the triangles in part `part` of a triangle block. Returns a bit mask of the hits in (0, t_max); t, u, v
// receive the distances and the barycentric coordinates of the second and third corner. Woop, Benthin, Wald,
// "Watertight Ray/Triangle Intersection", JCGT 2013, without the double-precision fallback: an edge function that
// rounds to zero counts as inside for both neighbours, so there are no leaks. Edge functions use no fma: neighbours get
// exactly opposite values on a shared edge. A ray cannot hit again the plane that it starts or ends on, but rounding
// can produce such a hit: the two primitives in `skip` are left out (TWO_TRIANGLES_BIT). This needs no epsilon.
INLINE uint intersect_triangles(__global const float8* block, uint part, const Ray* ray, uint2 skip, float t_max,
                                FloatLanes* t, FloatLanes* u, FloatLanes* v)
{
    __global const FloatLanes* rows = (__global const FloatLanes*)block + part;
    const int second = 3 * (int)BVH_PARTS, third = 2 * second;  // to the rows of the second and third corners
    const int4 k = ray->axis * (int)BVH_PARTS;
    const float4 o = ray->permuted_origin, s = ray->shear;
    __global const FloatLanes *x = rows + k.x, *y = rows + k.y, *z = rows + k.z;
    const FloatLanes az = z[0] - o.z, bz = z[second] - o.z, cz = z[third] - o.z;
    const FloatLanes ax = (x[0] - o.x) - s.x * az, ay = (y[0] - o.y) - s.y * az;
    const FloatLanes bx = (x[second] - o.x) - s.x * bz, by = (y[second] - o.y) - s.y * bz;
    const FloatLanes cx = (x[third] - o.x) - s.x * cz, cy = (y[third] - o.y) - s.y * cz;
    const FloatLanes edge_a = cx * by - cy * bx, edge_b = ax * cy - ay * cx, edge_c = bx * ay - by * ax;
    const FloatLanes min_edge = MIN(MIN(edge_a, edge_b), edge_c), max_edge = MAX(MAX(edge_a, edge_b), edge_c);
    const FloatLanes determinant = edge_a + edge_b + edge_c;
    const IntLanes inside = ((min_edge >= 0.0f) | (max_edge <= 0.0f)) & (determinant != 0.0f);
    const FloatLanes inverse = 1.0f / determinant;
    *t = (edge_a * az + edge_b * bz + edge_c * cz) * s.z * inverse;
    *u = edge_b * inverse;
    *v = edge_c * inverse;
    const UintLanes ids = AS_UINT_LANES(rows[third + second]);
    const IntLanes hits = inside & (*t > 0.0f) & (*t < t_max) & (ids != skip.x);
#if FEATURE_PARALLELOGRAM_LIGHTS
    const uint end = skip.y & ~TWO_TRIANGLES_BIT;
    return LANE_BITS(hits & (ids != end) & (ids != (skip.y & TWO_TRIANGLES_BIT ? end + 1u : end)));
#else
    return LANE_BITS(hits & (ids != skip.y));
#endif
}
#endif
