// A ray against a node and against a block of triangles of the 8-wide bounding volume hierarchy, whose layout is told in
// host/isonoise/scene/bvh.py.
#pragma once
#include "geometry/instance.h"
#include "util/math.h"

#define NODE_ROWS 7u

// The walk of one ray is not done for many paths at once, so its triples are vectors; of four, all of which have a value.
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
    // What takes a plane of a box to its distance along the ray: plane * scale + shift. Near planes are rounded down and far ones
    // up, by more than all roundings can add up to, so that none ever loses a child.
    float4 near_scale, near_shift, far_scale, far_shift;
    int4 flip;          // from a node's row of lower planes to that of the near ones: 3 for negative directions, else 0
    int4 axis;          // x, y, z permuted so that |direction| is largest along the last
    float4 shear;       // Woop's shear constants for the permuted axes
    float4 permuted;    // origin, permuted
} Ray;

INLINE Ray make_ray(float4 origin, float4 direction)
{
    Ray ray;
    ray.origin = origin;
    ray.direction = direction;
    const float4 size = abs_float4(direction);
    // A component of zero becomes one that moves the ray by nothing that counts and keeps the shifts finite.
    const float4 least = 1e-37f * (1.0f + abs_float4(origin));
    const float4 inverse = 1.0f / (size < least ? copy_sign_float4(least, direction) : direction);
    // Every operation rounds by 2^-24 of its result. What is lost of a shift does not become smaller where it cancels against a
    // plane: at most 5 of them, taken off and added. The others widen the far side: Ize, "Robust BVH Ray Traversal", JCGT 2013.
    const float4 shift = -origin * inverse, rounding = 0x1.8p-22f * abs_float4(shift);
    ray.near_scale = inverse;
    ray.near_shift = shift - rounding;
    ray.far_scale = inverse * 1.0000008f;
    ray.far_shift = shift * 1.0000008f + rounding;
    ray.flip = inverse < 0.0f ? (int4)(3) : (int4)(0);
    const int kz = size.x > size.y ? (size.x > size.z ? 0 : 2) : (size.y > size.z ? 1 : 2);
    const int next = kz == 2 ? 0 : kz + 1, after = 3 - kz - next;
    Float4Lanes d, o;  // by number from memory: a choice among three components takes five instructions
    d.all = direction;
    o.all = origin;
    // exchanging the first two axes keeps the orientation of triangles for negative directions
    const bool flip = d.lane[kz] < 0.0f;
    ray.axis = (int4)(flip ? after : next, flip ? next : after, kz, 0);
    const float scale = 1.0f / d.lane[kz];
    ray.shear = (float4)(d.lane[ray.axis.x] * scale, d.lane[ray.axis.y] * scale, scale, 0.0f);
    ray.permuted = (float4)(o.lane[ray.axis.x], o.lane[ray.axis.y], o.lane[kz], 0.0f);
    return ray;
}

#if FEATURE_INSTANCES
// The same for a ray of the world, in the space of an instance's group.
INLINE Ray make_object_ray(__global const Instance* instance, float4 origin, float4 direction)
{
    Vec3 o = from_float4(origin), d = from_float4(direction);
    ray_to_object(instance, &o, &d);
    return make_ray(to_float4(o), to_float4(d));
}
#endif

// Which of the node's children the ray meets before t_max, as bits; `entry` gets the distances at which it enters them.
INLINE uint intersect_node(__global const float8* node, const Ray* ray, float t_max, float8* entry)
{
    const int4 flip = ray->flip;
    const float4 near = ray->near_scale, near_by = ray->near_shift, far = ray->far_scale, far_by = ray->far_shift;
    __global const float8 *near_row_x = node + flip.x, *near_row_y = node + flip.y + 1, *near_row_z = node + flip.z + 2;
    __global const float8 *far_row_x = node - flip.x + 3, *far_row_y = node - flip.y + 4, *far_row_z = node - flip.z + 5;
    const float8 near_x = MAD8(*near_row_x, near.x, near_by.x), far_x = MAD8(*far_row_x, far.x, far_by.x);
    const float8 near_y = MAD8(*near_row_y, near.y, near_by.y), far_y = MAD8(*far_row_y, far.y, far_by.y);
    const float8 near_z = MAD8(*near_row_z, near.z, near_by.z), far_z = MAD8(*far_row_z, far.z, far_by.z);
    const float8 near_yz = MAX(near_y, near_z), near_x0 = MAX(near_x, (float8)(0.0f));
    const float8 far_yz = MIN(far_y, far_z), far_xt = MIN(far_x, (float8)(t_max));
    *entry = MAX(near_yz, near_x0);
    return mask_bits(*entry <= MIN(far_yz, far_xt));
}

#if FEATURE_TRIANGLES
// The ray against the 8 triangles of a block: bits of those met in (0, t_max), their distances and barycentric coordinates
// (of the second and third corner). Woop, Benthin, Wald, "Watertight Ray/Triangle Intersection", JCGT 2013, without the
// double precision fall-back: an edge function that rounds to zero counts as inside for both neighbours, so nothing leaks.
// The edge functions are written without fma: then neighbours get exactly opposite values on a shared edge.
// A plane cannot be met again by a ray that starts or ends on it, but rounding can say so: the two primitives in `skip` are left
// out, which needs no epsilon.
INLINE uint intersect_triangle_block(__global const float8* block, const Ray* ray, uint2 skip, float t_max, float8* t, float8* u, float8* v)
{
    const int4 k = ray->axis;
    const float4 o = ray->permuted, s = ray->shear;
    __global const float8 *x = block + k.x, *y = block + k.y, *z = block + k.z;
    const float8 az = z[0] - o.z, bz = z[3] - o.z, cz = z[6] - o.z;
    const float8 ax = (x[0] - o.x) - s.x * az, ay = (y[0] - o.y) - s.y * az;
    const float8 bx = (x[3] - o.x) - s.x * bz, by = (y[3] - o.y) - s.y * bz;
    const float8 cx = (x[6] - o.x) - s.x * cz, cy = (y[6] - o.y) - s.y * cz;
    const float8 edge_a = cx * by - cy * bx, edge_b = ax * cy - ay * cx, edge_c = bx * ay - by * ax;
    const float8 lowest = MIN(MIN(edge_a, edge_b), edge_c), highest = MAX(MAX(edge_a, edge_b), edge_c);
    const float8 determinant = edge_a + edge_b + edge_c;
    const int8 inside = ((lowest >= 0.0f) | (highest <= 0.0f)) & (determinant != 0.0f);
    const float8 inverse = 1.0f / determinant;
    *t = (edge_a * az + edge_b * bz + edge_c * cz) * s.z * inverse;
    *u = edge_b * inverse;
    *v = edge_c * inverse;
    const uint8 ids = as_uint8(block[9]);
    return mask_bits(inside & (*t > 0.0f) & (*t < t_max) & (ids != skip.x) & (ids != skip.y));
}
#endif
